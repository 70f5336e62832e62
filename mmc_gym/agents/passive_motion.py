"""The Passive Motion Paradigm: the target pulls at the hand of an internal body, which gives way.

    force     F = K e,               e = target − hand
    torques   τ = Jᵀ F
    motion    q̇ = Γ(t) A τ,          A = I: all joints give way alike
    so        ẋ = Γ(t) J Jᵀ K e

Γ is a time base generator: with ξ the minimum-jerk course from 0 to 1 in T,

    Γ(t) = ξ̇ / (1 − ξ)

grows without bound towards T, so the hand is at the target at T wherever it came from (a terminal
attractor), with a bell-shaped speed.

The stiffness K = |e| / |JJᵀe| is a scalar that takes from the body's geometry what would distort
the time course: |ẋ| = Γ |e|.  The path is what the arm's mobility makes it, slightly curved.

A control step is integrated in `SUBSTEPS`.  Towards T, and wherever the arm is more mobile in one
direction than in another, the equation is stiff, so the force is that at the end of the step:

    Δq = Jᵀ F,     (ρ + JJᵀ) F = e,     ρ = 1/(K G),     G = σ/(1 − σ)

with σ_k = (ξ_k − ξ_{k−1}) / (1 − ξ_{k−1}), the share of the distance that Γ asks for.  G is such
that an arm of equal mobility 1/K in all directions covers it exactly; for others, `CORRECTIONS`
put the mobility right that K was made of.  (It is damped least squares, the damping set by the
time base.)  After T, σ = 1, and what is left goes as fast as it can: where the arm is nearly
stretched or folded, the hand may arrive late.

Literature: F. A. Mussa-Ivaldi, P. Morasso, R. Zaccaria (1988), Kinematic networks: a distributed
model for representing and regularizing motor redundancy, Biol. Cybern. 60, 1–16.  V. Mohan,
P. Morasso (2011), Passive motion paradigm: an alternative to optimal control, Front. Neurorobot.
5:4.  M. Zak (1988), Terminal attractors for addressable memory in neural networks, Phys. Lett. A
133, 18–22.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmc_gym.agents.base import JointTargetAgent, Sensed
from mmc_gym.agents.ik.agent import jacobian
from mmc_gym.agents.ik.dead_end import (
    SegmentLengths,
    hand_position,
    leave_line,
    nearest_reachable,
)
from mmc_gym.agents.ik.jacobian import limited, resisted_force
from mmc_gym.agents.movement import Movement, begin, follow, step, where
from mmc_gym.network.chain import Floats
from mmc_gym.network.time_base import share

SUBSTEPS = 3
"""Integration steps in a control step."""
MAX_CHANGE = 0.1
"""Most that a joint turns in an integration step, radians."""


CORRECTIONS = 1
"""Times that the mobility is put right in an integration step."""
LEAST_RESISTANCE = 0.05**2
"""Bound of ρ, segment lengths squared, so that a step is bounded where J is singular."""
MOST_RESISTANCE = 1e30
"""Bound of ρ, where the time base asks for nothing yet."""

_TINY = np.finfo(np.float64).tiny


class PassiveMotionState(NamedTuple):
    """State of the agent: the movement, and the joint angles of the internal body (..., N)."""

    movement: Movement
    joint_angles: Floats


class PassiveMotionAgent(JointTargetAgent[PassiveMotionState]):
    """Moves an internal body by the Passive Motion Paradigm; the servos follow its joints."""

    def start(self, sensed: Sensed) -> PassiveMotionState:
        """Internal bodies in the sensed postures, about to move."""
        hand = hand_position(sensed.joint_angles, self.interface.segment_lengths)
        movement = begin(hand, sensed.target, self.interface.control_step)
        return PassiveMotionState(movement, sensed.joint_angles)

    def restart(
        self, state: PassiveMotionState, fresh: PassiveMotionState, started: NDArray[np.bool_]
    ) -> PassiveMotionState:
        """The movements and postures, new where an episode started."""
        return PassiveMotionState(
            where(started, fresh.movement, state.movement),
            np.where(started[..., None], fresh.joint_angles, state.joint_angles),
        )

    def batch_shape(self, state: PassiveMotionState) -> tuple[int, ...]:
        """Those of the internal bodies."""
        return state.joint_angles.shape[:-1]

    def advance(
        self, state: PassiveMotionState, sensed: Sensed
    ) -> tuple[Floats, PassiveMotionState]:
        """Joint angles of the internal body after one control step."""
        lengths = self.interface.segment_lengths
        hand = hand_position(state.joint_angles, lengths)
        movement = follow(state.movement, hand, sensed.target, self.interface.control_step)
        target = nearest_reachable(sensed.target, lengths)
        joint_angles = leave_line(state.joint_angles, target, lengths)
        for part in range(1, SUBSTEPS + 1):
            number = SUBSTEPS * movement.elapsed + part
            pulled = share(number, SUBSTEPS * movement.duration)
            moved = passive_motion_step(joint_angles, target, pulled, lengths)
            joint_angles = self.interface.within_limits_from(joint_angles, moved)
        return joint_angles, PassiveMotionState(step(movement), joint_angles)


def passive_motion_step(
    joint_angles: Floats,
    target: Floats,
    share: Floats,
    segment_lengths: SegmentLengths,
) -> Floats:
    """Joint angles (..., N) after an integration step of the internal body.

    Args:
        joint_angles: radians, (..., N).
        target: segment lengths, (..., 2).
        share: ∫ Γ dt over the step, as the share of the distance that is to be covered, (...).
        segment_lengths: N lengths.
    """
    hand, jacobian_x, jacobian_y = jacobian(joint_angles, segment_lengths)
    error = target - hand
    distance = np.maximum(np.hypot(error[..., 0], error[..., 1]), _TINY)
    torque = jacobian_x * error[..., :1] + jacobian_y * error[..., 1:]
    moved = np.hypot((jacobian_x * torque).sum(axis=-1), (jacobian_y * torque).sum(axis=-1))
    mobility = moved / distance  # 1/K at the beginning of the step
    effort = (1 - share) / np.maximum(share, _TINY)  # 1/G
    for _ in range(1 + CORRECTIONS):
        resistance = np.clip(mobility * effort, LEAST_RESISTANCE, MOST_RESISTANCE)
        force_x, force_y = resisted_force(jacobian_x, jacobian_y, error, resistance)
        covered_x = error[..., 0] - resistance * force_x
        covered_y = error[..., 1] - resistance * force_y
        covered = np.hypot(covered_x, covered_y) / distance
        mobility = resistance * covered / np.maximum(1 - covered, _TINY)
    change = jacobian_x * force_x[..., None] + jacobian_y * force_y[..., None]
    return joint_angles + limited(change, MAX_CHANGE)
