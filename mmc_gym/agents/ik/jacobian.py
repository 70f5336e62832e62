"""Inverse kinematics by the Jacobian: transpose, pseudo-inverse, damped, and with a null space.

    e = target − hand,   shortened to at most `max_step` except for the transpose
    transpose        Δq = α Jᵀe,             α = ⟨e, JJᵀe⟩ / ⟨JJᵀe, JJᵀe⟩
    pseudo-inverse   Δq = J⁺e = Jᵀ(JJᵀ)⁻¹e
    damped           Δq = Jᵀ(JJᵀ + λ²I)⁻¹e
    null space       Δq = Jᵀ(JJᵀ + λ²I)⁻¹e − κ (I − J⁺J) ∇H(q)

J is the Jacobian of the hand's position with respect to the joint angles q.  All solvers are
iterations in the sense of `inverse_kinematics.Solver`.

Literature: W. A. Wolovich, H. Elliott (1984), A computational technique for inverse kinematics,
23rd IEEE Conf. on Decision and Control, 1359–1363 (transpose).  D. E. Whitney (1969), IEEE Trans.
Man-Machine Systems 10, 47–53 (pseudo-inverse).  C. W. Wampler (1986), IEEE Trans. Syst. Man
Cybern. 16, 93–101, and Y. Nakamura, H. Hanafusa (1986), J. Dyn. Syst. Meas. Control 108, 163–171
(damping).  A. Liégeois (1977), Automatic supervisory control of the configuration and behavior of
multibody mechanisms, IEEE Trans. Syst. Man Cybern. 7, 868–871 (null space).  S. R. Buss, J.-S. Kim
(2005), Selectively damped least squares for inverse kinematics, J. Graphics Tools 10(3), 37–49
(shortened error).
"""

from __future__ import annotations

import numpy as np

from mmc_gym.agents.ik.agent import jacobian
from mmc_gym.agents.ik.dead_end import SegmentLengths
from mmc_gym.interface import JointLimits
from mmc_gym.network.chain import Floats, wrap_angle

_TINY = np.finfo(np.float64).tiny


def jacobian_transpose(
    joint_angles: Floats,
    target: Floats,
    segment_lengths: SegmentLengths,
    max_change: float = 0.05,
) -> Floats:
    """One iteration of the Jacobian transpose; joint angles (..., N).

    α is the step that takes the hand nearest to the target, were J constant.  The error is not
    shortened: α Jᵀe is bounded by `max_change`.

    Args:
        joint_angles: radians, (..., N).
        target: segment lengths, (..., 2).
        segment_lengths: N lengths.
        max_change: most that a joint turns, radians; where it is less than the method asks for,
            all joints turn by the same share of that.
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
    """One iteration of the pseudo-inverse, J⁺ = Σ v uᵀ/σ for J = Σ σ u vᵀ; joint angles (..., N).

    Singularities: a σ less than `truncation` times the largest counts as 0, so that the arm does
    not try to move where it cannot.  Before that the change by each σ is bounded for itself (as
    in selectively damped least squares), so that a hopeless direction does not hold up the other.

    Args:
        joint_angles: radians, (..., N).
        target: segment lengths, (..., 2).
        segment_lengths: N lengths.
        truncation: smallest ratio of the singular values at which both are used.
        max_step: longest error that is acted on, segment lengths.
        max_change: most that a joint turns for one singular value, radians.
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
    """One iteration of damped least squares; joint angles (..., N).

    The change is at most `max_step` / (2 `damping`), at singularities too.

    Args:
        joint_angles: radians, (..., N).
        target: segment lengths, (..., 2).
        segment_lengths: N lengths.
        damping: λ, segment lengths.
        max_step: longest error that is acted on, segment lengths.
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
    """One iteration of damped least squares with a comfortable posture; joint angles (..., N).

    H = ½ Σ (q_i − m_i)²: Liégeois's distance from the middles m of the joints' ranges.  Where there
    are no limits these are 0, and the first joint, which only says where the arm points, is left
    out: among all postures that reach the target the evenly bent one is the most comfortable.
    With limits each term has a weight, (narrowest range / its range)⁴, and joints may pass through
    the forbidden range here: comfort takes them out again, and the servos go round.  The projector
    is that of the undamped pseudo-inverse, so comfort does not move the hand; it is bounded, so it
    needs no damping.

    Args:
        joint_angles: radians, (..., N).
        target: segment lengths, (..., 2).
        segment_lengths: N lengths.
        comfort: κ, the share of the way to comfort that one iteration goes.
        damping: λ, segment lengths.
        max_step: longest error that is acted on, segment lengths.
        joint_limits: lowest and highest angle of each joint, radians; None: joints turn freely.
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
    """Jᵀ(JJᵀ + λ²I)⁻¹e, the change of the joint angles (..., N)."""
    force_x, force_y = resisted_force(jacobian_x, jacobian_y, error, damping**2)
    change: Floats = jacobian_x * force_x[..., None] + jacobian_y * force_y[..., None]
    return change


def shortened(error: Floats, max_step: float) -> Floats:
    """Vectors (..., 2), those longer than `max_step` shortened to it."""
    distance = np.hypot(error[..., 0], error[..., 1])[..., None]
    short: Floats = error * (max_step / np.maximum(distance, max_step))
    return short


def limited(change: Floats, max_change: float) -> Floats:
    """Changes of the joint angles (..., N), made smaller where a joint's is above `max_change`."""
    largest = np.abs(change).max(axis=-1, keepdims=True)
    smaller: Floats = change * (max_change / np.maximum(largest, max_change))
    return smaller


def resisted_force(
    jacobian_x: Floats, jacobian_y: Floats, error: Floats, resistance: Floats | float
) -> tuple[Floats, Floats]:
    """Both components (...) of f = (JJᵀ + ρI)⁻¹e: the damped step is Jᵀf, the hand's e − ρf.

    Args:
        jacobian_x: first row of J, (..., N).
        jacobian_y: its second row, (..., N).
        error: e, segment lengths, (..., 2).
        resistance: ρ = λ², segment lengths squared, for all or each, (...).
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
) -> list[tuple[Floats, Floats, Floats]]:
    """For both singular values σ of J: u (..., 2), σ·v = Jᵀu (..., N), and 1/σ² (...).

    J = Σ σ u vᵀ.  1/σ² is 0 where σ is less than `truncation` times the larger one.
    """
    xx = (jacobian_x * jacobian_x).sum(axis=-1)
    yy = (jacobian_y * jacobian_y).sum(axis=-1)
    xy = (jacobian_x * jacobian_y).sum(axis=-1)
    angle = np.arctan2(2 * xy, xx - yy) / 2  # of the eigenvector of J Jᵀ with the larger value
    larger = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    smaller = np.stack([-larger[..., 1], larger[..., 0]], axis=-1)
    parts: list[tuple[Floats, Floats, Floats]] = []
    least = np.full_like(xx, _TINY)
    for toward in (larger, smaller):
        row = toward[..., :1] * jacobian_x + toward[..., 1:] * jacobian_y
        square = (row * row).sum(axis=-1)
        inverse = np.divide(1.0, square, out=np.zeros_like(square), where=square > least)
        parts.append((toward, row, inverse))
        least = np.maximum(truncation**2 * square, _TINY)
    return parts
