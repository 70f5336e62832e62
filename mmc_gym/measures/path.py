"""Measures of the path: length, straightness, and whether hand or joints move straighter."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from mmc_gym.measures.catalogue import measure
from mmc_gym.measures.episode import Episode, Floats, moving_part


def straightness(points: ArrayLike) -> float:
    """Return the distance between a path's ends over the path's length; 1 is straight.

    |x_n − x_0| / Σ|x_{k+1} − x_k|, between 0 and 1; NaN for a path without length.

    Args:
        points: positions of the hand, or joint angles, (points, dimensions).
    """
    path = np.asarray(points, dtype=np.float64)
    length = _length(path)
    return float(np.linalg.norm(path[-1] - path[0])) / length if length > 0.0 else math.nan


def _length(path: Floats) -> float:
    return float(np.linalg.norm(np.diff(path, axis=0), axis=-1).sum())


def linearity_index(points: ArrayLike) -> float:
    """Return the largest distance of a path from the line between its ends, over its length.

    max_k |r_k − (r_k·u) u| / |x_n − x_0|, with r_k = x_k − x_0 and u the unit vector from the first
    to the last point.  0 is straight, ½ a half circle; NaN if the path ends where it began.  For
    `points` see `straightness`.

    Source:
        Atkeson and Hollerbach (1985), J. Neurosci. 5(9), 2318–2330,
        https://doi.org/10.1523/JNEUROSCI.05-09-02318.1985.
    """
    path = np.asarray(points, dtype=np.float64)
    away = path - path[0]
    length = float(np.linalg.norm(away[-1]))
    if length == 0.0:
        return math.nan
    along = away[-1] / length
    across = away - (away @ along)[:, None] * along
    return float(np.linalg.norm(across, axis=-1).max()) / length


@measure(label="path / direct line", best="low", shown=True, successes_only=True)
def path_ratio(episode: Episode) -> float:
    """Return the length of the hand's path over the line from start to target; 1 is straight.

    Σ|p_{k+1} − p_k| / |target − p_0|, over the whole episode, with corrections and tremor at the
    target.  Below 1 only if the hand stops short.  Under a visuomotor rotation both lengths are the
    cursor's, because the cursor must reach the target.  NaN where the target moves, and where the
    line is shorter than ε, because the ratio would grow without bound.
    """
    line = float(np.linalg.norm(episode.target - episode.seen_hands[0]))
    if line < episode.tolerance or not episode.target_stands:
        return math.nan
    return _length(episode.seen_hands) / line


@measure(label="path efficiency", best="high", decimals=3, successes_only=True)
def path_efficiency(episode: Episode) -> float:
    """Return the `straightness` of the hand's path while it moves."""
    return straightness(episode.hands[episode.movement_points])


@measure(label="largest deviation / length", best="low", decimals=3, successes_only=True)
def maximal_deviation(episode: Episode) -> float:
    """Return the `linearity_index` of the hand's path while it moves.

    The line joins the ends of the path.  It is not the line to the target, because under a
    visuomotor rotation the cursor aims there.  NaN if the ends are closer than ε.
    """
    part = moving_part(episode.speeds)
    hands = episode.hands[part.start : part.stop + 1]
    if np.linalg.norm(hands[-1] - hands[0]) < episode.tolerance:
        return math.nan
    return linearity_index(hands)


@measure(label="path efficiency of the joints", best="high", decimals=3, successes_only=True)
def joint_path_efficiency(episode: Episode) -> float:
    """Return the `straightness` of the path of the joint angles while the hand moves."""
    return straightness(episode.joint_angles[episode.movement_points])


@measure(label="straighter in hand than in joint space", successes_only=True)
def hand_over_joint_straightness(episode: Episode) -> float:
    """Return how much straighter the movement is in hand space (1) than in joint space (−1).

    (d_joints − d_hand) / (d_joints + d_hand), where d is the `linearity_index` of the path in
    each space while the hand moves.  0 if both are equally bent; NaN if the hand or the joints
    end where they began, and without joints.

    Source:
        On planning movements in hand or in joint space: Morasso (1981), Exp. Brain Res. 42,
        223–227; Hollerbach and Atkeson (1987), Biol. Cybern. 56, 279–292.
    """
    points = episode.movement_points
    of_hand = linearity_index(episode.hands[points])
    of_joints = linearity_index(episode.joint_angles[points])
    total = of_hand + of_joints
    return (of_joints - of_hand) / total if total != 0.0 else math.nan
