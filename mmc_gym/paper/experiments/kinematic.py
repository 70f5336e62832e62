"""The kinematic network: the 420 movements with every normalizer, and longer than the paper's.

An iteration is Eq. 2 with d = 10, and the normalization (paper, Sect. "Results", MMC network).
The tables give the schedule that the published figures were made with ("delayed"), and the one
that the equations are printed for ("synchronous"): see `network.model`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from mmc_gym._plotting import COLOURS
from mmc_gym.network.chain import Floats
from mmc_gym.network.model import MMCNetwork
from mmc_gym.network.normalizers import Normalizer
from mmc_gym.paper.experiment import (
    Captioned,
    Result,
    Row,
    Settings,
    experiment,
    how_many,
    over_runs,
)
from mmc_gym.paper.figures import DISTANCE, draw_courses, make_panels, styled
from mmc_gym.paper.protocol import (
    ACCURATE,
    EUCLIDEAN,
    FAR,
    all_normalizers,
    record_runs,
    summarize_networks,
)
from mmc_gym.paper.published import KINEMATIC_COURSE, KINEMATIC_DISTANCES, KINEMATIC_FAR

ITERATIONS = 100
LONG = 500
DELAYED = MMCNetwork(schedule="delayed")
SYNCHRONOUS = MMCNetwork(schedule="synchronous")


@experiment("kinematic", "420 movements of the kinematic network with every normalizer")
def run(settings: Settings) -> Result:
    """Run the movements with every normalizer, in both schedules."""
    normalizers = all_normalizers(settings)
    table = summarize_networks(settings, (DELAYED, SYNCHRONOUS), normalizers, ITERATIONS)
    shown = [name for name in (EUCLIDEAN, "[16]", "[16, 16]") if name in normalizers]
    courses = {name: record_runs(DELAYED, normalizers[name], ITERATIONS).distance for name in shown}
    finals = {name: final_distances(runs) for name, runs in normalizers.items()}
    euclidean, accurate = finals.pop(EUCLIDEAN)[0], finals.pop(ACCURATE)
    longer = {name: longer_course(normalizers[name]) for name in (*shown, ACCURATE)}
    times = [
        f"{name} {finals[name].mean() / euclidean.mean():.1f} times"
        for name in ("[16, 16]", "[16]")
        if name in finals
    ]
    return Result(
        rows=[*_distance_rows(table), *_schedule_rows(table), *_longer_rows(longer)],
        figures={
            "kinematic_distance": Captioned(
                draw_courses({DISTANCE: courses}),
                "Normalized distance of the hand from the target over the 420 movements, kinematic "
                "network, d = 10; learned normalizers: all "
                f"{len(normalizers[shown[-1]])} trained networks together.",
            ),
            "final_distance": Captioned(
                draw_final_distances(finals, euclidean),
                f"Normalized distance after {ITERATIONS} iterations by the hidden units of the "
                "normalization network; dashed: Euclidean normalization.",
            ),
        },
        data={
            "kinematic_networks": table,
            "kinematic_courses": courses,
            "final_distances": {**finals, EUCLIDEAN: euclidean},
            "longer": pd.DataFrame({"iteration": np.arange(1, LONG + 1), **longer}),
        },
        points={
            3: "; ".join(
                f"{name} {course[ITERATIONS - 1]:.4f} after {ITERATIONS} iterations, "
                f"{course[-1]:.4f} after {LONG}"
                for name, course in longer.items()
            ),
            4: f"{', '.join(times)} the Euclidean one (all trained networks); {ACCURATE} "
            f"{accurate.mean() / euclidean.mean():.3f} times",
        },
    )


def final_distances(normalizers: Sequence[Normalizer]) -> Floats:
    """Return distances after 100 iterations with each normalizer, (normalizers, movements)."""
    final = record_runs(DELAYED, normalizers, ITERATIONS).distance[:, -1]
    return final.reshape(len(normalizers), -1)


def longer_course(normalizers: Sequence[Normalizer]) -> Floats:
    """Return the mean distance of movements and normalizers over 500 iterations, (500,)."""
    mean: Floats = record_runs(DELAYED, normalizers, LONG).distance.mean(axis=0)
    return mean


def _distance_rows(table: pd.DataFrame) -> list[Row]:
    delayed = table[table["schedule"] == "delayed"]
    rows = []
    for name, runs in delayed.groupby("normalizer", sort=False):
        several = how_many(len(runs))
        rows.append(
            Row(
                f"{name}: distance after {ITERATIONS} iterations, mean ± sd",
                paper="“close to the exact solution”" if name == "[16, 16]" else None,
                data=KINEMATIC_DISTANCES.get(str(name)),
                ours=f"{over_runs(runs['final'])} ± {runs['deviation'].mean():.4f}",
                unit="of start to target",
                note=f"delayed; published: one network, {several}" if several else "delayed",
            )
        )
        rows.append(
            Row(
                f"{name}: movements that end above {FAR}",
                data=KINEMATIC_FAR.get(str(name)),
                ours=over_runs(runs["far"], ".0f"),
                unit="of 420",
            )
        )
    return rows


def _schedule_rows(table: pd.DataFrame) -> list[Row]:
    rows = []
    published: dict[str, dict[int, float | None]] = {
        "delayed": {**KINEMATIC_COURSE},
        "synchronous": dict.fromkeys(KINEMATIC_COURSE),
    }
    for schedule, course in published.items():
        found = table[(table["schedule"] == schedule) & (table["normalizer"] == EUCLIDEAN)].iloc[0]
        rows += [
            Row(
                f"{EUCLIDEAN}, {schedule}: mean distance after {iteration} iterations",
                data=f"{value:.5f}" if value else None,
                ours=f"{found[f'distance_{iteration}']:.5f}",
                unit="of start to target",
                note="" if value else "the schedule that the equations are printed for",
            )
            for iteration, value in course.items()
        ]
    return rows


def _longer_rows(longer: Mapping[str, Floats]) -> list[Row]:
    return [
        Row(
            f"{name}: mean distance after {LONG} iterations",
            paper="“not further improving”" if name == EUCLIDEAN else None,
            data=0.0028 if name == EUCLIDEAN else None,
            ours=float(course[-1]),
            unit="of start to target",
            note=f"after {ITERATIONS}: {course[ITERATIONS - 1]:.4f}",
        )
        for name, course in longer.items()
    ]


@styled
def draw_final_distances(runs: Mapping[str, Floats], reference: Floats) -> Figure:
    """Draw the mean final distance of each run, and mean ± deviation over the movements of all.

    Args:
        runs: final distances by architecture, (runs, movements).
        reference: final distances with the Euclidean normalization, (movements,).
    """
    places = np.arange(len(runs))
    means = np.array([of_runs.mean() for of_runs in runs.values()])
    deviations = np.array([of_runs.std() for of_runs in runs.values()])
    figure, (axes,) = make_panels(1, max(0.5 * len(runs) + 1.2, 4.2), 3.1)
    axes.fill_between(
        places,
        np.maximum(means - deviations, 0),
        means + deviations,
        color=COLOURS[0],
        alpha=0.15,
        linewidth=0,
        label="± standard deviation over movements",
    )
    axes.plot(places, means, color=COLOURS[0], marker="o", markersize=4, label="mean")
    for place, of_runs in zip(places, runs.values(), strict=True):
        label = "mean of one trained network" if place == 0 else None
        of_each = of_runs.mean(axis=1)
        at = np.full(len(of_each), place)
        axes.plot(at, of_each, "_", color="black", markersize=7, label=label)
    axes.axhline(float(reference.mean()), color=COLOURS[1], linestyle="--", label=EUCLIDEAN)
    axes.set_xticks(places, list(runs), rotation=45, ha="right", rotation_mode="anchor")
    axes.set(
        xlabel="hidden units of the normalization network",
        ylabel=f"distance after {ITERATIONS} iterations\n[of start to target]",
        ylim=(0, 1.3 * float((means + deviations).max())),  # the legend stands above
    )
    axes.legend(frameon=False, ncols=2, loc="upper center")
    return figure
