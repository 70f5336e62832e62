"""Inverse kinematics by geometry, joint after joint: cyclic coordinate descent, and FABRIK.

Cyclic coordinate descent turns one joint at a time, from the hand to the base, so that the hand
comes as near to the target as this joint alone can bring it: into the line from joint to target.

FABRIK (forward and backward reaching inverse kinematics) places nodes: first it puts the hand on
the target and draws each segment behind it, from the hand to the base; then it puts the base back
and draws each segment behind that.  A drawn segment keeps its length, and points from the node
that has been placed to where its other node was.

Points of the plane are complex numbers here, x + iy: to turn is to multiply.  All solvers are
iterations in the sense of `inverse_kinematics.Solver`.

Literature: L.-C. T. Wang, C. C. Chen (1991), A combined optimization method for solving the inverse
kinematics problem of mechanical manipulators, IEEE Trans. Robotics and Automation 7, 489–499.
A. Aristidou, J. Lasenby (2011), FABRIK: a fast, iterative solver for the inverse kinematics
problem, Graphical Models 73, 243–260.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from mmc_gym.agents.ik.dead_end import SegmentLengths
from mmc_gym.interface import JointLimits
from mmc_gym.network.chain import Floats, wrap_angle

Points: TypeAlias = NDArray[np.complex128]

COINCIDENT = 1e-9
"""Points nearer to each other than this, in reaches, have no direction."""


def cyclic_coordinate_descent(
    joint_angles: Floats,
    target: Floats,
    segment_lengths: SegmentLengths,
    max_change: float = 0.1,
    joint_limits: JointLimits | None = None,
) -> Floats:
    """One iteration of cyclic coordinate descent, a turn of every joint; joint angles (..., N).

    With turns of any size the joints next to the hand turn most, and the arm curls up before the
    others get to work.  Small turns make all take part, and a path of the hand that is nearly
    straight; π allows any.  A joint on which the hand or the target lies does not turn.

    Args:
        joint_angles: radians, (..., N).
        target: segment lengths, (..., 2).
        segment_lengths: N lengths.
        max_change: most that a joint turns, radians.
        joint_limits: lowest and highest angle of each joint, radians, at which it stops, and the
            joints after it take over; None: joints turn freely.
    """
    lengths = np.array(segment_lengths)
    aim = _points(target)
    segments = lengths * np.exp(1j * np.cumsum(joint_angles, axis=-1))
    nodes = np.cumsum(segments, axis=-1)
    joints, hand = nodes - segments, nodes[..., -1]
    least = (COINCIDENT * lengths.sum()) ** 2
    change = np.zeros(np.broadcast_shapes(joint_angles.shape, (*aim.shape, 1)))
    for joint in reversed(range(len(lengths))):
        reach = hand - joints[..., joint]
        turn = (aim - joints[..., joint]) * reach.conj()
        angle = np.where(np.abs(turn) > least, np.angle(turn), 0.0)
        change[..., joint] = np.clip(angle, -max_change, max_change)
        if joint_limits is not None:
            present, (low, high) = joint_angles[..., joint], joint_limits[joint]
            change[..., joint] = np.clip(present + change[..., joint], low, high) - present
        hand = joints[..., joint] + reach * np.exp(1j * change[..., joint])
    return joint_angles + change


def fabrik(joint_angles: Floats, target: Floats, segment_lengths: SegmentLengths) -> Floats:
    """One iteration of FABRIK, backward and forward; joint angles (..., N).

    To a target out of reach the arm stretches out straight.  A segment whose ends coincide keeps
    its direction.

    Args:
        joint_angles: radians, (..., N).
        target: segment lengths, (..., 2).
        segment_lengths: N lengths.
    """
    aim = _points(target)
    directions = list(np.moveaxis(np.exp(1j * np.cumsum(joint_angles, axis=-1)), -1, 0))
    nodes = [np.zeros_like(aim)]
    for length, direction in zip(segment_lengths, directions, strict=True):
        nodes.append(nodes[-1] + length * direction)
    reach = sum(segment_lengths)
    nodes[-1] = aim
    for joint in reversed(range(len(directions))):
        directions[joint] = _direction(nodes[joint + 1] - nodes[joint], directions[joint], reach)
        nodes[joint] = nodes[joint + 1] - segment_lengths[joint] * directions[joint]
    nodes[0] = np.zeros_like(aim)
    for joint, length in enumerate(segment_lengths):
        directions[joint] = _direction(nodes[joint + 1] - nodes[joint], directions[joint], reach)
        nodes[joint + 1] = nodes[joint] + length * directions[joint]
    straight = _direction(aim, directions[0], reach)
    segment_angles = np.angle(
        np.stack([np.where(np.abs(aim) > reach, straight, each) for each in directions], axis=-1)
    )
    relative = np.diff(segment_angles, axis=-1, prepend=0.0)
    return joint_angles + wrap_angle(relative - joint_angles)


def _points(vectors: Floats) -> Points:
    points: Points = vectors[..., 0] + 1j * vectors[..., 1]
    return points


def _direction(vector: Points, otherwise: Points, reach: float) -> Points:
    length = np.abs(vector)
    apart = length > COINCIDENT * reach
    return np.where(apart, vector / np.where(apart, length, 1.0), otherwise)
