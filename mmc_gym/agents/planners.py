"""Minimum-jerk movements of the hand, and inverse kinematics along the way.

The hand goes from rest at x₀ to rest at the target g in T, on the path of least ∫ |d³x/dt³|² dt:

    x(t) = x₀ + (g − x₀) (10 τ³ − 15 τ⁴ + 6 τ⁵),     τ = t/T

a straight line with a bell-shaped speed.  At any time the rest of it is the quintic from the
present position, velocity and acceleration to rest at g in what remains of T.  So that is what is
stepped along, and a target that has moved is simply another g: the movement turns to it smoothly.

The posture follows by damped least squares.  `movement` says when a movement begins and what T is.

Literature: T. Flash, N. Hogan (1985), The coordination of arm movements: an experimentally
confirmed mathematical model, J. Neurosci. 5, 1688–1703.  B. Hoff, M. A. Arbib (1993), Models of
trajectory formation and temporal interaction of reach and grasp, J. Motor Behavior 25, 175–192
(the rest of the movement from the present state).
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmc_gym.agents.base import JointTargetAgent, Sensed
from mmc_gym.agents.ik.agent import iterate
from mmc_gym.agents.ik.dead_end import hand_position
from mmc_gym.agents.ik.jacobian import damped_least_squares
from mmc_gym.agents.movement import Movement, begin, follow, step, where
from mmc_gym.network.chain import Floats

ITERATIONS = 3
"""Iterations of inverse kinematics in a control step."""

# The plan moves a fraction of a length in a step, so less damping than that of a lone solver
# keeps the hand on the path, and is enough.
_track = partial(damped_least_squares, damping=0.05, max_step=0.1)


class HandPlan(NamedTuple):
    """Where the hand is to be, (..., 2) each; time in control steps, lengths in segment lengths."""

    position: Floats
    velocity: Floats
    acceleration: Floats


class MinimumJerkState(NamedTuple):
    """State of the agent: the plan, the movement it is for, and the joint angles (..., N)."""

    plan: HandPlan
    movement: Movement
    joint_angles: Floats


class MinimumJerkAgent(JointTargetAgent[MinimumJerkState]):
    """Plans the path of the hand by minimum jerk and follows it by damped least squares."""

    def start(self, sensed: Sensed) -> MinimumJerkState:
        """Plans that begin where the hands are, at rest."""
        hand = hand_position(sensed.joint_angles, self.interface.segment_lengths)
        return MinimumJerkState(
            HandPlan(hand, np.zeros_like(hand), np.zeros_like(hand)),
            begin(hand, sensed.target, self.interface.control_step),
            sensed.joint_angles,
        )

    def restart(
        self, state: MinimumJerkState, fresh: MinimumJerkState, started: NDArray[np.bool_]
    ) -> MinimumJerkState:
        """The plans and postures, new where an episode started."""
        return MinimumJerkState(
            where(started, fresh.plan, state.plan),
            where(started, fresh.movement, state.movement),
            np.where(started[..., None], fresh.joint_angles, state.joint_angles),
        )

    def batch_shape(self, state: MinimumJerkState) -> tuple[int, ...]:
        """Those of the postures."""
        return state.joint_angles.shape[:-1]

    def advance(self, state: MinimumJerkState, sensed: Sensed) -> tuple[Floats, MinimumJerkState]:
        """Joint angles that put the hand where the plan has it after one control step."""
        plan, lengths = state.plan, self.interface.segment_lengths
        movement = follow(state.movement, plan.position, sensed.target, self.interface.control_step)
        plan = minimum_jerk_step(plan, movement.target, movement.remaining)
        joint_angles = iterate(
            *(_track, state.joint_angles, plan.position, lengths, ITERATIONS),
            self.interface.joint_limits,
        )
        return joint_angles, MinimumJerkState(plan, step(movement), joint_angles)


def minimum_jerk_step(plan: HandPlan, target: Floats, remaining: Floats) -> HandPlan:
    """The plan one control step later, on the way of least jerk to rest at the target.

    Args:
        plan: position, velocity and acceleration, (..., 2) each.
        target: segment lengths, (..., 2).
        remaining: control steps until the hand is to rest there, (...); with one or less it
            rests there now.

    >>> plan = HandPlan(np.zeros(2), np.zeros(2), np.zeros(2))
    >>> for remaining in (4, 3, 2, 1):
    ...     plan = minimum_jerk_step(plan, np.array([1.0, 0.0]), np.array(remaining))
    ...     print(plan.position.round(4), plan.velocity.round(4))
    [0.1035 0.    ] [0.2637 0.    ]
    [0.5 0. ] [0.4688 0.    ]
    [0.8965 0.    ] [0.2637 0.    ]
    [1. 0.] [0. 0.]
    """
    time = np.maximum(remaining, 1.0)[..., None]
    way = target - plan.position
    velocity, acceleration = plan.velocity * time, plan.acceleration * time**2
    third = 10 * way - 6 * velocity - 1.5 * acceleration
    fourth = -15 * way + 8 * velocity + 1.5 * acceleration
    fifth = 6 * way - 3 * velocity - 0.5 * acceleration
    phase = 1 / time
    square, cube = phase**2, phase**3
    after = HandPlan(
        plan.position
        + (phase * velocity + square * acceleration / 2)
        + cube * (third + phase * fourth + square * fifth),
        (velocity + phase * acceleration) / time
        + square * (3 * third + 4 * phase * fourth + 5 * square * fifth) / time,
        acceleration / time**2
        + phase * (6 * third + 12 * phase * fourth + 20 * square * fifth) / time**2,
    )
    rest = HandPlan(np.broadcast_to(target, way.shape), np.zeros_like(way), np.zeros_like(way))
    return where(np.broadcast_to(remaining <= 1, way.shape[:-1]), rest, after)
