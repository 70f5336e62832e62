"""Measures of all episodes in an environment of the battery that is suited to them.

    paper       420 movements: each of 21 targets from 20 starts.  Donders' law: how much does the
                posture at a target depend on where the hand came from?
    distances   from one point outward, 4 distances × 8 directions.  Fitts' law over 4 widths of the
                target.  No agent is told the width, and none trades speed for accuracy by it: it
                says how the time grows until the hand stays within ever less.
    pursuit     a target on a smooth path.  Two-thirds power law: how does the hand's speed depend
                on the curvature of its path?  The ideal hand beside it follows the same target.

A new measure is a function in `set_metrics` and an entry in `SET_MEASURES`.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from mmc_gym.measures.catalogue import Direction
from mmc_gym.measures.reaching import success_at_end, time_to_target
from mmc_gym.measures.rollout import Episode
from mmc_gym.measures.sets import (
    Line,
    fitts_law,
    posture_variability,
    speed_curvature_law,
)

FITTS_WIDTHS = (0.02, 0.05, 0.1, 0.2)
"""Diameters of the target, segment lengths."""

WARM_UP = 1.0
"""Seconds in which a hand finds a moving target, and which the power law leaves out."""


@dataclass(frozen=True, kw_only=True)
class SetMeasure:
    """How a measure is taken from the episodes in an environment.

    Attributes:
        name: its name in the data.
        label: its heading in tables.
        unit: of its values; empty for a number.
        best: whether high or low values are good.
        decimals: at most so many are shown.
        environment: that it is taken in, by its name in `battery.ENVIRONMENTS`.
        of: the measure of one policy's episodes; NaN where they have none.
    """

    name: str
    label: str
    unit: str
    best: Direction
    decimals: int
    environment: str
    of: Callable[[Sequence[Episode]], float]


def set_measures_in(environment: str) -> tuple[SetMeasure, ...]:
    """The measures that are taken in an environment; none in most."""
    return tuple(measure for measure in SET_MEASURES if measure.environment == environment)


def variability_at_targets(episodes: Sequence[Episode]) -> float:
    """Mean over targets of `posture_variability` at the end of successful episodes, radians.

    Hands elsewhere than at the target would have other postures for that alone.  Targets that
    were reached fewer than twice are left out.
    """
    postures = defaultdict(list)
    for episode in episodes:
        if success_at_end(episode.distances, episode.tolerance):
            postures[tuple(episode.targets[-1].round(9).tolist())].append(episode.joint_angles[-1])
    spreads = [posture_variability(group) for group in postures.values() if len(group) > 1]
    return float(np.mean(spreads)) if spreads else math.nan


def fitts_line(episodes: Sequence[Episode]) -> Line:
    """`fitts_law` over distances and `FITTS_WIDTHS`: mean times to stay within half a width.

    A condition that some episode never settles in is left out: the mean of the others would be
    too short.
    """
    groups = defaultdict(list)
    for episode in episodes:
        groups[round(float(episode.distances[0]), 3)].append(episode)
    conditions = [
        (
            distance,
            width,
            float(np.mean([time_to_target(e.distances, width / 2, e.control_step) for e in group])),
        )
        for distance, group in groups.items()
        for width in FITTS_WIDTHS
    ]
    return fitts_law(*np.transpose(conditions)) if conditions else fitts_law([], [], [])


def power_line(episodes: Sequence[Episode]) -> Line:
    """`speed_curvature_law` of each episode after `WARM_UP`; medians over the episodes."""
    lines = [
        speed_curvature_law(e.hands[round(WARM_UP / e.control_step) :], e.control_step)
        for e in episodes
    ]
    found = [line for line in lines if not math.isnan(line.slope)]
    return Line(*np.median(found, axis=0).tolist()) if found else speed_curvature_law([], 1.0)


SET_MEASURES: tuple[SetMeasure, ...] = (
    SetMeasure(
        name="posture_variability",
        label="posture variability",
        unit="rad",
        best="low",
        decimals=3,
        environment="paper",
        of=variability_at_targets,
    ),
    SetMeasure(
        name="fitts_slope",
        label="Fitts' slope",
        unit="s/bit",
        best="low",
        decimals=3,
        environment="distances",
        of=lambda episodes: fitts_line(episodes).slope,
    ),
    SetMeasure(
        name="fitts_intercept",
        label="Fitts' intercept",
        unit="s",
        best="neither",
        decimals=2,
        environment="distances",
        of=lambda episodes: fitts_line(episodes).intercept,
    ),
    SetMeasure(
        name="fitts_r_squared",
        label="Fitts' law explains",
        unit="fraction",
        best="neither",
        decimals=2,
        environment="distances",
        of=lambda episodes: fitts_line(episodes).r_squared,
    ),
    SetMeasure(
        name="speed_curvature_exponent",
        label="speed-curvature exponent",
        unit="",
        best="neither",
        decimals=3,
        environment="pursuit",
        of=lambda episodes: -power_line(episodes).slope,
    ),
    SetMeasure(
        name="speed_curvature_r_squared",
        label="power law explains",
        unit="fraction",
        best="neither",
        decimals=2,
        environment="pursuit",
        of=lambda episodes: power_line(episodes).r_squared,
    ),
)
"""All of them."""
