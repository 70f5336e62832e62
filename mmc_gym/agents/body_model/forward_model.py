"""The forward model: where a posture takes the hand, and a command the joints.

In this folder arrays lead with n arms, each of N joints.  Joint angles, turns and segment lengths
are (n, N); angles are in radians, speeds in rad/s, times in control steps.  Points and vectors of
the plane are complex numbers x + iy, (n,), because multiplication rotates them.  Exceptions are
stated.
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from mmc_gym.geometry import Floats, damped_least_squares
from mmc_gym.interface import ReachInterface

Points: TypeAlias = NDArray[np.complexfloating]
Bools: TypeAlias = NDArray[np.bool_]


def as_points(vectors: Floats) -> Points:
    """Return vectors (..., 2) as points, (...)."""
    return np.ascontiguousarray(vectors, np.float64).view(np.complex128)[..., 0]


def as_vectors(points: Points) -> Floats:
    """Return points (...) as vectors, (..., 2)."""
    return np.ascontiguousarray(points).view(np.float64).reshape(*points.shape, 2)


def squared(points: Points) -> Floats:
    """Return |z|²."""
    return points.real**2 + points.imag**2


def unit_vectors(joint_angles: Floats) -> Points:
    """Return the direction of each segment as a unit vector, (..., N)."""
    return np.exp(1j * np.cumsum(joint_angles, axis=-1))


def hand(joint_angles: Floats, lengths: Floats) -> Points:
    """Return the position of the hand, (...), for joint angles and lengths (..., N)."""
    return (lengths * unit_vectors(joint_angles)).sum(axis=-1)


def to_hand(joint_angles: Floats, lengths: Floats) -> Points:
    """Return the vectors from each joint to the hand, (..., N); the first is the hand itself."""
    segments = lengths * unit_vectors(joint_angles)
    return np.cumsum(segments[..., ::-1], axis=-1)[..., ::-1]


def pull_hand(levers: Points, error: Points, damping: float, held: Bools | None) -> Floats:
    """Return the turns that move the hand by `error`, (...), by damped least squares, (..., N).

    The levers are those of `to_hand`, (..., N); joints that are `held`, likewise, do not turn.
    """
    if held is not None:
        levers = np.where(held, 0, levers)
    jacobian = np.swapaxes(as_vectors(1j * levers), -1, -2)
    return damped_least_squares(jacobian, as_vectors(error), damping)


def command_of(interface: ReachInterface, joint_angles: Floats, joint_targets: Floats) -> Floats:
    """Return the command that the servos get, (..., N).

    Under position control it is the target.  Under delta and velocity control it is the turn from
    the believed joint angles, so where a joint ends depends on its true angle.
    """
    if interface.control == "joint_position":
        return joint_targets
    return interface.turn(joint_angles, joint_targets)


def commanded_turn(interface: ReachInterface, joint_angles: Floats, commands: Floats) -> Floats:
    """Return how far commands turn joints in a control step, radians, (..., N).

    The speed of a position servo is proportional to the angle left, up to a limit.  In a control
    step Δt it turns a joint at q with the target c by about

        Δq = clip((1 − exp(−gain Δt)) (c − q), ±speed_limit Δt).

    Inertia and torque limits are left out, so a heavy or loaded arm lags behind.  Under
    `joint_delta` a target is never far ahead, so joints stay below full speed.  Under
    `joint_velocity` a joint keeps one speed during the step.

    >>> interface = ReachInterface((1.0, 1.0), "joint_position", 6.0, 12.0, 0.02)
    >>> commanded_turn(interface, np.zeros(2), np.array([0.1, 2.0])).round(3).tolist()
    [0.021, 0.12]
    """
    part, left, most = turn_share(interface), commands, interface.max_joint_delta
    if interface.control == "joint_position":
        left = interface.turn(joint_angles, commands)
        most = interface.speed_limit * interface.control_step / part
    return part * bounded(left, most)


def turn_share(interface: ReachInterface) -> float:
    """Return the share of the angle left that a servo turns a joint in a control step."""
    gain, step = interface.servo_gain, interface.control_step
    return gain * step if interface.control == "joint_velocity" else 1 - math.exp(-gain * step)


def bounded(values: Floats, most: float) -> Floats:
    """Return values clipped to ±most: np.clip takes twice as long for few arms."""
    return np.minimum(np.maximum(values, -most), most)
