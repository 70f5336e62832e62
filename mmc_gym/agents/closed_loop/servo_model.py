"""What an agent expects of its servos: the forward model of joints under their commands.

A position servo asks for a speed proportional to what is left, up to its limit, so that in a
control step Δt a joint at q that is sent to c is expected to turn by

    Δq = clip((1 − exp(−gain Δt)) (c − q), ±speed_limit Δt)

Inertia and torque limits are left out: an arm that is heavy, or loaded, lags behind this.
"""

from __future__ import annotations

import math

import numpy as np

from mmc_gym.agents.base import ReachInterface
from mmc_gym.network.chain import Floats


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
