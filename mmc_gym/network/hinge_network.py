"""The MMC network for arms of hinges in space: pose, position, elbow, locked joints.

Nodes p_0 (base) … p_N (hand) follow from the arm, see `hinge_arm`; hinge i lies in node k(i), along
the unit vector u_i.  A clamp holds the vector v_0g from the base to a node, at v*_0g; three vectors
h_a of length s that turn with the hand stand for its rotation, and are held at h*_a.

**What a hinge computes.**  From the triangle (0, k, g) follows v_kg = v*_0g − v_0k, one of the
computations that `model` averages.  All others agree with the present value, because the vectors of
a hinged arm are those of one posture q after each iteration.  So every hinge asks for the missing

    e_g = v*_0g − v_0g,      e_a = h*_a − h_a

and its estimate is the angle by which it alone would best make up for it (least squares; the sums
run over held vectors that it carries, and h_a counts as v_kg):

    α_i = Σ_g (u_i × v_kg)·e_g / Σ_g |u_i × v_kg|²

**The mean of multiple computations** is over the hinges: n computations q^(i) of the posture, each
of which differs from the present one in q_i by α_i, and the present one, weighted by the damping d:

    q̃ = 1/d Σ_i q^(i) + (d − n)/d q      ⇔      q̃_i = q_i + α_i / d

With a velocity, as in the dynamic network, and limits in place of lengths,

    v ← α/d + decay·v,      q ← nearest posture within the limits to q + v

where v forgets its past whenever this opposes the estimates, Σ_i α_i v_i Σ_g |u_i × v_kg|² < 0, and
v_i = 0 at a limit.  A held joint has two equal limits.  The posture is at rest where all estimates
vanish: at the target, or where no small change brings it nearer; hence the many starts.

Near a solution no mode diverges for d > n/2 without a velocity, and for d > n/(2 (1 + decay)) with
it: n estimates may all ask for the same.  (In the plane the bound is (N + 1)/2.)

So this shares the vectors, their triangles, clamps, damping and velocity with `MMCNetwork`, but it
averages over hinges, where `MMCNetwork` averages over triangles and then normalizes each segment.
For ball joints that works in space too: `MMCNetwork(dimensions=3)`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from importlib.util import find_spec
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mmc_gym._errors import (
    UserError,
    require,
    require_choice,
    require_floats,
    require_number,
    require_positive,
    require_whole,
    spelt,
    unknown,
)
from mmc_gym.network import hinge_iteration
from mmc_gym.network.chain import Floats
from mmc_gym.network.hinge_arm import HingeArm
from mmc_gym.network.hinge_iteration import LANES, Arm, Plan, block_type, compiled_relax

POOL = 128  # postures, of which the nearest to a task are its starts
NEWTON = 6  # steps of Newton's method
POLISHED = 1e-6  # where they shall end, m and radians
_CHUNK = 64  # tasks in memory at once


@dataclass(frozen=True, eq=False)
class HingeState:
    """Postures of a batch of arms, and how fast they change.

    Attributes:
        joint_angles: radians, (..., n).
        joint_velocities: radians per iteration, (..., n).
    """

    joint_angles: Floats
    joint_velocities: Floats


@dataclass(frozen=True, eq=False)
class HingeClamps:
    """Parts of an arm held at given places, made by `HingeNetwork.clamp`.

    Attributes:
        position: of the hand, (..., 3), or None.
        rotation: of the hand, (..., 3, 3), or None.
        held: angles of held joints by joint, (...).
        points: positions of other nodes by node, (..., 3).
    """

    position: Floats | None = None
    rotation: Floats | None = None
    held: Mapping[int, Floats] = field(default_factory=dict)
    points: Mapping[int, Floats] = field(default_factory=dict)

    @cached_property
    def batch_shape(self) -> tuple[int, ...]:
        """The batch axes of all values together."""
        shapes = [one.shape for one in self.held.values()]
        shapes += [
            one.shape[:-1] for one in (self.position, *self.points.values()) if one is not None
        ]
        shapes += [] if self.rotation is None else [self.rotation.shape[:-2]]
        return _together("clamps", shapes)


@dataclass(frozen=True, eq=False)
class HingeSolution:
    """Where a network has settled; `...` are the batch axes of the task.

    Attributes:
        joint_angles: (..., n), within the limits.
        position_error: largest distance of a held node, the hand or a point, from its place, m.
        rotation_error: angle between the hand's rotation and the wanted one, radians.
        iterations: iterations until it settled; up to 16 starts iterate together.
        is_solved: whether both errors are within the tolerance.
    """

    joint_angles: Floats
    position_error: Floats
    rotation_error: Floats
    iterations: NDArray[np.int64]
    is_solved: NDArray[np.bool_]


@spelt
@dataclass(frozen=True, eq=False)
class HingeNetwork:
    """Description of an MMC network for an arm of hinges; it holds no state.

    Attributes:
        arm: the arm.
        damping: d, the weight of the present posture in the mean; more than n / (2 (1 + decay)).
            None is a third of the number of joints that are not held.
        velocity_decay: factor on the velocity in each iteration, from 0 to below 1.
        hand_size: s, length of the vectors that stand for the hand's rotation, m.
        engine: "numpy"; "numba", which compiles the same algorithm in some seconds for each number
            of joints and nodes; or None, "numba" where it is installed.

    Raises:
        UserError: for a value outside its range, or an unknown argument; as `MissingExtraError`,
            for the engine "numba" where it is not installed.

    >>> network = HingeNetwork(HingeArm.named("panda"), engine="numpy")
    >>> solution = network.solve(position=[0.4, 0.2, 0.5], held={3: -1.8})
    >>> solution.is_solved.item(), solution.joint_angles[3].item()
    (True, -1.8)
    >>> network.arm.forward(solution.joint_angles)[:3, 3].round(2).tolist()
    [0.4, 0.2, 0.5]
    """

    arm: HingeArm
    damping: float | None = None
    velocity_decay: float = 0.97
    hand_size: float = 0.12
    engine: str | None = None

    def __post_init__(self) -> None:
        require(isinstance(self.arm, HingeArm), "arm", self.arm, "a HingeArm")
        decay = self.velocity_decay
        require_number("velocity_decay", decay, "from 0 to below 1", lambda value: 0 <= value < 1)
        least = self.arm.joint_count / (2 * (1 + decay))
        if self.damping is not None:
            accepted = f"finite, and more than n / (2 (1 + velocity_decay)) = {least:g}"
            require_number("damping", self.damping, accepted, lambda d: least < d < np.inf)
        require_positive("hand_size", self.hand_size)
        require_choice("engine", self.engine, ("numpy", "numba", None))
        if self.engine == "numba":
            compiled_relax()  # raises here if numba is missing

    def state(self, joint_angles: ArrayLike) -> HingeState:
        """Return arms at rest in postures (..., n)."""
        angles = _floats("joint_angles", joint_angles, (self.arm.joint_count,))
        return HingeState(angles, np.zeros_like(angles))

    def clamp(
        self,
        position: ArrayLike | None = None,
        rotation: ArrayLike | None = None,
        held: Mapping[int, ArrayLike] | None = None,
        points: Mapping[int, ArrayLike] | None = None,
    ) -> HingeClamps:
        """Hold the hand's position and rotation, joints, and nodes: any task, or a mixture.

        Args:
            position: of the hand, seen from the base, (..., 3).
            rotation: of the hand, (..., 3, 3).
            held: angles (...) of joints that do not move, by index of the joint; a locked joint, or
                all of them for the forward task.
            points: positions (..., 3) of nodes by their index, such as the elbow's, see `HingeArm`.

        Raises:
            UserError: for a joint or node that there is not, or a value of another shape.
        """
        held, points = held or {}, points or {}
        for joint in held:
            if joint not in range(self.arm.joint_count):
                raise unknown("joint", joint, range(self.arm.joint_count))
        for node in points:
            if node not in range(1, self.arm.node_count):
                raise unknown("node", node, range(1, self.arm.node_count))
        return HingeClamps(
            None if position is None else _floats("position", position, (3,)),
            None if rotation is None else _floats("rotation", rotation, (3, 3)),
            {joint: _floats("held", angle, ()) for joint, angle in held.items()},
            {node: _floats("points", point, (3,)) for node, point in points.items()},
        )

    def run(self, state: HingeState, clamps: HingeClamps, iterations: int = 1) -> HingeState:
        """Return the state after `iterations` iterations; `state` itself stays as it is.

        Batch axes of state and clamps are broadcast against each other.
        """
        require_whole("iterations", iterations, least=0)
        batch = _together("state", [state.joint_angles.shape[:-1], clamps.batch_shape])
        task = self._task(clamps, batch)
        n, count = self.arm.joint_count, len(task.low)
        blocks = self._blocks(-(-count // LANES))
        lanes = np.minimum(np.arange(len(blocks) * LANES), count - 1).reshape(len(blocks), LANES)
        self._fill(blocks, task, lanes)
        for name, values in (("angle", state.joint_angles), ("speed", state.joint_velocities)):
            rows = np.broadcast_to(values, (*batch, n)).reshape(-1, n)
            blocks[name] = np.swapaxes(rows[lanes], 1, 2)
        np.clip(blocks["angle"], blocks["low"], blocks["high"], out=blocks["angle"])
        self._relax(blocks, self._plan(task, iterations))
        angles, speeds = (
            np.swapaxes(blocks[name], 1, 2).reshape(-1, n)[:count].reshape(*batch, n)
            for name in ("angle", "speed")
        )
        return HingeState(angles, speeds)

    def solve(
        self,
        position: ArrayLike | None = None,
        rotation: ArrayLike | None = None,
        start: ArrayLike | None = None,
        held: Mapping[int, ArrayLike] | None = None,
        points: Mapping[int, ArrayLike] | None = None,
        starts: int = 128,
        tolerance: tuple[float, float] = (1e-3, 1e-2),
        polish: bool = False,
        seed: int = 0,
        iterations: int = 150,
    ) -> HingeSolution:
        """Return where the network settles, from many starts.

        The starts are postures drawn within the limits, those nearest to the task first; 16 settle
        together, and the first to settle wins.  Where none does, the best is returned.

        Args:
            position: see `clamp`, as `rotation`, `held` and `points`.
            rotation: of the hand.
            start: postures (..., n) to begin with: what settles from there is preferred, then what
                is nearest to it.
            held: angles of joints that do not move.
            points: positions of nodes.
            starts: at most so many, in groups of 16.
            tolerance: of position, m, and of rotation, radians.
            polish: whether steps of Newton's method follow, within the limits; where they do not
                end within 1e-6 m and radians, other starts follow.
            seed: of the starts.
            iterations: of each start at most.

        Raises:
            UserError: for a value that `clamp` refuses, or batch axes that do not fit.
        """
        clamps = self.clamp(position, rotation, held, points)
        require_whole("starts", starts)
        require_whole("iterations", iterations)
        far, turn = (require_positive("tolerance", each) for each in tolerance)
        batch, first = clamps.batch_shape, None
        if start is not None:
            first = self.state(start).joint_angles
            batch = _together("start", [batch, first.shape[:-1]])
            first = np.broadcast_to(first, (*batch, first.shape[-1])).reshape(-1, first.shape[-1])
        task = self._task(clamps, batch)
        plan = self._plan(task, iterations, far, turn, NEWTON if polish else 0)
        parts = []
        for begin in range(0, max(1, len(task.low)), _CHUNK):
            rows = slice(begin, begin + _CHUNK)
            near = None if first is None else first[rows]
            own = task.of(rows)
            parts.append(self._settle(own, plan, near, starts, seed))
        angles, errors, counts = map(np.concatenate, zip(*parts))
        solved = (errors[:, 0] < far) & (errors[:, 1] < turn)
        return HingeSolution(
            angles.reshape(*batch, self.arm.joint_count),
            errors[:, 0].reshape(batch),
            errors[:, 1].reshape(batch),
            counts.reshape(batch),
            solved.reshape(batch),
        )

    def _settle(
        self, task: _Task, plan: Plan, first: Floats | None, starts: int, seed: int
    ) -> tuple[Floats, Floats, NDArray[np.int64]]:
        """Return angles (batch, n), errors (batch, 2) and iterations (batch,)."""
        count = len(task.low)
        angles, errors = np.empty_like(task.low), np.empty((count, 2))
        counts, least = np.zeros(count, np.int64), np.full(count, np.inf)
        waves = -(-starts // LANES)
        pool = self._pool(max(POOL, waves * LANES), seed)
        order = np.broadcast_to(np.arange(LANES), (count, LANES))  # of the pool
        active = np.arange(count)
        for wave in range(waves):
            follows = first is not None and wave == 0
            if wave == (first is not None):  # sorted when it is first needed
                order = self._order(task, plan, pool)
            blocks = self._blocks(len(active))
            self._fill(blocks, task, active)
            chosen = order[active, wave * LANES : (wave + 1) * LANES]
            blocks["angle"] = np.swapaxes(pool[chosen], 1, 2)
            if first is not None and follows:
                blocks["angle"][:, :, 0] = first
            np.clip(blocks["angle"], blocks["low"], blocks["high"], out=blocks["angle"])
            self._relax(blocks, plan._replace(first=follows))
            is_good = blocks["settled"] > 0
            if plan.newton:
                is_good &= blocks["miss"] < POLISHED**2
                is_good &= (blocks["sine"] < POLISHED**2) | (task.weight == 0)
            rank = np.where(is_good, plan.newton * blocks["merit"], np.inf)
            if first is not None and follows:
                rank += ((blocks["angle"] - first[:, :, None]) ** 2).sum(axis=1)
                rank[:, 0] = np.where(is_good[:, 0], -1.0, np.inf)
            found = np.isfinite(rank).any(axis=1)
            lane = np.where(found, rank.argmin(axis=1), blocks["merit"].argmin(axis=1))
            at = np.arange(len(active)), lane
            merit = np.where(found, -1.0, blocks["merit"][at])
            take = merit < least[active]
            rows, at = active[take], (at[0][take], lane[take])
            angles[rows] = np.swapaxes(blocks["angle"], 1, 2)[at]
            errors[rows, 0] = np.sqrt(blocks["miss"][at])
            turn = np.arctan2(np.sqrt(blocks["sine"][at]), blocks["cosine"][at])
            errors[rows, 1] = turn if task.weight else 0.0
            least[rows] = merit[take]
            counts[active] += blocks["iterations"]
            active = active[~found]
            if not active.size:
                break
        return angles, errors, counts

    def _order(self, task: _Task, plan: Plan, pool: Floats) -> NDArray[np.intp]:
        """Return the order of a pool for each task, those first that lack least, (batch, size)."""
        count, parts = len(task.low), len(pool) // LANES
        blocks = self._blocks(count * parts)
        self._fill(blocks, task, np.repeat(np.arange(count), parts))
        each = np.swapaxes(pool.reshape(parts, LANES, -1), 1, 2)
        blocks["angle"] = np.tile(each, (count, 1, 1))
        np.clip(blocks["angle"], blocks["low"], blocks["high"], out=blocks["angle"])
        self._relax(blocks, plan._replace(times=0, newton=0))
        return np.argsort(blocks["merit"].reshape(count, -1), axis=1)

    def _pool(self, size: int, seed: int) -> Floats:
        """Return postures within the limits, (size, n)."""
        if (size, seed) not in self._pools:
            random = np.random.default_rng([seed, size, 77])  # not what users draw targets from
            low, high = np.where(np.isinf(self.arm.limits), (-np.pi, np.pi), self.arm.limits).T
            self._pools[size, seed] = random.uniform(low, high, (size, self.arm.joint_count))
        return self._pools[size, seed]

    @cached_property
    def _pools(self) -> dict[tuple[int, int], Floats]:
        return {}

    def _task(self, clamps: HingeClamps, batch: tuple[int, ...]) -> _Task:
        """Return the task of each arm of a batch."""

        def rows(value: Floats, trailing: tuple[int, ...]) -> Floats:
            return np.broadcast_to(value, (*batch, *trailing)).reshape(-1, *trailing)

        arm, places = self.arm, dict(clamps.points)
        if clamps.position is not None:
            places[arm.node_count - 1] = clamps.position
        low, high = (rows(limit, (arm.joint_count,)).copy() for limit in arm.limits.T)
        for joint, angle in clamps.held.items():
            low[:, joint] = high[:, joint] = rows(angle, ())
        place = np.zeros((len(low), arm.node_count, 3))
        for node, point in places.items():
            place[:, node] = rows(point, (3,))
        is_placed = np.array([node in places for node in range(arm.node_count)])
        rotation = rows(np.eye(3) if clamps.rotation is None else clamps.rotation, (3, 3))
        free = max(1, arm.joint_count - len(clamps.held))
        share = np.full(len(low), 3 / free if self.damping is None else 1 / self.damping)
        weight = 0.0 if clamps.rotation is None else 2 * self.hand_size**2
        return _Task(low, high, place, rotation, share, is_placed, weight)

    def _blocks(self, count: int) -> NDArray[Any]:
        return np.zeros(count, block_type(self.arm.joint_count, self.arm.node_count))

    def _fill(self, blocks: NDArray[Any], task: _Task, rows: NDArray[np.intp]) -> None:
        """Write tasks into blocks: rows of the batch, (blocks,) or (blocks, lanes)."""
        wanted = task.rotation @ self.arm.home[:3, :3].T  # as a turn of the whole arm
        values = task.low, task.high, task.place, task.share, wanted
        for name, every in zip(("low", "high", "place", "share", "wanted"), values):
            each = every[rows]
            blocks[name] = np.moveaxis(each, 1, -1) if rows.ndim == 2 else each[..., None]

    def _plan(
        self, task: _Task, times: int, far: float = 0.0, turn: float = 0.0, newton: int = 0
    ) -> Plan:
        decay = float(self.velocity_decay)
        return Plan(task.is_placed, task.weight, decay, times, far, turn, False, newton)

    @cached_property
    def _relax(self) -> Any:
        """`hinge_iteration.relax` for this arm, or the compiled one."""
        is_compiled = self.engine == "numba" or (self.engine is None and find_spec("numba"))
        relax = compiled_relax() if is_compiled else hinge_iteration.relax
        return lambda blocks, plan: relax(blocks, self._arm, plan)

    @cached_property
    def _arm(self) -> Arm:
        arm = self.arm
        nodes = arm.nodes(np.zeros(arm.joint_count))
        return Arm(arm.axes, arm.points, nodes, np.array(arm.joint_nodes))


class _Task(NamedTuple):
    """The clamps of each arm of a batch, as arrays.

    Attributes:
        low: least angles, (batch, n); those of a held joint are equal.
        high: largest angles, (batch, n).
        place: where nodes are held, (batch, N + 1, 3).
        rotation: of the hand, (batch, 3, 3).
        share: 1/d, (batch,).
        is_placed: which nodes are held, (N + 1,).
        weight: 2 s² where the hand's rotation is held, otherwise 0.
    """

    low: Floats
    high: Floats
    place: Floats
    rotation: Floats
    share: Floats
    is_placed: NDArray[np.bool_]
    weight: float

    def of(self, rows: slice) -> _Task:
        """Return some rows of the batch."""
        low, high, place, rotation, share, is_placed, weight = self
        return _Task(
            low[rows], high[rows], place[rows], rotation[rows], share[rows], is_placed, weight
        )


def _together(name: str, shapes: list[tuple[int, ...]]) -> tuple[int, ...]:
    try:
        return np.broadcast_shapes(*shapes)
    except ValueError as error:
        raise UserError(f"{name} must have batch axes that fit, got {shapes}") from error


def _floats(name: str, value: ArrayLike, trailing: tuple[int, ...]) -> Floats:
    """Return a copy in float64 of a finite array whose last axes are `trailing`."""
    return np.array(require_floats(name, value, trailing), np.float64)
