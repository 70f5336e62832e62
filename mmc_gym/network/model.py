"""The MMC network: a recurrent network whose attractors are the valid postures of the arm.

Every vector v_ij of the chain is computed from each of its m = N − 1 triangles.  The results are
averaged with the present value (Eq. 2 of the paper, exactly so for N = 3):

    ṽ_ij = 1/d Σ_{k≠i,j} (v_ik + v_kj) + (d − m)/d v_ij,     v_ba = −v_ab
         ⇔  ṽ = (I − 1/d ∂₂∂₂ᵀ) v                            ∂₂ from `triangle_incidence`

Then the segments are brought back to their lengths:

    kinematic:  L ← normalize(L̃)
    dynamic:    v ← rule(L̃ − L, v),   L̂ = L + v,   L ← normalize(L̂)          (Eqs. 3, 4)

There are two rules for the velocity, the paper's Eq. 3 and what its figures were made with,

    "paper":      v = 1/d_v (L̃ − L) + decay (d_v − 1)/d_v v
    "reference":  v = decay ((L̃ − L) + d_v v) / (d_v + 1)

and two schedules.  "synchronous" reads the newest values everywhere, as the equations are printed.
"delayed" is what the published figures were made with: the triangle terms read the normalized
segments of one iteration ago, and only the self term and the velocity read the new ones.

All of this but the normalization is linear.  So the whole state is one array with a row per
variable, and an iteration is one matrix product and one normalization (`Iteration`).  A clamped
variable is a row of the identity.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import lru_cache
from typing import TYPE_CHECKING, Literal, NamedTuple, TypeAlias, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mmc_gym._errors import require
from mmc_gym._notebook import facts_table
from mmc_gym.network import chain
from mmc_gym.network.chain import Floats, Pair
from mmc_gym.network.normalizers import EuclideanNormalizer, Normalizer

if TYPE_CHECKING:  # numpy is all that the network needs
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Rows: TypeAlias = "slice | NDArray[np.intp]"
Dynamics = Literal["kinematic", "paper", "reference"]
Schedule = Literal["synchronous", "delayed"]

# Arms iterated together: their rows, twice, fit the second-level cache of common processors.
_BLOCK = 4096


@dataclass(frozen=True, eq=False)
class MMCState:
    """Values of all variables of a batch of networks.

    The properties show them with the batch first, without a copy.

    Attributes:
        values: one row per variable with the batch on the last axes, (rows, 2, ...): the chain's
            vectors, then the segments that await their normalization (schedule "delayed" only),
            then the segment velocities (dynamic networks only).
        segment_count: N.
    """

    values: Floats
    segment_count: int

    @property
    def vectors(self) -> Floats:
        """All vectors v_ij, shape (..., N(N+1)/2, 2), in the order of `chain.vector_pairs`."""
        return self._rows(0, self.segment_count * (self.segment_count + 1) // 2)

    @property
    def segments(self) -> Floats:
        """Segment vectors, normalized, shape (..., N, 2)."""
        return self._rows(0, self.segment_count)

    @property
    def joint_angles(self) -> Floats:
        """Relative joint angles of the segments in ]−π, π], shape (..., N)."""
        return chain.joint_angles_from_segments(self.segments)

    @property
    def end_effector(self) -> Floats:
        """Sum of the segments: the position of the hand in this posture, shape (..., 2)."""
        return np.moveaxis(self.values[: self.segment_count].sum(axis=0), 0, -1)

    @property
    def batch_shape(self) -> tuple[int, ...]:
        """Leading axes of the other properties."""
        return self.values.shape[2:]

    def _rows(self, start: int, stop: int) -> Floats:
        return np.moveaxis(self.values[start:stop], (0, 1), (-2, -1))


@dataclass(frozen=True, eq=False)
class Clamps:
    """Variables held at given values; made by the network that they are used with.

    Attributes:
        rows: their rows in the state, in ascending order.
        values: what they are held at, (rows, 2, ...).
    """

    rows: tuple[int, ...]
    values: Floats


NO_CLAMPS = Clamps((), np.empty((0, 2)))


class Trajectory(NamedTuple):
    """What a network went through.

    Attributes:
        state: the last one.
        segments: after every iteration, (iterations, ..., N, 2).
    """

    state: MMCState
    segments: Floats

    def plot(self, axes: Axes | None = None) -> Figure:
        """Return a figure of the first arms, later iterations darker, and of their hands' paths.

        A cross marks R, which an inverse task holds at the target.

        Args:
            axes: to draw on; of a new figure if None.
        """
        from mmc_gym._plotting import plot_postures

        segments = self.segments.reshape(len(self.segments), -1, *self.segments.shape[-2:])
        last = self.state.vectors[..., -1, :].reshape(-1, 2)
        return plot_postures(chain.node_positions(segments), last, axes)


@dataclass(frozen=True)
class MMCNetwork:
    """Description of an MMC network for a planar arm of N ≥ 2 segments; it holds no state.

    It converges for d > (N + 1)/2, and without oscillation for d ≥ N + 1.  At d = N + 1 the linear
    part needs a single iteration.

    Attributes:
        segment_lengths: N positive lengths.
        damping: d, the weight of the present value in the mean (paper: 10).
        normalizer: Euclidean (classical network) or learned.
        dynamics: "kinematic", or a rule for the velocity: "paper" or "reference".
        velocity_damping: d_v (paper: 5).  Dynamic networks only.
        velocity_decay: factor on the velocity in each iteration (paper: 0.92).  Dynamic only.
        schedule: "synchronous" or "delayed".

    Raises:
        UserError: for fewer than two segments, or a value outside its range.

    >>> network = MMCNetwork()
    >>> state = network.state_from_joint_angles([0.3, 0.6, 0.6])
    >>> state = network.run(state, network.inverse([-1.0, 1.5]), iterations=100)
    >>> state.end_effector.round(2).tolist()
    [-1.0, 1.5]
    """

    segment_lengths: tuple[float, ...] = (1.0, 1.0, 1.0)
    damping: float = 10.0
    normalizer: Normalizer = field(default_factory=EuclideanNormalizer)
    dynamics: Dynamics = "kinematic"
    velocity_damping: float = 5.0
    velocity_decay: float = 0.92
    schedule: Schedule = "synchronous"

    def __post_init__(self) -> None:
        lengths = tuple(float(length) for length in self.segment_lengths)
        object.__setattr__(self, "segment_lengths", lengths)
        fine = len(lengths) >= 2 and all(0 < length < np.inf for length in lengths)
        require(fine, "segment_lengths", lengths, "two or more positive and finite lengths")
        require(0 < self.damping < np.inf, "damping", self.damping, "positive and finite")
        least, value = 1 if self.dynamics == "paper" else 0, self.velocity_damping
        require(least <= value < np.inf, "velocity_damping", value, f"finite, at least {least}")
        value = self.velocity_decay
        require(0 <= value <= 1, "velocity_decay", value, "between 0 and 1")
        for name, accepted in (("dynamics", Dynamics), ("schedule", Schedule)):
            choice = getattr(self, name)
            require(choice in get_args(accepted), name, choice, f"one of {get_args(accepted)}")

    @property
    def segment_count(self) -> int:
        """N."""
        return len(self.segment_lengths)

    @property
    def facts(self) -> dict[str, str]:
        """What is to know of the network, by heading."""
        return {one.name.replace("_", " "): str(getattr(self, one.name)) for one in fields(self)}

    def _repr_html_(self) -> str:
        return facts_table(self, self.facts)

    # States

    def state_from_joint_angles(self, joint_angles: ArrayLike) -> MMCState:
        """Return the state of arms at rest in a posture; joint angles (..., N) in radians."""
        angles = _as_floats("joint_angles", joint_angles, (self.segment_count,))
        return self.state_from_segments(
            chain.segments_from_joint_angles(angles, self.segment_lengths)
        )

    def state_from_segments(self, segments: ArrayLike) -> MMCState:
        """Return the state at rest with these segment vectors (..., N, 2), the others consistent.

        They are not normalized before the first iteration.  float32 is kept, anything else
        becomes float64.

        Raises:
            ValueError: if the shape is another or a value is not finite.
        """
        segments = _as_floats("segments", segments, (self.segment_count, 2))
        parts = [chain.chain_vectors(segments)]
        if self.schedule == "delayed":
            parts.append(segments)
        if self.dynamics != "kinematic":
            parts.append(np.zeros_like(segments))
        rows = np.moveaxis(np.concatenate(parts, axis=-2), (-2, -1), (0, 1))
        return MMCState(np.ascontiguousarray(rows), self.segment_count)

    # Tasks

    def inverse(self, target: ArrayLike) -> Clamps:
        """Hold the end effector at `target` (..., 2): the inverse task."""
        # The same as `clamp`, in a third of the time: agents call it in every control step.
        target = _as_floats("target", target, (2,))
        row = self.segment_count * (self.segment_count + 1) // 2 - 1
        batch = range(target.ndim - 1)
        return Clamps((row,), target.transpose(target.ndim - 1, *batch).copy()[None])

    def forward(self, segments: ArrayLike) -> Clamps:
        """Hold every segment at its vector in `segments` (..., N, 2): the forward task."""
        segments = _as_floats("segments", segments, (self.segment_count, 2))
        return self.clamp({(i, i + 1): segments[..., i, :] for i in range(self.segment_count)})

    def clamp(self, vectors: Mapping[Pair, ArrayLike]) -> Clamps:
        """Hold the vectors v_ij of the given node pairs at values (..., 2): any mixed task.

        A segment is held as it is given, and should have its length.

        Raises:
            UserError: for a pair that is no vector of the chain.
            ValueError: for a value that is not a finite array of shape (..., 2).
        """
        pairs = chain.vector_pairs(self.segment_count)
        held: dict[int, Floats] = {}
        for pair, value in vectors.items():
            require(pair in pairs, "a clamp", pair, f"a node pair of {pairs}")
            held[pairs.index(pair)] = _as_floats(f"clamp {pair}", value, (2,))
        if not held:
            return NO_CLAMPS
        if self.schedule == "delayed":  # the pending value of a clamped segment is held as well
            segments = [row for row in held if row < self.segment_count]
            held |= {len(pairs) + row: held[row] for row in segments}
        rows = tuple(sorted(held))
        values = np.stack(np.broadcast_arrays(*(held[row] for row in rows)))
        return Clamps(rows, np.ascontiguousarray(np.moveaxis(values, -1, 1)))

    # Iterating

    def step(self, state: MMCState, clamps: Clamps = NO_CLAMPS) -> MMCState:
        """Return the state after one iteration."""
        return self.run(state, clamps, iterations=1)

    def run(self, state: MMCState, clamps: Clamps = NO_CLAMPS, iterations: int = 1) -> MMCState:
        """Return the state after `iterations` iterations; `state` itself stays as it is.

        Batch axes of state and clamps are broadcast against each other.

        Raises:
            ValueError: if state or clamps come from another kind of network, or `iterations` is
                negative.
        """
        values, clamped = state.values, clamps.values
        iteration = compile_iteration(self, clamps.rows, values.dtype.char)
        if len(values) != len(iteration.operator) or state.segment_count != self.segment_count:
            raise ValueError(f"state must come from this network, got {len(values)} rows")
        if iterations < 0:
            raise ValueError(f"iterations must be 0 or more, got {iterations}")
        if clamped.ndim > 2 and clamped.shape[2:] != values.shape[2:]:
            batch = np.broadcast_shapes(values.shape[2:], clamped.shape[2:])
            values, clamped = _broadcast(values, batch), _broadcast(clamped, batch)
        result = np.empty(values.shape, dtype=values.dtype)
        rows, size = len(result), result[0, 0].size
        source, out = values.reshape(rows, 2, size), result.reshape(rows, 2, size)
        held = clamped.reshape(len(clamped), 2, clamped[0, 0].size if clamps.rows else 1)
        for start in range(0, size, _BLOCK):
            block = slice(start, start + _BLOCK)
            current = source[:, :, block].copy()
            if clamps.rows:
                current[iteration.clamped] = held if held.shape[2] == 1 else held[:, :, block]
            out[:, :, block] = iteration.repeat(current, iterations)
        return MMCState(result, self.segment_count)

    def trajectory(self, state: MMCState, clamps: Clamps, iterations: int) -> Trajectory:
        """Run, and record the segments after every iteration.

        Returns:
            The last state, and the segments of all iterations, (iterations, ..., N, 2); its `plot`
            draws them.

        >>> network = MMCNetwork()
        >>> start = network.state_from_joint_angles([0.3, 0.6, 0.6])
        >>> state, segments = network.trajectory(start, network.inverse([-1.0, 1.5]), 50)
        >>> segments.shape
        (50, 3, 2)
        """
        state = self.run(state, clamps, iterations=0)  # broadcasts state and clamps
        postures = np.empty((iterations, *state.segments.shape), dtype=state.values.dtype)
        for iteration in range(iterations):
            state = self.step(state, clamps)
            postures[iteration] = state.segments
        return Trajectory(state, postures)


@dataclass(frozen=True, eq=False)
class Iteration:
    """One iteration of a network, for a set of clamped rows and a dtype.

    Attributes:
        operator: its linear part, see `linear_operator`.
        clamped: rows that hold clamp values.
        normalized: rows to normalize, those of the free segments.
        lengths: lengths to bring them to, (n, 1).
        normalizer: what brings them there.
        normalizes_first: tells whether this is done before the linear part (schedule "delayed").
    """

    operator: Floats
    clamped: Rows
    normalized: Rows
    lengths: Floats
    normalizer: Normalizer
    normalizes_first: bool

    def repeat(self, values: Floats, iterations: int) -> Floats:
        """Return the state (rows, 2, batch) after so many iterations; `values` is overwritten."""
        following = np.empty_like(values)
        flat = (len(values), -1)
        for _ in range(iterations):
            if self.normalizes_first:
                self._normalize(values)
            self.operator.dot(values.reshape(flat), following.reshape(flat))
            if not self.normalizes_first:
                self._normalize(following)
            values, following = following, values
        return values

    def _normalize(self, values: Floats) -> None:
        rows = self.normalized
        if isinstance(rows, slice):
            self.normalizer.normalize_rows(values[rows], self.lengths)
        elif rows.size:
            segments = values[rows]
            self.normalizer.normalize_rows(segments, self.lengths)
            values[rows] = segments


@lru_cache(maxsize=256)
def compile_iteration(network: MMCNetwork, clamped: tuple[int, ...], dtype: str) -> Iteration:
    """Prepare the iteration for clamped rows (`Clamps.rows`) and a dtype's character."""
    count = network.segment_count
    free = [row for row in range(count) if row not in clamped]
    delayed = network.schedule == "delayed"
    offset = len(chain.vector_pairs(count)) if delayed else 0
    return Iteration(
        operator=linear_operator(network, clamped).astype(dtype),
        clamped=_as_slice(clamped),
        normalized=_as_slice(tuple(offset + row for row in free)),
        lengths=np.array(network.segment_lengths, dtype=dtype)[free, None],
        normalizer=network.normalizer,
        normalizes_first=delayed,
    )


