"""Planned movements of the hand, by minimum jerk.

A movement begins with the episode, and whenever the target jumps.  It takes

    T = T₀ + d / v̄,     d the distance of the hand from the target at its beginning

Durations of reaching movements grow about linearly with their amplitude (for a given accuracy and
medium amplitudes, Fitts's logarithm is nearly a line).  T₀ and v̄ suit the arm: a minimum-jerk
movement of 3 segment lengths peaks at 6 lengths/s, half of what its servos can do, and the longest
possible movement, of 6 lengths, takes 1.7 s.  If the target moves by less than a jump, the movement
continues for at least `HORIZON` more control steps.  So the hand pursues the target without haste,
and noise in the seen target is smoothed.

The hand goes from rest at x₀ to rest at the target g in T, on the path of least ∫ |d³x/dt³|² dt:

    x(t) = x₀ + (g − x₀) (10 τ³ − 15 τ⁴ + 6 τ⁵),     τ = t/T

a straight line with a bell-shaped speed.  At any time the rest of the movement is the quintic from
the present position, velocity and acceleration to rest at g in the rest of T.  Each control step
follows that quintic.  A target that has moved is simply another g, to which the movement turns
smoothly.  The posture follows by damped least squares.

Literature: Flash & Hogan (1985), J. Neurosci. 5, 1688–1703.  Hoff & Arbib (1993), J. Motor Behavior
25, 175–192 (the rest of the movement from the present state).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from typing_extensions import override

from mmc_gym.agents.base import JointTargetAgent, where
from mmc_gym.agents.inverse_kinematics import hand_position, iterate
from mmc_gym.geometry import Floats
from mmc_gym.interface import Sensed

BASE_DURATION = 0.2  #: T₀: duration of a movement of no length, s
AVERAGE_SPEED = 4.0  #: v̄: growth of distance with duration, segment lengths / s
NEW_TARGET_DISTANCE = 0.3  #: a target that moves farther in a control step has jumped, lengths
HORIZON = 5  #: least number of control steps that remain while the target moves
ITERATIONS = 3  #: iterations of inverse kinematics in a control step
#: λ of inverse kinematics: lower than for a solver alone, because the plan moves the hand only a
#: fraction of a length in a step; a low λ keeps the hand on the path
DAMPING = 0.05


class MovementTiming(NamedTuple):
    """The target and timing of a movement under way."""

    target: Floats  #: segment lengths, (..., 2)
    elapsed: Floats  #: control steps since the movement began, (...)
    duration: Floats  #: T, control steps, (...)

    @property
    def remaining(self) -> Floats:
        """Control steps until the movement ends, at least 0, (...)."""
        return np.maximum(self.duration - self.elapsed, 0.0)


def begin_movement(hand: Floats, target: Floats, control_step: float) -> MovementTiming:
    """Return a new movement of the hand to a target, both (..., 2) in segment lengths."""
    way = target - hand
    distance = np.hypot(way[..., 0], way[..., 1])
    duration = np.ceil((BASE_DURATION + distance / AVERAGE_SPEED) / control_step - 1e-9)
    return MovementTiming(target, np.zeros_like(duration), duration)


def follow_target(
    movement: MovementTiming, hand: Floats, target: Floats, control_step: float
) -> MovementTiming:
    """Return the movement to the present target; if the target jumped, begin anew from the hand."""
    shift = target - movement.target
    moved = np.hypot(shift[..., 0], shift[..., 1])
    if not moved.any():
        return movement
    longer = np.where(moved > 0, movement.elapsed + HORIZON, 0.0)
    new = begin_movement(hand, target, control_step)
    same = MovementTiming(target, movement.elapsed, np.maximum(movement.duration, longer))
    return where(moved > NEW_TARGET_DISTANCE, new, same)


def one_step_later(movement: MovementTiming) -> MovementTiming:
    """Return the movement one control step later."""
    return movement._replace(elapsed=movement.elapsed + 1.0)


class HandPlan(NamedTuple):
    """Planned motion of the hand, each field (..., 2), in segment lengths and control steps."""

    position: Floats
    velocity: Floats
    acceleration: Floats


class MinimumJerkState(NamedTuple):
    """State of a `MinimumJerkAgent`: plan, movement under way, and joint angles (..., N)."""

    plan: HandPlan
    movement: MovementTiming
    joint_angles: Floats


class MinimumJerkAgent(JointTargetAgent[MinimumJerkState]):
    """Plans the path of the hand by minimum jerk and follows it by damped least squares."""

    @override
    def start(self, sensed: Sensed) -> MinimumJerkState:
        hand = hand_position(sensed.joint_angles, self.interface.segment_lengths)
        plan = HandPlan(hand, np.zeros_like(hand), np.zeros_like(hand))
        movement = begin_movement(hand, sensed.target, self.interface.control_step)
        return MinimumJerkState(plan, movement, sensed.joint_angles)

    @override
    def advance(self, state: MinimumJerkState, sensed: Sensed) -> tuple[Floats, MinimumJerkState]:
        interface, hand = self.interface, state.plan.position
        movement = follow_target(state.movement, hand, sensed.target, interface.control_step)
        plan = minimum_jerk_step(state.plan, movement.target, movement.remaining)
        lengths, limits = interface.segment_lengths, interface.joint_limits
        posture = iterate(state.joint_angles, plan.position, lengths, ITERATIONS, limits, DAMPING)
        return posture, MinimumJerkState(plan, one_step_later(movement), posture)


def minimum_jerk_step(plan: HandPlan, target: Floats, remaining: Floats) -> HandPlan:
    """Return the plan one control step later, on the path of least jerk to rest at a target.

    The hand comes to rest at its target (..., 2) after `remaining` control steps (...), or after
    this step if at most one remains.
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
