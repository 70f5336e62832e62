"""Inverse kinematics as a policy: a solver iterates on an internal posture, servos follow it.

The internal posture starts as the sensed one.  In each control step a solver takes it nearer to
the target, by a few iterations, and its joint angles are the servos' targets.  Later
senses do not change it: this is resolved-rate control (Whitney 1969) over position servos.

With J, the derivative of the hand's position by the joint angles q, an iteration is

    Δq = Jᵀ(JJᵀ + λ²I)⁻¹e,     e = target − hand, shortened to at most `max_step`

`max_step` and `damping` (λ) are in segment lengths.

Literature: Whitney (1969), IEEE Trans. Man-Machine Systems 10, 47–53.  Wampler (1986), IEEE Trans.
Syst. Man Cybern. 16, 93–101, and Nakamura & Hanafusa (1986), J. Dyn. Syst. Meas. Control 108,
163–171 (damping).  Buss & Kim (2005), J. Graphics Tools 10(3), 37–49 (shortened error).
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from typing_extensions import override

from mmc_gym._errors import require_whole
from mmc_gym.agents.base import JointTargetAgent
from mmc_gym.geometry import (
    Floats,
    damped_least_squares,
    nearest_reachable,
    node_positions,
    segments_from_joint_angles,
)
from mmc_gym.interface import JointLimits, ReachInterface, Sensed
from mmc_gym.network.chain import BEND

SegmentLengths: TypeAlias = tuple[float, ...]

STRAIGHT = 0.01  #: angle within which an arm is straight, and a target in line with it, radians
_LEFT = np.array([-1.0, 1.0])  # (y, x) times this is (x, y) turned left by a right angle


class InverseKinematicsAgent(JointTargetAgent[Floats]):
    """Runs `damped_step` on an internal posture; its state is joint angles (..., N)."""

    def __init__(self, interface: ReachInterface, iterations_per_step: int = 3) -> None:
        require_whole("iterations_per_step", iterations_per_step)
        super().__init__(interface)
        self.iterations_per_step = iterations_per_step

    @override
    def start(self, sensed: Sensed) -> Floats:
        return sensed.joint_angles

    @override
    def advance(self, state: Floats, sensed: Sensed) -> tuple[Floats, Floats]:
        lengths, limits = self.interface.segment_lengths, self.interface.joint_limits
        state = iterate(state, sensed.target, lengths, self.iterations_per_step, limits)
        return state, state


def iterate(
    joint_angles: Floats,
    target: Floats,
    segment_lengths: SegmentLengths,
    iterations: int,
    joint_limits: JointLimits | None = None,
    damping: float = 0.1,
) -> Floats:
    """Return joint angles (..., N) after iterations of `damped_step`; first leave a dead end.

    A target out of reach is replaced by the nearest point within reach, because an arm that keeps
    pulling outward trembles where it is stretched.
    """
    target = nearest_reachable(target, segment_lengths)
    joint_angles = leave_line(joint_angles, target, segment_lengths)
    for _ in range(iterations):
        joint_angles = damped_step(joint_angles, target, segment_lengths, joint_limits, damping)
    return joint_angles


def jacobian(joint_angles: Floats, segment_lengths: SegmentLengths) -> tuple[Floats, Floats]:
    """Return the hand (..., 2), and J (..., 2, N): column i is (hand − p_i) turned by 90°."""
    nodes = node_positions(segments_from_joint_angles(joint_angles, segment_lengths))
    hand = nodes[..., -1, :]
    arm = hand[..., None, :] - nodes[..., :-1, :]
    return hand, np.swapaxes(arm[..., ::-1] * _LEFT, -1, -2)


def hand_position(joint_angles: Floats, segment_lengths: SegmentLengths | Floats) -> Floats:
    """Return the position of the hand (..., 2), segment lengths, from joint angles (..., N)."""
    return segments_from_joint_angles(joint_angles, segment_lengths).sum(axis=-2)


def leave_line(joint_angles: Floats, target: Floats, segment_lengths: SegmentLengths) -> Floats:
    """Return joint angles (..., N), with arms bent a little that no iteration could move.

    Where all segments and the target lie in one line, no joint can move the hand towards the
    target (Jᵀe = 0), and the network's vectors stay in that line.  Each joint of such an arm turns
    by `BEND`, unless the hand is at the target.  Targets (..., 2) must be within reach.
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
    return joint_angles + BEND * stuck[..., None]


def damped_step(
    joint_angles: Floats,
    target: Floats,
    segment_lengths: SegmentLengths,
    joint_limits: JointLimits | None = None,
    damping: float = 0.1,
    max_step: float = 0.1,
) -> Floats:
    """Return joint angles (..., N) after an iteration towards targets (..., 2).

    The change is at most `max_step` / (2 `damping`), at singularities too.  Joints stop at their
    limits, the lowest and highest angle of each in radians; None: they turn freely.
    """
    hand, by_joints = jacobian(joint_angles, segment_lengths)
    error = target - hand
    distance = np.hypot(error[..., 0], error[..., 1])[..., None]
    error = error * (max_step / np.maximum(distance, max_step))
    moved = joint_angles + damped_least_squares(by_joints, error, damping)
    return moved if joint_limits is None else np.clip(moved, *np.transpose(joint_limits))
