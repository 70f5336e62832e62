"""One iteration of the network: a matrix product, and a normalization.

All of an iteration but the normalization is linear.  So the whole state is one array with a row per
variable, and a matrix over these rows is the linear part.  A clamped variable is a row of the
identity.  `model` has the equations.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mmc_gym._errors import UserError, require, unknown
from mmc_gym.geometry import Floats
from mmc_gym.network import chain
from mmc_gym.network.normalizers import Normalizer, whole_blocks

# Arms iterated together: their rows, twice, fit the second-level cache of common processors.
_BLOCK = 4096


class Iteration:
    """Iterations of a network in numpy, for a set of clamped rows and a dtype's character."""

    def __init__(self, network: Any, clamped: tuple[int, ...], dtype: str) -> None:
        free = [row for row in range(network.segment_count) if row not in clamped]
        self._is_delayed = network.schedule == "delayed"
        offset = len(chain.vector_pairs(network.segment_count)) if self._is_delayed else 0
        self._normalizer: Normalizer = network.normalizer
        #: the linear part, see `linear_operator`
        self.operator: Floats = linear_operator(network, clamped).astype(dtype)
        #: rows of the free segments
        self.normalized = _as_slice(tuple(offset + row for row in free))
        #: lengths to bring them to, (n, 1)
        self.lengths: Floats = np.array(network.segment_lengths, dtype=dtype)[free, None]

    def __call__(self, values: Floats, times: int) -> None:
        """Iterate a state (rows, 2, batch) in place; its clamped rows have their values."""
        rows, _, batch = values.shape
        for start in range(0, batch, _BLOCK):
            block = values[:, :, start : start + _BLOCK]
            size = 2 * block.shape[2]
            now, following = np.zeros((2, rows, whole_blocks(size)), values.dtype)
            states = [one[:, :size].reshape(block.shape) for one in (now, following)]  # views
            states[0][:] = block
            for _ in range(times):
                if self._is_delayed:
                    self._normalize(states[0])
                self.operator.dot(now, following)
                now, following = following, now
                states.reverse()
                if not self._is_delayed:
                    self._normalize(states[0])
            block[:] = states[0]

    def _normalize(self, values: Floats) -> None:
        segments = values[self.normalized]  # a view if they are neighbours, otherwise a copy
        self._normalizer.normalize_rows(segments, self.lengths)
        if not isinstance(self.normalized, slice):
            values[self.normalized] = segments


cached_iteration = lru_cache(maxsize=256)(Iteration)


def linear_operator(
    network: Any, clamped: Sequence[int] = (), triangles: Any = None, arrays: Any = np
) -> Any:
    """Return the linear part of an iteration, a matrix K over the rows of the state, (rows, rows).

    The next state is normalize(K state) if the network is synchronous.  If it is delayed, it is
    K normalize(state), and the pending segments are normalized.

    Args:
        network: an `MMCNetwork`; or a `TorchNetwork`, through whose parameters gradients flow.
        clamped: rows that are held (`Clamps.rows`).
        triangles: ∂₂∂₂ᵀ, see `chain.triangle_products`; by default that of the network, in numpy.
        arrays: the module that `triangles` is an array of, numpy or torch.
    """
    if triangles is None:
        triangles = chain.triangle_products(network.segment_count)
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
    pairs = chain.vector_pairs(network.segment_count)
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


def _as_slice(rows: tuple[int, ...]) -> slice | NDArray[np.intp]:
    """Return neighbouring rows as a slice, which numpy indexes without a copy."""
    if rows and rows == tuple(range(rows[0], rows[-1] + 1)):
        return slice(rows[0], rows[-1] + 1)
    return np.array(rows, dtype=np.intp)
