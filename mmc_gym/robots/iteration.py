"""Iterations of the network of hinges, in numpy and compiled by numba from the same functions.

`network` has the equations.  A block is a task and a number of postures side by side in
lanes.  All functions but `relax` act on lanes one by one: `k` is the index of a lane where numba
compiles them, and all lanes of all blocks at once in numpy.  So both do the same operations.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from types import FunctionType, SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmc_gym.geometry import Floats

LANES = 16  # postures in a block
_HELD = 1e12  # damping of a joint that rests
_EVERY = (slice(None),)  # lanes of numpy


class Arm(NamedTuple):
    """A `HingeArm` in its zero posture: its nodes, and the node of each hinge."""

    axes: Floats
    points: Floats
    nodes: Floats
    joint_nodes: NDArray[np.int64]


class Plan(NamedTuple):
    """Which parts are held, and for how long to iterate."""

    is_placed: NDArray[np.bool_]  #: whether each node is held, (N + 1,)
    weight: float  #: 2 s² where the hand's rotation is held, otherwise 0
    share: float  #: 1/d
    calm: float  #: 1/d once the first starts have failed
    decay: float  #: factor on the velocity
    times: int = 0  #: iterations at most
    far: float = 0.0  #: tolerance of held nodes, m; 0 where iterations shall not stop
    turn: float = 0.0  #: tolerance of the hand's rotation, radians
    alone: int = 0  #: iterations in which a block stops only when its first posture has settled
    near: float = 0.0  #: a first posture that lacks less, m², has all iterations alone
    newton: int = 0  #: steps of Newton's method that follow then
    is_exact: bool = False  #: whether they follow in all blocks
    ridge: float = 0.0  #: their least damping, m²


@lru_cache
def task_type(joints: int, nodes: int) -> np.dtype[Any]:
    """Return the type of a task: limits, places of held nodes, rotation as a turn of the arm."""
    shapes = {"low": (joints,), "high": (joints,), "place": (nodes, 3), "wanted": (3, 3)}
    return np.dtype([(name, np.float64, shape) for name, shape in shapes.items()])


@lru_cache
def block_type(joints: int, nodes: int) -> np.dtype[Any]:
    """Return the type of blocks for `relax`; the shapes of their arrays are part of it."""
    task = task_type(joints, nodes)
    shapes: dict[str, tuple[int, ...]] = {name: task[name].shape for name in task.names or ()}
    shapes |= dict.fromkeys(("sine", "cosine", "miss", "merit", "memory", "settled"), ())
    shapes |= dict.fromkeys(("angle", "speed", "asked", "size"), (joints,))
    shapes |= {"node": (nodes, 3), "gap": (nodes, 3), "axis": (joints, 3)}
    shapes |= {"row": (joints, joints + 1), "free": (joints,)}
    shapes |= {"turn": (3, 3), "shift": (3,), "spin": (3,)}
    kinds = [(name, np.float64, (*shape, LANES)) for name, shape in shapes.items()]
    return np.dtype([*kinds, ("iterations", np.int64), ("alone", np.int64)])


def relax(blocks: NDArray[Any], arm: Arm, plan: Plan) -> None:
    """Iterate each block, in place, until it settles: in numpy, all blocks at once."""
    begin(_all_at_once(blocks), arm, _EVERY)
    rows, active = np.arange(len(blocks)), blocks
    for time in range(plan.times + 1):
        block = _all_at_once(active)
        look(block, arm, plan, _EVERY)
        active["iterations"] = time
        if time == 0:
            is_near = block.merit[:, 0] < plan.near
            active["alone"] = np.where(is_near, plan.times, plan.alone)
        is_alone = time < active["alone"]
        settled = np.where(is_alone, block.settled[:, 0], block.settled.max(axis=1))
        is_done = (settled > 0) | (time == plan.times)
        if is_done.any():
            blocks[rows[is_done]] = active[is_done]
            rows, active = rows[~is_done], active[~is_done]
            if not len(rows):
                break
            block = _all_at_once(active)
        move(block, arm, plan, _EVERY)
    rows = np.flatnonzero(plan.is_exact | (blocks["alone"] == plan.times))
    active = blocks[rows]
    block = _all_at_once(active)
    for _ in range(plan.newton):
        newton(block, arm, plan, _EVERY)
        look(block, arm, plan, _EVERY)
    blocks[rows] = active


def _all_at_once(blocks: NDArray[Any]) -> SimpleNamespace:
    """Return the arrays of all blocks, with blocks and lanes on the last axes, as views."""
    kinds = blocks.dtype
    names = [name for name in kinds.names or () if kinds[name].shape]
    return SimpleNamespace(**{name: np.moveaxis(blocks[name], 0, -2) for name in names})


def relax_compiled(blocks: Any, arm: Any, plan: Any) -> None:
    """Do what `relax` does, block by block; for numba."""
    lanes = range(LANES)
    for b in range(blocks.shape[0]):
        block = blocks[b]
        begin(block, arm, lanes)
        for time in range(plan.times + 1):
            look(block, arm, plan, lanes)
            block.iterations = time
            if time == 0:
                block.alone = plan.times if block.merit[0] < plan.near else plan.alone
            settled = block.settled[0]
            if time >= block.alone:
                for k in lanes:
                    settled = max(settled, block.settled[k])
            if settled > 0.0 or time == plan.times:
                break
            move(block, arm, plan, lanes)
        if plan.is_exact or block.alone == plan.times:
            for _ in range(plan.newton):
                newton(block, arm, plan, lanes)
                look(block, arm, plan, lanes)


@lru_cache
def compiled_relax() -> Callable[[NDArray[Any], Arm, Plan], None]:
    """Return `relax`, compiled."""
    from mmc_gym._compiling import compiled, inner

    names = dict(globals())
    for one in (begin, sine_and_cosine, place_node, lever, look, stretch, ask, move, newton):
        names[one.__name__] = inner(FunctionType(one.__code__, names, one.__name__))
    return compiled(FunctionType(relax_compiled.__code__, names, "relax_compiled"))


def begin(block: Any, arm: Any, lanes: Any) -> None:
    """Bring postures within the limits."""
    for i in range(arm.axes.shape[0]):
        for k in lanes:
            block.free[i, k] = 1.0 * (block.low[i, k] < block.high[i, k])
            angle = np.maximum(block.angle[i, k], block.low[i, k])
            block.angle[i, k] = np.minimum(angle, block.high[i, k])


def sine_and_cosine(angle: Any) -> tuple[Any, Any]:
    """Return both by their series, to 1e-13, after a reduction to a quarter turn."""
    quarter = np.floor(angle * (2 / np.pi) + 0.5)
    x = angle - quarter * (np.pi / 2)
    y = x * x
    s = 1 / 120 + y * (-1 / 5040 + y * (1 / 362880 + y * (-1 / 39916800 + y / 6227020800)))
    s = x + x * y * (-1 / 6 + y * s)
    c = 1 / 40320 + y * (-1 / 3628800 + y * (1 / 479001600 - y / 87178291200))
    c = 1 + y * (-0.5 + y * (1 / 24 + y * (-1 / 720 + y * c)))
    quarter = quarter - 4 * np.floor(quarter * 0.25)  # 0, 1, 2 or 3
    half = np.floor(quarter * 0.5)
    is_odd = quarter - 2 * half
    sign = 1 - 2 * half
    return sign * (is_odd * c + (1 - is_odd) * s), sign * ((1 - is_odd) * c - is_odd * s)


def place_node(block: Any, home: Any, g: int, lanes: Any) -> None:
    """Move a node of the zero posture along with what carries it."""
    for a in range(3):
        for k in lanes:
            x, y, z = block.turn[a, 0, k], block.turn[a, 1, k], block.turn[a, 2, k]
            moved = x * home[g, 0] + y * home[g, 1] + z * home[g, 2]
            block.node[g, a, k] = moved + block.shift[a, k]


def look(block: Any, arm: Any, plan: Any, lanes: Any) -> None:
    """Find nodes and axes of postures by the product of exponentials, and what they lack."""
    for a in range(3):
        for k in lanes:
            block.shift[a, k] = 0.0
            block.turn[a, 0, k] = 0.0
            block.turn[a, 1, k] = 0.0
            block.turn[a, 2, k] = 0.0
            block.turn[a, a, k] = 1.0
    for i in range(arm.axes.shape[0]):
        if i == 0 or arm.joint_nodes[i] != arm.joint_nodes[i - 1]:
            place_node(block, arm.nodes, arm.joint_nodes[i], lanes)
        ux, uy, uz = arm.axes[i, 0], arm.axes[i, 1], arm.axes[i, 2]
        px, py, pz = arm.points[i, 0], arm.points[i, 1], arm.points[i, 2]
        for k in lanes:
            block.sine[k], block.cosine[k] = sine_and_cosine(block.angle[i, k])
        for a in range(3):
            for k in lanes:  # a row r of the turn becomes r + sin q r×u + (1 − cos q) (u u·r − r)
                x, y, z = block.turn[a, 0, k], block.turn[a, 1, k], block.turn[a, 2, k]
                s, c = block.sine[k], 1.0 - block.cosine[k]
                along = x * ux + y * uy + z * uz
                dx = s * (y * uz - z * uy) + c * (along * ux - x)
                dy = s * (z * ux - x * uz) + c * (along * uy - y)
                dz = s * (x * uy - y * ux) + c * (along * uz - z)
                block.axis[i, a, k] = along
                block.shift[a, k] = block.shift[a, k] - (dx * px + dy * py + dz * pz)
                block.turn[a, 0, k] = x + dx
                block.turn[a, 1, k] = y + dy
                block.turn[a, 2, k] = z + dz
    place_node(block, arm.nodes, arm.nodes.shape[0] - 1, lanes)
    for k in lanes:
        block.miss[k] = 0.0
        block.merit[k] = 0.0
        block.sine[k] = 0.0
        block.cosine[k] = -0.5
    for g in range(1, arm.nodes.shape[0]):
        if plan.is_placed[g]:
            for k in lanes:
                x = block.place[g, 0, k] - block.node[g, 0, k]
                y = block.place[g, 1, k] - block.node[g, 1, k]
                z = block.place[g, 2, k] - block.node[g, 2, k]
                square = x * x + y * y + z * z
                block.gap[g, 0, k] = x
                block.gap[g, 1, k] = y
                block.gap[g, 2, k] = z
                block.miss[k] = np.maximum(block.miss[k], square)
                block.merit[k] = block.merit[k] + square
    for a in range(3):
        c, e = (a + 1) % 3, (a + 2) % 3
        for k in lanes:
            spin, trace = 0.0 * block.miss[k], 0.0 * block.miss[k]
            for f in range(3):
                trace = trace + block.wanted[a, f, k] * block.turn[a, f, k]
                spin = spin + block.wanted[e, f, k] * block.turn[c, f, k]
                spin = spin - block.wanted[c, f, k] * block.turn[e, f, k]
            block.spin[a, k] = 0.5 * spin
            block.sine[k] = block.sine[k] + 0.25 * spin * spin  # squares
            block.cosine[k] = block.cosine[k] + 0.5 * trace
    far, turn = plan.far * plan.far, np.sin(min(plan.turn, np.pi / 2)) ** 2
    for k in lanes:
        block.merit[k] = block.merit[k] + 2.0 * plan.weight * (1.0 - block.cosine[k])
        is_turned = (block.sine[k] < turn) * (block.cosine[k] > 0.0) + (plan.weight == 0.0)
        block.settled[k] = 1.0 * (block.miss[k] < far) * is_turned


def lever(block: Any, i: int, g: int, h: int, k: Any) -> tuple[Any, Any, Any]:
    """Return u_i × v_gh: how fast hinge i, in node g, moves node h."""
    x = block.node[h, 0, k] - block.node[g, 0, k]
    y = block.node[h, 1, k] - block.node[g, 1, k]
    z = block.node[h, 2, k] - block.node[g, 2, k]
    ux, uy, uz = block.axis[i, 0, k], block.axis[i, 1, k], block.axis[i, 2, k]
    return uy * z - uz * y, uz * x - ux * z, ux * y - uy * x


def stretch(block: Any, i: int, g: int, h: int, k: Any) -> Any:
    """Return the product of v_gh and what node h lacks, both across the axis of hinge i."""
    product, along, lack = 0.0, 0.0, 0.0
    for a in range(3):
        v = block.node[h, a, k] - block.node[g, a, k]
        product = product + v * block.gap[h, a, k]
        along = along + v * block.axis[i, a, k]
        lack = lack + block.gap[h, a, k] * block.axis[i, a, k]
    return product - along * lack


def ask(block: Any, arm: Any, plan: Any, lanes: Any) -> None:
    """Find what gaps and spin ask of each hinge, and how far it reaches: α is their quotient."""
    for i in range(arm.axes.shape[0]):
        g = arm.joint_nodes[i]
        for k in lanes:
            turned = block.axis[i, 0, k] * block.spin[0, k] + block.axis[i, 1, k] * block.spin[1, k]
            turned = turned + block.axis[i, 2, k] * block.spin[2, k]
            block.asked[i, k] = plan.weight * turned
            block.size[i, k] = plan.weight + 1e-9
        for h in range(g + 1, arm.nodes.shape[0]):
            if plan.is_placed[h]:
                for k in lanes:
                    x, y, z = lever(block, i, g, h, k)
                    along = x * block.gap[h, 0, k] + y * block.gap[h, 1, k] + z * block.gap[h, 2, k]
                    block.asked[i, k] = block.asked[i, k] + along
                    block.size[i, k] = block.size[i, k] + (x * x + y * y + z * z)
                    block.size[i, k] = block.size[i, k] + np.maximum(
                        stretch(block, i, g, h, k), 0.0
                    )


def move(block: Any, arm: Any, plan: Any, lanes: Any) -> None:
    """Average the hinges' estimates, and move within the limits."""
    joints = arm.axes.shape[0]
    ask(block, arm, plan, lanes)
    for k in lanes:
        block.memory[k] = 0.0
    for i in range(joints):
        for k in lanes:
            block.memory[k] = block.memory[k] + block.asked[i, k] * block.speed[i, k]
    for k in lanes:
        block.memory[k] = plan.decay * (block.memory[k] >= 0.0)
    for i in range(joints):
        for k in lanes:
            step = plan.share * block.asked[i, k] / block.size[i, k]
            step = step + block.memory[k] * block.speed[i, k]
            asked = block.angle[i, k] + step
            angle = np.minimum(np.maximum(asked, block.low[i, k]), block.high[i, k])
            block.speed[i, k] = step * (angle == asked)
            block.angle[i, k] = angle


