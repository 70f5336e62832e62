"""Geometry of an arm: angles, nodes, what is within its reach, and steps towards a target.

Lengths are in segment lengths, angles in radians; arrays have leading batch axes.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from operator import add
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.floating]
_LEFT_TURN = np.array([-1, 1], np.int8)  # turns (y, x) into (−y, x), and keeps the type of floats


def node_positions(segments: Floats) -> Floats:
    """Return the nodes p_0 = 0 … p_N, shape (..., N + 1, 2), from segments (..., N, 2)."""
    base = np.zeros_like(segments[..., :1, :])
    return np.concatenate([base, np.cumsum(segments, axis=-2)], axis=-2)


def segments_from_joint_angles(joint_angles: Floats, segment_lengths: ArrayLike) -> Floats:
    """Return the segment vectors (..., N, 2) of a posture; their sum is the end effector.

    Joint angles (..., N) are relative, radians, 0 = straight on.

    >>> segments_from_joint_angles(np.array([0.0, np.pi / 2]), (1.0, 2.0)).round(6)
    array([[1., 0.],
           [0., 2.]])
    """
    segment_angles = np.cumsum(joint_angles, axis=-1)
    lengths = np.asarray(segment_lengths, dtype=segment_angles.dtype)
    return np.stack([lengths * np.cos(segment_angles), lengths * np.sin(segment_angles)], axis=-1)


def joint_angles_from_segments(segments: Floats) -> Floats:
    """Return relative joint angles in ]−π, π], shape (..., N), from segments (..., N, 2)."""
    segment_angles = np.arctan2(segments[..., 1], segments[..., 0])
    joint_angles = segment_angles.copy()
    joint_angles[..., 1:] -= segment_angles[..., :-1]
    return wrap_angle(joint_angles)


def wrap_angle(angle: Floats) -> Floats:
    """Return the same angle in ]−π, π] (radians).

    >>> wrap_angle(np.array([-np.pi, 0.0, 3 * np.pi])).round(6).tolist()
    [3.141593, 0.0, 3.141593]
    """
    return np.pi - (np.pi - angle) % (2 * np.pi)


def turned_back(x: Any, y: Any, cosine: Any, sine: Any) -> tuple[Any, Any]:
    """Return the components of vectors (x, y) in a frame whose x axis is (cosine, sine)."""
    return cosine * x + sine * y, cosine * y - sine * x


def in_the_world(vectors: Floats, joint_angles: Floats) -> Floats:
    """Rotate vectors (..., 2) from the first segment's frame into the world frame."""
    first = joint_angles[..., :1]
    # With np.stack of the two components it would take twice as long for few arms.
    return np.cos(first) * vectors + np.sin(first) * (vectors[..., ::-1] * _LEFT_TURN)


def reachable_radii(segment_lengths: Sequence[float]) -> tuple[float, float]:
    """Return inner and outer radius of the disc or ring that the end effector can reach.

    >>> reachable_radii((1.0, 1.0, 1.0)), reachable_radii((3.0, 1.0))
    ((0.0, 3.0), (2.0, 4.0))
    """
    reach = float(reduce(add, segment_lengths))  # not sum(), see `shared_ring`
    return max(0.0, 2 * max(segment_lengths) - reach), reach


def nearest_reachable(target: Floats, segment_lengths: Sequence[float]) -> Floats:
    """Return targets (..., 2); those out of reach are moved to the nearest point within.

    >>> nearest_reachable(np.array([4.0, 0.0]), (1.0, 1.0, 1.0))
    array([3., 0.])
    """
    inner, outer = reachable_radii(segment_lengths)
    distance = np.hypot(target[..., 0], target[..., 1])
    outside = (distance < inner) | (distance > outer)
    if not outside.any():
        return target
    bearing = np.arctan2(target[..., 1], target[..., 0])  # defined at the base too
    radius = np.clip(distance, inner, outer)
    nearest = np.stack([radius * np.cos(bearing), radius * np.sin(bearing)], axis=-1)
    return np.where(outside[..., None], nearest, target)


def damped_least_squares(jacobian: Floats, error: Floats, damping: float) -> Floats:
    """Return the change of joint angles Δq = Jᵀ(JJᵀ + λ²I)⁻¹e, shape (..., N).

    Args:
        jacobian: J, derivatives of the hand's position by the joint angles, (..., 2 or 3, N).
        error: e, what the position lacks, (..., 2 or 3).
        damping: λ, in units of the lengths; |Δq| is at most |e| / (2 λ), at singularities too.

    >>> damped_least_squares(np.array([[0.0, 0.0], [2.0, 1.0]]), np.array([0.0, 0.5]), 0.1).round(3)
    array([0.2, 0.1])
    """
    if jacobian.shape[-2] == 2:  # the inverse of a symmetric 2 × 2, written out, is faster
        row_x, row_y = jacobian[..., 0, :], jacobian[..., 1, :]
        xx = (row_x * row_x).sum(axis=-1) + damping**2
        yy = (row_y * row_y).sum(axis=-1) + damping**2
        xy = (row_x * row_y).sum(axis=-1)
        determinant = xx * yy - xy * xy
        force_x = (yy * error[..., 0] - xy * error[..., 1]) / determinant
        force_y = (xx * error[..., 1] - xy * error[..., 0]) / determinant
        return row_x * force_x[..., None] + row_y * force_y[..., None]
    transposed = np.swapaxes(jacobian, -1, -2)
    damped = jacobian @ transposed + damping**2 * np.eye(jacobian.shape[-2])
    change: Floats = (transposed @ np.linalg.solve(damped, error[..., None]))[..., 0]
    return change
