"""Bridging a delay of the senses: the old observation, run forward with the commands sent since.

An agent that sees the arm of k control steps ago knows what it has asked of it since.  The servo
model takes the old posture q through those k commands c::

    q̂(t) = servo(… servo(servo(q(t−k), c(t−k)), c(t−k+1)) …, c(t−1))

The delay itself is estimated, not told.  A joint that is asked to move is expected to have turned
by `MOVED` after some step a, and is seen to have after some step b; the delay is the least b − a of
all joints.  Before a joint is seen to move, the delay is at least the time since it was expected
to.  Each joint counts for itself, since one that is locked never moves.

Literature: R. C. Miall, D. J. Weir, D. M. Wolpert, J. F. Stein (1993), Is the cerebellum a Smith
predictor?, J. Motor Behavior 25, 203–216.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmc_gym.interface import ReachInterface
from mmc_gym.network.chain import Floats, wrap_angle


def expected_turn(interface: ReachInterface, joint_angles: Floats, joint_targets: Floats) -> Floats:
    """By how much joints turn in a control step, radians, (..., N).

    Args:
        interface: knows gain and speed limit.
        joint_angles: where the joints are, radians, (..., N).
        joint_targets: what their servos are sent to, radians, (..., N); the short way
            round, or the way that joint limits leave.

    >>> interface = ReachInterface((1.0, 1.0), "joint_position", 6.0, 12.0, 0.02)
    >>> expected_turn(interface, np.zeros(2), np.array([0.1, 2.0])).round(3).tolist()
    [0.021, 0.12]
    """
    step = interface.control_step
    share, most = 1 - math.exp(-interface.servo_gain * step), interface.speed_limit * step
    turn: Floats = np.clip(share * interface.turn(joint_angles, joint_targets), -most, most)
    return turn


LONGEST = 25
"""The longest delay that is bridged, control steps."""
MOVED = 0.1
"""A joint has moved if it has turned by this since the start, radians; noise turns it by less."""


class Delay(NamedTuple):
    """What is remembered to tell the delay, and to bridge it.

    Attributes:
        commands: joint targets sent, the latest last, radians, (..., LONGEST + 1, N).
        start: posture of the first observation, radians, (..., N).
        waited: control steps since each joint should have moved, 0 if it need not yet, (..., N).
        late: how late each joint was, or is by now if it has not moved, (..., N).
        has_moved: 1 where a joint has been seen to move, (..., N).
    """

    commands: Floats
    start: Floats
    waited: Floats
    late: Floats
    has_moved: Floats


def start(joint_angles: Floats) -> Delay:
    """Nothing sent yet: servos hold the joints (..., N) where they are."""
    held = np.repeat(joint_angles[..., None, :], LONGEST + 1, axis=-2)
    zero = np.zeros_like(joint_angles)
    return Delay(held, joint_angles, zero, zero, zero)


def sent(delay: Delay, joint_targets: Floats) -> Delay:
    """After the joints were sent to these targets (..., N), radians."""
    latest = joint_targets[..., None, :]
    return delay._replace(commands=np.concatenate([delay.commands[..., 1:, :], latest], axis=-2))


def watch(delay: Delay, joint_angles: Floats, expected: Floats) -> Delay:
    """What is remembered after joints were seen, and where the servo model expected them.

    Args:
        delay: what was remembered.
        joint_angles: as they are seen, radians, (..., N).
        expected: where they should be now, radians, (..., N).
    """
    is_due = np.abs(wrap_angle(expected - delay.start)) > MOVED
    moves = np.abs(wrap_angle(joint_angles - delay.start)) > MOVED
    waited = np.where(is_due | (delay.waited > 0), delay.waited + 1, 0.0)
    late = np.where(delay.has_moved > 0, delay.late, np.maximum(waited - 1, 0.0))
    return delay._replace(waited=waited, late=late, has_moved=np.maximum(delay.has_moved, moves))


def steps_late(delay: Delay) -> NDArray[np.intp]:
    """The estimated delay, control steps, (...)."""
    late = np.where(delay.waited > 0, delay.late, np.inf).min(axis=-1)
    return np.clip(np.where(np.isfinite(late), late, 0.0), 0, LONGEST).astype(np.intp)


def command_before(delay: Delay, steps: NDArray[np.intp]) -> Floats:
    """The joint targets (..., N) that were sent `steps` (...) control steps before the latest."""
    index = (LONGEST - steps)[..., None, None]
    command: Floats = np.take_along_axis(delay.commands, index, axis=-2)[..., 0, :]
    return command


def run_forward(
    interface: ReachInterface, delay: Delay, joint_angles: Floats, steps: NDArray[np.intp]
) -> Floats:
    """Where joints that were at these angles `steps` control steps ago should be now.

    Args:
        interface: knows the servos.
        delay: knows the commands.
        joint_angles: radians, (..., N).
        steps: how long ago, (...).
    """
    for back in range(int(steps.max(initial=0)), 0, -1):
        turn = expected_turn(interface, joint_angles, delay.commands[..., -back, :])
        joint_angles = joint_angles + np.where((back <= steps)[..., None], turn, 0.0)
    return joint_angles