def newton(block: Any, arm: Any, plan: Any, lanes: Any) -> None:
    """Do a damped step of Newton's method; joints that it brings to a limit rest in the next.

    With e, what is lacking, and the levers J of the hinges it solves (JᵀJ + λ I) Δq = Jᵀe, where
    λ = |e|² or more (Levenberg), by Gauss-Jordan elimination.
    """
    joints = arm.axes.shape[0]
    ask(block, arm, plan, lanes)
    for i in range(joints):
        for j in range(joints):
            for k in lanes:
                block.row[i, j, k] = 0.0
            for a in range(3):
                for k in lanes:
                    along = block.axis[i, a, k] * block.axis[j, a, k]
                    block.row[i, j, k] = block.row[i, j, k] + plan.weight * along
            for h in range(max(arm.joint_nodes[i], arm.joint_nodes[j]) + 1, arm.nodes.shape[0]):
                if plan.is_placed[h]:
                    for k in lanes:
                        x, y, z = lever(block, i, arm.joint_nodes[i], h, k)
                        u, v, w = lever(block, j, arm.joint_nodes[j], h, k)
                        block.row[i, j, k] = block.row[i, j, k] + (x * u + y * v + z * w)
        for k in lanes:
            damping = block.merit[k] + plan.ridge + _HELD * (1.0 - block.free[i, k])
            block.row[i, i, k] = block.row[i, i, k] + damping
            block.row[i, joints, k] = block.asked[i, k] * block.free[i, k]
    for p in range(joints):
        for i in range(joints):
            if i != p:
                for k in lanes:
                    block.memory[k] = block.row[i, p, k] / block.row[p, p, k]
                for j in range(p, joints + 1):
                    for k in lanes:
                        less = block.memory[k] * block.row[p, j, k]
                        block.row[i, j, k] = block.row[i, j, k] - less
    for i in range(joints):
        for k in lanes:
            asked = block.angle[i, k] + block.row[i, joints, k] / block.row[i, i, k]
            angle = np.minimum(np.maximum(asked, block.low[i, k]), block.high[i, k])
            block.free[i, k] = (block.low[i, k] < block.high[i, k]) * (angle == asked)
            block.angle[i, k] = angle
