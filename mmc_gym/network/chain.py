"""The kinematic chain: its nodes, vectors and triangles; and an iteration of a network over it.

A chain of N segments has the nodes p_0 (base) … p_N (end effector), and one vector
v_ij = p_j − p_i for every i < j: the segments L_i = v_{i−1,i}, the diagonals D, and the
end effector R = v_0N.  Every three nodes i < k < j close a triangle, v_ij = v_ik + v_kj::

            p_2 ──L_3── p_3
           ╱   ╲       ╱
         L_2    D_1   R          N = 3: v_01 v_12 v_23 | v_02 v_13 | v_03
         ╱        ╲  ╱                  L_1  L_2  L_3  | D_1  D_2  | R
       p_1 ──L_1── p_0

Vectors are ordered by the number of segments they span: first the N segments, last R.

All of an iteration but the normalization is linear, see `model` for the equations.  So the state is
one array with a row per variable, and a matrix over these rows is the linear part.  A clamped
variable is a row of the identity.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mmc_gym._errors import UserError, require, unknown
from mmc_gym.geometry import Floats, node_positions
from mmc_gym.network.normalizers import Normalizer, product, whole_blocks

Pair = tuple[int, int]

# Arms iterated together: their rows, twice, fit the second-level cache of common processors.
_BLOCK = 4096

BEND = 0.02
"""Angle by which each joint of a straight arm is bent if it could not leave the line, rad."""


def vector_pairs(segment_count: int) -> list[Pair]:
    """Return the node pairs (i, j) of the chain's N(N+1)/2 vectors, segments first, R last.

    >>> vector_pairs(3)
    [(0, 1), (1, 2), (2, 3), (0, 2), (1, 3), (0, 3)]
    """
    return [
        (start, start + span)
        for span in range(1, segment_count + 1)
        for start in range(segment_count + 1 - span)
    ]


def triangle_incidence(segment_count: int) -> NDArray[np.float64]:
    """Return the incidence ∂₂ of vectors and triangles, shape (vectors, triangles).

    The column of the triangle i < k < j states v_ij − v_ik − v_kj = 0.  A vector is part of
    m = N − 1 triangles, so every row has N − 1 entries that are not zero (1 or −1).
    """
    row = {pair: index for index, pair in enumerate(vector_pairs(segment_count))}
    triangles = list(combinations(range(segment_count + 1), 3))
    incidence = np.zeros((len(row), len(triangles)))
    for column, (i, k, j) in enumerate(triangles):
        incidence[row[i, j], column] = 1.0
        incidence[row[i, k], column] = -1.0
        incidence[row[k, j], column] = -1.0
    return incidence


def triangle_products(segment_count: int) -> NDArray[np.float64]:
    """Return ∂₂∂₂ᵀ, shape (vectors, vectors): the triangles that two vectors share."""
    incidence = triangle_incidence(segment_count)
    return incidence @ incidence.T


def chain_vectors(segments: Floats) -> Floats:
    """Return all vectors v_ij of a chain, (..., N(N+1)/2, 2), from segments (..., N, 2).

    They are in the order of `vector_pairs`.
    """
    starts, ends = np.array(vector_pairs(segments.shape[-2])).T
    nodes = node_positions(segments)
    return nodes[..., ends, :] - nodes[..., starts, :]


class Iteration:
    """Iterations of a network in numpy, for a set of clamped rows and a dtype's character."""

    def __init__(self, network: Any, clamped: tuple[int, ...], dtype: str) -> None:
        free = [row for row in range(network.segment_count) if row not in clamped]
        self._is_delayed = network.schedule == "delayed"
        offset = len(vector_pairs(network.segment_count)) if self._is_delayed else 0
        self._normalizer: Normalizer = network.normalizer
        #: the linear part, see `linear_operator`
        self.operator: Floats = linear_operator(network, clamped).astype(dtype)
        rows = np.array(free, np.intp) + offset
        is_view = len(free) > 0 and bool((np.diff(rows) == 1).all())
        self._free = slice(rows[0], rows[-1] + 1) if is_view else rows
        #: lengths to bring free segments to, (n, 1)
        self.lengths: Floats = np.array(network.segment_lengths, dtype=dtype)[free, None]

    def __call__(self, values: Floats, times: int) -> None:
        """Iterate a state (rows, 2, batch) in place; its clamped rows have their values."""
        for start in range(0, values.shape[2], _BLOCK):
            block = values[:, :, start : start + _BLOCK]
            now, following, *states = matrices_of(block)
            for _ in range(times):
                if self._is_delayed:
                    self._normalize(states[0])
                product(self.operator, now, following)
                now, following = following, now
                states.reverse()
                if not self._is_delayed:
                    self._normalize(states[0])
            block[:] = states[0]

    def _normalize(self, values: Floats) -> None:
        segments = values[self._free]  # a view if they are neighbours, otherwise a copy
        self._normalizer.normalize_rows(segments, self.lengths)
        if not isinstance(self._free, slice):
            values[self._free] = segments


