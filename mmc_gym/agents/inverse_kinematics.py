"""Inverse kinematics as a policy: a solver iterates on an internal posture, servos follow it.

The internal posture starts as the sensed one.  In each control step a solver takes it nearer to
the target, by a few iterations, and its joint angles are the servos' targets.  Later
senses do not change it: this is resolved-rate control (Whitney 1969) over position servos.

**By the Jacobian.**  With J, the derivative of the hand's position by the joint angles q,

    Δq = Jᵀ(JJᵀ + λ²I)⁻¹e,     e = target − hand, shortened to at most `max_step`

`max_step` and `damping` (λ) are in segment lengths.

**In closed form**, for one, two or three segments.  With the orientation φ of the last segment
given, an arm of three is one of two, to the wrist:

    w = target − ℓ₃ (cos φ, sin φ),     |ℓ₁ − ℓ₂| ≤ |w| ≤ ℓ₁ + ℓ₂
    tan²(q₂/2) = ((ℓ₁ + ℓ₂)² − |w|²) / (|w|² − (ℓ₁ − ℓ₂)²)               elbow on either side
    q₁ = ∠w − ∠(ℓ₁ + ℓ₂ cos q₂, ℓ₂ sin q₂),     q₃ = φ − q₁ − q₂

The half angle is exact where acos is not: near the stretched and the folded arm.  φ is the one
redundant freedom.  The angle α between φ and the target's direction determines |w|.  Possible α
form an interval of |α|, which is swept.  The solution nearest to the present posture is chosen, by
the Euclidean distance of joint angles the short way round.

Literature: D. E. Whitney (1969), Resolved motion rate control of manipulators and human
prostheses, IEEE Trans. Man-Machine Systems 10, 47–53.  C. W. Wampler (1986), IEEE Trans. Syst. Man
Cybern. 16, 93–101, and Y. Nakamura, H. Hanafusa (1986), J. Dyn. Syst. Meas. Control 108, 163–171
(damping).  S. R. Buss, J.-S. Kim (2005), Selectively damped least squares for inverse kinematics,
J. Graphics Tools 10(3), 37–49 (shortened error).  J. J. Craig, Introduction to Robotics: Mechanics
and Control, ch. 4 (planar arm of three joints).
"""

from __future__ import annotations

from collections.abc import Callable
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
    wrap_angle,
)
from mmc_gym.interface import CannotActError, JointLimits, ReachInterface, Sensed
from mmc_gym.network.chain import BEND

SegmentLengths: TypeAlias = tuple[float, ...]
Solver: TypeAlias = Callable[[Floats, Floats, SegmentLengths, "JointLimits | None"], Floats]
"""One iteration of a method: joint angles (..., N) in radians, for a target.

It is a pure function of joint angles (..., N), targets (..., 2) in segment lengths, N lengths, and
the lowest and highest angle of each joint in radians (None: joints turn freely).
"""

STRAIGHT = 0.01  #: angle within which an arm is straight, and a target in line with it, radians
ORIENTATIONS = 90  #: orientations of a sweep, on either side of the target's direction

_LEFT = np.array([-1.0, 1.0])  # (y, x) times this is (x, y) turned left by a right angle
_TINY = np.finfo(np.float64).tiny
_SLACK = 1e-9  # radians beyond a limit that count as within
_FAR = 1e3  # more than any squared distance of postures


class InverseKinematicsAgent(JointTargetAgent[Floats]):
    """Runs a solver on an internal posture; its state is that posture's joint angles (..., N)."""

    def __init__(
        self, interface: ReachInterface, solver: Solver, iterations_per_step: int = 1
    ) -> None:
        """Make the agent, whose solver is one iteration, such as `damped_step`.

        It cannot act under torque control, or if the solver is not for so many segments.
        """
        require_whole("iterations_per_step", iterations_per_step)
        super().__init__(interface)
        self.solver = solver
        self.iterations_per_step = iterations_per_step
        lengths = interface.segment_lengths
        stretched, target = np.zeros(len(lengths)), np.array([sum(lengths), 0.0])
        solver(stretched, target, lengths, interface.joint_limits)  # refuses here, if at all

    @override
    def start(self, sensed: Sensed) -> Floats:
        return sensed.joint_angles

    @override
    def advance(self, state: Floats, sensed: Sensed) -> tuple[Floats, Floats]:
        lengths, limits = self.interface.segment_lengths, self.interface.joint_limits
        count = self.iterations_per_step
        state = iterate(self.solver, state, sensed.target, lengths, count, limits)
        return state, state


def damped_least_squares_agent(interface: ReachInterface) -> InverseKinematicsAgent:
    """Make the agent of `damped_step`, three iterations per control step."""
    return InverseKinematicsAgent(interface, damped_step, iterations_per_step=3)


def closed_form_agent(interface: ReachInterface) -> InverseKinematicsAgent:
    """Make the agent of `closed_form`."""
    return InverseKinematicsAgent(interface, closed_form)


def iterate(
    solver: Solver,
    joint_angles: Floats,
    target: Floats,
    segment_lengths: SegmentLengths,
    iterations: int,
    joint_limits: JointLimits | None = None,
) -> Floats:
    """Return joint angles (..., N) after iterations of a solver; first leave a dead end.

    A target out of reach is replaced by the nearest point within reach, because an arm that keeps
    pulling outward trembles where it is stretched.
    """
    target = nearest_reachable(target, segment_lengths)
    joint_angles = leave_line(joint_angles, target, segment_lengths)
    for _ in range(iterations):
        joint_angles = solver(joint_angles, target, segment_lengths, joint_limits)
    return joint_angles


