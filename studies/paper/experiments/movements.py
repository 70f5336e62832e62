"""Run the paper's movements with its kinematic and dynamic networks, and its example.

An iteration of the kinematic network is Eq. 2 with d = 10, and the normalization; in the dynamic
network segments have velocities, Eqs. 3 and 4 with d_v = 5 (paper, Sect. "Results").  The tables
have both schedules and both velocity rules of `network.model`.  The published figures were made
with the schedule "delayed" and the rule "reference".
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import product
from typing import get_args

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.signal import find_peaks

from mmc_gym.geometry import Floats
from mmc_gym.measures.episode import MOVING, moving_part
from mmc_gym.measures.speed import peakedness, phase_of_peak
from mmc_gym.network.model import MMCNetwork, Schedule
from mmc_gym.network.normalizers import EuclideanNormalizer, Normalizer
from studies.paper.experiment import (
    Captioned,
    ExperimentSettings,
    Result,
    ResultRow,
    how_many,
    over_runs,
)
from studies.paper.figures import (
    DISTANCE,
    VELOCITY,
    draw_courses,
    draw_final_distances,
    draw_postures,
    draw_profiles,
)
from studies.paper.networks import trained_architectures
from studies.paper.protocol import (
    ACCURATE,
    EUCLIDEAN,
    FAR,
    INNER,
    SECOND_PEAK,
    Recording,
    all_normalizers,
    each,
    record_example,
    record_runs,
    summarize_networks,
)
from studies.paper.published import (
    CLASSICAL_PUBLISHED,
    DYNAMIC_EUCLIDEAN,
    DYNAMIC_PUBLISHED,
    KINEMATIC_COURSE,
    KINEMATIC_PUBLISHED,
    PublishedDynamics,
)

KINEMATIC_ITERATIONS, LONG = 100, 500
DYNAMIC_ITERATIONS, SHAPE_ITERATIONS = 40, 100

HIDDEN = "[16, 16]"
CLASSICAL = MMCNetwork(schedule="delayed")
SYNCHRONOUS = MMCNetwork(schedule="synchronous")
DYNAMIC = replace(CLASSICAL, dynamics="reference")
UNDECAYED = replace(DYNAMIC, velocity_decay=1.0)
NETWORKS: tuple[MMCNetwork, ...] = (
    CLASSICAL,
    *(
        MMCNetwork(dynamics=dynamics, velocity_decay=decay, schedule=schedule)
        for schedule, (dynamics, decay) in product(get_args(Schedule), DYNAMIC_PUBLISHED)
    ),
)
"""Networks of the dynamic experiment."""

_of_distance = partial(ResultRow, unit="of start to target")
_of_movements = partial(ResultRow, unit="of 420")


def kinematic(settings: ExperimentSettings) -> Result:
    """Run the 420 movements of the kinematic network, also for longer than the paper does."""
    normalizers = all_normalizers(settings)
    networks = (CLASSICAL, SYNCHRONOUS)
    table = summarize_networks(networks, normalizers, KINEMATIC_ITERATIONS)
    shown = (EUCLIDEAN, "[16]", HIDDEN)
    courses = {
        name: record_runs(CLASSICAL, normalizers[name], KINEMATIC_ITERATIONS).distance
        for name in shown
    }
    finals = {name: final_distances(runs) for name, runs in normalizers.items()}
    euclidean, accurate = finals.pop(EUCLIDEAN)[0], finals.pop(ACCURATE)
    longer = {name: longer_course(normalizers[name]) for name in (*shown, ACCURATE)}
    times = [
        f"{name} {finals[name].mean() / euclidean.mean():.1f} times" for name in (HIDDEN, "[16]")
    ]
    return Result(
        rows=[*_kinematic_rows(table), *_course_rows(table), *_longer_rows(longer)],
        figures={
            "kinematic_distance": Captioned(
                draw_courses({DISTANCE: courses}),
                "Normalized distance of the hand from the target over the 420 movements, kinematic "
                "network, d = 10; learned normalizers: all "
                f"{len(normalizers[HIDDEN])} trained networks together.",
            ),
            "final_distance": Captioned(
                draw_final_distances(finals, euclidean),
                f"Normalized distance after {KINEMATIC_ITERATIONS} iterations by the hidden units "
                "of the normalization network; dashed: Euclidean normalization.",
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
                f"{name} {course[KINEMATIC_ITERATIONS - 1]:.4f} after {KINEMATIC_ITERATIONS} "
                f"iterations, {course[-1]:.4f} after {LONG}"
                for name, course in longer.items()
            ),
            4: f"{', '.join(times)} the Euclidean one (all trained networks); {ACCURATE} "
            f"{accurate.mean() / euclidean.mean():.3f} times",
        },
    )


def final_distances(normalizers: Sequence[Normalizer]) -> Floats:
    """Return distances after 100 iterations with each normalizer, (normalizers, movements)."""
    final = record_runs(CLASSICAL, normalizers, KINEMATIC_ITERATIONS).distance[:, -1]
    return final.reshape(len(normalizers), -1)


def longer_course(normalizers: Sequence[Normalizer]) -> Floats:
    """Return the mean distance over movements and normalizers, for 500 iterations, (500,)."""
    recording = record_runs(CLASSICAL, normalizers, LONG, KINEMATIC_ITERATIONS)
    mean: Floats = recording.distance.mean(axis=0)
    return mean


def _kinematic_rows(table: pd.DataFrame) -> list[ResultRow]:
    delayed = table[table["schedule"] == "delayed"]
    rows = []
    for name, runs in delayed.groupby("normalizer", sort=False):
        distance, far = KINEMATIC_PUBLISHED.get(str(name), (None, None))
        several = how_many(len(runs))
        rows += [
            _of_distance(
                f"{name}: distance after {KINEMATIC_ITERATIONS} iterations, mean ± sd",
                paper="“close to the exact solution”" if name == HIDDEN else None,
                data=distance,
                ours=f"{over_runs(runs['final'])} ± {runs['deviation'].mean():.4f}",
                note=f"delayed; published: one network, {several}" if several else "delayed",
            ),
            _of_movements(
                f"{name}: movements that end above {FAR}",
                data=far,
                ours=over_runs(runs["far"], ".0f"),
            ),
        ]
    return rows


def _course_rows(table: pd.DataFrame) -> list[ResultRow]:
    rows = []
    for network in (CLASSICAL, SYNCHRONOUS):
        measured = _of(table, network, EUCLIDEAN).iloc[0]
        published = network is CLASSICAL
        rows += [
            _of_distance(
                f"{EUCLIDEAN}, {network.schedule}: mean distance after {iteration} iterations",
                data=f"{value:.5f}" if published else None,
                ours=f"{measured[f'distance_{iteration}']:.5f}",
                note="" if published else "the schedule that the equations are printed for",
            )
            for iteration, value in KINEMATIC_COURSE.items()
        ]
    return rows


def _longer_rows(longer: Mapping[str, Floats]) -> list[ResultRow]:
    return [
        _of_distance(
            f"{name}: mean distance after {LONG} iterations",
            paper="“not further improving”" if name == EUCLIDEAN else None,
            data=0.0028 if name == EUCLIDEAN else None,
            ours=float(course[-1]),
            note=f"after {KINEMATIC_ITERATIONS}: {course[KINEMATIC_ITERATIONS - 1]:.4f}",
        )
        for name, course in longer.items()
    ]


def dynamic(settings: ExperimentSettings) -> Result:
    """Run the 420 movements with every rule, decay, schedule and normalizer."""
    normalizers = all_normalizers(settings)
    table = summarize_networks(NETWORKS, normalizers, DYNAMIC_ITERATIONS)
    exact, hidden = normalizers[EUCLIDEAN], normalizers[HIDDEN]
    classical, *followers = recordings = {
        "classical (Euclidean)": record_runs(CLASSICAL, exact, DYNAMIC_ITERATIONS),
        f"dynamic {HIDDEN}, decay 0.92": record_runs(DYNAMIC, hidden, DYNAMIC_ITERATIONS),
        f"dynamic {HIDDEN}, decay 1": record_runs(UNDECAYED, hidden, DYNAMIC_ITERATIONS),
    }
    distances = {name: recording.distance for name, recording in recordings.items()}
    velocities = {name: recording.velocity for name, recording in recordings.items()}
    means = {name: distance.mean(axis=0) for name, distance in distances.items()}
    overshoots, exact_overshoots = (
        over_runs(_of(table, DYNAMIC, name)["overshoots"], ".0f") for name in (HIDDEN, EUCLIDEAN)
    )
    return Result(
        rows=[*_dynamic_rows(table), *_euclidean_rows(table)],
        figures={
            "classical_and_dynamic": Captioned(
                draw_courses({DISTANCE: distances, VELOCITY: velocities}),
                "Normalized distance and velocity over the 420 movements: kinematic network with "
                f"Euclidean normalization, and dynamic network ({HIDDEN}, all trained networks "
                "together; rule of the published figures).",
            ),
        },
        data={
            "dynamic_networks": table,
            "dynamic_courses": {
                f"{quantity} {name}": getattr(recording, quantity)
                for name, recording in recordings.items()
                for quantity in ("distance", "velocity")
            },
        },
        points={
            1: "; ".join(
                f"{name}: {_catching_up(means[classical], means[name])}" for name in followers
            ),
            2: f"{overshoots} of 420 ({HIDDEN}, {len(hidden)} networks); "
            f"{exact_overshoots} with Euclidean normalization",
            5: _shapes_of_movements(exact, hidden),
            6: "both rules and both schedules, each in the table",
        },
    )


def catching_up(leader: ArrayLike, follower: ArrayLike) -> int | None:
    """Return the iteration, from 1, after which the follower is never farther; None without one.

    >>> catching_up([0.9, 0.5, 0.3, 0.2], [1.0, 0.5, 0.4, 0.1])
    4
    """
    behind = np.flatnonzero(np.asarray(follower) > np.asarray(leader))
    first = int(behind[-1]) + 2 if behind.size else 1
    return first if first <= np.size(leader) else None


def _catching_up(leader: Floats, follower: Floats) -> str:
    iteration = catching_up(leader, follower)
    if iteration:
        return f"at iteration {iteration}"
    return f"not within {len(leader)} iterations (ratio {follower[-1] / leader[-1]:.2f})"


def _shapes_of_movements(exact: Sequence[Normalizer], hidden: Sequence[Normalizer]) -> str:
    """Describe single movements by the definition that reproduces the published numbers.

    The data came without one.  It was sought among windows of a movement, medians and means, and
    sets of targets.
    """
    shapes = (
        f"classical {_shape(CLASSICAL, exact)}",
        f"dynamic (Euclidean) {_shape(DYNAMIC, exact)}",
        f"dynamic {HIDDEN} {_shape(DYNAMIC, hidden)}",
    )
    return (
        "peak over mean, time to peak (and as in bell-shaped, over all of 40 iterations): "
        f"{'; '.join(shapes)}. Medians between targets at radius 1 and 2 from the first to the "
        f"last of {SHAPE_ITERATIONS} iterations with {100 * MOVING:g} % of the peak velocity or "
        "more. The data came without a definition; this one was found by trial to give their "
        "numbers, with the Euclidean normalization"
    )


def _shape(network: MMCNetwork, normalizers: Sequence[Normalizer]) -> str:
    kinematic = network.dynamics == "kinematic"
    warm_iterations = KINEMATIC_ITERATIONS if kinematic else DYNAMIC_ITERATIONS
    velocity = record_runs(network, normalizers, SHAPE_ITERATIONS, warm_iterations).velocity
    velocity = velocity[np.tile(INNER, len(normalizers))]
    parts = [profile[moving_part(profile)] for profile in velocity]
    ratio = np.median([part.max() / part.mean() for part in parts])
    time = np.median([part.argmax() / part.size for part in parts])
    whole = velocity[:, :DYNAMIC_ITERATIONS]
    whole_ratio, whole_time = np.median(
        [each(peakedness, whole), each(phase_of_peak, whole)], axis=1
    )
    return f"{ratio:.2f}, {time:.2f} ({whole_ratio:.2f}, {whole_time:.2f})"


def _of(table: pd.DataFrame, network: MMCNetwork, normalizer: str) -> pd.DataFrame:
    """Return the rows of all runs of a normalizer in a network."""
    decay = network.velocity_decay
    return table[
        (table["dynamics"] == network.dynamics)
        & (table["schedule"] == network.schedule)
        & (table["decay"].fillna(decay) == decay)  # kinematic networks have none
        & (table["normalizer"] == normalizer)
    ]


def _dynamic_rows(table: pd.DataFrame) -> list[ResultRow]:
    classical = _of(table, CLASSICAL, EUCLIDEAN)
    rows = _network_rows("classical (Euclidean)", classical, CLASSICAL_PUBLISHED)
    for (dynamics, decay), published in DYNAMIC_PUBLISHED.items():
        network = replace(DYNAMIC, dynamics=dynamics, velocity_decay=decay)
        name = f"{HIDDEN}, rule “{dynamics}”, decay {decay:g}"
        rows += _network_rows(name, _of(table, network, HIDDEN), published)
    return rows


def _network_rows(name: str, runs: pd.DataFrame, published: PublishedDynamics) -> list[ResultRow]:
    peaks = zip(runs["peak_velocity"], runs["peak_iteration"], strict=True)
    decays = name.endswith("decay 0.92")
    return [
        *(
            _of_distance(
                f"{name}: mean distance after {iteration} iterations",
                data=value,
                ours=over_runs(runs[f"distance_{iteration}"]),
                note=how_many(len(runs)),
            )
            for iteration, value in published.distances.items()
        ),
        _of_distance(
            f"{name}: standard deviation after {DYNAMIC_ITERATIONS} iterations",
            data=published.deviation,
            ours=over_runs(runs["deviation"]),
        ),
        ResultRow(
            f"{name}: peak of the mean velocity, at iteration",
            data=published.peak,
            ours=", ".join(f"{peak:.4f} at {iteration:.0f}" for peak, iteration in peaks),
            unit="of start to target / iteration",
        ),
        _of_movements(
            f"{name}: movements that overshoot",
            paper="“no overshoot”" if decays else None,
            data=published.overshoots,
            ours=over_runs(runs["overshoots"], ".0f"),
            note="the paper says it of the example movement" if decays else "",
        ),
        _of_movements(
            f"{name}: movements with a second velocity peak",
            data=published.second_peaks,
            ours=over_runs(runs["second_peaks"], ".0f"),
        ),
    ]


def _euclidean_rows(table: pd.DataFrame) -> list[ResultRow]:
    rows = []
    for (dynamics, decay, schedule), published in DYNAMIC_EUCLIDEAN.items():
        network = MMCNetwork(dynamics=dynamics, velocity_decay=decay, schedule=schedule)
        measured = _of(table, network, EUCLIDEAN).iloc[0]
        rows.append(
            _of_distance(
                f"{EUCLIDEAN}, rule “{dynamics}”, decay {decay:g}, {schedule}: mean distance "
                f"after {', '.join(map(str, published))} iterations",
                data=", ".join(f"{value:.5f}" for value in published.values()),
                ours=", ".join(f"{measured[f'distance_{k}']:.5f}" for k in published),
                note="no learned weights: must agree to the digit",
            )
        )
    return rows


def example(settings: ExperimentSettings) -> Result:
    """Make the example movement, from the starting posture to (−1.8, 1.8) in 40 iterations.

    Figures and data show the first of the [16, 16] networks.
    """
    hidden = trained_architectures(settings, ((16, 16),))[HIDDEN].normalizers
    exact = "kinematic (Euclidean)"
    published = {exact: CLASSICAL_PUBLISHED}
    movements = {exact: _examples(CLASSICAL, [EuclideanNormalizer()])}
    for (dynamics, decay), values in DYNAMIC_PUBLISHED.items():
        name = f"dynamic {HIDDEN}, rule “{dynamics}”, decay {decay:g}"
        published[name] = values
        network = replace(DYNAMIC, dynamics=dynamics, velocity_decay=decay)
        movements[name] = _examples(network, hidden)
    kinematic_hidden = f"kinematic {HIDDEN}"
    first = {name: recordings[0] for name, recordings in movements.items()}
    first[kinematic_hidden] = _examples(CLASSICAL, hidden[:1])[0]
    _, decayed, undecayed, *_ = movements
    postures = {
        exact: first[exact],
        kinematic_hidden: first[kinematic_hidden],
        f"dynamic {HIDDEN}, decay 0.92": first[decayed],
    }
    velocities = {
        exact: first[exact].velocity,
        f"dynamic {HIDDEN}, decay 0.92": first[decayed].velocity,
        f"dynamic {HIDDEN}, decay 1": first[undecayed].velocity,
    }
    peaks = [second_peak(recording.velocity) for recording in movements[undecayed]]
    return Result(
        rows=[
            *(
                _of_distance(
                    f"{name}: distance after {DYNAMIC_ITERATIONS} iterations",
                    paper=published[name].example_in_text,
                    data=published[name].example,
                    ours=over_runs([recording.distance[-1] for recording in recordings], ".5f"),
                    note=how_many(len(recordings)),
                )
                for name, recordings in movements.items()
            ),
            ResultRow(
                f"{undecayed}: second velocity peak, at iteration",
                data="0.0139 at 28",
                ours=", ".join(f"{peak[0]:.4f} at {peak[1]}" if peak else "none" for peak in peaks),
                unit="of start to target / iteration",
                note="each network" if len(peaks) > 1 else "",
            ),
        ],
        figures={
            "example_postures": Captioned(
                draw_postures(postures),
                "Example movement: a posture every two iterations, the hand as dots.",
            ),
            "example_velocity": Captioned(
                draw_profiles({"": velocities}),
                "Velocity of the hand in the example movement: classical network, and dynamic "
                "network with and without velocity decay (rule “reference”).",
            ),
        },
        data={
            "example": {
                f"{part} {name}": getattr(recording, part)
                for name, recording in first.items()
                for part in ("segments", "distance", "velocity")
            }
        },
    )


def _examples(network: MMCNetwork, normalizers: Sequence[Normalizer]) -> list[Recording]:
    return [record_example(replace(network, normalizer=normalizer)) for normalizer in normalizers]


def second_peak(velocity: ArrayLike) -> tuple[float, int] | None:
    """Return height and iteration (from 1) of the highest peak after the main one, or None.

    A peak stands out by more than 5 % of the highest velocity (`SECOND_PEAK`).

    >>> second_peak([0.1, 1.0, 0.2, 0.3, 0.1]), second_peak([0.1, 1.0, 0.2])
    ((0.3, 4), None)
    """
    velocity = np.asarray(velocity, dtype=np.float64)
    first = int(velocity.argmax())
    after = velocity[first:]
    peaks, _ = find_peaks(after, prominence=SECOND_PEAK * velocity[first])
    if not peaks.size:
        return None
    second = int(peaks[after[peaks].argmax()])
    return float(after[second]), first + second + 1
