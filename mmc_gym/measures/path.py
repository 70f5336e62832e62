"""The path of a movement: how long it is, how straight, and in which space it is straighter."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from mmc_gym.measures.reaching import Floats


def path_ratio(hands: ArrayLike, target: ArrayLike, tolerance: float) -> float:
    """Length of the hand's path over the straight line from start to target; 1 is straight.

    Σ|p_{k+1} − p_k| / |target − p_0|, over the whole episode, corrections and tremor at the
    target included.  Below 1 only if the hand stops short.  Under a visuomotor rotation both are
    the cursor's: the target is not where the hand is to go.  NaN where the straight line is
    shorter than ε: there is no movement to make, and the ratio would blow up.

    Args:
        hands: positions of the hand, or of the cursor, segment lengths, (steps + 1, 2).
        target: segment lengths, (2,).
        tolerance: ε, segment lengths.
    """
    hands = np.asarray(hands, dtype=np.float64)
    straight = float(np.linalg.norm(np.asarray(target) - hands[0]))
    if straight < tolerance:
        return math.nan
    return float(np.linalg.norm(np.diff(hands, axis=0), axis=-1).sum()) / straight


def path_efficiency(points: ArrayLike) -> float:
    """Straight line from a path's first to its last point, over the path's length: 1 is straight.

    |x_n − x_0| / Σ|x_{k+1} − x_k|, between 0 and 1; NaN for a path that goes nowhere.

    Args:
        points: of the hand, or of the joints, (points, dimensions).

    Example:
        >>> path_efficiency([[0, 0], [3, 0], [3, 4]])  # 5 as the crow flies, 7 on the path
        0.714286
    """
    path = np.asarray(points, dtype=np.float64)
    length = float(np.linalg.norm(np.diff(path, axis=0), axis=-1).sum())
    return float(np.linalg.norm(path[-1] - path[0])) / length if length > 0.0 else math.nan


def maximal_deviation(points: ArrayLike, start: ArrayLike, end: ArrayLike) -> float:
    """Largest distance of a path from the line through two points, over the distance of these.

    max_k |r_k − (r_k·u) u| / |end − start|, with r_k = x_k − start, u the unit vector from start
    to end.  ½ for a half circle; NaN if start and end are one point.

    Args:
        points: of the hand, or of the joints, (points, dimensions).
        start: a point of the line, (dimensions,).
        end: another one.

    Source:
        Atkeson and Hollerbach (1985), J. Neurosci. 5(9), 2318–2330,
        https://doi.org/10.1523/JNEUROSCI.05-09-02318.1985, as linearity index.
    """
    origin = np.asarray(start, dtype=np.float64)
    line = np.asarray(end, dtype=np.float64) - origin
    length = float(np.linalg.norm(line))
    if length == 0.0:
        return math.nan
    along = line / length
    away = np.asarray(points, dtype=np.float64) - origin
    across: Floats = away - (away @ along)[:, None] * along
    return float(np.linalg.norm(across, axis=-1).max()) / length


def hand_over_joint_straightness(hands: ArrayLike, joint_angles: ArrayLike) -> float:
    """Is a movement straighter in hand space (up to 1) or in joint space (down to −1)?

    (d_joints − d_hand) / (d_joints + d_hand), d the `maximal_deviation` of the path from the line
    between its ends, in either space.  0 where both are equally bent, NaN where the hand or the
    joints end where they began, or without joints.

    Args:
        hands: positions, (points, 2).
        joint_angles: at the same times, not wrapped, radians, (points, N).

    Source:
        The question whether movements are planned in hand or in joint space: Morasso (1981), Exp.
        Brain Res. 42, 223–227; Hollerbach and Atkeson (1987), Biol. Cybern. 56, 279–292.
    """
    path, posture = np.asarray(hands, dtype=np.float64), np.asarray(joint_angles)
    if posture.shape[-1] == 0:
        return math.nan
    of_hand = maximal_deviation(path, path[0], path[-1])
    of_joints = maximal_deviation(posture, posture[0], posture[-1])
    total = of_hand + of_joints
    return (of_joints - of_hand) / total if total != 0.0 else math.nan
