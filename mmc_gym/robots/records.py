"""What the network of hinges hands to its compiled iterations."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple, TypeAlias, get_type_hints

import numpy as np
from numpy.typing import NDArray

from mmc_gym.geometry import Floats
from mmc_gym.robots.arm import HingeArm

Records: TypeAlias = NDArray[np.void]


class Hold(NamedTuple):
    """Which parts of an arm a task holds; not where, so that tasks of a kind share a course."""

    nodes: tuple[int, ...]  #: held nodes, the hand or the tool among them
    has_rotation: bool  #: whether the hand's rotation, or a direction of it, is held
    axis: int | None  #: the axis of the hand that is held in a direction
    tool: bytes | None  #: pose of the tool, (4, 4), as bytes
    free_joints: int  #: number of joints that are not held


def tool_pose(tool: bytes) -> Floats:
    """Return the pose of a tool that a `Hold` has, (4, 4)."""
    return np.frombuffer(tool).reshape(4, 4)


class Pace(NamedTuple):
    """How a try goes on."""

    share: float  #: 1/d
    weight: float  #: 2 s² where the hand's rotation or a direction of it is held, otherwise 0
    iterations: int  #: at most
    newton_steps: int  #: steps of Newton's method that follow, at most
    stalled: float  #: share of what it lacks that ten iterations leave of a try that ends there


class Race(NamedTuple):
    """How `HingeNetwork.solve` tries one start after the other, and when a try is near."""

    near: Pace  #: of a given start that lacks less than `near_start`; the pace of `run`
    quick: Pace  #: of the next ones
    calm: Pace  #: of those that follow
    place: Pace  #: of more starts, for the place alone, where all tries miss it
    last: Pace  #: of the nearest end, where none has settled
    decay: float  #: factor on the velocity
    far: float = 0.0  #: tolerance of held nodes, m; all are 0 where iterations shall not stop
    turn: float = 0.0  #: tolerance of the hand's rotation, radians
    loose_far: float = 0.0  #: the same two, at which iterations stop
    loose_turn: float = 0.0
    ridge: float = 0.0  #: least damping of Newton's method, m²
    near_start: float = 0.0  #: m²
    quick_tries: int = 0
    starts: int = 0  #: at most
    has_both: bool = False  #: whether places and rotation are held


def course_of(arm: HingeArm, hold: Hold, race: Race) -> Records:
    """Return what all tries of a solve share, an array (1,) of `course_type`."""
    nodes = arm.nodes(np.zeros(arm.joint_count))
    home = arm.home
    if hold.tool is not None:
        home = home @ tool_pose(hold.tool)
        nodes = np.vstack([nodes, home[:3, 3]])
    joints, ratios, is_slide = map(np.array, (arm.axis_joints, arm.ratios, arm.is_slide))
    course = np.zeros(1, course_type(arm.joint_count, len(nodes), len(arm.axes)))
    course["axes"], course["points"], course["nodes"] = arm.axes, arm.points, nodes
    course["joint_nodes"], course["joints"] = arm.joint_nodes, joints
    course["turns"] = np.where(is_slide, 0.0, ratios)
    course["slides"] = np.where(is_slide, ratios, 0.0)
    course["has_turns"] = 1.0
    course["has_turns"][:, joints[is_slide | (ratios % 1 != 0)]] = 0.0
    course["is_placed"][:, list(hold.nodes)] = 1
    if hold.axis is not None:
        course["axis"] = home[:3, hold.axis]
    for name, value in race._asdict().items():
        course[name] = value
    return course


@lru_cache
def course_type(joints: int, nodes: int, axes: int) -> np.dtype[np.void]:
    """Return the type of what all tries share: an arm, what is held, and a `Race`.

    The arm is that of the zero posture, with the point of a tool as last node.  An axis belongs to
    the node `joint_nodes`; a displacement of the joint `joints` turns it by `turns`, or makes it
    slide by `slides`.  `has_turns` is 1 where a whole turn of a joint changes nothing, otherwise 0.
    `is_placed` is 1 for held nodes, and `axis` that of the hand that is held in a direction, or 0.
    """
    shapes = {"axes": (axes, 3), "points": (axes, 3), "nodes": (nodes, 3), "axis": (3,)}
    shapes |= {"turns": (axes,), "slides": (axes,), "has_turns": (joints,)}
    numbers = [(name, np.float64, shape) for name, shape in shapes.items()]
    whole = [(name, np.int64, (axes,)) for name in ("joint_nodes", "joints")]
    placed = ("is_placed", np.uint8, (nodes,))  # numba knows no bools in arrays of a record
    return np.dtype([*numbers, *whole, placed, *_fields(Race)])


def _fields(kind: type) -> list[Any]:
    """Return the fields of a record that has those of a `Pace` or a `Race`."""
    parts = get_type_hints(kind).items()
    return [(name, _fields(part) if part is Pace else part) for name, part in parts]


@lru_cache
def posture_type(joints: int, nodes: int) -> np.dtype[np.void]:
    """Return the type of a posture of the pool; a point x has moved to `moved` x + `shift`."""
    shapes = {"angle": (joints,), "node": (nodes, 3), "moved": (3, 3), "shift": (3,)}
    return np.dtype([(name, np.float64, shape) for name, shape in shapes.items()])


@lru_cache
def task_type(joints: int, nodes: int) -> np.dtype[np.void]:
    """Return the type of a task: limits, places of held nodes, rotation as a turn of the arm."""
    shapes = {"low": (joints,), "high": (joints,), "place": (nodes, 3), "rotation": (3, 3)}
    return np.dtype([(name, np.float64, shape) for name, shape in shapes.items()])


@lru_cache
def end_type(joints: int) -> np.dtype[np.void]:
    """Return the type of a record of where a try ended; `rank` is negative if it is solved."""
    numbers = [(name, np.float64) for name in ("far", "turn", "rank")]
    whole = [("iterations", np.int64), ("is_solved", np.bool_)]
    return np.dtype([("angle", np.float64, (joints,)), *numbers, *whole])


@lru_cache
def try_type(joints: int, nodes: int, axes: int) -> np.dtype[np.void]:
    """Return the type of a try: a task, its end, and arrays that `iteration` names."""
    shapes: dict[str, tuple[int, ...]] = dict.fromkeys(("miss", "merit", "sine", "cosine"), ())
    shapes |= dict.fromkeys(("velocity", "pull", "leverage", "free", "start"), (joints,))
    shapes |= {"node": (nodes, 3), "gap": (nodes, 3), "axis": (axes, 3), "heading": (3,)}
    shapes |= {"row": (joints, joints + 1), "moved": (3, 3), "shift": (3,), "spin": (3,)}
    arrays = [(name, np.float64, shape) for name, shape in shapes.items()]
    parts = (task_type(joints, nodes), end_type(joints))
    return np.dtype([*(field for part in parts for field in part.descr), *arrays])
