"""The MMC network for arms of hinges in space: pose, position, elbow, locked joints.

Nodes p_0 (base) … p_N (hand) follow from the arm, see `arm`; hinge i lies in node k(i), along
the unit vector u_i.  A clamp holds the vector v_0g from the base to a node, at v*_0g; three vectors
h_a of length s that turn with the hand stand for its rotation, and are held at h*_a.  Where only a
direction is held, it is one h of length √2 s along an axis of the hand.  A tool's point that is
held is one more node, after the hand.

**What a hinge computes.**  From the triangle (0, k, g) follows v_kg = v*_0g − v_0k, one of the
computations that `MMCNetwork` averages.  All others agree with the present value, because the
vectors of a hinged arm are those of one posture q after each iteration.  What is missing is

    e_g = v*_0g − v_0g,      e_a = h*_a − h_a

and the estimate of a hinge is the angle by which it alone would best make up for it (least squares;
the sums run over held vectors that it carries, and h_a counts as v_kg):

    α_i = Σ_g (u_i × v_kg)·e_g / Σ_g (|u_i × v_kg|² + max(0, c_g)),

where c_g, the product of v_kg and e_g across u_i, counts where the arm is too short.

**The mean of multiple computations** is over the hinges: n computations q^(i) of the posture, each
of which differs from the present one in q_i by α_i, and the present one, weighted by the damping d:

    q̃ = 1/d Σ_i q^(i) + (d − n)/d q      ⇔      q̃_i = q_i + α_i / d

With a velocity, as in the dynamic network, and limits in place of lengths,

    v ← α/d + decay·v,      q ← nearest posture within the limits to q + v

where v forgets its past (decay counts as 0) whenever it opposes the estimates,
Σ_i v_i Σ_g (u_i × v_kg)·e_g < 0, and v_i = 0 at a limit.  A held joint has two equal limits.  The
posture is at rest where all estimates vanish: at the target, or where no small change brings it
nearer; hence the many starts.

Near a solution no mode diverges for d > n/2 without a velocity, and for d > n/(2 (1 + decay)) with
it, as long as it is not forgotten: n estimates may all ask for the same.  Those of few hinges, or
of hinges in a plane, do, and need d > n/2.  (The bound of `MMCNetwork` is (N + 1)/2.)

**The last steps** of `solve` are not the network's.  The estimates α are the diagonal of a system,
JᵀJ δq = Jᵀe, where J has the levers u_i × v_kg as columns.  From 8 cm and 0.4 rad on all of it is
solved, damped by |e|² (Newton's method, Levenberg), which takes some five steps where the network
takes forty or more.  `run` is the network alone.

So this shares the vectors, their triangles, clamps, damping and velocity with `MMCNetwork`, but it
averages over hinges, where `MMCNetwork` averages over triangles and then normalizes each segment.
For ball joints that works in space, too.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from types import ModuleType
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mmc_gym._errors import (
    UserError,
    require,
    require_array,
    require_batch,
    require_choice,
    require_floats,
    require_number,
    require_numbers,
    require_positive,
    require_whole,
    spelt,
    unknown,
)
from mmc_gym.geometry import Floats
from mmc_gym.robots.arm import HingeArm, nearest_rotations, require_poses
from mmc_gym.robots.records import (
    Hold,
    Pace,
    Race,
    Records,
    course_of,
    end_type,
    posture_type,
    task_type,
    tool_pose,
    try_type,
)

Axis = Literal["x", "y", "z"]
HeldJoints: TypeAlias = "Mapping[int, ArrayLike] | Mapping[str, ArrayLike]"

POOL = 128  # postures, of which the nearest to a task are its starts; where all fail, as many more
NEAR_LIMITS = 0.2  # of these are between limits and this share of the ranges from them
NEAR_START = 0.3  # miss of a start that has all iterations, shares of the arm's length
QUICK_TRIES = 16  # from the pool, with little damping
QUICK_ITERATIONS = 80  # of each at most, if there are more starts
EXACT = 1e-3, 1e-2  # m and radians, below which the end of a single start is polished
EXACT_SHARE = 5e-4  # that of position for arms of more than 2 m, shares of their length
EARLY = 80, 40  # times these, below which Newton's method follows, if there are more starts
STALLED = 0.95  # share of what a try lacks that ten iterations leave: it ends
NEWTON_STEPS = 16  # at most
RIDGE = 3.0  # square root of the least damping of these steps, tolerances of position
FEW = 4  # free joints, up to which a third of them is too little damping
CALM = 0.6  # damping that is enough for any, shares of the free joints
PLACE_FIRST = 0.003  # weight of rotation where places go first, shares of tolerance × arm's length
PLACE_STEPS = 60  # of Newton's method, then
DISTINCT = 0.1  # difference of a joint by which solutions are not the same, radians or m
_TOLERANCES = "two positive numbers, of position in m and of rotation in radians"
_NO_START = "None beside prefer or solutions, for which all starts settle"
_AXES = get_args(Axis)
_NO_TURN: Floats = np.zeros((3, 3))
_SINGLE = float(np.finfo(np.float32).eps)


@dataclass(frozen=True, eq=False)
class HingeState:
    """Postures of a batch of arms, and how fast they change."""

    joint_angles: Floats  #: radians, (..., n)
    joint_velocities: Floats  #: radians per iteration, (..., n)


@dataclass(frozen=True, eq=False)
class HingeClamps:
    """Parts of an arm held at given places, made by `HingeNetwork.clamp`."""

    tasks: Records  #: the limits and places, an array (...) of `records.task_type`
    hold: Hold  #: which nodes, and what else


@dataclass(frozen=True, eq=False)
class HingeSolution:
    """Where a network has settled; `...` are the batch axes of the task."""

    joint_angles: Floats  #: (..., n), within the limits
    position_error: Floats  #: largest distance of a held node, the hand too, from its place, m
    rotation_error: Floats  #: angle between the hand's rotation and the wanted one, radians
    iterations: NDArray[np.int64]  #: iterations until it settled, those of all starts
    is_solved: NDArray[np.bool_]  #: whether both errors are within the tolerance

    def __str__(self) -> str:
        """Return in one line how many tasks are solved, and by how much the worst one misses."""
        errors = self.position_error, self.rotation_error
        far, turn = (np.nanmax(error, initial=0.0) for error in errors)
        count = f"{np.sum(self.is_solved)} of {np.size(self.is_solved)} solved"
        return f"{count}; the worst misses by {1e3 * far:.3g} mm and {turn:.3g} rad"


@spelt
@dataclass(frozen=True, eq=False)
class HingeNetwork:
    """Description of an MMC network for an arm of hinges; it holds no state.

    It takes the extra `fast`: numba compiles it, in some seconds for each number of joints and
    nodes.

    >>> network = HingeNetwork(HingeArm.named("panda"))
    >>> solution = network.solve(position=[0.4, 0.2, 0.5], held={"panda_joint4": -1.8})
    >>> solution.is_solved.item(), solution.joint_angles[3].item()
    (True, -1.8)
    >>> network.arm.forward(solution.joint_angles)[:3, 3].round(2).tolist()
    [0.4, 0.2, 0.5]
    >>> print(network.solve(position=[0.4, 0.2, 1.5]))
    0 of 1 solved; the worst misses by 392 mm and 0 rad
    """

    arm: HingeArm
    #: d, the weight of the present posture in the mean; more than n / (2 (1 + decay)).  None is a
    #: share of the number of joints that are not held: 0.6 for up to four, otherwise a third, which
    #: is faster; but 0.6, too, in `solve` for starts after the first 16.
    damping: float | None = None
    velocity_decay: float = 0.97  #: factor on the velocity in each iteration, from 0 to below 1
    #: s, length of the vectors that stand for the hand's rotation, shares of the arm's length
    hand_size: float = 0.1

    def __post_init__(self) -> None:
        require(isinstance(self.arm, HingeArm), "arm", self.arm, "a HingeArm")
        decay = self.velocity_decay
        require_number("velocity_decay", decay, "from 0 to below 1", lambda value: 0 <= value < 1)
        least = self.arm.joint_count / (2 * (1 + decay))
        if self.damping is not None:
            accepted = f"finite, and more than n / (2 (1 + velocity_decay)) = {least:g}"
            require_number("damping", self.damping, accepted, lambda d: least < d < np.inf)
        require_positive("hand_size", self.hand_size)
        import mmc_gym.robots.iteration  # noqa: F401  (raises here if numba is missing)

    def state(self, joint_angles: ArrayLike) -> HingeState:
        """Return arms at rest in postures (..., n)."""
        angles = _floats("joint_angles", joint_angles, (self.arm.joint_count,))
        return HingeState(angles, np.zeros_like(angles))

    def clamp(
        self,
        position: ArrayLike | None = None,
        rotation: ArrayLike | None = None,
        held: HeldJoints | None = None,
        points: Mapping[int, ArrayLike] | None = None,
        *,
        pose: ArrayLike | None = None,
        direction: ArrayLike | None = None,
        axis: Axis = "z",
        tool: ArrayLike | None = None,
    ) -> HingeClamps:
        """Hold the hand's position and rotation, joints, and nodes: any task, or a mixture.

        Args:
            position: of the hand, seen from the base, (..., 3).
            rotation: of the hand, a matrix (..., 3, 3), a quaternion (..., 4) in scipy's order x,
                y, z, w, or scipy's `Rotation`.  A matrix must be orthogonal within 1e-3; one that
                is off by more than 1e-6 counts as the nearest rotation.
            held: angles (...) of joints that do not move, within their limits, by index or name of
                the joint; a locked joint, or all of them for the forward task.  One beyond a limit
                by no more than float32 rounds counts as the limit.
            points: positions (..., 3) of nodes by their index, such as the elbow's, see `HingeArm`.
            pose: position and rotation of the hand in one, (..., 4, 4).
            direction: in which an axis of the hand points, (..., 3), of any length; in place of
                `rotation`, it leaves the turn about that axis free.
            axis: of the hand, "x", "y" or "z".
            tool: a point of a tool, seen from the hand, (3,), or its pose, (4, 4).  Position,
                rotation, pose and direction are then those of the tool.
        """
        arm, home, last = self.arm, self.arm.home, self.arm.node_count - 1
        angles = self._held(held) if held else {}
        places = self._places(points) if points else {}
        if pose is not None:
            is_alone = position is None and rotation is None and direction is None
            require(is_alone, "pose", pose, "without position, rotation or direction beside it")
            poses = require_poses("pose", pose)
            place: Floats | None = poses[..., :3, 3]
            rotations: Floats | None = poses[..., :3, :3]
        else:
            place = None if position is None else _floats("position", position, (3,))
            rotations = None if rotation is None else _rotations(rotation)
        require(rotation is None or direction is None, "direction", direction, "without rotation")
        require_choice("axis", axis, _AXES)
        tool_bytes = None if tool is None else _tool_pose(tool).tobytes()
        if tool_bytes is not None:
            home, last = home @ tool_pose(tool_bytes), last + 1
        if place is not None:
            places[last] = place
        turn, column = _NO_TURN, None  # of the whole arm in its zero posture
        if rotations is not None:
            turn = rotations @ (self._home_turn if tool is None else home[:3, :3].T)
        elif direction is not None:
            aim = _floats("direction", direction, (3,))
            length = np.linalg.norm(aim, axis=-1, keepdims=True)
            require(bool((length > 0).all()), "direction", direction, "other than zero")
            column = _AXES.index(axis)
            # The product of this and the turn of a posture has twice the cosine as its trace.
            turn = 2 * (aim / length)[..., :, None] * home[:3, column]
        shapes = [angle.shape for angle in angles.values()]
        shapes += [place.shape[:-1] for place in places.values()]
        shapes.append(turn.shape[:-2])
        free_task = _free_task(arm, last + 1)
        tasks = np.empty(require_batch("clamps", shapes), free_task.dtype)
        tasks[...], tasks["rotation"] = free_task, turn
        for joint, angle in angles.items():
            tasks["low"][..., joint] = tasks["high"][..., joint] = angle
        for node, place in places.items():
            tasks["place"][..., node, :] = place
        has_rotation = rotations is not None or direction is not None
        free = max(1, arm.joint_count - len(angles))
        return HingeClamps(tasks, Hold(tuple(places), has_rotation, column, tool_bytes, free))

    def _held(self, held: HeldJoints) -> dict[int, Floats]:
        """Return the angles of held joints by index, within their limits."""
        accepted = "a mapping of joints, by index or name, to angles"
        require(isinstance(held, Mapping), "held", held, accepted)
        arm, angles = self.arm, dict[int, Floats]()
        for key, value in held.items():
            joint, angle = arm.joint_index(key), _floats("held", value, ())
            require(joint not in angles, "held", list(held), "of different joints")
            (low, high), name = arm.limits[joint], arm.joint_names[joint]
            angles[joint] = angle.clip(low, high)
            most = _SINGLE * np.maximum(1.0, np.abs(angles[joint]))
            if (np.abs(angle - angles[joint]) > most).any():
                movers = zip(arm.axis_joints, arm.is_slide)
                units = {"m" if slides else "rad" for mover, slides in movers if mover == joint}
                accepted = f"{low:.6g} to {high:.6g} {' or '.join(sorted(units))}"
                require(False, "held", angle.tolist(), f"within the limits of {name!r}, {accepted}")
        return angles

    def _places(self, points: Mapping[int, ArrayLike]) -> dict[int, Floats]:
        """Return the places of held nodes by index."""
        accepted = "a mapping of nodes, by index, to positions"
        require(isinstance(points, Mapping), "points", points, accepted)
        nodes = range(1, self.arm.node_count)
        for node in points:
            if node not in nodes:
                raise unknown("node", node, nodes)
        return {node: _floats("points", point, (3,)) for node, point in points.items()}

    def run(self, state: HingeState, clamps: HingeClamps, iterations: int = 1) -> HingeState:
        """Return the state after `iterations` iterations; `state` itself stays as it is.

        Batch axes of state and clamps are broadcast against each other.
        """
        require_whole("iterations", iterations, least=0)
        batch = require_batch("state", [state.joint_angles.shape[:-1], clamps.tasks.shape])
        tries = self._tries(np.broadcast_to(clamps.tasks, batch))
        tries["angle"], tries["velocity"] = state.joint_angles, state.joint_velocities
        pace = self._pace(clamps.hold, iterations)
        race = Race(pace, pace, pace, pace, pace, self.velocity_decay)
        course = course_of(self.arm, clamps.hold, race)
        _compiled().settle_tries(tries.reshape(-1), course, course["near"])
        return HingeState(tries["angle"].copy(), tries["velocity"].copy())

    def solve(  # noqa: D417  (`clamp` describes the others)
        self,
        position: ArrayLike | None = None,
        rotation: ArrayLike | None = None,
        start: ArrayLike | None = None,
        held: HeldJoints | None = None,
        points: Mapping[int, ArrayLike] | None = None,
        starts: int = 2 * POOL,
        tolerance: tuple[float, float] = (1e-3, 1e-2),
        seed: int = 0,
        iterations: int = 150,
        *,
        pose: ArrayLike | None = None,
        direction: ArrayLike | None = None,
        axis: Axis = "z",
        tool: ArrayLike | None = None,
        prefer: ArrayLike | None = None,
        solutions: int | None = None,
    ) -> HingeSolution:
        """Return where the network settles, from many starts.

        The starts are postures drawn within the limits, those nearest to the task first; after 128
        come some near the limits.  The first to settle wins.  Where none does, the best is
        returned: places, the hand's too, as near as can be, and its rotation as near as they leave
        it.

        A start that comes within 8 cm and 0.4 rad ends with at most 16 damped steps of Newton's
        method; a single one (`starts` = 1) does if it was near, or for tolerances below 1 mm or
        0.01 rad.

        Args:
            position: see `clamp`, as all that is not here.
            start: postures (..., n) to begin with.  Other starts win only where nothing settles
                from there in 80 iterations, or in all `iterations` where the start is near: it
                misses by less than 0.3 of the arm.  Of four others the nearest to it wins.  Joints
                never turn by a whole turn more than limits require: seen from `start`, or without
                one from the middle of their limits, which is 0 without limits.
            starts: at most so many, `start` among them.  Those that get no nearer end early.
            tolerance: of position, m, and of rotation, radians: two numbers.
            seed: of the starts.
            iterations: of each start at most.
            prefer: postures (..., n).  All starts settle, and of the solutions the nearest to it
                wins, each hinge by its nearest whole turn; a metre of a slide counts as a radian.
            solutions: so many are returned, on an axis after those of the batch, the nearest to
                `prefer` or to the middle of the limits first.  All starts settle.  They differ by
                0.1 rad in some joint, or 0.1 m of a slide; where there are fewer, the rest is nan
                and not solved.
        """
        clamps = self.clamp(
            position, rotation, held, points, pose=pose, direction=direction, axis=axis, tool=tool
        )
        require_whole("starts", starts)
        require_whole("iterations", iterations)
        require_whole("seed", seed, least=0, most=np.inf)
        far, turn = require_numbers("tolerance", tolerance, _TOLERANCES, _are_tolerances)
        require(start is None or (prefer is None and solutions is None), "start", start, _NO_START)
        tasks, near, batch = clamps.tasks, self._middle, clamps.tasks.shape
        n, has_start = len(near), start is not None
        if has_start or prefer is not None:
            name, reference = ("start", start) if has_start else ("prefer", prefer)
            near = np.array(require_floats(name, reference, (n,)), np.float64)
            batch = require_batch(name, [tasks.shape, near.shape[:-1]])
            if not tasks.shape == near.shape[:-1] == batch:
                near = np.broadcast_to(near, (*batch, n)).copy()
                tasks = np.broadcast_to(tasks, batch).copy()
        if not (clamps.hold.nodes or clamps.hold.has_rotation or held):
            accepted = "a position, a rotation, a pose, a direction, points or held"
            raise UserError(f"solve must be given a task: {accepted}")
        count = 1 if solutions is None else require_whole("solutions", solutions, most=starts)
        course, kind = _course(self, clamps.hold, far, turn, iterations, starts)
        pool = _pool(self.arm, -(-starts // POOL), seed)
        tasks, near = tasks.ravel(), near.reshape(-1, n)
        ends = np.empty((len(tasks), count), end_type(n))
        if prefer is not None or solutions is not None:
            angles, near = pool["angle"].reshape(-1, n), np.broadcast_to(near, (len(tasks), n))
            for row, task in enumerate(tasks):
                tries = self._tries(np.broadcast_to(task, starts))
                tries["angle"], tries["start"] = angles[:starts], near[row]
                tries["angle"][0] = near[row]
                ends[row] = _nearest(tries, course, count)
        else:
            _compiled().solve_tasks(tasks, near, has_start, pool, ends[:, 0], kind, course)
        ends = ends.reshape(batch if solutions is None else (*batch, count))
        reached = ends["angle"], ends["far"], ends["turn"]
        return HingeSolution(*reached, ends["iterations"], ends["is_solved"])

    def _tries(self, tasks: Records) -> Records:
        """Return tries at rest for tasks (...)."""
        kind = try_type(self.arm.joint_count, tasks.dtype["place"].shape[0], len(self.arm.axes))
        tries = np.zeros(tasks.shape, kind)
        for name in tasks.dtype.names or ():
            tries[name] = tasks[name]
        return tries

    def _pace(self, hold: Hold, iterations: int) -> Pace:
        """Return the pace of `run` and of the first starts."""
        free_joints = hold.free_joints
        is_calm = self.damping or free_joints <= FEW
        share = self._calm_share(free_joints) if is_calm else 3 / free_joints
        weight = 2 * (self.hand_size * self._length) ** 2 if hold.has_rotation else 0.0
        return Pace(share, weight, iterations, newton_steps=0, stalled=np.inf)

    def _calm_share(self, free_joints: int) -> float:
        """Return 1/d for starts after the first ones have failed."""
        return 1 / (self.damping or CALM * free_joints)

    @cached_property
    def _length(self) -> float:
        """Return the length of the arm, m: of its segments and of the strokes of its slides."""
        arm = self.arm
        nodes, slides = arm.nodes(np.zeros(arm.joint_count)), np.array(arm.is_slide)
        segments = np.linalg.norm(np.diff(nodes, axis=0), axis=1)
        farthest = np.abs(arm.limits).max(axis=1)[np.array(arm.axis_joints)[slides]]
        strokes = np.abs(np.array(arm.ratios)[slides] * farthest)
        return float(segments.sum() + strokes.sum()) or 1.0

    @cached_property
    def _home_turn(self) -> Floats:
        """Return the inverse rotation of the hand in the zero posture; contiguous, for speed."""
        return self.arm.home[:3, :3].T.copy()

    @cached_property
    def _middle(self) -> Floats:
        """Return the middle of each joint's range, 0 where it has none, (n,)."""
        has_both = np.isfinite(self.arm.limits).all(axis=1, keepdims=True)
        middle: Floats = np.where(has_both, self.arm.limits, 0.0).mean(axis=1)
        return middle


