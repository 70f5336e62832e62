"""Measures of reaching: success, time, accuracy and rest at the target, and the hand's path there.

In formulas d_k is the distance from hand to target after step k, d_0 that at the start, T the
control step in seconds, and ε the distance within which a target counts as reached.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mmc_gym.measures.catalogue import measure
from mmc_gym.measures.episode import Episode, moving_part

DWELL = 0.2  # s at the end of an episode in which the hand must stay, for success with dwell
REST = 0.5  # s at the end of an episode in which jitter is measured


def stays_within(distances: ArrayLike, tolerance: float, steps: int = 0) -> bool:
    """Return whether the hand is within `tolerance` throughout the last `steps` steps.

    d_k ≤ ε for k = n − steps … n, where n is the last step.  Distances from hand to target are
    (steps + 1,).  A shorter episode counts as a whole; one without distances is not within.
    """
    last = np.asarray(distances)[-steps - 1 :]
    return bool(last.size and (last <= tolerance).all())


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

    NaN without distances, or where one is NaN.
    """
    profile = np.asarray(distances, dtype=np.float64)
    return float((profile - np.minimum.accumulate(profile)).max()) if profile.size else math.nan


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
    return largest_retreat(episode.distances) if episode.is_target_fixed else math.nan


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


def linearity_index(points: ArrayLike) -> float:
    """Return the largest distance of a path from the line between its ends, over its length.

    max_k |r_k − (r_k·u) u| / |x_n − x_0|, with r_k = x_k − x_0 and u the unit vector from the first
    to the last point (points, dimensions).  0 is straight, ½ a half circle; NaN if the path ends
    where it began, or has no points.

    Source: Atkeson and Hollerbach (1985), J. Neurosci. 5(9), 2318–2330,
    https://doi.org/10.1523/JNEUROSCI.05-09-02318.1985.
    """
    path = np.asarray(points, dtype=np.float64)
    if not len(path):
        return math.nan
    away = path - path[0]
    length = math.sqrt(away[-1].dot(away[-1]))
    if length == 0.0:
        return math.nan
    along = away[-1] / length
    across = away - (away @ along)[:, None] * along
    return math.sqrt((across * across).sum(axis=-1).max()) / length


@measure(label="path / direct line", best="low", shown=True, successes_only=True)
def path_ratio(episode: Episode) -> float:
    """Return the length of the hand's path over the line from start to target; 1 is straight.

    Σ|p_{k+1} − p_k| / |target − p_0|, over the whole episode, with corrections and tremor at the
    target; under a visuomotor rotation of the cursor.  NaN where the target moves, and where the
    line is shorter than ε, because the ratio would grow without bound.
    """
    line = float(np.linalg.norm(episode.target - episode.seen_hands[0]))
    if line < episode.tolerance or not episode.is_target_fixed:
        return math.nan
    steps = np.diff(episode.seen_hands, axis=0)
    return float(np.linalg.norm(steps, axis=-1).sum()) / line


@measure(label="largest deviation / length", best="low", decimals=3, successes_only=True)
def maximal_deviation(episode: Episode) -> float:
    """Return the `linearity_index` of the hand's path while it moves.

    From the line between its ends, not to the target, because under a visuomotor rotation the
    cursor aims there.  NaN if the ends are closer than ε.
    """
    part = moving_part(episode.speeds)
    hands = episode.hands[part.start : part.stop + 1]
    if np.linalg.norm(hands[-1] - hands[0]) < episode.tolerance:
        return math.nan
    return linearity_index(hands)
