"""The linear part of an iteration of the MMC network, as one matrix over the state's rows.

The rows are those of `MMCState.values`.  All that an iteration needs beside the state is
compiled once for a network, a set of clamped rows, and a dtype.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mmc_gym.network.chain import Floats, triangle_incidence

if TYPE_CHECKING:
    from mmc_gym.network.model import MMCNetwork

Rows: TypeAlias = "slice | NDArray[np.intp]"


@dataclass(frozen=True, eq=False)
class CompiledIteration:
    """What an iteration needs, for one network, set of clamped vectors, and dtype."""

    operator: Floats  # (rows, rows), the linear part of an iteration
    clamped: Rows  # rows that hold clamp values
    normalized: Rows  # rows to normalize: the free segments
    lengths: Floats  # their lengths, (n, 1)


@lru_cache(maxsize=256)
def compile_iteration(
    network: MMCNetwork, clamped: tuple[int, ...], dtype: str
) -> CompiledIteration:
    """Compile an iteration for rows that are held (`Clamps.rows`) and a dtype's character."""
    count = network.segment_count
    free = [row for row in range(count) if row not in clamped]
    offset = count * (count + 1) // 2 if network.schedule == "delayed" else 0
    return CompiledIteration(
        operator=linear_operator(network, clamped).astype(dtype),
        clamped=_as_slice(clamped),
        normalized=_as_slice(tuple(offset + row for row in free)),
        lengths=np.array(network.segment_lengths, dtype=dtype)[free, None],
    )


def linear_operator(network: MMCNetwork, clamped: Sequence[int] = ()) -> NDArray[np.float64]:
    """The linear part of an iteration, as a matrix over the rows of the state.

    Args:
        network: the network.
        clamped: rows that are held (`Clamps.rows`).

    Returns:
        Matrix K of shape (rows, rows).  Synchronous: the state is normalize(K state).
        Delayed: K normalize(state), where the pending segments are what is normalized.
    """
    count = network.segment_count
    incidence = triangle_incidence(count)
    vectors = len(incidence)
    mean = np.eye(vectors) - incidence @ incidence.T / network.damping

    # Where the segments are read from and written to, and where their velocities stand.
    delayed = network.schedule == "delayed"
    dynamic = network.dynamics != "kinematic"
    size = vectors + count * (delayed + dynamic)
    if clamped and clamped[-1] >= size:
        raise ValueError(f"clamps must come from this network, got row {clamped[-1]} of {size}")
    identity = np.eye(size)
    segment, vector = slice(0, count), slice(0, vectors)
    new = slice(vectors, vectors + count) if delayed else segment
    velocity = slice(size - count, size)

    operator = np.zeros((size, size))
    operator[vector, vector] = mean
    proposed = operator[segment].copy()  # L̃
    if delayed:
        operator[segment] = identity[new]
        self_term = np.diag(np.diag(mean)[segment])
        proposed[:, segment] -= self_term
        proposed[:, new] += self_term
    if dynamic:
        gain, memory = velocity_rule(network)
        operator[velocity] = gain * (proposed - identity[new]) + memory * identity[velocity]
        operator[new] = identity[new] + operator[velocity]  # L̂ = L + v
    else:
        operator[new] = proposed
    for row in clamped:
        operator[row] = identity[row]
        if row < count and dynamic:
            operator[size - count + row] = 0.0
    return operator


def velocity_rule(network: MMCNetwork) -> tuple[float, float]:
    """Factors of (L̃ − L) and of the old velocity in the new velocity."""
    d_v, decay = network.velocity_damping, network.velocity_decay
    if network.dynamics == "paper":
        return 1 / d_v, decay * (d_v - 1) / d_v
    return decay / (d_v + 1), decay * d_v / (d_v + 1)


def _as_slice(rows: tuple[int, ...]) -> Rows:
    """Neighbouring rows as a slice, which numpy indexes without a copy."""
    if rows and rows == tuple(range(rows[0], rows[-1] + 1)):
        return slice(rows[0], rows[-1] + 1)
    return np.array(rows, dtype=np.intp)
