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

from mmc_gym.agents.base import JointTargetAgent
from mmc_gym.agents.ik.dead_end import SegmentLengths, leave_line, nearest_reachable
from mmc_gym.interface import JointLimits, ReachInterface, Sensed
from mmc_gym.network.chain import Floats, node_positions, segments_from_joint_angles

Solver: TypeAlias = Callable[[Floats, Floats, SegmentLengths], Floats]
"""One iteration: (joint angles (..., N), target (..., 2), N lengths) → joint angles (..., N)."""


class InverseKinematicsAgent(JointTargetAgent[Floats]):
    """Runs a solver on an internal posture; its state is that posture's joint angles (..., N)."""

    def __init__(
        self,
        interface: ReachInterface,
        solver: Solver,
        iterations_per_step: int = 1,
        heeds_limits: bool = False,
    ) -> None:
        """Make the agent.

        Args:
            interface: of the environment.
            solver: one iteration of the method.
            iterations_per_step: iterations in a control step.
            heeds_limits: whether the solver knows joint limits; otherwise its iterations end there.

        Raises:
            ValueError: if `iterations_per_step` is less than one, under torque control, or if
                the solver is none for this number of segments.
        """
        if iterations_per_step < 1:
            raise ValueError(f"iterations_per_step must be at least 1, got {iterations_per_step}")
        super().__init__(interface)
        self.solver = solver
        self._limits = None if heeds_limits else interface.joint_limits
        self.iterations_per_step = iterations_per_step
        lengths = interface.segment_lengths
        solver(np.zeros(len(lengths)), np.array([sum(lengths), 0.0]), lengths)  # refuses here

    def start(self, sensed: Sensed) -> Floats:
        """The sensed postures."""
        return sensed.joint_angles

    def restart(self, state: Floats, fresh: Floats, started: NDArray[np.bool_]) -> Floats:
        """The internal postures, the sensed ones where an episode started."""
        return np.where(started[..., None], fresh, state)

    def batch_shape(self, state: Floats) -> tuple[int, ...]:
        """Those of the internal postures."""
        return state.shape[:-1]

    def advance(self, state: Floats, sensed: Sensed) -> tuple[Floats, Floats]:
        """Joint angles of the internal postures after the iterations of one control step."""
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
    """Joint angles (..., N) after a number of a solver's iterations, out of a dead end if in one.

    Args:
        solver: one iteration.
        joint_angles: radians, (..., N).
        target: segment lengths, (..., 2); out of reach, the nearest point within is meant, since
            an arm that goes on pulling outward trembles where it is stretched.
        segment_lengths: N lengths.
        iterations: how many.
        joint_limits: lowest and highest angle of each joint, radians; an iteration that goes
            beyond ends there.  None: joints turn freely.
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
    """The hand (..., 2), and how it moves with the joints: ∂x/∂q and ∂y/∂q, each (..., N).

    A joint turns the hand about itself: column i of J is (hand − p_i) turned by 90°.
    """
    nodes = node_positions(segments_from_joint_angles(joint_angles, segment_lengths))
    hand = nodes[..., -1, :]
    arm = hand[..., None, :] - nodes[..., :-1, :]
    return hand, -arm[..., 1], arm[..., 0]
