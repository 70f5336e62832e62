"""Inverse kinematics as a policy: a solver iterates on an internal posture, servos follow it.

The internal posture starts as the sensed one.  In each control step a solver takes it nearer to
the target, by a few iterations, and its joint angles are the servos' targets.  Nothing sensed
later changes it: that is resolved-rate control (Whitney 1969) over position servos, and the same
for all methods here.

A solver is a pure function, `solver(joint_angles, target, segment_lengths)`, of arrays with any
leading batch axes; `differential`, `geometric` and `closed_form` have them.

Literature: D. E. Whitney (1969), Resolved motion rate control of manipulators and human
prostheses, IEEE Trans. Man-Machine Systems 10, 47–53.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from mmc_gym.agents.base import JointTargetAgent, ReachInterface, Sensed
from mmc_gym.network.chain import (
    Floats,
    node_positions,
    reachable_radii,
    segments_from_joint_angles,
)

SegmentLengths: TypeAlias = tuple[float, ...]

Solver: TypeAlias = Callable[[Floats, Floats, SegmentLengths], Floats]
"""One iteration: (joint angles (..., N), target (..., 2), N lengths) → joint angles (..., N)."""

STRAIGHT = 0.01
"""An arm is taken as straight, and a target as in line with it, within this angle, radians."""
BEND = 0.02
"""By which each joint of a straight arm is bent, where no solver could leave the line, radians."""


class InverseKinematicsAgent(JointTargetAgent[Floats]):
    """Runs a solver on an internal posture; its state is that posture's joint angles (..., N)."""

    def __init__(
        self, interface: ReachInterface, solver: Solver, iterations_per_step: int = 1
    ) -> None:
        """Make the agent.

        Args:
            interface: of the environment.
            solver: one iteration of the method.
            iterations_per_step: iterations in a control step.

        Raises:
            ValueError: if `iterations_per_step` is less than one, under torque control, or if
                the solver is none for this number of segments.
        """
        if iterations_per_step < 1:
            raise ValueError(f"iterations_per_step must be at least 1, got {iterations_per_step}")
        super().__init__(interface)
        self.solver = solver
        self.iterations_per_step = iterations_per_step
        lengths = interface.segment_lengths
        solver(np.zeros(len(lengths)), np.array([sum(lengths), 0.0]), lengths)  # refuses here

    def start(self, sensed: Sensed) -> Floats:
        """The sensed postures."""
        return sensed.joint_angles

    def restart(self, state: Floats, fresh: Floats, started: NDArray[np.bool_]) -> Floats:
        """The internal postures, the sensed ones where an episode started."""
        return np.where(started[..., None], fresh, state)

    def advance(self, state: Floats, sensed: Sensed) -> tuple[Floats, Floats]:
        """Joint angles of the internal postures after the iterations of one control step."""
        lengths = self.interface.segment_lengths
        state = iterate(self.solver, state, sensed.target, lengths, self.iterations_per_step)
        return state, state


def iterate(
    solver: Solver,
    joint_angles: Floats,
    target: Floats,
    segment_lengths: SegmentLengths,
    iterations: int,
) -> Floats:
    """Joint angles (..., N) after a number of a solver's iterations, out of a dead end if in one.

    Args:
        solver: one iteration.
        joint_angles: radians, (..., N).
        target: segment lengths, (..., 2); out of reach, the nearest point within is meant, since
            an arm that goes on pulling outward trembles where it is stretched.
        segment_lengths: N lengths.
        iterations: how many.
    """
    target = nearest_reachable(target, segment_lengths)
    joint_angles = leave_line(joint_angles, target, segment_lengths)
    for _ in range(iterations):
        joint_angles = solver(joint_angles, target, segment_lengths)
    return joint_angles


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

    Where all segments and the target lie in one line, no joint can move the hand towards the
    target (Jᵀe = 0), and every iterative method would stay there.  Each joint of such an arm
    turns by `BEND`, unless the hand is at the target.

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


def jacobian(
    joint_angles: Floats, segment_lengths: SegmentLengths
) -> tuple[Floats, Floats, Floats]:
    """The hand (..., 2), and how it moves with the joints: ∂x/∂q and ∂y/∂q, each (..., N).

    A joint turns the hand about itself: column i of J is (hand − p_i) turned by 90°.
    """
    nodes = node_positions(segments_from_joint_angles(joint_angles, segment_lengths))
    hand = nodes[..., -1, :]
    arm = hand[..., None, :] - nodes[..., :-1, :]
    return hand, -arm[..., 1], arm[..., 0]
