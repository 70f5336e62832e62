"""What the network of hinges hands to its compiled iterations."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmc_gym.geometry import Floats
from mmc_gym.robots.arm import HingeArm


class ZeroPosture(NamedTuple):
    """A `HingeArm` in its zero posture: nodes, a tool's point too, and axes with their joints."""

    axes: Floats  #: (a, 3)
    points: Floats  #: (a, 3)
    nodes: Floats  #: (N + 1, 3)
    joint_nodes: NDArray[np.int64]  #: the node of each axis, (a,)
    joints: NDArray[np.int64]  #: the joint that moves each axis, (a,)
    turns: Floats  #: by how much a displacement of its joint turns each axis, 0 of a slide, (a,)
    slides: Floats  #: how far it slides along the axis, 0 of a hinge, (a,)
    has_turns: Floats  #: 1 where a whole turn of a joint changes nothing, otherwise 0, (n,)

    @classmethod
    def of(cls, arm: HingeArm) -> ZeroPosture:
        """Return that of an arm."""
        nodes = arm.nodes(np.zeros(arm.joint_count))
        joints, ratios, is_slide = map(np.array, (arm.axis_joints, arm.ratios, arm.is_slide))
        has_turns = np.ones(arm.joint_count)
        has_turns[joints[is_slide | (ratios % 1 != 0)]] = 0.0
        return cls(
            axes=arm.axes,
            points=arm.points,
            nodes=nodes,
            joint_nodes=np.array(arm.joint_nodes),
            joints=joints,
            turns=np.where(is_slide, 0.0, ratios),
            slides=np.where(is_slide, ratios, 0.0),
            has_turns=has_turns,
        )


class Tolerance(NamedTuple):
    """When a try is near; all 0 where iterations shall not stop."""

    far: float  #: from held nodes, m
    turn: float  #: of the hand's rotation, radians
    loose_far: float  #: the same two, at which iterations stop
    loose_turn: float
    ridge: float  #: least damping of Newton's method, m²


class Course(NamedTuple):
    """What is held, and when it is reached: after `decay` the fields of `Tolerance`."""

    is_placed: NDArray[np.bool_]  #: whether each node is held, (N + 1,)
    axis: Floats  #: of the hand in the zero posture that is held in a direction, or zeros, (3,)
    decay: float  #: factor on the velocity
    far: float
    turn: float
    loose_far: float
    loose_turn: float
    ridge: float


class Pace(NamedTuple):
    """How a try goes on."""

    share: float  #: 1/d
    weight: float  #: 2 s² where the hand's rotation or a direction of it is held, otherwise 0
    iterations: int  #: at most
    newton_steps: int  #: steps of Newton's method that follow
    stalled: float  #: share of what it lacks that ten iterations leave of a try that ends there


class Race(NamedTuple):
    """How `HingeNetwork.solve` tries one start after the other."""

    near: Pace  #: of a given start that lacks less than `near_start`
    quick: Pace  #: of the next ones
    calm: Pace  #: of those that follow
    last: Pace  #: of the nearest end, where none has settled
    near_start: float  #: m²
    quick_tries: int
    starts: int  #: at most
    has_both: bool  #: whether places and rotation are held


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
    """Return the type of a record of where a try ended; `rank` is negative if it has settled."""
    numbers = [(name, np.float64) for name in ("far", "turn", "rank")]
    return np.dtype([("angle", np.float64, (joints,)), *numbers, ("iterations", np.int64)])


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
