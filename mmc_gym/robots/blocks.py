"""What the network of hinges hands to its compiled iterations."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmc_gym.geometry import Floats
from mmc_gym.robots.arm import HingeArm

LANES = 16  # postures in a block


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


class Course(NamedTuple):
    """How blocks iterate: what is held, the mean, and when they stop."""

    is_placed: NDArray[np.bool_]  #: whether each node is held, (N + 1,)
    axis: Floats  #: of the hand in the zero posture that is held in a direction, or zeros, (3,)
    weight: float  #: 2 s² where the hand's rotation or a direction of it is held, otherwise 0
    share: float  #: 1/d
    decay: float  #: factor on the velocity
    iterations: int  #: at most
    far: float = 0.0  #: tolerance of held nodes, m; 0 where iterations shall not stop
    turn: float = 0.0  #: tolerance of the hand's rotation, radians
    alone: int = 0  #: iterations in which a block stops only when its first posture has settled
    near: float = 0.0  #: a first posture that lacks less, m², has all iterations alone
    turns_back: bool = False  #: whether joints turn by whole turns, as near to `start` as can be
    takes_all: bool = False  #: whether blocks stop only when all of their postures have settled
    newton_steps: int = 0  #: steps of Newton's method that follow then
    is_exact: bool = False  #: whether they follow in all blocks
    ridge: float = 0.0  #: their least damping, m²


@lru_cache
def task_type(joints: int, nodes: int) -> np.dtype[np.void]:
    """Return the type of a task: limits, places of held nodes, rotation as a turn of the arm."""
    shapes = {"low": (joints,), "high": (joints,), "place": (nodes, 3), "rotation": (3, 3)}
    return np.dtype([(name, np.float64, shape) for name, shape in shapes.items()])


@lru_cache
def block_type(joints: int, nodes: int, axes: int) -> np.dtype[np.void]:
    """Return the type of a block: a task, and arrays of its lanes that `iteration` names."""
    task = task_type(joints, nodes)
    shapes: dict[str, tuple[int, ...]] = {name: task[name].shape for name in task.names or ()}
    shapes |= dict.fromkeys(("sine", "cosine", "miss", "merit", "memory", "settled", "away"), ())
    shapes |= dict.fromkeys(("angle", "velocity", "pull", "leverage", "free", "start"), (joints,))
    shapes |= {"node": (nodes, 3), "gap": (nodes, 3), "axis": (axes, 3)}
    shapes |= {"row": (joints, joints + 1), "turn": (3, 3)}
    shapes |= dict.fromkeys(("shift", "spin", "heading"), (3,))
    kinds = [(name, np.float64, (*shape, LANES)) for name, shape in shapes.items()]
    return np.dtype([*kinds, ("iterations", np.int64), ("alone", np.int64)])