@cache
def _compiled() -> ModuleType:
    from mmc_gym.robots import iteration

    return iteration


@lru_cache(maxsize=16)
def _course(
    network: HingeNetwork, hold: Hold, far: float, turn: float, iterations: int, starts: int
) -> tuple[Records, Records]:
    """Return what the tries of a solve share, see `course_of`, and an empty array of tries."""
    length = network._length
    exact = max(EXACT[0], EXACT_SHARE * length), EXACT[1]
    early = EARLY if starts > 1 else (1, 1)
    loose = max(far, early[0] * exact[0]), max(turn, early[1] * exact[1])
    plain = network._pace(hold, iterations)
    near = plain._replace(newton_steps=NEWTON_STEPS)
    few = min(iterations, QUICK_ITERATIONS)
    quick = near._replace(iterations=few, stalled=STALLED)
    # Those that are left are hard, such as postures with all joints at limits.
    last = plain._replace(share=network._calm_share(hold.free_joints))
    calm = last._replace(newton_steps=NEWTON_STEPS, stalled=STALLED)
    # So little weight of the rotation costs a share of the tolerance of places at most.
    weight = min(PLACE_FIRST * far * length, plain.weight)
    has_both = hold.has_rotation and bool(hold.nodes)
    if has_both:
        last = Pace(0.0, weight, iterations=0, newton_steps=PLACE_STEPS, stalled=np.inf)
    elif starts == 1:
        last = last._replace(iterations=0)
    if starts == 1:  # such as that of an agent's step: it has all iterations
        quick = near if far < exact[0] or turn < exact[1] else plain
    race = Race(
        *(near, quick, calm, quick._replace(weight=0.0), last),
        *(network.velocity_decay, far, turn, *loose),
        ridge=(RIDGE * far) ** 2,
        near_start=(NEAR_START * length) ** 2,
        quick_tries=QUICK_TRIES,
        starts=starts,
        has_both=has_both,
    )
    course = course_of(network.arm, hold, race)
    nodes = course["nodes"].shape[1]
    return course, np.empty(0, try_type(network.arm.joint_count, nodes, len(network.arm.axes)))