def jacobian(joint_angles: Floats, segment_lengths: SegmentLengths) -> tuple[Floats, Floats]:
    """Return the hand (..., 2), and J, its derivatives by the joint angles, (..., 2, N).

    A joint turns the hand about itself: column i of J is (hand − p_i) turned by 90°.
    """
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
    """Iterate once by damped least squares: a `Solver`.

    The change is at most `max_step` / (2 `damping`), at singularities too.  Joints stop at their
    limits.
    """
    hand, by_joints = jacobian(joint_angles, segment_lengths)
    error = target - hand
    distance = np.hypot(error[..., 0], error[..., 1])[..., None]
    error = error * (max_step / np.maximum(distance, max_step))
    moved = joint_angles + damped_least_squares(by_joints, error, damping)
    return moved if joint_limits is None else np.clip(moved, *np.transpose(joint_limits))


def closed_form(
    joint_angles: Floats,
    target: Floats,
    segment_lengths: SegmentLengths,
    joint_limits: JointLimits | None = None,
) -> Floats:
    """Return the solution nearest to a posture, joint angles (..., N): a `Solver` for N up to 3.

    One iteration is enough.  For a target out of reach it solves for the nearest point within.
    With two equal segments and the target at the base the first joint is free; its angle is then
    arbitrary.  Solutions beyond joint limits do not count, and distances are measured along the way
    that the limits allow.  If all are beyond, the one least beyond is moved to the limits.
    """
    found = solutions(target, segment_lengths, joint_angles)
    changes = found - joint_angles[..., None, :]
    beyond: Floats | float = 0.0
    if joint_limits is None:
        # As `wrap_angle`, but for the last bits, in a fifth of the time.
        ways = changes - 2 * np.pi * np.rint(changes / (2 * np.pi))
    else:
        low, high = np.transpose(joint_limits)
        within = (low + high) / 2 + wrap_angle(found - (low + high) / 2)
        allowed = np.clip(within, low, high)
        beyond = np.abs(within - allowed).max(axis=-1)
        beyond = np.where(beyond > _SLACK, _FAR + beyond * _FAR, 0.0)
        changes = ways = allowed - joint_angles[..., None, :]
    nearest = (np.einsum("...i,...i", ways, ways) + beyond).argmin(axis=-1)
    change = np.take_along_axis(changes, nearest[..., None, None], axis=-2)[..., 0, :]
    return joint_angles + (wrap_angle(change) if joint_limits is None else change)


def solutions(target: Floats, segment_lengths: SegmentLengths, joint_angles: Floats) -> Floats:
    """Return postures that bring the hand to `target`, radians in any turn, (..., solutions, N).

    A target out of reach counts as the nearest point within.  One or two segments have one or two
    postures.  With three segments there is one for each way to bend and each of several
    orientations of the last segment: the extreme ones, some between them, and that of
    `joint_angles`, or the extreme one next to it.
    """
    count = len(segment_lengths)
    if count > 3:
        accepted = "1, 2 or 3 for a solution in closed form"
        raise CannotActError(f"segment_lengths must be {accepted}, got {count}: {segment_lengths}")
    target = nearest_reachable(target, segment_lengths)
    bearing = np.arctan2(target[..., 1], target[..., 0])
    if count == 1:
        return bearing[..., None, None]
    if count == 2:
        return np.stack(_two_segments(target, *segment_lengths), axis=-2)
    present = wrap_angle(joint_angles.sum(axis=-1) - bearing)
    distance = np.hypot(target[..., 0], target[..., 1])
    orientations = bearing[..., None] + _orientations(distance, present, segment_lengths)
    hand = np.stack([np.cos(orientations), np.sin(orientations)], axis=-1)
    wrist = target[..., None, :] - segment_lengths[2] * hand
    both = [
        np.concatenate([two, (orientations - two.sum(axis=-1))[..., None]], axis=-1)
        for two in _two_segments(wrist, *segment_lengths[:2])
    ]
    return np.concatenate(both, axis=-2)


def _orientations(distance: Floats, present: Floats, segment_lengths: SegmentLengths) -> Floats:
    """Return the α of a sweep for targets at a distance, (..., 2 `ORIENTATIONS` + 1)."""
    first, second, last = segment_lengths
    # |w|² = distance² + ℓ₃² − 2 distance ℓ₃ cos α; at the base any α gives the same.
    product = np.maximum(2 * distance * last, _TINY)
    square = distance * distance + last * last
    least = np.arccos(np.clip((square - (first - second) ** 2) / product, -1.0, 1.0))
    most = np.arccos(np.clip((square - (first + second) ** 2) / product, -1.0, 1.0))
    swept = np.linspace(least, most, ORIENTATIONS, axis=-1)
    nearest = np.copysign(np.clip(np.abs(present), least, most), present)
    return np.concatenate([nearest[..., None], swept, -swept], axis=-1)


def _two_segments(wrist: Floats, first: float, second: float) -> tuple[Floats, Floats]:
    """Return both solutions for two segments, (..., 2); if too far, for the nearest point."""
    distance = np.hypot(wrist[..., 0], wrist[..., 1])
    short = (first + second - distance) * (first + second + distance)
    long = (distance - abs(first - second)) * (distance + abs(first - second))
    elbow = 2 * np.arctan2(np.sqrt(np.maximum(short, 0.0)), np.sqrt(np.maximum(long, 0.0)))
    bearing = np.arctan2(wrist[..., 1], wrist[..., 0])
    offset = np.arctan2(second * np.sin(elbow), first + second * np.cos(elbow))
    ways = (bearing - offset, elbow), (bearing + offset, -elbow)
    return np.stack(ways[0], axis=-1), np.stack(ways[1], axis=-1)
