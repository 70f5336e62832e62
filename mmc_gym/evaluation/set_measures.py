"""Measures that need many episodes of a certain kind, and the sets of episodes they need.

A set is an environment and the trials that are played in it; a measure is a function of what an
agent did in all of them.

    postures   the paper's 420 movements: each of 21 targets from 20 starts.  Donders' law: how
               much does the posture at a target depend on where the hand came from?
    targets    from one point outward, 4 distances × 8 directions.  Fitts' law over 4 widths of the
               target.  No agent is told the width, and none trades speed for accuracy by it: it
               says how the time grows until the hand stays within ever less.
    pursuit    a target on a smooth path.  Two-thirds power law: how does the hand's speed depend
               on the curvature of its path?  The reference beside it follows the same target.

A new measure is a function in `set_metrics` and an entry in `SET_MEASURES`.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import gymnasium as gym
import numpy as np
import pandas as pd

from mmc_gym.envs.tasks import PointToPoint
from mmc_gym.evaluation.entrants import Factory
from mmc_gym.evaluation.measures import Direction
from mmc_gym.evaluation.metrics import success_at_end, time_to_target
from mmc_gym.evaluation.reference import REFERENCE, minimum_jerk_episodes
from mmc_gym.evaluation.rollout import Episode, episode_seeds, run_episodes
from mmc_gym.evaluation.set_metrics import (
    Line,
    fitts_law,
    posture_variability,
    speed_curvature_law,
)

FITTS_DISTANCES = (0.1, 0.2, 0.3, 0.4)
"""From start to target, in reaches."""

FITTS_WIDTHS = (0.02, 0.05, 0.1, 0.2)
"""Diameters of the target, segment lengths."""

DIRECTIONS = 8
WARM_UP = 1.0
"""Seconds in which a hand finds a moving target, and which the power law leaves out."""


@dataclass(frozen=True)
class EpisodeSet:
    """Episodes that set measures are taken from.

    Attributes:
        env: id of the environment.
        arguments: of it.
        trials: numbers of the trials, where the task counts them.
        episodes: how many, where it draws them.
    """

    env: str
    arguments: Mapping[str, Any] = field(default_factory=dict)
    trials: Sequence[int] = ()
    episodes: int = 0

    def play(self, factory: Factory, seed: int = 0) -> tuple[Episode, ...]:
        """Let the agent that `factory` makes for the environment play all trials."""
        env = gym.make(self.env, **self.arguments)
        try:
            options = [{"trial": trial} for trial in self.trials] or None
            seeds = episode_seeds(seed, len(self.trials) or self.episodes)
            return run_episodes(factory(env), env, seeds, options=options)
        finally:
            env.close()


@dataclass(frozen=True, kw_only=True)
class SetMeasure:
    """How a measure is taken from a set of episodes.

    Attributes:
        name: its name in the data.
        label: its heading in tables.
        unit: of its values; empty for a number.
        best: whether high or low values are good.
        decimals: at most so many are shown.
        episodes: the set it needs, by its name in `EPISODE_SETS`.
        of: the measure; NaN where the episodes have none.
    """

    name: str
    label: str
    unit: str
    best: Direction
    decimals: int
    episodes: str
    of: Callable[[Sequence[Episode]], float]


def measure_sets(
    agents: Mapping[str, Factory], seed: int = 0, names: Sequence[str] | None = None
) -> pd.DataFrame:
    """Let agents play the sets that measures need, and take the measures.

    Args:
        agents: what makes each agent for an environment, see `entrants.entrants`.
        seed: of starts and targets, where they are drawn.
        names: of the measures; None for all.

    Returns:
        A row per agent, `REFERENCE` among them, and measure: agent, measure, unit, episodes,
        value.

    Raises:
        ValueError: for a name that no measure has.
    """
    known = {measure.name: measure for measure in SET_MEASURES}
    unknown = [name for name in names or () if name not in known]
    if unknown:
        raise ValueError(f"names must be among {list(known)}, got {unknown}")
    wanted = [known[name] for name in names or known]
    rows = []
    for name in dict.fromkeys(measure.episodes for measure in wanted):
        played = {label: EPISODE_SETS[name].play(make, seed) for label, make in agents.items()}
        if played:
            played.setdefault(REFERENCE, minimum_jerk_episodes(next(iter(played.values()))))
        for measure in (measure for measure in wanted if measure.episodes == name):
            for label, episodes in played.items():
                rows.append(
                    {
                        "agent": label,
                        "measure": measure.name,
                        "unit": measure.unit,
                        "episodes": len(episodes),
                        "value": measure.of(episodes),
                    }
                )
    return pd.DataFrame(rows, columns=["agent", "measure", "unit", "episodes", "value"])


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


def _outward() -> PointToPoint:
    turns = [math.tau * k / DIRECTIONS for k in range(DIRECTIONS)]
    circles = [
        (distance * math.cos(turn), 0.5 + distance * math.sin(turn))
        for distance in FITTS_DISTANCES
        for turn in turns
    ]
    return PointToPoint(((0.0, 0.5), *circles), tuple((0, k + 1) for k in range(len(circles))))


EPISODE_SETS: dict[str, EpisodeSet] = {
    "postures": EpisodeSet("MMCReachPaper-v0", trials=range(420)),
    "targets": EpisodeSet(
        "MMCReach-v0", {"task": _outward()}, range(len(FITTS_DISTANCES) * DIRECTIONS)
    ),
    "pursuit": EpisodeSet("MMCReachPursuit-v0", episodes=10),
}
"""Sets of episodes by name; see the module's docstring."""


SET_MEASURES: tuple[SetMeasure, ...] = (
    SetMeasure(
        name="posture_variability",
        label="posture variability",
        unit="rad",
        best="low",
        decimals=3,
        episodes="postures",
        of=variability_at_targets,
    ),
    SetMeasure(
        name="fitts_slope",
        label="Fitts' slope",
        unit="s/bit",
        best="low",
        decimals=3,
        episodes="targets",
        of=lambda episodes: fitts_line(episodes).slope,
    ),
    SetMeasure(
        name="fitts_intercept",
        label="Fitts' intercept",
        unit="s",
        best="neither",
        decimals=2,
        episodes="targets",
        of=lambda episodes: fitts_line(episodes).intercept,
    ),
    SetMeasure(
        name="fitts_r_squared",
        label="Fitts' law explains",
        unit="fraction",
        best="neither",
        decimals=2,
        episodes="targets",
        of=lambda episodes: fitts_line(episodes).r_squared,
    ),
    SetMeasure(
        name="speed_curvature_exponent",
        label="speed-curvature exponent",
        unit="",
        best="neither",
        decimals=3,
        episodes="pursuit",
        of=lambda episodes: -power_line(episodes).slope,
    ),
    SetMeasure(
        name="speed_curvature_r_squared",
        label="power law explains",
        unit="fraction",
        best="neither",
        decimals=2,
        episodes="pursuit",
        of=lambda episodes: power_line(episodes).r_squared,
    ),
)
"""All measures of sets of episodes."""
