"""Inverse kinematics in closed form, for one, two or three segments.

With the orientation φ of the last segment given, an arm of three is one of two, to the wrist:

    w = target − ℓ₃ (cos φ, sin φ),     |ℓ₁ − ℓ₂| ≤ |w| ≤ ℓ₁ + ℓ₂
    tan²(q₂/2) = ((ℓ₁ + ℓ₂)² − |w|²) / (|w|² − (ℓ₁ − ℓ₂)²)               elbow on either side
    q₁ = ∠w − ∠(ℓ₁ + ℓ₂ cos q₂, ℓ₂ sin q₂),     q₃ = φ − q₁ − q₂

The half angle is exact where acos is not: near the stretched and the folded arm.  φ is the one
redundant freedom; the angle α between φ and the target's direction decides on |w|, so those that
are possible are an interval of |α|, which is swept.  Of all solutions, the one is taken that is
nearest to the present posture, in the Euclidean distance of joint angles the short way round.

Literature: J. J. Craig, Introduction to Robotics: Mechanics and Control, ch. 4 (planar arm of
three joints).
"""

from __future__ import annotations

import numpy as np

from mmc_gym.agents.ik.agent import SegmentLengths
from mmc_gym.interface import CannotActError, JointLimits
from mmc_gym.network.chain import Floats, nearest_reachable, wrap_angle

ORIENTATIONS = 90
"""Orientations that a sweep takes on either side of the target's direction."""

_SLACK = 1e-9  # radians beyond a limit that count as within
_FAR = 1e3  # more than any squared distance of postures


def closed_form(
    joint_angles: Floats,
    target: Floats,
    segment_lengths: SegmentLengths,
    joint_limits: JointLimits | None = None,
) -> Floats:
    """Return the solution nearest to a posture, joint angles (..., N): a `Solver` for N up to 3.

    It is done after one iteration, for a solution is the nearest to itself.  For a target out of
    reach it solves for the nearest point within.  With two equal segments and the target at the
    base the first joint is free; its angle is then an arbitrary one.

    Args:
        joint_angles: the present posture, radians, (..., N).
        target: segment lengths, (..., 2).
        segment_lengths: N = 1, 2 or 3 lengths.
        joint_limits: lowest and highest angle of each joint, radians; None: joints turn freely.
            Solutions beyond them do not count, and the nearest is that by the way which they
            leave.  If all are beyond, it is the one least so, brought to the limits.

    Raises:
        CannotActError: for another number of segments.

    >>> closed_form(np.array([0.5, 0.5]), np.array([1.0, 1.0]), (1.0, 1.0)).round(6)
    array([0.      , 1.570796])
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
    """Return all solutions of a sweep; joint angles in any turn, radians, (..., solutions, N).

    With three segments the sweep takes in both ends of the interval of orientations, and the one
    of `joint_angles`, or the end next to it.  The arguments are those of `closed_form`.
    """
    count = len(segment_lengths)
    if count > 3:
        raise CannotActError(
            f"segment_lengths must be 1, 2 or 3 for a solution in closed form, got {count}: "
            f"{segment_lengths}"
        )
    target = nearest_reachable(target, segment_lengths)
    bearing = np.arctan2(target[..., 1], target[..., 0])
    if count == 1:
        return bearing[..., None, None]
    if count == 2:
        return np.stack(_two_segments(target, *segment_lengths), axis=-2)
    last = segment_lengths[2]
    present = wrap_angle(joint_angles.sum(axis=-1) - bearing)
    orientations = bearing[..., None] + _orientations(
        np.hypot(target[..., 0], target[..., 1]), present, segment_lengths
    )
    hand = np.stack([np.cos(orientations), np.sin(orientations)], axis=-1)
    wrist = target[..., None, :] - last * hand
    both = [
        np.concatenate([two, (orientations - two.sum(axis=-1))[..., None]], axis=-1)
        for two in _two_segments(wrist, *segment_lengths[:2])
    ]
    return np.concatenate(both, axis=-2)


def _orientations(distance: Floats, present: Floats, segment_lengths: SegmentLengths) -> Floats:
    """Return α of a sweep, for targets at a distance from the base; (..., 2 `ORIENTATIONS` + 1)."""
    first, second, last = segment_lengths
    # |w|² = distance² + ℓ₃² − 2 distance ℓ₃ cos α; at the base any α gives the same.
    product = np.maximum(2 * distance * last, np.finfo(np.float64).tiny)
    square = distance * distance + last * last
    least = np.arccos(np.clip((square - (first - second) ** 2) / product, -1.0, 1.0))
    most = np.arccos(np.clip((square - (first + second) ** 2) / product, -1.0, 1.0))
    swept = np.linspace(least, most, ORIENTATIONS, axis=-1)
    nearest = np.copysign(np.clip(np.abs(present), least, most), present)
    return np.concatenate([nearest[..., None], swept, -swept], axis=-1)


def _two_segments(wrist: Floats, first: float, second: float) -> tuple[Floats, Floats]:
    """Return both solutions for two segments, (..., 2); to the nearest point if too far."""
    distance = np.hypot(wrist[..., 0], wrist[..., 1])
    short = (first + second - distance) * (first + second + distance)
    long = (distance - abs(first - second)) * (distance + abs(first - second))
    elbow = 2 * np.arctan2(np.sqrt(np.maximum(short, 0.0)), np.sqrt(np.maximum(long, 0.0)))
    bearing = np.arctan2(wrist[..., 1], wrist[..., 0])
    offset = np.arctan2(second * np.sin(elbow), first + second * np.cos(elbow))
    return (
        np.stack([bearing - offset, elbow], axis=-1),
        np.stack([bearing + offset, -elbow], axis=-1),
    )
