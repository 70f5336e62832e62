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
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mmc_gym._errors import LARGEST_SIZE, UserError, require, require_between
from mmc_gym.geometry import Floats
from mmc_gym.network.chain import cached_iteration, matrices_of, triangle_products, velocity_rule
from mmc_gym.network.model import Clamps, MMCNetwork, MMCState
from mmc_gym.network.normalizers import Normalizer, product

Dtype: TypeAlias = "np.dtype[np.floating]"

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
    require(network.schedule == "synchronous", "schedule", network.schedule, "'synchronous'")
    values = network.hold(state, clamps).values
    batch, count = values.shape[2:], network.segment_count
    flat = values.reshape(*values.shape[:2], -1)
    iteration = cached_iteration(network, clamps.rows, values.dtype.char)
    lengths = iteration.lengths
    if body.segment_lengths is not None:
        lengths = _batch_last(body.segment_lengths, batch, values.dtype)
    add_sensed = _sensing(network, body, batch, values.dtype) if body.weight else None
    nearest = _rigid_bodies(body, lengths, network.normalizer, batch, values.dtype)
    now, following, *states = matrices_of(flat)
    for _ in range(iterations):
        product(iteration.operator, now, following)
        states.reverse()
        if add_sensed is not None:
            add_sensed(states[0], now)
        if nearest is None:
            network.normalizer.normalize_rows(states[0][:count], lengths)
        else:
            states[0][:count] = nearest(states[0][:count])
        now, following = following, now
    flat[:] = states[0]
    return MMCState(values, count)


def _sensing(
    network: MMCNetwork, body: Embodiment, batch: tuple[int, ...], dtype: Dtype
) -> Callable[[Floats, Floats], None]:
    """Return a function that makes the sensed posture one more computation in the mean.

    It changes what is proposed, (rows, 2, batch), for the state in a matrix (see `matrices_of`).
    """
    count, triangles = network.segment_count, triangle_products(network.segment_count)
    mean = np.eye(len(triangles)) - triangles / network.damping
    to_mean = np.zeros((count, network.row_count), dtype=dtype)  # makes L̃⁰ of a state
    to_mean[:, : len(mean)] = mean[:count]
    share = velocity_rule(network)[0] * (body.weight / (network.damping + body.weight))
    sensed = _batch_last(body.sensed, batch, dtype, 2)  # L^s, (N, 2, batch)

    def add(proposed: Floats, matrix: Floats) -> None:
        unsensed = product(to_mean, matrix)[:, : sensed[0].size].reshape(sensed.shape)
        change = share * (sensed - unsensed)
        proposed[:count] += change
        if network.dynamics != "kinematic":
            proposed[-count:] += change

    return add


def _rigid_bodies(
    body: Embodiment, lengths: Floats, normalizer: Normalizer, batch: tuple[int, ...], dtype: Dtype
) -> Callable[[Floats], Floats] | None:
    """Return a function from proposed segments to the nearest possible ones, both (N, 2, batch).

    Return None if no joint is locked.  Complex numbers are vectors and turns.
    """
    if body.locked is None or not body.locked.any():
        return None
    locked = _batch_last(body.locked, batch, dtype) > 0
    starts, is_tied = ~locked, locked.copy()  # of bodies; to the base
    turned = np.exp(1j * np.where(locked, _batch_last(body.joint_angles, batch, dtype), 0.0))
    for joint in range(1, len(locked)):
        turned[joint] *= np.where(locked[joint], turned[joint - 1], 1.0)
        is_tied[joint] &= is_tied[joint - 1]
    segments = lengths * turned  # ℓ_i R(c_i)
    span = _over_bodies(starts, segments)
    squares = np.broadcast_to(SEGMENT_WEIGHT * lengths**2, locked.shape)
    weight = _over_bodies(starts, squares) + np.abs(span) ** 2  # of the segments and the span

    def nearest(vectors: Floats) -> Floats:
        proposed = vectors[:, 0] + 1j * vectors[:, 1]
        fit = _over_bodies(starts, SEGMENT_WEIGHT * segments.conj() * proposed)
        fit = fit + span.conj() * _over_bodies(starts, proposed)
        direction = np.stack([fit.real, fit.imag], axis=1) / weight[:, None]
        normalizer.normalize_rows(direction, np.ones((len(fit), 1), dtype=direction.dtype))
        turn = np.where(is_tied, 1.0, direction[:, 0] + 1j * direction[:, 1])
        placed = segments * turn
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


def _batch_last(
    values: ArrayLike | None, batch: tuple[int, ...], dtype: Dtype, *axes: int
) -> Floats:
    """Return an array (..., N, *axes) with the batch last and flat."""
    array = np.asarray(values, dtype)
    trailing = array.shape[array.ndim - 1 - len(axes) :]
    full = np.broadcast_to(array, (*batch, *trailing)).reshape(-1, *trailing)
    return np.ascontiguousarray(np.moveaxis(full, 0, -1))
