"""Measures of what an episode costs: effort, work, reward and computing time."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from mmc_gym.measures.catalogue import measure
from mmc_gym.measures.episode import Episode, Floats


@measure(label="joint effort", unit="mass len²/s", best="low", decimals=1, successes_only=True)
def joint_effort(episode: Episode) -> float:
    """Return ∫ Σ_i |τ_i| dt over the servos of all joints i, mass · length² / s.

    Holding still costs nothing in the horizontal plane.  NaN without joints, or where an engine
    does not tell.
    """
    return _sum(episode.servo_impulses)


@measure(
    label="joint work", unit="mass len²/s²", best="low", decimals=1, shown=True, successes_only=True
)
def joint_work(episode: Episode) -> float:
    """Return ∫ Σ_i |τ_i q̇_i| dt over the servos of all joints i, mass · length² / s².

    Braking counts as much as driving, as in muscles and in motors that do not feed back.  NaN as
    for `joint_effort`.

    Source:
        Absolute work as the cost of a reach: Alexander (1997), Biol. Cybern. 76, 97–105.
    """
    return _sum(episode.servo_work)


def _sum(values: Floats) -> float:
    return float(values.sum()) if values.size else math.nan


@measure(label="sum of rewards", best="high", decimals=0, shown=True)
def episode_return(episode: Episode) -> float:
    """Return the sum of the rewards, undiscounted."""
    return float(np.sum(episode.rewards))


@measure(label="time per action", unit="µs", best="low", decimals=1, shown=True)
def action_time(episode: Episode) -> float:
    """Return the median time that one `predict` took, µs; NaN for an episode without steps.

    The median, because now and then the operating system takes the processor away.
    """
    return _of_times(episode, np.median)


@measure(label="time per action, 99th percentile", unit="µs", best="low", decimals=1)
def slow_action_time(episode: Episode) -> float:
    """Return the time that one `predict` in a hundred exceeds, µs; NaN without steps.

    The 99th percentile is what a control loop must be prepared for.
    """
    return _of_times(episode, lambda times: np.percentile(times, 99))


def _of_times(episode: Episode, statistic: Callable[[Floats], Any]) -> float:
    times = episode.action_times * 1e6
    # Of most episodes of a benchmark they are unknown, which need not be sorted to find out.
    return float(statistic(times)) if times.size and not np.isnan(times[0]) else math.nan
