"""The dead end that all iterative methods share: an arm in one line with its target.

Where all segments and the target lie in one line, no joint can move the hand towards the target
(Jᵀe = 0).  The network has no way out either, for all its vectors lie in that line, and so do their
means.  `leave_line` bends such an arm a little, for inverse kinematics and the network alike.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np

from mmc_gym.network.chain import Floats, reachable_radii, segments_from_joint_angles

SegmentLengths: TypeAlias = tuple[float, ...]

STRAIGHT = 0.01
"""An arm is taken as straight, and a target as in line with it, within this angle, radians."""
BEND = 0.02
"""By which each joint of a straight arm is bent, where no method could leave the line, radians."""


def hand_position(joint_angles: Floats, segment_lengths: SegmentLengths) -> Floats:
    """Positions of the hand (..., 2), segment lengths, for joint angles (..., N)."""
    hand: Floats = segments_from_joint_angles(joint_angles, segment_lengths).sum(axis=-2)
    return hand


def nearest_reachable(target: Floats, segment_lengths: SegmentLengths) -> Floats:
    """Targets (..., 2), those out of reach moved to the nearest point within.

    >>> nearest_reachable(np.array([4.0, 0.0]), (1.0, 1.0, 1.0))
    array([3., 0.])
    """
    inner, outer = reachable_radii(segment_lengths)
    distance = np.hypot(target[..., 0], target[..., 1])
    outside = (distance < inner) | (distance > outer)
    if not outside.any():
        return target
    bearing = np.arctan2(target[..., 1], target[..., 0])  # defined at the base too
    radius = np.clip(distance, inner, outer)
    nearest = np.stack([radius * np.cos(bearing), radius * np.sin(bearing)], axis=-1)
    return np.where(outside[..., None], nearest, target)


def leave_line(joint_angles: Floats, target: Floats, segment_lengths: SegmentLengths) -> Floats:
    """The same joint angles (..., N), but bent a little where an iteration can get nowhere.

    Each joint of an arm that lies in one line with its target turns by `BEND`, unless the hand is
    at the target.

    Args:
        joint_angles: radians, (..., N).
        target: within reach, segment lengths, (..., 2).
        segment_lengths: N lengths.
    """
    straight = np.abs(np.sin(joint_angles[..., 1:])).max(axis=-1, initial=0.0) < STRAIGHT
    if not straight.any():
        return joint_angles
    error = target - hand_position(joint_angles, segment_lengths)
    distance = np.hypot(error[..., 0], error[..., 1])
    first = joint_angles[..., 0]
    across = np.abs(np.cos(first) * error[..., 1] - np.sin(first) * error[..., 0])
    away = distance > 1e-3 * sum(segment_lengths)
    stuck = straight & away & (across < STRAIGHT * distance)
    bent: Floats = joint_angles + BEND * stuck[..., None]
    return bent
