"""Inverse kinematics by iteration: four solvers by the Jacobian, and two joint after joint.

Each is a `Solver`: that says what the first three arguments are, and what is returned.  Four go by
the Jacobian J of the hand's position with respect to the joint angles q:

    e = target − hand,   shortened to at most `max_step` except for the transpose
    transpose        Δq = α Jᵀe,             α = ⟨e, JJᵀe⟩ / ⟨JJᵀe, JJᵀe⟩
    pseudo-inverse   Δq = J⁺e = Jᵀ(JJᵀ)⁻¹e
    damped           Δq = Jᵀ(JJᵀ + λ²I)⁻¹e
    null space       Δq = Jᵀ(JJᵀ + λ²I)⁻¹e − κ (I − J⁺J) ∇H(q)

`max_step` and `damping` (λ) are in segment lengths.  `max_change` is the most that a joint turns,
and `joint_limits` the lowest and highest angle of each joint, radians; None: joints turn freely.

Cyclic coordinate descent turns one joint at a time, from the hand to the base, so that the hand
comes as near to the target as this joint alone can bring it: into the line from joint to target.

FABRIK (forward and backward reaching inverse kinematics) places nodes: first it puts the hand on
the target and draws each segment behind it, from the hand to the base; then it puts the base back
and draws each segment behind that.  A drawn segment keeps its length, and points from the node
that has been placed to where its other node was.

Literature: W. A. Wolovich, H. Elliott (1984), A computational technique for inverse kinematics,
23rd IEEE Conf. on Decision and Control, 1359–1363 (transpose).  D. E. Whitney (1969), IEEE Trans.
Man-Machine Systems 10, 47–53 (pseudo-inverse).  C. W. Wampler (1986), IEEE Trans. Syst. Man
Cybern. 16, 93–101, and Y. Nakamura, H. Hanafusa (1986), J. Dyn. Syst. Meas. Control 108, 163–171
(damping).  A. Liégeois (1977), Automatic supervisory control of the configuration and behavior of
multibody mechanisms, IEEE Trans. Syst. Man Cybern. 7, 868–871 (null space).  S. R. Buss, J.-S. Kim
(2005), Selectively damped least squares for inverse kinematics, J. Graphics Tools 10(3), 37–49
(shortened error).  L.-C. T. Wang, C. C. Chen (1991), A combined optimization method for solving the
inverse kinematics problem of mechanical manipulators, IEEE Trans. Robotics and Automation 7,
489–499 (cyclic coordinate descent).  A. Aristidou, J. Lasenby (2011), FABRIK: a fast, iterative
solver for the inverse kinematics problem, Graphical Models 73, 243–260.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from mmc_gym.agents.ik.agent import SegmentLengths, jacobian
from mmc_gym.interface import JointLimits
from mmc_gym.network.chain import Floats, wrap_angle

Points: TypeAlias = NDArray[np.complex128]
"""Points of the plane as complex numbers, x + iy: to turn is to multiply."""

COINCIDENT = 1e-9
"""Points nearer to each other than this, in reaches, have no direction."""

_TINY = np.finfo(np.float64).tiny


def jacobian_transpose(
    joint_angles: Floats,
    target: Floats,
    segment_lengths: SegmentLengths,
    max_change: float = 0.05,
) -> Floats:
    """Iterate once by the Jacobian transpose.

    α is the step that takes the hand nearest to the target, were J constant.  The error is not
    shortened: where α Jᵀe is more than `max_change` for a joint, all turn by the same share of it.
    """
    hand, jacobian_x, jacobian_y = jacobian(joint_angles, segment_lengths)
    error = target - hand
    direction = jacobian_x * error[..., :1] + jacobian_y * error[..., 1:]
    moved_x = (jacobian_x * direction).sum(axis=-1)
    moved_y = (jacobian_y * direction).sum(axis=-1)
    along = error[..., 0] * moved_x + error[..., 1] * moved_y
    square = moved_x * moved_x + moved_y * moved_y
    size = np.divide(along, square, out=np.zeros_like(along), where=square > _TINY)
    return joint_angles + limited(size[..., None] * direction, max_change)


def pseudo_inverse(
    joint_angles: Floats,
    target: Floats,
    segment_lengths: SegmentLengths,
    truncation: float = 0.002,
    max_step: float = 0.1,
    max_change: float = 0.2,
) -> Floats:
    """Iterate once by the pseudo-inverse, J⁺ = Σ v uᵀ/σ for J = Σ σ u vᵀ.

    Singularities: a σ less than `truncation` times the largest counts as 0, so that the arm does
    not try to move where it cannot.  Before that the change by each σ is bounded for itself (as
    in selectively damped least squares), so that a hopeless direction does not hold up the other.
    """
    hand, jacobian_x, jacobian_y = jacobian(joint_angles, segment_lengths)
    error = shortened(target - hand, max_step)
    for toward, row, inverse in _singular_rows(jacobian_x, jacobian_y, truncation):
        share = (toward * error).sum(axis=-1) * inverse
        joint_angles = joint_angles + limited(share[..., None] * row, max_change)
    return joint_angles


def damped_least_squares(
    joint_angles: Floats,
    target: Floats,
    segment_lengths: SegmentLengths,
    damping: float = 0.1,
    max_step: float = 0.1,
) -> Floats:
    """Iterate once by damped least squares.

    The change is at most `max_step` / (2 `damping`), at singularities too.
    """
    hand, jacobian_x, jacobian_y = jacobian(joint_angles, segment_lengths)
    error = shortened(target - hand, max_step)
    return joint_angles + _damped_change(jacobian_x, jacobian_y, error, damping)


def null_space(
    joint_angles: Floats,
    target: Floats,
    segment_lengths: SegmentLengths,
    comfort: float = 0.03,
    damping: float = 0.1,
    max_step: float = 0.1,
    joint_limits: JointLimits | None = None,
) -> Floats:
    """Iterate once by damped least squares, towards a comfortable posture.

    H = ½ Σ (q_i − m_i)²: Liégeois's distance from the middles m of the joints' ranges.  Where there
    are no limits these are 0, and the first joint, which only says where the arm points, is left
    out: among all postures that reach the target the evenly bent one is the most comfortable.
    With limits each term has a weight, (narrowest range / its range)⁴, and joints may pass through
    the forbidden range here: comfort takes them out again, and the servos go round.  The projector
    is that of the undamped pseudo-inverse, so comfort does not move the hand; it is bounded, so it
    needs no damping.  `comfort` is κ, the share of the way to it that one iteration goes.
    """
    hand, jacobian_x, jacobian_y = jacobian(joint_angles, segment_lengths)
    error = shortened(target - hand, max_step)
    change = _damped_change(jacobian_x, jacobian_y, error, damping)
    if joint_limits is None:
        toward_comfort = -comfort * wrap_angle(joint_angles)
        toward_comfort[..., 0] = 0.0
    else:
        middle, spread = np.mean(joint_limits, axis=-1), np.ptp(joint_limits, axis=-1)
        weight = (spread.min() / spread) ** 4
        toward_comfort = comfort * weight * wrap_angle(middle - joint_angles)
    for _, row, inverse in _singular_rows(jacobian_x, jacobian_y, truncation=1e-6):
        share = (row * toward_comfort).sum(axis=-1) * inverse
        toward_comfort = toward_comfort - share[..., None] * row
    return joint_angles + change + toward_comfort


def _damped_change(jacobian_x: Floats, jacobian_y: Floats, error: Floats, damping: float) -> Floats:
    """Return Jᵀ(JJᵀ + λ²I)⁻¹e, the change of the joint angles (..., N)."""
    force_x, force_y = resisted_force(jacobian_x, jacobian_y, error, damping**2)
    change: Floats = jacobian_x * force_x[..., None] + jacobian_y * force_y[..., None]
    return change


def shortened(error: Floats, max_step: float) -> Floats:
    """Return vectors (..., 2), those longer than `max_step` shortened to it."""
    distance = np.hypot(error[..., 0], error[..., 1])[..., None]
    short: Floats = error * (max_step / np.maximum(distance, max_step))
    return short


def limited(change: Floats, max_change: float) -> Floats:
    """Return changes (..., N) of joint angles, all smaller where one is above `max_change`."""
    largest = np.abs(change).max(axis=-1, keepdims=True)
    smaller: Floats = change * (max_change / np.maximum(largest, max_change))
    return smaller


def resisted_force(
    jacobian_x: Floats, jacobian_y: Floats, error: Floats, resistance: Floats | float
) -> tuple[Floats, Floats]:
    """Return both components (...) of f = (JJᵀ + ρI)⁻¹e: the damped step is Jᵀf, the hand's e − ρf.

    The resistance ρ = λ², in segment lengths squared, is one for all or one for each, (...).
    """
    # (J Jᵀ + ρ I) is 2 × 2 and symmetric; its inverse is written out.
    xx = (jacobian_x * jacobian_x).sum(axis=-1) + resistance
    yy = (jacobian_y * jacobian_y).sum(axis=-1) + resistance
    xy = (jacobian_x * jacobian_y).sum(axis=-1)
    determinant = xx * yy - xy * xy
    return (
        (yy * error[..., 0] - xy * error[..., 1]) / determinant,
        (xx * error[..., 1] - xy * error[..., 0]) / determinant,
    )


def _singular_rows(
    jacobian_x: Floats, jacobian_y: Floats, truncation: float
) -> Iterator[tuple[Floats, Floats, Floats]]:
    """Yield u (..., 2), σ·v = Jᵀu (..., N) and 1/σ² (...) for both singular values σ of J.

    J = Σ σ u vᵀ.  1/σ² is 0 where σ is less than `truncation` times the larger one.
    """
    xx = (jacobian_x * jacobian_x).sum(axis=-1)
    yy = (jacobian_y * jacobian_y).sum(axis=-1)
    xy = (jacobian_x * jacobian_y).sum(axis=-1)
    angle = np.arctan2(2 * xy, xx - yy) / 2  # of the eigenvector of J Jᵀ with the larger value
    larger = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    smaller = np.stack([-larger[..., 1], larger[..., 0]], axis=-1)
    least = np.full_like(xx, _TINY)
    for toward in (larger, smaller):
        row = toward[..., :1] * jacobian_x + toward[..., 1:] * jacobian_y
        square = (row * row).sum(axis=-1)
        yield toward, row, np.divide(1.0, square, out=np.zeros_like(square), where=square > least)
        least = np.maximum(truncation**2 * square, _TINY)


def cyclic_coordinate_descent(
    joint_angles: Floats,
    target: Floats,
    segment_lengths: SegmentLengths,
    max_change: float = 0.1,
    joint_limits: JointLimits | None = None,
) -> Floats:
    """Turn every joint once by cyclic coordinate descent.

    With turns of any size the joints next to the hand turn most, and the arm curls up before the
    others get to work.  Small turns make all take part, and a path of the hand that is nearly
    straight; π allows any.  A joint on which the hand or the target lies does not turn.  One that
    stops at its limit leaves the rest to the joints after it.
    """
    lengths = np.array(segment_lengths)
    aim = _points(target)
    segments = lengths * np.exp(1j * np.cumsum(joint_angles, axis=-1))
    nodes = np.cumsum(segments, axis=-1)
    joints, hand = nodes - segments, nodes[..., -1]
    least = (COINCIDENT * lengths.sum()) ** 2
    change = np.zeros(np.broadcast_shapes(joint_angles.shape, (*aim.shape, 1)))
    for joint in reversed(range(len(lengths))):
        reach = hand - joints[..., joint]
        turn = (aim - joints[..., joint]) * reach.conj()
        angle = np.where(np.abs(turn) > least, np.angle(turn), 0.0)
        change[..., joint] = np.clip(angle, -max_change, max_change)
        if joint_limits is not None:
            present, (low, high) = joint_angles[..., joint], joint_limits[joint]
            change[..., joint] = np.clip(present + change[..., joint], low, high) - present
        hand = joints[..., joint] + reach * np.exp(1j * change[..., joint])
    return joint_angles + change


def fabrik(joint_angles: Floats, target: Floats, segment_lengths: SegmentLengths) -> Floats:
    """Iterate once by FABRIK, backward and forward.

    To a target out of reach the arm stretches out straight.  A segment whose ends coincide keeps
    its direction.
    """
    aim = _points(target)
    directions = list(np.moveaxis(np.exp(1j * np.cumsum(joint_angles, axis=-1)), -1, 0))
    nodes = [np.zeros_like(aim)]
    for length, direction in zip(segment_lengths, directions, strict=True):
        nodes.append(nodes[-1] + length * direction)
    reach = sum(segment_lengths)
    nodes[-1] = aim
    for joint in reversed(range(len(directions))):
        directions[joint] = _direction(nodes[joint + 1] - nodes[joint], directions[joint], reach)
        nodes[joint] = nodes[joint + 1] - segment_lengths[joint] * directions[joint]
    nodes[0] = np.zeros_like(aim)
    for joint, length in enumerate(segment_lengths):
        directions[joint] = _direction(nodes[joint + 1] - nodes[joint], directions[joint], reach)
        nodes[joint + 1] = nodes[joint] + length * directions[joint]
    straight = _direction(aim, directions[0], reach)
    segment_angles = np.angle(
        np.stack([np.where(np.abs(aim) > reach, straight, each) for each in directions], axis=-1)
    )
    relative = np.diff(segment_angles, axis=-1, prepend=0.0)
    return joint_angles + wrap_angle(relative - joint_angles)


def _points(vectors: Floats) -> Points:
    points: Points = vectors[..., 0] + 1j * vectors[..., 1]
    return points


def _direction(vector: Points, otherwise: Points, reach: float) -> Points:
    length = np.abs(vector)
    apart = length > COINCIDENT * reach
    return np.where(apart, vector / np.where(apart, length, 1.0), otherwise)
