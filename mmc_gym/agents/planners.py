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
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from mmc_gym.agents.base import JointTargetAgent
from mmc_gym.agents.ik.agent import iterate, jacobian
from mmc_gym.agents.ik.dead_end import (
    SegmentLengths,
    hand_position,
    leave_line,
    nearest_reachable,
)
from mmc_gym.agents.ik.jacobian import damped_least_squares, limited, resisted_force
from mmc_gym.interface import Sensed
from mmc_gym.network.chain import Floats
from mmc_gym.network.time_base import share

SHORTEST = 0.2
"""T₀: duration of a movement that has nowhere to go, s."""
AVERAGE_SPEED = 4.0
"""v̄: growth of distance with duration, segment lengths/s."""
JUMP = 0.3
"""A target that moves farther than this in a control step has jumped, segment lengths."""
HORIZON = 5
"""Control steps that are left at least while the target moves on."""


class Movement(NamedTuple):
    """A movement under way.

    Attributes:
        target: segment lengths, (..., 2).
        elapsed: control steps since it began, (...).
        duration: T, control steps, (...).
    """

    target: Floats
    elapsed: Floats
    duration: Floats

    @property
    def remaining(self) -> Floats:
        """Control steps until it is over, 0 at the least, (...)."""
        return np.maximum(self.duration - self.elapsed, 0.0)


def begin(hand: Floats, target: Floats, control_step: float) -> Movement:
    """A movement that begins.

    Args:
        hand: segment lengths, (..., 2).
        target: segment lengths, (..., 2).
        control_step: s.

    >>> begin(np.array([1.0, 0.0]), np.array([3.0, 0.0]), control_step=0.02).duration.item()
    35.0
    """
    way = target - hand
    distance = np.hypot(way[..., 0], way[..., 1])
    duration = np.ceil((SHORTEST + distance / AVERAGE_SPEED) / control_step - 1e-9)
    return Movement(target, np.zeros_like(duration), duration)


def follow(movement: Movement, hand: Floats, target: Floats, control_step: float) -> Movement:
    """The movement to where the target is now: a new one if it has jumped.

    Args:
        movement: under way.
        hand: where a new movement would begin, segment lengths, (..., 2).
        target: segment lengths, (..., 2).
        control_step: s.
    """
    shift = target - movement.target
    moved = np.hypot(shift[..., 0], shift[..., 1])
    if not moved.any():
        return movement
    longer = np.where(moved > 0, movement.elapsed + HORIZON, 0.0)
    same = Movement(target, movement.elapsed, np.maximum(movement.duration, longer))
    return where(moved > JUMP, begin(hand, target, control_step), same)


def step(movement: Movement) -> Movement:
    """The movement one control step later."""
    return movement._replace(elapsed=movement.elapsed + 1.0)


Arrays = TypeVar("Arrays", bound="tuple[Floats, ...]")


def where(condition: NDArray[np.bool_], yes: Arrays, no: Arrays) -> Arrays:
    """A named tuple of arrays, from `yes` where a condition on the batch holds, else from `no`."""

    def chosen(first: Floats, second: Floats) -> Floats:
        trailing = (1,) * (np.ndim(first) - np.ndim(condition))
        return np.where(np.reshape(condition, (*np.shape(condition), *trailing)), first, second)

    return type(yes)(*map(chosen, yes, no))


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
