"""Iterations of the network with knowledge of the body: sensed posture, lengths, locked joints.

The end effector R is held at the target.  Each kind of knowledge may differ between the arms of a
batch.  Without any, an iteration equals that of `MMCNetwork.run`, bit for bit.

**A sensed posture is one more computation in the mean.**  With L^s the sensed segments and w the
weight of that computation, the mean of a segment becomes

    L̃ = (Σ_{k≠i,j} (v_ik + v_kj) + (d − m) L + w L^s) / (d + w)
      = L̃⁰ + w/(d + w) (L^s − L̃⁰),                  L̃⁰ the mean without it

**Each arm may have its own lengths**: L ← ℓ · normalize(L̃/ℓ) with these ℓ.

**A locked joint is a clamp on an angle.**  The segments on both sides of it are one rigid body,
which can turn but not bend.  Its segments are ℓ_i R(c_i) u, where R(c_i) turns by the sum of the
locked joints' angles.  Its span is D = Σ ℓ_i R(c_i) u, of fixed length and at a fixed angle to each
segment.  A free segment is replaced by the nearest vector of its length.  Likewise, a body is
replaced by the one that best fits its proposed segments L̃_i and their sum,

    u = normalize(λ Σ ℓ_i R(c_i)ᵀ L̃_i + (Σ ℓ_i R(c_i))ᵀ Σ L̃_i),     L_i ← ℓ_i R(c_i) u

The span dominates (λ is small), as in a network of one segment less, in which the body is a
segment.  With the segments alone, a folded body would turn slowly.  With the span alone, a body
whose span is 0 would have no direction.  A body of one segment is a free segment.  If the first
joint is locked, its body is tied to the base and cannot turn.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mmc_gym._errors import LARGEST_SIZE, UserError, require, require_between
from mmc_gym.geometry import Floats
from mmc_gym.network.chain import triangle_products
from mmc_gym.network.iteration import compile_iteration, velocity_rule
from mmc_gym.network.model import Clamps, MMCNetwork, MMCState, require_plane
from mmc_gym.network.normalizers import Normalizer

SEGMENT_WEIGHT = 0.05  #: λ: weight of the segments of a rigid body, beside its span


@dataclass(frozen=True, eq=False)
class Embodiment:
    """Knowledge about the bodies of a batch of arms; None where there is none."""

    segment_lengths: Floats | None = None  #: of each arm, (..., N), in place of the network's
    sensed: Floats | None = None  #: sensed segments, (..., N, 2)
    weight: float = 0.0  #: w, the weight of the sensed posture in the mean; at least 0
    locked: NDArray[np.bool_] | None = None  #: whether each joint is locked, (..., N)
    joint_angles: Floats | None = None  #: of the locked joints, radians, (..., N)

    def __post_init__(self) -> None:
        require_between(0, LARGEST_SIZE, weight=self.weight)
        if self.weight and self.sensed is None:
            raise UserError("sensed must be given if it has a weight, got None")
        if self.locked is not None and self.joint_angles is None:
            raise UserError("joint_angles must be given if joints are locked, got None")


def embodied_run(
    network: MMCNetwork, state: MMCState, clamps: Clamps, body: Embodiment, iterations: int = 1
) -> MMCState:
    """Return the state after `iterations` iterations of a synchronous network towards a target.

    The `clamps` hold the end effector at the target, see `MMCNetwork.inverse`.  The arrays of
    `body` broadcast to the state's batch axes.

    >>> network = MMCNetwork()
    >>> start = network.state_from_joint_angles([0.3, 0.6, 0.6])
    >>> locked = Embodiment(locked=np.array([False, True, False]), joint_angles=start.joint_angles)
    >>> end = embodied_run(network, start, network.inverse([-1.0, 1.5]), locked, 300)
    >>> end.end_effector.round(2).tolist(), end.joint_angles[1].round(2).item()
    ([-1.0, 1.5], 0.6)
    """
    require(isinstance(body, Embodiment), "body", body, "an Embodiment")
    require_plane(network)
    require(network.schedule == "synchronous", "schedule", network.schedule, "'synchronous'")
    state = network.run(state, clamps, iterations=0)  # broadcasts, and sets R
    values, count, rows = state.values, network.segment_count, len(state.values)
    iteration = compile_iteration(network, clamps.rows, values.dtype.char)
    current = values.reshape(rows, 2, -1)
    lengths = iteration.lengths
    if body.segment_lengths is not None:
        lengths = _batch_last(body.segment_lengths, values, (count,))
    pull = _pull(network, body, values)
    nearest = _nearest(network.normalizer, body, lengths, values)
    for _ in range(iterations):
        following = iteration.operator.dot(current.reshape(rows, -1)).reshape(current.shape)
        if pull is not None:
            pull(current, following)
        following[:count] = nearest(following[:count])
        current = following
    return MMCState(current.reshape(values.shape), count)


def _pull(
    network: MMCNetwork, body: Embodiment, values: Floats
) -> Callable[[Floats, Floats], None] | None:
    """Return a function that adds the sensed posture to an iteration; states (rows, 2, batch)."""
    if body.sensed is None or not body.weight:
        return None
    count, is_dynamic = network.segment_count, network.dynamics != "kinematic"
    sensed = _batch_last(body.sensed, values, (count, 2))
    triangles = triangle_products(count)
    mean = np.eye(len(triangles)) - triangles / network.damping
    to_mean = np.zeros((count, len(values)), dtype=values.dtype)  # makes L̃⁰ of the state
    to_mean[:, : len(mean)] = mean[:count]
    factor = velocity_rule(network)[0] * (body.weight / (network.damping + body.weight))

    def pull(current: Floats, following: Floats) -> None:
        proposed = to_mean.dot(current.reshape(len(current), -1)).reshape(sensed.shape)
        change = factor * (sensed - proposed)
        following[:count] += change
        if is_dynamic:
            following[-count:] += change

    return pull


def _nearest(
    normalizer: Normalizer, body: Embodiment, lengths: Floats, values: Floats
) -> Callable[[Floats], Floats]:
    """Return a function of proposed segments (N, 2, batch): the nearest that the body allows.

    Complex numbers represent vectors and turns of the rigid bodies that locks make.
    """
    if body.locked is None or body.joint_angles is None or not body.locked.any():

        def normalized(segments: Floats) -> Floats:
            normalizer.normalize_rows(segments, lengths)
            return segments

        return normalized
    count = body.locked.shape[-1]
    locked = _batch_last(body.locked, values, (count,)) > 0
    starts, is_tied = ~locked, locked.copy()  # a body's first segment; tied to the base
    turned = np.exp(1j * np.where(locked, _batch_last(body.joint_angles, values, (count,)), 0.0))
    for joint in range(1, count):
        turned[joint] *= np.where(locked[joint], turned[joint - 1], 1.0)
        is_tied[joint] &= is_tied[joint - 1]
    own = lengths * turned  # ℓ_i R(c_i)
    span = _over_bodies(starts, own)
    squares = np.broadcast_to(SEGMENT_WEIGHT * lengths**2, locked.shape)
    weight = _over_bodies(starts, squares) + np.abs(span) ** 2

    def nearest(segments: Floats) -> Floats:
        proposed = segments[:, 0] + 1j * segments[:, 1]
        fit = _over_bodies(starts, SEGMENT_WEIGHT * own.conj() * proposed)
        fit = fit + span.conj() * _over_bodies(starts, proposed)
        direction = np.stack([fit.real, fit.imag], axis=1) / weight[:, None]
        normalizer.normalize_rows(direction, np.ones((count, 1), dtype=direction.dtype))
        placed = own * np.where(is_tied, 1.0, direction[:, 0] + 1j * direction[:, 1])
        return np.stack([placed.real, placed.imag], axis=1)

    return nearest


def _over_bodies(starts: NDArray[np.bool_], values: NDArray[Any]) -> NDArray[Any]:
    """Return the sum over each rigid body, at all its segments, (N, batch)."""
    sums, count = values.copy(), len(values)
    for joint in range(1, count):  # complete at the last segment of each body
        sums[joint] += np.where(starts[joint], 0.0, sums[joint - 1])
    for joint in range(count - 1, 0, -1):
        sums[joint - 1] = np.where(starts[joint], sums[joint - 1], sums[joint])
    return sums


def _batch_last(array: NDArray[Any], values: Floats, trailing: tuple[int, ...]) -> Floats:
    """Return an array (..., *trailing) with the batch last and flat, in the state's dtype."""
    full = np.broadcast_to(np.asarray(array, values.dtype), (*values.shape[2:], *trailing))
    return np.ascontiguousarray(np.moveaxis(full.reshape(-1, *trailing), 0, -1))
