"""Measures of reaching: success, time, accuracy and rest at the target.

In formulas d_k is the distance from hand to target after step k, d_0 that at the start, T the
control step in seconds, and ε the distance within which a target counts as reached.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mmc_gym.measures.catalogue import measure
from mmc_gym.measures.episode import Episode

DWELL = 0.2  # s at the end of an episode in which the hand must stay, for success with dwell
REST = 0.5  # s at the end of an episode in which jitter is measured


def stays_within(distances: ArrayLike, tolerance: float, steps: int = 0) -> bool:
    """Return whether the hand is within `tolerance` throughout the last `steps` steps.

    d_k ≤ ε for k = n − steps … n, where n is the last step.  With one step or more, a hand that
    only passes the target when time is up does not count.
    Distances from hand to target are (steps + 1,).  A distance of exactly ε, the tolerance, is
    within, as in the environment.  A shorter episode counts as a whole.
    """
    return bool((np.asarray(distances)[-steps - 1 :] <= tolerance).all())


def arrival_time(distances: ArrayLike, tolerance: float, control_step: float) -> float:
    """Return the seconds until the hand is within `tolerance` and stays until the episode ends.

    T · min{k : d_j ≤ ε for every j ≥ k}, where T is the `control_step`: 0 for a hand that is there
    from the start, NaN if the episode ends outside.  The first entry would make a hand the quickest
    that rushes through the target.  For the other arguments see `stays_within`.

    >>> arrival_time([1.0, 0.0, 0.5, 0.04, 0.01], 0.05, 0.02)  # enters, leaves, settles
    0.06
    """
    outside = np.flatnonzero(~(np.asarray(distances) <= tolerance))  # so is all, if ε is NaN
    first_to_stay = int(outside[-1]) + 1 if outside.size else 0
    return first_to_stay * control_step if first_to_stay < np.size(distances) else math.nan


def largest_retreat(distances: ArrayLike) -> float:
    """Return how far the hand retreats from the target: max_{k>j} (d_k − d_j), at least 0.

    The published figures call more than 0.01 of the way from start to target an overshoot.
    """
    profile = np.asarray(distances, dtype=np.float64)
    return float((profile - np.minimum.accumulate(profile)).max())


_SHARE: Any = {"unit": "fraction", "best": "high", "statistic": "mean", "decimals": 3}


@measure(label="success at the end", shown=True, **_SHARE)
def success(episode: Episode) -> float:
    """Return 1 if the hand is within ε of the target when the episode ends, else 0.

    Passing through the target is no success, because the task is to stay there.  Where ε is not
    known, it is what the environment says at the end.
    """
    if episode.is_success is not None:
        return float(episode.is_success)
    return float(stays_within(episode.distances, episode.tolerance))


@measure(label="within 1 % of reach", shown=True, **_SHARE)
def success_1_percent(episode: Episode) -> float:
    """Return 1 if the hand stays within 1 % of the reach for the last `DWELL` seconds, else 0."""
    steps = round(DWELL / episode.control_step)
    return float(stays_within(episode.distances, 0.01 * episode.reach, steps))


@measure(label="final distance", unit="lengths", best="low", decimals=3, shown=True)
def final_distance(episode: Episode) -> float:
    """Return the distance from hand to target when the episode ends, segment lengths."""
    return float(episode.distances[-1])


@measure(label="time to target", unit="s", best="low", shown=True, successes_only=True)
def time_to_target(episode: Episode) -> float:
    """Return the seconds until the hand is at the target and stays, see `arrival_time`.

    An episode has this value exactly if its `success` is 1.
    """
    return arrival_time(episode.distances, episode.tolerance, episode.control_step)


@measure(label="overshoot", unit="lengths", best="low", decimals=3, successes_only=True)
def overshoot(episode: Episode) -> float:
    """Return how far the hand retreats from the target, see `largest_retreat`.

    NaN where the target moves, or another one follows.
    """
    return largest_retreat(episode.distances) if episode.target_stands else math.nan


@measure(label="jitter at the target", unit="lengths", best="low", decimals=4, successes_only=True)
def jitter(episode: Episode) -> float:
    """Return how much the hand trembles in the last `REST` seconds: √(mean |e_k − ē|²).

    e_k is the vector from target to hand and ē its mean, so that neither a constant error nor a
    moving target counts.  For a hand that circles it is the radius.  In segment lengths; NaN unless
    the hand is at the target throughout.
    """
    steps = round(REST / episode.control_step)
    if not stays_within(episode.distances, episode.tolerance, steps):
        return math.nan
    errors = (episode.seen_hands - episode.targets)[-steps - 1 :]
    return float(np.sqrt(((errors - errors.mean(axis=0)) ** 2).sum(axis=-1).mean()))
