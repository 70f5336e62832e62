"""Inverse kinematics as a policy: a solver iterates on an internal posture, servos follow it.

The internal posture starts as the sensed one.  In each control step a solver takes it nearer to
the target, by a few iterations, and its joint angles are the servos' targets.  Nothing sensed
later changes it: that is resolved-rate control (Whitney 1969) over position servos, and the same
for all the solvers of `iterative` and `closed_form`.

Literature: D. E. Whitney (1969), Resolved motion rate control of manipulators and human
prostheses, IEEE Trans. Man-Machine Systems 10, 47–53.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TypeAlias

import numpy as np
from typing_extensions import override

from mmc_gym._errors import require, require_whole
from mmc_gym.agents.base import JointTargetAgent
from mmc_gym.interface import JointLimits, ReachInterface, Sensed
from mmc_gym.network.chain import (
    BEND,
    Floats,
    nearest_reachable,
    node_positions,
    segments_from_joint_angles,
)

SegmentLengths: TypeAlias = tuple[float, ...]
Solver: TypeAlias = Callable[[Floats, Floats, SegmentLengths], Floats]
"""One iteration of a method, a pure function of joint angles, target and segment lengths.

It is given joint angles (..., N) in radians, targets (..., 2) in segment lengths, and N lengths;
it returns joint angles (..., N).
"""

STRAIGHT = 0.01
"""An arm is taken as straight, and a target as in line with it, within this angle, radians."""


class InverseKinematicsAgent(JointTargetAgent[Floats]):
    """Runs a solver on an internal posture; its state is that posture's joint angles (..., N)."""

    def __init__(
        self,
        interface: ReachInterface,
        solver: Callable[..., Floats],
        iterations_per_step: int = 1,
        heeds_limits: bool = False,
    ) -> None:
        """Make the agent.

        Args:
            interface: of the environment.
            solver: one iteration of the method, a `Solver`.
            iterations_per_step: iterations in a control step.
            heeds_limits: whether the solver takes `joint_limits`; if not, its iterations end there.

        Raises:
            UserError: if `iterations_per_step` is less than one; as `CannotActError`, under torque
                control, or if the solver is none for this number of segments.
        """
        require_whole("iterations_per_step", iterations_per_step)
        require(callable(solver), "solver", solver, "a function, such as damped_least_squares")
        super().__init__(interface)
        limits = interface.joint_limits
        self.solver = partial(solver, joint_limits=limits) if heeds_limits else solver
        self._limits = None if heeds_limits else limits
        self.iterations_per_step = iterations_per_step
        lengths = interface.segment_lengths
        self.solver(np.zeros(len(lengths)), np.array([sum(lengths), 0.0]), lengths)  # refuses here

    @override
    def start(self, sensed: Sensed) -> Floats:
        return sensed.joint_angles

    @override
    def advance(self, state: Floats, sensed: Sensed) -> tuple[Floats, Floats]:
        lengths, count = self.interface.segment_lengths, self.iterations_per_step
        state = iterate(self.solver, state, sensed.target, lengths, count, self._limits)
        return state, state


def iterate(
    solver: Solver,
    joint_angles: Floats,
    target: Floats,
    segment_lengths: SegmentLengths,
    iterations: int,
    joint_limits: JointLimits | None = None,
) -> Floats:
    """Return joint angles (..., N) after iterations of a solver, out of a dead end if in one.

    Out of reach, the nearest point within is meant: an arm that goes on pulling outward trembles
    where it is stretched.  An iteration that goes beyond a joint limit ends there.
    """
    target = nearest_reachable(target, segment_lengths)
    joint_angles = leave_line(joint_angles, target, segment_lengths)
    for _ in range(iterations):
        joint_angles = solver(joint_angles, target, segment_lengths)
        if joint_limits is not None:
            joint_angles = np.clip(joint_angles, *np.transpose(joint_limits))
    return joint_angles


def jacobian(
    joint_angles: Floats, segment_lengths: SegmentLengths
) -> tuple[Floats, Floats, Floats]:
    """Return the hand (..., 2), and how it moves with the joints: ∂x/∂q and ∂y/∂q, each (..., N).

    A joint turns the hand about itself: column i of J is (hand − p_i) turned by 90°.
    """
    nodes = node_positions(segments_from_joint_angles(joint_angles, segment_lengths))
    hand = nodes[..., -1, :]
    arm = hand[..., None, :] - nodes[..., :-1, :]
    return hand, -arm[..., 1], arm[..., 0]


def hand_position(joint_angles: Floats, segment_lengths: SegmentLengths | Floats) -> Floats:
    """Return where the hand is, segment lengths, (..., 2), for joint angles (..., N)."""
    hand: Floats = segments_from_joint_angles(joint_angles, segment_lengths).sum(axis=-2)
    return hand


def leave_line(joint_angles: Floats, target: Floats, segment_lengths: SegmentLengths) -> Floats:
    """Return the same joint angles (..., N), but bent a little where an iteration gets nowhere.

    Where all segments and the target lie in one line, no joint can move the hand towards the
    target (Jᵀe = 0).  The network has no way out either, for all its vectors lie in that line, and
    so do their means.  Each joint of such an arm turns by `BEND`, unless the hand is at the target,
    (..., 2), which must be within reach.
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
