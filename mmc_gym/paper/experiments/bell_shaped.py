"""Bettered: movements that are bell-shaped each, not only on average, by a time base.

The paper's dynamic network has a bell-shaped velocity profile on average over the 420 movements.
Here the kinematic network is given a gain that varies in time, such that in iteration k of T

    |x_k − x_{k−1}| = σ_k |R − x_{k−1}|,     σ_k = (ξ_k − ξ_{k−1}) / (1 − ξ_{k−1}),

x the hand and ξ the minimum-jerk time base: see `network.time_base`.  Each movement, the warm one
too, takes all of its iterations.  Beside it, through the same code: the paper's networks, and a
hand that moves straight from start to target with minimum jerk.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mmc_gym.network.chain import Floats
from mmc_gym.network.model import MMCNetwork, MMCState
from mmc_gym.network.normalizers import LearnedNormalizer
from mmc_gym.network.time_base import minimum_jerk, timed_trajectory
from mmc_gym.paper.experiment import Experiment, Progress, Result, Row, Settings
from mmc_gym.paper.figures import (
    DISTANCE,
    VELOCITY,
    draw_courses,
    draw_profiles,
    draw_shares,
)
from mmc_gym.paper.protocol import (
    ACCURATE,
    FAR,
    OVERSHOOT,
    PAIRS,
    STARTING_SEGMENTS,
    TARGETS,
    Recording,
    record_movements,
    shapes,
)

ITERATIONS = (40, 100)
MINIMUM_JERK = "minimum jerk"
TIME_BASE = "time base (Euclidean)"
CLASSICAL = "kinematic (Euclidean)"
DYNAMIC = "dynamic (paper's recipe [16, 16]), decay 0.92"

_SHOWN = (DYNAMIC, CLASSICAL, TIME_BASE, MINIMUM_JERK)
_EXAMPLES = ((7, 10), (0, 8), (14, 18))  # pairs of targets: middle, inward out, stretched


def record_timed_movements(network: MMCNetwork, iterations: int) -> Recording:
    """The 420 movements on a time base, each as long as its recording; the warm one as well."""
    start, target = TARGETS[PAIRS[:, 0]], TARGETS[PAIRS[:, 1]]
    state = network.state_from_segments(STARTING_SEGMENTS)
    warm, _ = timed_trajectory(network, state, TARGETS, iterations)
    state = MMCState(np.ascontiguousarray(warm.values[..., PAIRS[:, 0]]), warm.segment_count)
    _, segments = timed_trajectory(network, state, target, iterations)
    return Recording(state.segments, np.moveaxis(segments, 0, -3), start, target)


def minimum_jerk_movements(iterations: int) -> Recording:
    """A hand on the straight line from start to target with minimum jerk, 420 times.

    There is no arm: each of the three vectors of a posture is a third of the hand's position.
    """
    start, target = TARGETS[PAIRS[:, 0]], TARGETS[PAIRS[:, 1]]
    covered = minimum_jerk(np.arange(iterations + 1) / iterations)[:, None]
    hand = start[:, None] + covered * (target - start)[:, None]
    thirds = np.repeat(hand[:, :, None] / 3, 3, axis=2)
    return Recording(thirds[:, 0], thirds[:, 1:], start, target)


def movers() -> dict[str, Callable[[int], Recording]]:
    """What makes the 420 movements in a given number of iterations, by name."""
    accurate, paper = LearnedNormalizer.shipped("accurate"), LearnedNormalizer.shipped("paper")
    networks: Mapping[str, MMCNetwork] = {
        f"{CLASSICAL}, synchronous": MMCNetwork(),
        CLASSICAL: MMCNetwork(schedule="delayed"),
        DYNAMIC: MMCNetwork(schedule="delayed", dynamics="reference", normalizer=paper),
        "dynamic (Euclidean), decay 0.92": MMCNetwork(schedule="delayed", dynamics="reference"),
        "dynamic (Euclidean), decay 1": MMCNetwork(
            schedule="delayed", dynamics="reference", velocity_decay=1.0
        ),
        "dynamic (Euclidean), rule “paper”, decay 0.92": MMCNetwork(
            schedule="delayed", dynamics="paper"
        ),
    }
    timed = {
        TIME_BASE: MMCNetwork(),
        f"time base ({ACCURATE})": MMCNetwork(normalizer=accurate),
        "time base (paper's recipe [16, 16])": MMCNetwork(normalizer=paper),
    }
    return {
        MINIMUM_JERK: minimum_jerk_movements,
        **{name: partial(record_timed_movements, network) for name, network in timed.items()},
        **{name: partial(_faithful, network) for name, network in networks.items()},
    }


def _faithful(network: MMCNetwork, iterations: int) -> Recording:
    return record_movements(network, iterations, warm_iterations=iterations)


def run(settings: Settings, progress: Progress) -> Result:
    """Measure how bell-shaped the movements of all networks are."""
    makers = movers()
    recordings: dict[tuple[str, int], Recording] = {}
    found: dict[tuple[str, int], dict[str, NDArray[np.float64]]] = {}
    total = len(makers) * len(ITERATIONS)
    for name, make in makers.items():
        for iterations in ITERATIONS:
            progress(len(found), total)
            recordings[name, iterations] = make(iterations)
            found[name, iterations] = shapes(recordings[name, iterations])
    progress(total, total)
    shown = {name: recordings[name, ITERATIONS[0]] for name in _SHOWN}
    correlations = {name: found[name, ITERATIONS[0]]["correlation"] for name in _SHOWN[:-1]}
    return Result(
        rows=tuple(row for name in makers for row in _rows(name, found)),
        figures={
            "bell_shape": draw_courses(
                {
                    DISTANCE: {name: recording.distance for name, recording in shown.items()},
                    VELOCITY: {name: recording.velocity for name, recording in shown.items()},
                }
            ),
            "bell_shape_examples": draw_profiles(
                {
                    _label(_movement(pair)): {
                        name: recording.velocity[_movement(pair)]
                        for name, recording in shown.items()
                    }
                    for pair in _EXAMPLES
                }
            ),
            "bell_shape_correlation": draw_shares(
                correlations, "correlation of velocity with minimum jerk"
            ),
        },
        captions={
            "bell_shape": "Normalized distance and velocity over the 420 movements in 40 "
            "iterations: the paper's networks, the kinematic network on a time base, and minimum "
            "jerk.",
            "bell_shape_examples": "Velocity in three movements (radius and angle of start and "
            "target).",
            "bell_shape_correlation": "Share of the 420 movements whose velocity profile has at "
            "most this correlation with minimum jerk (40 iterations).",
        },
        data={"bell_shape": _frame(found)},
    )


def _movement(pair: tuple[int, int]) -> int:
    return int(np.flatnonzero((np.array(pair) == PAIRS).all(axis=1))[0])


def _label(movement: int) -> str:
    """Start and target of a movement by radius and angle, such as "1, 60° → 2, 120°"."""
    first, second = (f"{target // 7 + 1}, {target % 7 * 30}°" for target in PAIRS[movement])
    return f"{first} → {second}"


def _labels(chosen: NDArray[np.bool_]) -> list[str]:
    return [_label(int(movement)) for movement in np.flatnonzero(chosen)]


def _frame(found: Mapping[tuple[str, int], Mapping[str, Floats]]) -> pd.DataFrame:
    """A row per mover, number of iterations, and movement."""
    labels = _labels(np.ones(len(PAIRS), dtype=bool))
    return pd.concat(
        [
            pd.DataFrame({"name": name, "iterations": iterations, "movement": labels, **columns})
            for (name, iterations), columns in found.items()
        ]
    )


def _rows(name: str, found: Mapping[tuple[str, int], Mapping[str, Floats]]) -> list[Row]:
    """A row per measure, with 40 and 100 iterations side by side."""
    both = [found[name, iterations] for iterations in ITERATIONS]
    classical = [found[CLASSICAL, iterations]["final"] for iterations in ITERATIONS]
    quantities: list[tuple[str, str, list[str], str]] = [
        (
            "correlation of velocity with minimum jerk, median (5 % to 95 %)",
            "",
            [_spread(one["correlation"], ".3f") for one in both],
            "aim: 0.95 or more",
        ),
        (
            "peak over mean velocity, median (5 % to 95 %)",
            "",
            [_spread(one["peak_to_mean"], ".2f") for one in both],
            "aim: 1.8 to 2.0",
        ),
        (
            "time to peak, median (5 % to 95 %)",
            "of duration",
            [_spread(one["time_to_peak"], ".2f") for one in both],
            "aim: 0.45 to 0.55",
        ),
        (
            "movements with a single velocity peak",
            "%",
            [f"{100 * (one['velocity_peaks'] == 1).mean():.1f}" for one in both],
            "aim: 95 or more",
        ),
        (
            "movements that overshoot",
            "of 420",
            [f"{(one['overshoot'] > OVERSHOOT).sum()}" for one in both],
            "aim: 0",
        ),
        (
            "final distance, mean ± sd",
            "of start to target",
            [f"{one['final'].mean():.4f} ± {one['final'].std():.4f}" for one in both],
            "aim: no more than " + " and ".join(f"{final.mean():.4f}" for final in classical),
        ),
        (
            f"movements that end above {FAR}; farther than by the {CLASSICAL} network",
            "of 420",
            [
                f"{(one['final'] > FAR).sum()}; {(one['final'] > final).sum()}"
                for one, final in zip(both, classical, strict=True)
            ],
            "",
        ),
    ]
    if name == TIME_BASE:
        quantities.append(
            (
                "which have more velocity peaks (radius and angle)",
                "",
                ["; ".join(_labels(one["velocity_peaks"] > 1)) for one in both],
                "the arm folds or turns over, at the largest gain, and then rushes",
            )
        )
    first, second = ITERATIONS
    return [
        Row(f"{name}: {quantity}", ours=f"{first}: {a}; {second}: {b}", unit=unit, note=note)
        for quantity, unit, (a, b), note in quantities
    ]


def _spread(values: Floats, digits: str) -> str:
    low, median, high = np.nanpercentile(values, (5, 50, 95))
    return f"{median:{digits}} ({low:{digits}} to {high:{digits}})"


EXPERIMENT = Experiment("bell-shaped", "bettered: a time base makes each movement bell-shaped", run)
