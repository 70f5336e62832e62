"""Bettered: movements that are bell-shaped each, not only on average, by a time base.

The paper's dynamic network has a bell-shaped velocity profile on average over the 420 movements.
Here the kinematic network is given a gain that varies in time, such that in iteration k of T

    |x_k − x_{k−1}| = σ_k |R − x_{k−1}|,     σ_k = (ξ_k − ξ_{k−1}) / (1 − ξ_{k−1}),

x the hand and ξ the minimum-jerk time base: see `network.time_base`.  Each movement, the warm one
too, takes all of its iterations.  Beside it, through the same code: the paper's networks, and a
hand that moves straight from start to target with minimum jerk.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import product

import numpy as np
import pandas as pd

from mmc_gym.network.chain import Floats
from mmc_gym.network.model import MMCNetwork
from mmc_gym.network.normalizers import LearnedNormalizer
from mmc_gym.network.time_base import minimum_jerk, timed_trajectory
from mmc_gym.paper.experiment import Captioned, Result, Row, Settings, mean_and_deviation
from mmc_gym.paper.figures import DISTANCE, VELOCITY, draw_courses, draw_profiles, draw_shares
from mmc_gym.paper.protocol import (
    ACCURATE,
    FAR,
    OVERSHOOT,
    PAIRS,
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

record_timed_movements = partial(record_movements, move=timed_trajectory)
"""Runs the 420 movements, warm ones too, on a time base as long as the recording."""

_SHOWN = (DYNAMIC, CLASSICAL, TIME_BASE, MINIMUM_JERK)
_EXAMPLES = ([7, 10], [0, 8], [14, 18])  # pairs of targets: middle, inward out, stretched


def minimum_jerk_movements(iterations: int) -> Recording:
    """Move a hand on the straight line from start to target with minimum jerk, 420 times.

    There is no arm: each of the three vectors of a posture is a third of the hand's position.
    """
    start, target = TARGETS[PAIRS[:, 0]], TARGETS[PAIRS[:, 1]]
    covered = minimum_jerk(np.arange(iterations + 1) / iterations)[:, None]
    hand = start[:, None] + covered * (target - start)[:, None]
    thirds = np.repeat(hand[:, :, None] / 3, 3, axis=2)
    return Recording(thirds[:, 0], thirds[:, 1:], start, target)


def movers() -> dict[str, Callable[[int], Recording]]:
    """Return functions that make the 420 movements in a number of iterations, by name."""
    accurate, paper = LearnedNormalizer.shipped("accurate"), LearnedNormalizer.shipped("paper")
    timed, plain = record_timed_movements, record_movements
    delayed = partial(MMCNetwork, schedule="delayed")
    dynamic = partial(delayed, dynamics="reference")
    return {
        MINIMUM_JERK: minimum_jerk_movements,
        TIME_BASE: partial(timed, MMCNetwork()),
        f"time base ({ACCURATE})": partial(timed, MMCNetwork(normalizer=accurate)),
        "time base (paper's recipe [16, 16])": partial(timed, MMCNetwork(normalizer=paper)),
        f"{CLASSICAL}, synchronous": partial(plain, MMCNetwork()),
        CLASSICAL: partial(plain, delayed()),
        DYNAMIC: partial(plain, dynamic(normalizer=paper)),
        "dynamic (Euclidean), decay 0.92": partial(plain, dynamic()),
        "dynamic (Euclidean), decay 1": partial(plain, dynamic(velocity_decay=1.0)),
        "dynamic (Euclidean), rule “paper”, decay 0.92": partial(plain, delayed(dynamics="paper")),
    }


def run(settings: Settings) -> Result:
    """Measure how bell-shaped the movements of all networks are."""
    makers = movers()
    recordings = {
        (name, iterations): makers[name](iterations)
        for name, iterations in settings.tracked(list(product(makers, ITERATIONS)))
    }
    found = {key: shapes(recording) for key, recording in recordings.items()}
    shown = {name: recordings[name, ITERATIONS[0]] for name in _SHOWN}
    distances = {name: recording.distance for name, recording in shown.items()}
    velocities = {name: recording.velocity for name, recording in shown.items()}
    examples = {
        _label(movement): {name: profiles[movement] for name, profiles in velocities.items()}
        for movement in (PAIRS.tolist().index(pair) for pair in _EXAMPLES)
    }
    labels = [_label(movement) for movement in range(len(PAIRS))]
    correlations = {name: found[name, ITERATIONS[0]]["correlation"] for name in _SHOWN[:-1]}
    return Result(
        rows=[row for name in makers for row in _rows(name, found)],
        figures={
            "bell_shape": Captioned(
                draw_courses({DISTANCE: distances, VELOCITY: velocities}),
                "Normalized distance and velocity over the 420 movements in 40 iterations: the "
                "paper's networks, the kinematic network on a time base, and minimum jerk.",
            ),
            "bell_shape_examples": Captioned(
                draw_profiles(examples),
                "Velocity in three movements (radius and angle of start and target).",
            ),
            "bell_shape_correlation": Captioned(
                draw_shares(correlations, "correlation of velocity with minimum jerk"),
                "Share of the 420 movements whose velocity profile has at most this correlation "
                "with minimum jerk (40 iterations).",
            ),
        },
        data={
            "bell_shape": pd.concat(
                [
                    pd.DataFrame(
                        {"name": name, "iterations": iterations, "movement": labels, **columns}
                    )
                    for (name, iterations), columns in found.items()
                ]
            )
        },
    )


def _label(movement: int | np.intp) -> str:
    """Return start and target of a movement by radius and angle, such as "1, 60° → 2, 120°"."""
    first, second = (f"{target // 7 + 1}, {target % 7 * 30}°" for target in PAIRS[movement])
    return f"{first} → {second}"


def _rows(name: str, found: Mapping[tuple[str, int], Mapping[str, Floats]]) -> list[Row]:
    """Return a row per measure, with 40 and 100 iterations side by side."""
    both = [found[name, iterations] for iterations in ITERATIONS]
    classical = [found[CLASSICAL, iterations]["final"] for iterations in ITERATIONS]

    def row(quantity: str, values: Sequence[str], unit: str = "", note: str = "") -> Row:
        sides = zip(ITERATIONS, values, strict=True)
        ours = "; ".join(f"{iterations}: {value}" for iterations, value in sides)
        return Row(f"{name}: {quantity}", ours=ours, unit=unit, note=note)

    def spread(quantity: str, column: str, digits: str, aim: str, unit: str = "") -> Row:
        texts = []
        for one in both:
            low, median, high = np.nanpercentile(one[column], (5, 50, 95))
            texts.append(f"{median:{digits}} ({low:{digits}} to {high:{digits}})")
        return row(f"{quantity}, median (5 % to 95 %)", texts, unit, f"aim: {aim}")

    rows = [
        spread("correlation of velocity with minimum jerk", "correlation", ".3f", "0.95 or more"),
        spread("peak over mean velocity", "peak_to_mean", ".2f", "1.8 to 2.0"),
        spread("time to peak", "time_to_peak", ".2f", "0.45 to 0.55", "of duration"),
        row(
            "movements with a single velocity peak",
            [f"{100 * (one['velocity_peaks'] == 1).mean():.1f}" for one in both],
            unit="%",
            note="aim: 95 or more",
        ),
        row(
            "movements that overshoot",
            [f"{(one['overshoot'] > OVERSHOOT).sum()}" for one in both],
            unit="of 420",
            note="aim: 0",
        ),
        row(
            "final distance, mean ± sd",
            [mean_and_deviation(one["final"]) for one in both],
            unit="of start to target",
            note="aim: no more than " + " and ".join(f"{final.mean():.4f}" for final in classical),
        ),
        row(
            f"movements that end above {FAR}; farther than by the {CLASSICAL} network",
            [
                f"{(one['final'] > FAR).sum()}; {(one['final'] > final).sum()}"
                for one, final in zip(both, classical, strict=True)
            ],
            unit="of 420",
        ),
    ]
    if name == TIME_BASE:
        rows.append(
            row(
                "which have more velocity peaks (radius and angle)",
                ["; ".join(map(_label, np.flatnonzero(one["velocity_peaks"] > 1))) for one in both],
                note="the arm folds or turns over, at the largest gain, and then rushes",
            )
        )
    return rows