cached_iteration = lru_cache(maxsize=256)(Iteration)


def matrices_of(values: Floats) -> list[Floats]:
    """Return a state (rows, 2, batch) and zeros as matrices for `product`, and both as views."""
    rows, _, batch = values.shape
    matrices = list(np.zeros((2, rows, whole_blocks(2 * batch)), values.dtype))
    states = [matrix[:, : 2 * batch].reshape(values.shape) for matrix in matrices]
    states[0][:] = values
    return [*matrices, *states]


def linear_operator(
    network: Any, clamped: Sequence[int] = (), triangles: Any = None, arrays: Any = np
) -> Any:
    """Return the linear part of an iteration, a matrix K over the rows of the state, (rows, rows).

    The next state is normalize(K state) if the network is synchronous.  If it is delayed, it is
    K normalize(state), and the pending segments are normalized.

    Args:
        network: an `MMCNetwork`; or a `TorchNetwork`, through whose parameters gradients flow.
        clamped: rows that are held (`Clamps.rows`).
        triangles: ∂₂∂₂ᵀ, see `triangle_products`; by default in numpy.
        arrays: the module that `triangles` is an array of, numpy or torch.
    """
    if triangles is None:
        triangles = triangle_products(network.segment_count)
    count, size, vectors = network.segment_count, network.row_count, len(triangles)
    delayed = network.schedule == "delayed"
    dynamic = network.dynamics != "kinematic"
    held = [row for row in clamped if row < count and delayed]
    if {row for row in clamped if row >= vectors} != {vectors + row for row in held}:
        raise UserError(f"clamps must come from a network of schedule {network.schedule!r}")
    # Rows of the identity select rows of the old state.
    identity = arrays.eye(size, dtype=triangles.dtype, device=triangles.device)
    old, velocity = identity[:vectors], identity[size - count :]
    new = identity[vectors : vectors + count] if delayed else old[:count]
    mean = old - triangles @ old / network.damping
    proposed = mean[:count]  # L̃
    if delayed:  # the triangle terms read the old segments, the self term the new ones
        proposed = proposed + (1 - (count - 1) / network.damping) * (new - old[:count])
    if dynamic:
        gain, memory = velocity_rule(network)
        velocity = gain * (proposed - new) + memory * velocity
        proposed = new + velocity  # L̂
    parts = [new, mean[count:], proposed] if delayed else [proposed, mean[count:]]
    operator = arrays.concat([*parts, velocity] if dynamic else parts)
    for row in clamped:
        operator[row] = identity[row]
        if row < count and dynamic:
            operator[size - count + row] = 0.0
    return operator


def velocity_rule(network: Any) -> tuple[Any, Any]:
    """Return the factors of L̃ − L and of the old velocity in the new velocity."""
    if network.dynamics == "kinematic":
        return 1.0, 0.0
    d_v, decay = network.velocity_damping, network.velocity_decay
    if network.dynamics == "paper":
        return 1 / d_v, decay * (d_v - 1) / d_v
    return decay / (d_v + 1), decay * d_v / (d_v + 1)


def held_rows(
    network: Any, name: str, vectors: Any, read: Callable[[str, Any, tuple[int, ...]], Any]
) -> dict[int, Any]:
    """Return the values of all held rows of an `MMCNetwork` or `TorchNetwork`, by row.

    `vectors`, the argument `name`, maps node pairs to vectors (..., 2).  `read` makes an array of a
    name, a value and the value's last axes.
    """
    accepted = "a mapping from pairs of nodes to vectors, such as {(0, 1): (1.0, 0.0)}"
    require(isinstance(vectors, Mapping), name, vectors, accepted)
    pairs = vector_pairs(network.segment_count)
    held = {}
    for pair, value in vectors.items():
        if pair not in pairs:
            turned = pair[::-1] if isinstance(pair, tuple) else ()
            guess = f"{turned} with the opposite sign" if turned in pairs else ""
            raise unknown("clamp", pair, pairs, guess=guess)
        held[pairs.index(pair)] = read(f"clamp {pair}", value, (2,))
    if network.schedule == "delayed":  # the pending value of a clamped segment is held as well
        segments = [row for row in held if row < network.segment_count]
        held |= {len(pairs) + row: held[row] for row in segments}
    return held