@lru_cache(maxsize=16)
def _free_task(arm: HingeArm, nodes: int) -> Records:
    """Return a task that holds nothing, an array () with the limits."""
    task = np.zeros((), task_type(arm.joint_count, nodes))
    task["low"], task["high"] = arm.limits.T
    return task


@lru_cache(maxsize=16)
def _pool(arm: HingeArm, rows: int, seed: int) -> Records:
    """Return postures within the limits, (rows, POOL); those of the second row are near limits."""
    random, n = np.random.default_rng([seed, POOL, 77]), arm.joint_count  # not as users draw
    low, high = arm.limits.T
    low = np.where(np.isinf(low), np.minimum(-np.pi, high - 2 * np.pi), low)
    high = np.where(np.isinf(high), np.maximum(np.pi, low + 2 * np.pi), high)
    angles = random.uniform(low, high, (rows, POOL, n))
    # Seven joints have all 128 combinations of their limits.
    is_high = random.integers(2, size=(POOL, n))
    is_high[:, :7] = np.arange(POOL)[:, None] >> np.arange(min(n, 7)) & 1
    limit = np.where(is_high, high, low)
    angles[1:2] = limit + NEAR_LIMITS * (angles[1:2] - limit)
    pool = np.empty((rows, POOL), posture_type(n, arm.node_count))
    pool["angle"], (pool["node"], _, _, hand) = angles, arm.frames(angles)
    pool["moved"] = hand[..., :3, :3] @ arm.home[:3, :3].T
    pool["shift"] = hand[..., :3, 3] - pool["moved"] @ arm.home[:3, 3]
    return pool


