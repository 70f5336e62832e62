"""The kinematic network: the 420 movements with every normalizer, and longer than the paper's.

An iteration is Eq. 2 with d = 10, and the normalization (paper, Sect. "Results", MMC network).
The tables give the schedule that the published figures were made with ("delayed"), and the one
that the equations are printed for ("synchronous"): see `network.model`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from mmc_gym.network.chain import Floats
from mmc_gym.network.model import MMCNetwork
from mmc_gym.network.normalizers import Normalizer
from mmc_gym.paper.experiment import Experiment, Progress, Result, Row, Settings
from mmc_gym.paper.figures import DISTANCE, draw_courses, draw_final_distances
from mmc_gym.paper.protocol import (
    ACCURATE,
    EUCLIDEAN,
    all_normalizers,
    over_runs,
    pooled,
    record_movements,
    summarize_networks,
)
from mmc_gym.paper.published import (
    KINEMATIC_COURSE,
    KINEMATIC_DISTANCES,
    KINEMATIC_FAR,
)

ITERATIONS = 100
LONG = 500
DELAYED = MMCNetwork(schedule="delayed")
SYNCHRONOUS = MMCNetwork(schedule="synchronous")


def run(settings: Settings, progress: Progress) -> Result:
    """Run the movements with every normalizer, in both schedules."""
    normalizers = all_normalizers(settings, progress)
    table = summarize_networks((DELAYED, SYNCHRONOUS), normalizers, ITERATIONS, progress)
    shown = [name for name in (EUCLIDEAN, "[16]", "[16, 16]") if name in normalizers]
    courses = {
        name: pooled(DELAYED, normalizers[name], ITERATIONS, ITERATIONS)[0] for name in shown
    }
    finals = {
        name: final_distances(runs)
        for name, runs in normalizers.items()
        if name not in (EUCLIDEAN, ACCURATE)
    }
    euclidean = courses[EUCLIDEAN][:, -1]
    longer = {name: longer_course(normalizers[name]) for name in (*shown, ACCURATE)}
    return Result(
        rows=(*_distance_rows(table), *_schedule_rows(table), *_longer_rows(longer)),
        figures={
            "kinematic_distance": draw_courses({DISTANCE: courses}),
            "final_distance": draw_final_distances(
                list(finals), list(finals.values()), euclidean, EUCLIDEAN, ITERATIONS
            ),
        },
        captions={
            "kinematic_distance": f"Normalized distance of the hand from the target over the 420 "
            f"movements, kinematic network, d = 10; learned normalizers: all "
            f"{len(normalizers[shown[-1]])} trained networks together.",
            "final_distance": f"Normalized distance after {ITERATIONS} iterations by the hidden "
            "units of the normalization network; dashed: Euclidean normalization.",
        },
        data={
            "kinematic_networks": table,
            "kinematic_courses": courses,
            "final_distances": {**finals, EUCLIDEAN: euclidean},
            "longer": pd.DataFrame(
                longer, index=pd.RangeIndex(1, LONG + 1, name="iteration")
            ).reset_index(),
        },
        points={
            3: "; ".join(
                f"{name} {course[ITERATIONS - 1]:.4f} after {ITERATIONS} iterations, "
                f"{course[-1]:.4f} after {LONG}"
                for name, course in longer.items()
            ),
            4: ", ".join(
                f"{name} {finals[name].mean() / euclidean.mean():.1f} times"
                for name in ("[16, 16]", "[16]")
                if name in finals
            )
            + f" the Euclidean one (all trained networks); {ACCURATE} "
            f"{final_distances(normalizers[ACCURATE]).mean() / euclidean.mean():.3f} times",
        },
    )


def final_distances(normalizers: Sequence[Normalizer]) -> Floats:
    """Distances after 100 iterations with each normalizer, (normalizers, movements)."""
    return np.stack(
        [
            record_movements(replace(DELAYED, normalizer=normalizer), ITERATIONS).distance[:, -1]
            for normalizer in normalizers
        ]
    )


def longer_course(normalizers: Sequence[Normalizer]) -> Floats:
    """Mean distance of the movements, and normalizers, over 500 iterations, (500,)."""
    distance, _ = pooled(DELAYED, normalizers, LONG, ITERATIONS)
    mean: Floats = distance.mean(axis=0)
    return mean


def _distance_rows(table: pd.DataFrame) -> list[Row]:
    delayed = table[table["schedule"] == "delayed"]
    rows = []
    for name, runs in delayed.groupby("normalizer", sort=False):
        several = f", {len(runs)} networks: mean (least to most)" if len(runs) > 1 else ""
        rows.append(
            Row(
                f"{name}: distance after {ITERATIONS} iterations, mean ± sd",
                paper="“close to the exact solution”" if name == "[16, 16]" else None,
                data=KINEMATIC_DISTANCES.get(str(name)),
                ours=f"{over_runs(runs['final'])} ± {runs['deviation'].mean():.4f}",
                unit="of start to target",
                note=f"delayed; published: one network{several}" if several else "delayed",
            )
        )
        rows.append(
            Row(
                f"{name}: movements that end above 0.1",
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


def _longer_rows(longer: dict[str, Floats]) -> list[Row]:
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


EXPERIMENT = Experiment(
    "kinematic", "420 movements of the kinematic network with every normalizer", run
)
