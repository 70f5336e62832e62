"""What measures look at in an episode: all of it, its moving part, or its end.

Measures of the shape of a movement look at its moving part (see `profiles.moving_part`).  There is
no movement, and they are NaN, if the hand never gets farther than the tolerance from its start.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from mmc_gym.measures import path as paths
from mmc_gym.measures import reaching as metrics
from mmc_gym.measures import speed as profiles
from mmc_gym.measures.reaching import Floats
from mmc_gym.measures.rollout import Episode

DWELL = 0.2
"""Seconds that the hand must have stayed for a success with dwell."""

REST = 0.5
"""Seconds at the end of an episode in which the hand's jitter is measured."""

PARTS_OF_REACH = (1, 2, 5)
"""Tolerances of successes with dwell, % of reach."""


def _moves(episode: Episode) -> bool:
    away = np.linalg.norm(episode.hands - episode.hands[0], axis=-1)
    return bool(away.max() > episode.tolerance)


def speeds(episode: Episode) -> Floats:
    """The speed profile of the hand over the whole episode, segment lengths/s, (n,)."""
    return profiles.hand_speed(episode.hands, episode.control_step)


def of_shape(of: Callable[[Floats, float], float]) -> Callable[[Episode], float]:
    """A measure of the speeds of the moving part, and the control step."""

    def measure(episode: Episode) -> float:
        if not _moves(episode):
            return math.nan
        profile = speeds(episode)
        return of(profile[profiles.moving_part(profile)], episode.control_step)

    return measure


def of_path(of: Callable[[Floats, Floats], float]) -> Callable[[Episode], float]:
    """A measure of the hand positions and joint angles of the moving part."""

    def measure(episode: Episode) -> float:
        if not _moves(episode):
            return math.nan
        part = profiles.moving_part(speeds(episode))
        points = slice(part.start, part.stop + 1)
        return of(episode.hands[points], episode.joint_angles[points])

    return measure


def _steps(seconds: float, episode: Episode) -> int:
    return round(seconds / episode.control_step)


def stays_within(percent: int) -> Callable[[Episode], float]:
    """Success with dwell, within so many percent of the reach, for the last `DWELL` seconds."""

    def measure(episode: Episode) -> float:
        tolerance = percent / 100 * episode.reach
        return metrics.success_with_dwell(episode.distances, tolerance, _steps(DWELL, episode))

    return measure


def deviation(episode: Episode) -> float:
    """Largest deviation from the line between the ends of the moving part; NaN if shorter than ε.

    Not from the line to the target: under a visuomotor rotation the hand is to go elsewhere.
    """
    part = profiles.moving_part(speeds(episode))
    hands = episode.hands[part.start : part.stop + 1]
    if np.linalg.norm(hands[-1] - hands[0]) < episode.tolerance:
        return math.nan
    return paths.maximal_deviation(hands, hands[0], hands[-1])


def where_target_stands(of: Callable[[Episode], float]) -> Callable[[Episode], float]:
    """A measure that is about one target; NaN where it moves, or another follows."""

    def measure(episode: Episode) -> float:
        stands = bool((episode.targets == episode.targets[0]).all())
        return of(episode) if stands else math.nan

    return measure


def final_jitter(episode: Episode) -> float:
    """Jitter in the last `REST` seconds; NaN unless the hand is at the target throughout."""
    steps = _steps(REST, episode)
    if not metrics.success_with_dwell(episode.distances, episode.tolerance, steps):
        return math.nan
    return metrics.jitter(episode.seen_hands, episode.targets, steps)