def _nearest(tries: Records, course: Records, count: int) -> Records:
    """Let all tries of a task settle; return those that differ, nearest to its start, (count,)."""
    _compiled().settle_tries(tries, course, course["calm"])
    kind = end_type(tries["angle"].shape[1])
    nearest = np.zeros(count, kind)
    for name in ("angle", "far", "turn"):
        nearest[name] = np.nan
    tries = tries[np.argsort(tries["rank"], kind="stable")]
    if tries["rank"][0] >= 0:
        _compiled().settle_tries(tries[:1], course, course["last"])
    ends = tries[list(kind.names or ())]
    nearest[0], size = ends[0], 1
    for end in ends[ends["rank"] < 0]:
        if size == count:
            break
        gap = np.abs(nearest["angle"][:size] - end["angle"])
        turned = np.minimum(gap, np.abs(gap - 2 * np.pi))
        if np.where(course["has_turns"][0], turned, gap).max(axis=1).min() > DISTINCT:
            nearest[size] = end
            size += 1
    return nearest


def _are_tolerances(bounds: tuple[float, ...]) -> bool:
    return len(bounds) == 2 and 0 < bounds[0] < np.inf and 0 < bounds[1] < np.inf


def _tool_pose(tool: ArrayLike) -> Floats:
    """Return the pose of a tool, (4, 4), that is given as such or as a point, (3,)."""
    value = require_array("tool", tool)
    if value.shape == (4, 4):
        return require_poses("tool", value)
    require(value.shape == (3,), "tool", value.shape, "of shape (3,) or (4, 4)")
    pose = np.eye(4)
    pose[:3, 3] = _floats("tool", value, (3,))
    return pose


