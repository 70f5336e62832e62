"""Measures of the path: length, straightness, and whether hand or joints move straighter."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from mmc_gym.measures.catalogue import measure
from mmc_gym.measures.episode import Episode, moving_part


def linearity_index(points: ArrayLike) -> float:
    """Return the largest distance of a path from the line between its ends, over its length.

    max_k |r_k − (r_k·u) u| / |x_n − x_0|, with r_k = x_k − x_0 and u the unit vector from the first
    to the last point.  0 is straight, ½ a half circle; NaN if the path ends where it began.
    The points are positions of the hand, or joint angles, (points, dimensions).

    Source: Atkeson and Hollerbach (1985), J. Neurosci. 5(9), 2318–2330,
    https://doi.org/10.1523/JNEUROSCI.05-09-02318.1985.
    """
    path = np.asarray(points, dtype=np.float64)
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
    target.  Below 1 only if the hand stops short.  Under a visuomotor rotation both lengths are the
    cursor's, because the cursor must reach the target.  NaN where the target moves, and where the
    line is shorter than ε, because the ratio would grow without bound.
    """
    line = float(np.linalg.norm(episode.target - episode.seen_hands[0]))
    if line < episode.tolerance or not episode.target_stands:
        return math.nan
    steps = np.diff(episode.seen_hands, axis=0)
    return float(np.linalg.norm(steps, axis=-1).sum()) / line


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


@measure(label="straighter in hand than in joint space", successes_only=True)
def hand_over_joint_straightness(episode: Episode) -> float:
    """Return how much straighter the movement is in hand space (1) than in joint space (−1).

    (d_joints − d_hand) / (d_joints + d_hand), where d is the `linearity_index` of the path in
    each space while the hand moves.  0 if both are equally bent; NaN if the hand or the joints
    end where they began, and without joints.

    On planning movements in hand or in joint space: Morasso (1981), Exp. Brain Res. 42,
    223–227; Hollerbach and Atkeson (1987), Biol. Cybern. 56, 279–292.
    """
    points = episode.movement_points
    of_hand = linearity_index(episode.hands[points])
    of_joints = linearity_index(episode.joint_angles[points])
    total = of_hand + of_joints
    return (of_joints - of_hand) / total if total != 0.0 else math.nan
