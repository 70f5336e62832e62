"""The MMC network: a recurrent network whose attractors are the valid postures of the arm.

Every vector v_ij of the chain is computed from each of its m = N − 1 triangles.  The results are
averaged with the present value (Eq. 2 of the paper, exactly so for N = 3):

    ṽ_ij = 1/d Σ_{k≠i,j} (v_ik + v_kj) + (d − m)/d v_ij,     v_ba = −v_ab
         ⇔  ṽ = (I − 1/d ∂₂∂₂ᵀ) v                            ∂₂ from `triangle_incidence`

Then the segments are brought back to their lengths:

    kinematic:  L ← normalize(L̃)
    dynamic:    v ← rule(L̃ − L, v),   L̂ = L + v,   L ← normalize(L̂)          (Eqs. 3, 4)

There are two rules for the velocity: the paper's Eq. 3, and the one behind its figures,

    "paper":      v = 1/d_v (L̃ − L) + decay (d_v − 1)/d_v v
    "reference":  v = decay ((L̃ − L) + d_v v) / (d_v + 1)

and two schedules.  "synchronous" reads the newest values everywhere, as printed.  "delayed" is the
one behind the published figures: the triangle terms read the normalized segments of one iteration
ago, and only the self term and the velocity read the new ones.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mmc_gym._errors import (
    UserError,
    require,
    require_batch,
    require_choice,
    require_floats,
    require_number,
    require_numbers,
    require_whole,
    spelt,
    unknown,
)
from mmc_gym.geometry import (
    Floats,
    joint_angles_from_segments,
    nearest_reachable,
    node_positions,
    segments_from_joint_angles,
)
from mmc_gym.network import chain
from mmc_gym.network.chain import Pair, cached_iteration, held_rows
from mmc_gym.network.normalizers import EuclideanNormalizer, Normalizer

if TYPE_CHECKING:  # numpy is all that the network needs
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Dynamics = Literal["kinematic", "paper", "reference"]
Schedule = Literal["synchronous", "delayed"]

# Vectors are in one line within this angle, radians: some roundings of their dtype.
_STRAIGHT = {"d": 1e-14, "f": 1e-5}


@dataclass(frozen=True, eq=False)
class MMCState:
    """Values of all variables of a batch of networks.

    The properties have the batch axes first; `vectors` and `segments` are views, not copies.
    """

    #: one row per variable, with the batch on the last axes, (rows, 2, ...): the chain's vectors,
    #: then the segments still to be normalized (schedule "delayed" only), then the segment
    #: velocities (dynamic networks only)
    values: Floats
    segment_count: int  #: N

    @property
    def vectors(self) -> Floats:
        """All vectors v_ij, shape (..., N(N+1)/2, 2), in the order of `chain.vector_pairs`."""
        rows = self.values[: self.segment_count * (self.segment_count + 1) // 2]
        return np.moveaxis(rows, (0, 1), (-2, -1))

    @property
    def segments(self) -> Floats:
        """Segment vectors, normalized, shape (..., N, 2)."""
        return self.vectors[..., : self.segment_count, :]

    @property
    def joint_angles(self) -> Floats:
        """Relative joint angles of the segments in ]−π, π], shape (..., N)."""
        return joint_angles_from_segments(self.segments)

    @property
    def end_effector(self) -> Floats:
        """Sum of the segments: the position of the hand in this posture, shape (..., 2)."""
        return np.moveaxis(self.values[: self.segment_count].sum(axis=0), 0, -1)

    @property
    def nodes(self) -> Floats:
        """Base, joints and hand of this posture, shape (..., N + 1, 2)."""
        return node_positions(self.segments)

    @property
    def batch_shape(self) -> tuple[int, ...]:
        """Shape of the batch: the leading axes of the other properties."""
        return self.values.shape[2:]


@dataclass(frozen=True, eq=False)
class Clamps:
    """Variables held at given values; made by methods of the network, such as `inverse`."""

    rows: tuple[int, ...]
    values: Floats
    segment_count: int


NO_CLAMPS = Clamps((), np.empty((0, 2)), 0)


class Trajectory(NamedTuple):
    """The states of a network over its iterations."""

    state: MMCState  #: the last state
    segments: Floats  #: after every iteration, (iterations, ..., N, 2)

    def plot(self, axes: Axes | None = None) -> Figure:
        """Draw the first arms of the batch, later iterations darker, and the paths of their hands.

        A cross marks the end of each R, the vector from base to hand, which an inverse task holds
        at the target.  Return the figure: that of `axes`, or a new one.
        """
        from mmc_gym._plotting import plot_postures

        arms = self.segments.reshape(len(self.segments), -1, *self.segments.shape[-2:])
        base_to_hand = self.state.vectors[..., -1, :].reshape(-1, 2)
        return plot_postures(node_positions(arms), base_to_hand, axes)


@spelt
@dataclass(frozen=True)
class MMCNetwork:
    """Description of an MMC network for an arm of N ≥ 2 segments; it holds no state.

    For arms in space there is `mmc_gym.robots.HingeNetwork`.

    The network converges for d > (N + 1)/2, and without oscillation for d ≥ N + 1.  At d = N + 1
    the linear part needs a single iteration.  A d of (N + 1)/2 or less raises a `UserError`.

    >>> network = MMCNetwork()
    >>> state = network.state_from_joint_angles([0.3, 0.6, 0.6])
    >>> state = network.run(state, network.inverse([-1.0, 1.5]), iterations=100)
    >>> state.end_effector.round(2).tolist()
    [-1.0, 1.5]
    """

    segment_lengths: tuple[float, ...] = (1.0, 1.0, 1.0)  #: N positive lengths
    #: d, the weight of the present value in the mean (paper: 10); more than (N + 1)/2
    damping: float = 10.0
    #: Euclidean (classical network) or learned
    normalizer: Normalizer = field(default_factory=EuclideanNormalizer)
    #: "kinematic", or a rule for the velocity: "paper" or "reference"
    dynamics: Dynamics = "kinematic"
    velocity_damping: float = 5.0  #: d_v (paper: 5).  Dynamic networks only.
    #: factor on the velocity in each iteration (paper: 0.92).  Dynamic only.
    velocity_decay: float = 0.92
    schedule: Schedule = "synchronous"  #: "synchronous" or "delayed"

    def __post_init__(self) -> None:
        accepted = "two or more positive and finite lengths"
        lengths = require_numbers(
            "segment_lengths",
            self.segment_lengths,
            accepted,
            lambda numbers: len(numbers) >= 2 and all(0 < length < np.inf for length in numbers),
        )
        object.__setattr__(self, "segment_lengths", lengths)
        half = (len(lengths) + 1) / 2
        accepted = f"finite, and more than (N + 1) / 2 = {half:g}, below which networks diverge"
        require_number("damping", self.damping, accepted, lambda d: half < d < np.inf)
        accepted = "a Normalizer, such as EuclideanNormalizer() or LearnedNormalizer.shipped()"
        require(isinstance(self.normalizer, Normalizer), "normalizer", self.normalizer, accepted)
        if str(self.dynamics) == "dynamic":  # there are two rules; the paper's is the first to try
            raise unknown("dynamics", self.dynamics, get_args(Dynamics), guess="paper")
        require_choice("dynamics", self.dynamics, get_args(Dynamics))
        require_choice("schedule", self.schedule, get_args(Schedule))
        least, value = 1 if self.dynamics == "paper" else 0, self.velocity_damping
        accepted = f"finite, at least {least}"
        require_number("velocity_damping", value, accepted, lambda d_v: least <= d_v < np.inf)
        value = self.velocity_decay
        require_number("velocity_decay", value, "between 0 and 1", lambda decay: 0 <= decay <= 1)

    @property
    def segment_count(self) -> int:
        """Number of segments, N."""
        return len(self.segment_lengths)

    def state_from_joint_angles(self, joint_angles: ArrayLike) -> MMCState:
        """Return the state of arms at rest with these joint angles (..., N), in radians."""
        angles = require_floats("joint_angles", joint_angles, (self.segment_count,))
        return self.state_from_segments(segments_from_joint_angles(angles, self.segment_lengths))

    def state_from_segments(self, segments: ArrayLike) -> MMCState:
        """Return the state at rest with segment vectors (..., N, 2); the other vectors are sums.

        The segments are not normalized before the first iteration.  float32 is kept; anything else
        becomes float64.
        """
        segments = require_floats("segments", segments, (self.segment_count, 2))
        parts = [chain.chain_vectors(segments)]
        if self.schedule == "delayed":
            parts.append(segments)
        if self.dynamics != "kinematic":
            parts.append(np.zeros_like(segments))
        rows = np.moveaxis(np.concatenate(parts, axis=-2), (-2, -1), (0, 1))
        return MMCState(np.ascontiguousarray(rows), self.segment_count)

    def inverse(self, target: ArrayLike) -> Clamps:
        """Return clamps that hold the end effector at `target` (..., 2): the inverse task."""
        # As `clamp`, but three times as fast: agents call it in every control step.
        target = require_floats("target", target, (2,))
        batch = range(target.ndim - 1)
        values = target.transpose(target.ndim - 1, *batch).copy()[None]
        return Clamps((self._hand_row,), values, self.segment_count)

    def forward(self, segments: ArrayLike) -> Clamps:
        """Return clamps that hold all segments at `segments` (..., N, 2): the forward task."""
        segments = require_floats("segments", segments, (self.segment_count, 2))
        return self.clamp({(i, i + 1): segments[..., i, :] for i in range(self.segment_count)})

    def clamp(self, vectors: Mapping[Pair, ArrayLike]) -> Clamps:
        """Return clamps that hold vectors v_ij, by node pair (i, j), at values (..., 2): any task.

        A held segment is not normalized, so its value should have the segment's length.
        """
        held = held_rows(self, "vectors", vectors, require_floats)
        if not held:
            return NO_CLAMPS
        rows = tuple(sorted(held))
        shapes = [array.shape for array in held.values()]
        shape = require_batch("vectors", shapes)
        values = np.stack([np.broadcast_to(held[row], shape) for row in rows])
        return Clamps(rows, np.ascontiguousarray(np.moveaxis(values, -1, 1)), self.segment_count)

    def step(self, state: MMCState, clamps: Clamps = NO_CLAMPS) -> MMCState:
        """Return the state after one iteration."""
        return self.run(state, clamps, iterations=1)

    def run(self, state: MMCState, clamps: Clamps = NO_CLAMPS, iterations: int = 1) -> MMCState:
        """Return the state after `iterations` iterations; `state` itself stays as it is.

        Batch axes of state and clamps are broadcast against each other.

        If a straight or folded arm, its target and all clamped vectors lie in one line, so do all
        means, and no iteration leaves that line.  If such an arm could get nearer to its target,
        each of its joints is first bent by `chain.BEND`.
        """
        require_whole("iterations", iterations, least=0)
        values = self.hold(state, clamps).values
        flat = values.reshape(*values.shape[:2], values[0, 0].size)
        cached_iteration(self, clamps.rows, values.dtype.char)(flat, iterations)
        return MMCState(values, self.segment_count)

    def hold(self, state: MMCState, clamps: Clamps) -> MMCState:
        """Return a copy of the state with clamped variables at their values, as `run` begins.

        Batch axes are broadcast.  Arms that could never leave the line they lie in are bent.
        """
        self._check(state, clamps)
        values, held = state.values, clamps.values
        if clamps.rows and held.shape[2:] != values.shape[2:]:
            try:
                batch = np.broadcast_shapes(values.shape[2:], held.shape[2:])
            except ValueError as error:
                accepted = f"that go with the state's, {values.shape[2:]}"
                got = held.shape[2:]
                raise UserError(f"clamps must have batch axes {accepted}, got {got}") from error
            values, held = _broadcast(values, batch), _broadcast(held, batch)
        values = self._bend_where_stuck(values, clamps.rows, held).copy()
        for row, vectors in zip(clamps.rows, held):
            values[row] = vectors
        return MMCState(values, self.segment_count)

    def trajectory(self, state: MMCState, clamps: Clamps, iterations: int) -> Trajectory:
        """Run the network and record the segments after every iteration.

        >>> network = MMCNetwork()
        >>> start = network.state_from_joint_angles([0.3, 0.6, 0.6])
        >>> state, segments = network.trajectory(start, network.inverse([-1.0, 1.5]), 50)
        >>> segments.shape
        (50, 3, 2)
        """
        require_whole("iterations", iterations, least=0)
        state = self.hold(state, clamps)
        postures = np.empty((iterations, *state.segments.shape), dtype=state.values.dtype)
        for iteration in range(iterations):
            state = self.step(state, clamps)
            postures[iteration] = state.segments
        return Trajectory(state, postures)

    def _check(self, state: MMCState, clamps: Clamps) -> None:
        """Raise a `UserError` if state or clamps do not come from a network like this one."""
        accepted = "an MMCState, such as network.state_from_joint_angles([0.3, 0.6, 0.6])"
        require(isinstance(state, MMCState), "state", state, accepted)
        accepted = "Clamps, such as network.inverse([1.0, 1.5])"
        require(isinstance(clamps, Clamps), "clamps", clamps, accepted)
        for name, count in (("state", state.segment_count), ("clamps", clamps.segment_count)):
            if count not in (self.segment_count, NO_CLAMPS.segment_count):
                accepted = f"of {self.segment_count} segments, as this network is"
                raise UserError(f"{name} must be {accepted}, got {count} segments")
        if len(state.values) != self.row_count:
            raise UserError(
                f"state must come from a network of dynamics {self.dynamics!r} and schedule "
                f"{self.schedule!r}, as this one, got {len(state.values)} rows"
            )

    @cached_property
    def _hand_row(self) -> int:
        return self.segment_count * (self.segment_count + 1) // 2 - 1

    @cached_property
    def row_count(self) -> int:
        """Number of rows in a state of this network, see `MMCState`."""
        count = self.segment_count
        blocks = (self.schedule == "delayed") + (self.dynamics != "kinematic")
        return count * (count + 1) // 2 + count * blocks

    def _bend_where_stuck(self, values: Floats, rows: tuple[int, ...], clamped: Floats) -> Floats:
        """Return values (rows, 2, ...); arms that could never leave their line are bent."""
        count, hand = self.segment_count, self._hand_row
        if hand not in rows:
            return values
        target = clamped[rows.index(hand)]
        if target.tobytes() == values[hand].tobytes():  # the target is not new
            return values
        lengths, first = self.segment_lengths, values[0]
        tolerance = _STRAIGHT[values.dtype.char] * lengths[0] * sum(lengths)
        is_straight = _are_in_line(first, values[1:count], tolerance)
        if not is_straight.any():
            return values
        target = nearest_reachable(np.moveaxis(target, 0, -1), lengths)
        way = target - np.moveaxis(values[:count].sum(axis=0), 0, -1)
        is_away = np.hypot(way[..., 0], way[..., 1]) > 1e-3 * sum(lengths)
        is_stuck = is_straight & _are_in_line(first, clamped, tolerance) & is_away
        bent = self.state_from_joint_angles(MMCState(values, count).joint_angles + chain.BEND)
        return np.where(is_stuck, bent.values, values)


def _are_in_line(first: Floats, others: Floats, tolerance: float) -> NDArray[np.bool_]:
    """Return whether all `others` (rows, 2, ...) are parallel to `first` (2, ...), as (...)."""
    cross = np.abs(first[0] * others[:, 1] - first[1] * others[:, 0])
    in_line: NDArray[np.bool_] = (cross <= tolerance).all(axis=0)
    return in_line


def _broadcast(values: Floats, batch: tuple[int, ...]) -> Floats:
    """Broadcast the batch axes of values (rows, axes, ...) to `batch`."""
    rows, axes, *present = values.shape
    missing = (1,) * (len(batch) - len(present))
    return np.broadcast_to(values.reshape(rows, axes, *missing, *present), (rows, axes, *batch))