def linear_operator(network: MMCNetwork, clamped: Sequence[int] = ()) -> NDArray[np.float64]:
    """Return the linear part of an iteration, a matrix K over the rows of the state, (rows, rows).

    The next state is normalize(K state) if the network is synchronous.  If it is delayed, it is
    K normalize(state), and the pending segments are normalized.

    Args:
        network: the network.
        clamped: rows that are held (`Clamps.rows`).
    """
    count, mean = network.segment_count, mean_operator(network)
    vectors = len(mean)

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
    if delayed:  # the triangle terms read the old segments, the self term the new ones
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


def mean_operator(network: MMCNetwork) -> NDArray[np.float64]:
    """Return I − 1/d ∂₂∂₂ᵀ, which makes the means ṽ of the vectors v."""
    incidence = chain.triangle_incidence(network.segment_count)
    return np.eye(len(incidence)) - incidence @ incidence.T / network.damping


def velocity_rule(network: MMCNetwork) -> tuple[float, float]:
    """Return the factors of (L̃ − L) and of the old velocity in the new velocity."""
    d_v, decay = network.velocity_damping, network.velocity_decay
    if network.dynamics == "paper":
        return 1 / d_v, decay * (d_v - 1) / d_v
    return decay / (d_v + 1), decay * d_v / (d_v + 1)


def _as_slice(rows: tuple[int, ...]) -> Rows:
    """Return neighbouring rows as a slice, which numpy indexes without a copy."""
    if rows and rows == tuple(range(rows[0], rows[-1] + 1)):
        return slice(rows[0], rows[-1] + 1)
    return np.array(rows, dtype=np.intp)


def _broadcast(values: Floats, batch: tuple[int, ...]) -> Floats:
    """Broadcast the batch axes of values (rows, 2, ...) to `batch`."""
    rows, two, *own = values.shape
    missing = (1,) * (len(batch) - len(own))
    return np.broadcast_to(values.reshape(rows, two, *missing, *own), (rows, two, *batch))


def _as_floats(name: str, value: ArrayLike, trailing: tuple[int, ...]) -> Floats:
    """Return the value as a finite float array whose last axes are `trailing`."""
    array = np.asarray(value)
    if array.dtype != np.float32:
        array = array.astype(np.float64)
    if array.shape[array.ndim - len(trailing) :] != trailing or array.ndim < len(trailing):
        raise ValueError(
            f"{name} must have shape (..., {', '.join(map(str, trailing))}), got {array.shape}"
        )
    if not np.isfinite(array).all():
        raise ValueError(f"{name} must be finite, got {value!r}")
    return array
