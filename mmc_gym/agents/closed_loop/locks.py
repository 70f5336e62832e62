"""Detecting a locked joint: it is asked to turn, and stays where it is.

For each joint, the turns that the servo model expects are summed up for as long as it stays where
it is.  Asked for enough, it is taken as locked; seen elsewhere, it is free again.  Nothing counts
before a joint of the arm is seen to move, for `PATIENCE` control steps at most: senses that are
late show an arm that does not move at all.

A load or an obstacle that holds a joint for long looks the same.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mmc_gym.network.chain import Floats, wrap_angle

ASKED = 0.8
"""What a joint must have been asked for before it is taken as locked, radians."""
ASKED_IF_TOLD = 0.2
"""The same for a joint that the agent was told to be one that locks."""
STILL = 0.08
"""A joint within this of where it was is still, radians; noise seldom takes it out."""
AVERAGED = 0.3
"""Share by which the place of a joint that is still is averaged in a control step."""
PATIENCE = 25
"""For so many control steps an arm of which nothing moves may be one that is seen late."""


class Locks(NamedTuple):
    """What is known of the joints, (..., N).

    Attributes:
        anchor: where each joint was when it last had moved, radians.
        place: where it has been since, averaged, radians.
        asked: what was asked of it there in all, radians.
        last: the posture last seen, radians.
        watched: control steps for which the arm was seen; `PATIENCE` once any joint moved.
        is_locked: 1 where a joint is taken as locked, at its `place`.
    """

    anchor: Floats
    place: Floats
    asked: Floats
    last: Floats
    watched: Floats
    is_locked: Floats


def start(joint_angles: Floats) -> Locks:
    """All joints free, none seen to move."""
    zero = np.zeros_like(joint_angles)
    return Locks(joint_angles, joint_angles, zero, joint_angles, zero, zero)


def observe(
    locks: Locks, joint_angles: Floats, expected: Floats, lockable: tuple[int, ...] = ()
) -> Locks:
    """What is known when joints are seen at these angles.

    Args:
        locks: what was known.
        joint_angles: radians, (..., N).
        expected: by how much the servo model expects them to have turned, radians, (..., N).
        lockable: indices of the only joints that can lock, where that was told.
    """
    enough = np.full(joint_angles.shape[-1], np.inf if lockable else ASKED)
    enough[list(lockable)] = ASKED_IF_TOLD
    was_locked = locks.is_locked > 0
    away = wrap_angle(joint_angles - np.where(was_locked, locks.place, locks.anchor))
    is_still = np.abs(away) < STILL
    any_moved = ~is_still.all(axis=-1, keepdims=True)
    watched = np.where(any_moved, PATIENCE, np.minimum(locks.watched + 1, PATIENCE))
    asked = np.where(is_still & (watched >= PATIENCE), locks.asked + expected, 0.0)
    is_locked = is_still & (was_locked | (np.abs(asked) > enough))
    average = locks.place + AVERAGED * wrap_angle(joint_angles - locks.place)
    return Locks(
        np.where(is_still, locks.anchor, joint_angles),
        np.where(is_still, average, joint_angles),
        asked,
        joint_angles,
        watched,
        is_locked.astype(float),
    )