def _rotations(rotation: Any) -> Floats:
    """Return rotations (..., 3, 3) that are given as such, as quaternions or as scipy's."""
    matrix = rotation.as_matrix() if hasattr(rotation, "as_matrix") else rotation
    value = require_array("rotation", matrix)
    if value.shape[-2:] == (3, 3):
        return nearest_rotations("rotation", value)
    is_pose = value.shape[-2:] == (4, 4) and bool((value[..., 3, :] == (0, 0, 0, 1)).all())
    if value.shape[-1:] == (4,) and not is_pose:
        quaternions = _floats("rotation", value, (4,))
        length = np.linalg.norm(quaternions, axis=-1, keepdims=True)
        is_unit = bool((np.abs(length - 1) <= 1e-3).all())
        require(is_unit, "rotation", rotation, "a quaternion x, y, z, w of length 1 within 0.001")
        quaternions /= length
        cross = np.cross(np.eye(3), quaternions[..., None, :3])  # cross @ x = (x, y, z) × x
        return np.eye(3) + 2 * quaternions[..., 3:, None] * cross + 2 * cross @ cross
    return _floats("rotation", value, (3, 3))  # raises


def _floats(name: str, value: ArrayLike, trailing: tuple[int, ...]) -> Floats:
    """Return a copy in float64 of a finite array whose last axes are `trailing`."""
    return require_floats(name, value, trailing).astype(np.float64, copy=False)
