"""Planned movements of the hand: by minimum jerk, and by the Passive Motion Paradigm.

A movement begins with the episode, and wherever the target jumps.  It takes

    T = T₀ + d / v̄,     d the distance of the hand from the target at its beginning

Durations of reaching movements grow about linearly with their amplitude (for given accuracy and
medium amplitudes, Fitts's logarithm is nearly a line).  T₀ and v̄ are chosen for the arm: with them
a minimum-jerk movement of 3 segment lengths peaks at 6 lengths/s, half of what its servos can do,
and the longest there is, of 6, takes 1.7 s.  A target that moves on by less than a jump belongs to
the same movement, which then goes on for at least `HORIZON` more control steps, so that the hand
pursues the target without haste, and noise in seeing the target is smoothed.

**Minimum jerk.**  The hand goes from rest at x₀ to rest at the target g in T, on the path of least
∫ |d³x/dt³|² dt:

    x(t) = x₀ + (g − x₀) (10 τ³ − 15 τ⁴ + 6 τ⁵),     τ = t/T

a straight line with a bell-shaped speed.  At any time the rest of it is the quintic from the
present position, velocity and acceleration to rest at g in what remains of T.  So that is what is
stepped along, and a target that has moved is simply another g: the movement turns to it smoothly.
The posture follows by damped least squares.

**The Passive Motion Paradigm.**  The target pulls at the hand of an internal body, which gives way:

    force     F = K e,               e = target − hand
    torques   τ = Jᵀ F
    motion    q̇ = Γ(t) A τ,          A = I: all joints give way alike
    so        ẋ = Γ(t) J Jᵀ K e

Γ = ξ̇ / (1 − ξ) is a time base generator, with ξ the minimum-jerk course from 0 to 1 in T.  It grows
without bound towards T, so the hand is at the target at T wherever it came from (a terminal
attractor), with a bell-shaped speed.  The stiffness K = |e| / |JJᵀe| is a scalar that takes from
the body's geometry what would distort the time course: |ẋ| = Γ |e|.  The path is what the arm's
mobility makes it, slightly curved.

A control step is integrated in `SUBSTEPS`.  Towards T, and wherever the arm is more mobile in one
direction than in another, the equation is stiff, so the force is that at the end of the step:

    Δq = Jᵀ F,     (ρ + JJᵀ) F = e,     ρ = 1/(K G),     G = σ/(1 − σ)

with σ_k = (ξ_k − ξ_{k−1}) / (1 − ξ_{k−1}), the share of the distance that Γ asks for.  G is such
that an arm of equal mobility 1/K in all directions covers it exactly; for others, `CORRECTIONS`
put the mobility right that K was made of.  (It is damped least squares, the damping set by the
time base.)  After T, σ = 1, and what is left goes as fast as it can: where the arm is nearly
stretched or folded, the hand may arrive late.

Literature: T. Flash, N. Hogan (1985), The coordination of arm movements: an experimentally
confirmed mathematical model, J. Neurosci. 5, 1688–1703.  B. Hoff, M. A. Arbib (1993), Models of
trajectory formation and temporal interaction of reach and grasp, J. Motor Behavior 25, 175–192
(the rest of the movement from the present state).  F. A. Mussa-Ivaldi, P. Morasso, R. Zaccaria
(1988), Kinematic networks: a distributed model for representing and regularizing motor redundancy,
Biol. Cybern. 60, 1–16.  V. Mohan, P. Morasso (2011), Passive motion paradigm: an alternative to
optimal control, Front. Neurorobot. 5:4.  M. Zak (1988), Terminal attractors for addressable memory
in neural networks, Phys. Lett. A 133, 18–22.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np
from typing_extensions import override

from mmc_gym.agents.base import JointTargetAgent, where
from mmc_gym.agents.ik.agent import (
    SegmentLengths,
    hand_position,
    iterate,
    jacobian,
    leave_line,
)
from mmc_gym.agents.ik.iterative import damped_least_squares, limited, resisted_force
from mmc_gym.interface import Sensed
from mmc_gym.network.chain import Floats, nearest_reachable
from mmc_gym.network.time_base import share

SHORTEST = 0.2
"""T₀: duration of a movement that has nowhere to go, s."""
AVERAGE_SPEED = 4.0
"""v̄: growth of distance with duration, segment lengths/s."""
JUMP = 0.3
"""A target that moves farther than this in a control step has jumped, segment lengths."""
HORIZON = 5
"""Control steps that are left at least while the target moves on."""

ITERATIONS = 3
"""Iterations of inverse kinematics in a control step."""
SUBSTEPS = 3
"""Integration steps of the internal body in a control step."""
MAX_CHANGE = 0.1
"""Most that a joint of it turns in an integration step, radians."""
CORRECTIONS = 1
"""Times that the mobility is put right in an integration step."""
LEAST_RESISTANCE = 0.05**2
"""Bound of ρ, segment lengths squared, so that a step is bounded where J is singular."""
MOST_RESISTANCE = 1e30
"""Bound of ρ, where the time base asks for nothing yet."""

_TINY = np.finfo(np.float64).tiny

# The plan moves a fraction of a length in a step, so less damping than that of a lone solver
# keeps the hand on the path, and is enough.
_track = partial(damped_least_squares, damping=0.05, max_step=0.1)


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
        """Control steps until it is over, at least 0, (...)."""
        return np.maximum(self.duration - self.elapsed, 0.0)


def begin(hand: Floats, target: Floats, control_step: float) -> Movement:
    """Begin a movement of the hand to a target, (..., 2) in segment lengths.

    >>> begin(np.array([1.0, 0.0]), np.array([3.0, 0.0]), control_step=0.02).duration.item()
    35.0
    """
    way = target - hand
    distance = np.hypot(way[..., 0], way[..., 1])
    duration = np.ceil((SHORTEST + distance / AVERAGE_SPEED) / control_step - 1e-9)
    return Movement(target, np.zeros_like(duration), duration)


def follow(movement: Movement, hand: Floats, target: Floats, control_step: float) -> Movement:
    """Return the movement to where the target is now: a new one, from the hand, if it jumped."""
    shift = target - movement.target
    moved = np.hypot(shift[..., 0], shift[..., 1])
    if not moved.any():
        return movement
    longer = np.where(moved > 0, movement.elapsed + HORIZON, 0.0)
    same = Movement(target, movement.elapsed, np.maximum(movement.duration, longer))
    return where(moved > JUMP, begin(hand, target, control_step), same)


def step(movement: Movement) -> Movement:
    """Return the movement one control step later."""
    return movement._replace(elapsed=movement.elapsed + 1.0)


class HandPlan(NamedTuple):
    """A planned motion of the hand, (..., 2) each; time in control steps, segment lengths."""

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

    @override
    def start(self, sensed: Sensed) -> MinimumJerkState:
        hand = hand_position(sensed.joint_angles, self.interface.segment_lengths)
        return MinimumJerkState(
            HandPlan(hand, np.zeros_like(hand), np.zeros_like(hand)),
            begin(hand, sensed.target, self.interface.control_step),
            sensed.joint_angles,
        )

    @override
    def advance(self, state: MinimumJerkState, sensed: Sensed) -> tuple[Floats, MinimumJerkState]:
        plan, lengths = state.plan, self.interface.segment_lengths
        movement = follow(state.movement, plan.position, sensed.target, self.interface.control_step)
        plan = minimum_jerk_step(plan, movement.target, movement.remaining)
        limits = self.interface.joint_limits
        posture = iterate(_track, state.joint_angles, plan.position, lengths, ITERATIONS, limits)
        return posture, MinimumJerkState(plan, step(movement), posture)


def minimum_jerk_step(plan: HandPlan, target: Floats, remaining: Floats) -> HandPlan:
    """Return the plan one control step later, on the way of least jerk to rest at the target.

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


class PassiveMotionState(NamedTuple):
    """State of the agent: the movement, and the joint angles of the internal body (..., N)."""

    movement: Movement
    joint_angles: Floats


class PassiveMotionAgent(JointTargetAgent[PassiveMotionState]):
    """Moves an internal body by the Passive Motion Paradigm; the servos follow its joints."""

    @override
    def start(self, sensed: Sensed) -> PassiveMotionState:
        hand = hand_position(sensed.joint_angles, self.interface.segment_lengths)
        movement = begin(hand, sensed.target, self.interface.control_step)
        return PassiveMotionState(movement, sensed.joint_angles)

    @override
    def advance(
        self, state: PassiveMotionState, sensed: Sensed
    ) -> tuple[Floats, PassiveMotionState]:
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
    joint_angles: Floats, target: Floats, share: Floats, segment_lengths: SegmentLengths
) -> Floats:
    """Return joint angles (..., N) after an integration step of the internal body.

    `share` is ∫ Γ dt over the step: the share of the distance that is to be covered, (...).
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
