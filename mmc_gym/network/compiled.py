"""Iterations of the network, compiled by numba: arms side by side in lanes.

`model` has the equations.  Two things make them cheap.  All triangles that a vector is part of are
summed at once: with S_i = Σ_k v_ik, the sum of all vectors from the node i (v_ki = −v_ik),

    Σ_{k≠i,j} (v_ik + v_kj) = S_i − S_j − 2 v_ij
    ⇒  ṽ_ij = (S_i − S_j)/d + (1 − (N + 1)/d) v_ij

which takes of the order of N² operations for all vectors, where a matrix takes N⁴.  (It also shows
why d = N + 1 needs a single iteration: (S_i − S_j)/(N + 1) are the vectors between the nodes that
fit best.)  And the arms of a block stay in the first-level cache for all iterations.

Lanes never mix and nothing is reassociated or fused: the numbers of an arm do not depend on its
neighbours.  Everything is computed in float64, whatever the dtype of the state.

A block is a record of arrays whose shapes are part of its type.  So the compiler knows N, writes
the loops over nodes out, and turns those over lanes into vector instructions.  It does so anew for
each N: a few seconds, once on a machine.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache, partial

import numpy as np
from numpy.typing import NDArray

from mmc_gym._compiling import compiled, inner
from mmc_gym.network.chain import Floats
from mmc_gym.network.model import MMCNetwork, check_clamped, velocity_rule

LANES = 32  # arms in a block
_NUDGE = 1e-100  # gives the zero vector a direction, as `EuclideanNormalizer` does
_SHARED = 3  # segments share a division; more zero vectors would underflow together


@lru_cache(maxsize=256)
def prepare(
    network: MMCNetwork, clamped: tuple[int, ...]
) -> Callable[[Floats, Floats, Floats, int], None]:
    """Return the iterations of a network with these rows clamped (`Clamps.rows`).

    It is a function of the state (rows, 2, batch), the values of the clamped rows (n, 2, batch or
    1), the array that the new state is written into, and how many iterations lead there.
    """
    check_clamped(network, clamped)
    return partial(iterate, *_constants(network), np.array(clamped, dtype=np.intp))


@lru_cache(maxsize=256)
def prepare_one(network: MMCNetwork) -> Callable[[Floats, float, float, Floats, Floats, int], bool]:
    """Return the same for the inverse task of a single arm, see `reach_by_one`."""
    return partial(reach_by_one, *_constants(network))


def _constants(network: MMCNetwork) -> tuple[NDArray[np.void], Floats, Floats, bool]:
    """Return the first arguments of the compiled functions, see `iterate`."""
    count = network.segment_count
    nodes = count + 1
    shapes = {
        "vector": (nodes * count // 2, 2),
        "pending": (count, 2),  # segments that await their normalization
        "velocity": (count, 2),
        "total": (nodes, 2),  # S_i
        "length": (count,),
        "size": (count,),  # before it is brought to that, see `_normalize`
        "others": (count,),
    }
    fields = [(name, np.float64, (*shape, LANES)) for name, shape in shapes.items()]
    no_blocks = np.empty(0, fields)
    rule = (1.0, 0.0) if network.dynamics == "kinematic" else velocity_rule(network)
    return (
        no_blocks,
        np.array(network.segment_lengths),
        np.array([1 / network.damping, *rule]),
        network.schedule == "delayed",
    )


@compiled
def iterate(no_blocks, lengths, rule, is_late, clamped, values, held, result, times):
    """Write the state after some iterations into `result`.

    Args:
        no_blocks: an empty array of blocks; its type says how many segments there are.
        lengths: of the segments, (N,).
        rule: 1/d, and the factors of L̃ − L and of the old velocity in the new velocity; 1 and 0
            make a kinematic network of a dynamic one.
        is_late: whether the schedule is "delayed".
        clamped: rows that are held, (n,).
        values: the state, (rows, 2, batch); see `MMCState`.
        held: what the clamped rows are held at, (n, 2, batch or 1).
        result: the state to be, (rows, 2, batch).
        times: how many iterations.
    """
    blocks = np.zeros(1, no_blocks.dtype)
    for i in range(lengths.shape[0]):
        blocks[0].length[i] = lengths[i]
    hand = blocks[0].vector.shape[0] - 1
    is_inverse = clamped.shape[0] == 1 and clamped[0] == hand  # nothing but R is held
    for first in range(0, values.shape[2], LANES):
        block = blocks[0]  # here, because a record does not keep its array alive
        lanes = min(LANES, values.shape[2] - first)
        _read(block, values, is_late, first, lanes)
        _hold(block, clamped, held, first, lanes)
        for _ in range(times):
            if is_late:
                for k in range(lanes):
                    _normalize(block.pending, block, k)
                if not is_inverse:
                    _hold(block, clamped, held, first, lanes)
                _advance_late(block, rule[0], rule[1], rule[2], lanes)
            else:
                _advance(block, rule[0], rule[1], rule[2], lanes)
            if not is_inverse:
                _average_hand(block, rule[0], lanes)
                _hold(block, clamped, held, first, lanes)
        if times > 0:
            _stop(block, clamped)
        _write(result, block, is_late, first, lanes)


@compiled
def reach_by_one(no_blocks, lengths, rule, is_late, values, x, y, result, joint_angles, times):
    """Let one arm iterate with its end effector held; return how bent it was before.

    The first four arguments, and `times`, are those of `iterate`.  The end effector is held at
    (x, y).  The state is `values`, (rows, 2); the one to be goes to `result`, and its joint angles,
    not wrapped, to `joint_angles`, (N,).

    Returns:
        The largest area that two neighbouring segments span, between 0 and ℓ_i ℓ_{i+1}.
    """
    count, (rows, _) = lengths.shape[0], values.shape
    area = 0.0
    for i in range(count - 1):
        across = values[i, 0] * values[i + 1, 1] - values[i, 1] * values[i + 1, 0]
        area = max(area, abs(across))
    clamped, held = np.empty(1, np.intp), np.empty((1, 2, 1))
    clamped[0] = count * (count + 1) // 2 - 1
    held[0, 0, 0], held[0, 1, 0] = x, y
    before, after = values.reshape(rows, 2, 1), result.reshape(rows, 2, 1)
    iterate(no_blocks, lengths, rule, is_late, clamped, before, held, after, times)
    parent = 0.0
    for i in range(count):
        angle = math.atan2(result[i, 1], result[i, 0])
        joint_angles[i] = angle - parent
        parent = angle
    return area


@inner
def _velocity_row(block, is_late):
    """Return the row of the state where velocities begin; of a kinematic network, its end."""
    return block.vector.shape[0] + (block.pending.shape[0] if is_late else 0)


@inner
def _read(block, values, is_late, first, lanes):
    pending, velocity = block.vector.shape[0], _velocity_row(block, is_late)
    is_dynamic = velocity < values.shape[0]
    for axis in range(2):
        for row in range(pending):
            for k in range(lanes):
                block.vector[row, axis, k] = values[row, axis, first + k]
        for i in range(block.velocity.shape[0]):
            if is_late:
                for k in range(lanes):
                    block.pending[i, axis, k] = values[pending + i, axis, first + k]
            if is_dynamic:
                for k in range(lanes):
                    block.velocity[i, axis, k] = values[velocity + i, axis, first + k]


@inner
def _write(result, block, is_late, first, lanes):
    pending, velocity = block.vector.shape[0], _velocity_row(block, is_late)
    is_dynamic = velocity < result.shape[0]
    for axis in range(2):
        for row in range(pending):
            for k in range(lanes):
                result[row, axis, first + k] = block.vector[row, axis, k]
        for i in range(block.velocity.shape[0]):
            if is_late:
                for k in range(lanes):
                    result[pending + i, axis, first + k] = block.pending[i, axis, k]
            if is_dynamic:
                for k in range(lanes):
                    result[velocity + i, axis, first + k] = block.velocity[i, axis, k]


@inner
def _hold(block, clamped, held, first, lanes):
    """Write the clamped values: vectors, and under "delayed" the segments that are pending."""
    pending = block.vector.shape[0]
    for index in range(clamped.shape[0]):
        row = clamped[index]
        for axis in range(2):
            for k in range(lanes):
                value = held[index, axis, first + k if held.shape[2] > 1 else 0]
                if row < pending:
                    block.vector[row, axis, k] = value
                else:
                    block.pending[row - pending, axis, k] = value


@inner
def _stop(block, clamped):
    """Set the velocities of clamped segments to zero."""
    for index in range(clamped.shape[0]):
        if clamped[index] < block.velocity.shape[0]:
            block.velocity[clamped[index]] = 0.0


@inner
def _row(i, j, nodes):
    """Return the row of v_ij, i < j, in the order of `chain.vector_pairs`."""
    span = j - i
    return (span - 1) * nodes - span * (span - 1) // 2 + i


@inner
def _add_up(vector, total, k):
    """Find S_i of every node."""
    nodes = total.shape[0]
    for i in range(nodes):
        # It begins with a vector: with 0 it would be an addition more.
        is_last = i == nodes - 1
        row = _row(i - 1, i, nodes) if is_last else _row(i, i + 1, nodes)
        x = -vector[row, 0, k] if is_last else vector[row, 0, k]
        y = -vector[row, 1, k] if is_last else vector[row, 1, k]
        for j in range(nodes):
            if i + 1 < j:
                x += vector[_row(i, j, nodes), 0, k]
                y += vector[_row(i, j, nodes), 1, k]
            elif j < i - is_last:
                x -= vector[_row(j, i, nodes), 0, k]
                y -= vector[_row(j, i, nodes), 1, k]
        total[i, 0, k] = x
        total[i, 1, k] = y


@inner
def _average(vector, total, share, i, j, k):
    """Replace v_ij by the mean of its computations."""
    row, own = _row(i, j, total.shape[0]), 1.0 - share * total.shape[0]
    x, y = vector[row, 0, k], vector[row, 1, k]
    vector[row, 0, k] = share * (total[i, 0, k] - total[j, 0, k]) + own * x
    vector[row, 1, k] = share * (total[i, 1, k] - total[j, 1, k]) + own * y


@inner
def _average_diagonals(vector, total, share, k):
    nodes = total.shape[0]
    for i in range(nodes):
        for j in range(nodes):
            if i + 1 < j and j - i < nodes - 1:
                _average(vector, total, share, i, j, k)


@inner
def _average_hand(block, share, lanes):
    """Replace R likewise, after all others: the inverse task, which holds it, does without."""
    last = block.total.shape[0] - 1
    for k in range(lanes):
        _average(block.vector, block.total, share, 0, last, k)


@inner
def _advance(block, share, gain, memory, lanes):
    """Do an iteration of the schedule "synchronous"."""
    vector, velocity, total = block.vector, block.velocity, block.total
    nodes, gain = float(total.shape[0]), gain * share
    for k in range(lanes):
        _add_up(vector, total, k)
        _average_diagonals(vector, total, share, k)
        for i in range(velocity.shape[0]):
            x, y = vector[i, 0, k], vector[i, 1, k]
            change_x = total[i, 0, k] - total[i + 1, 0, k] - nodes * x
            change_y = total[i, 1, k] - total[i + 1, 1, k] - nodes * y
            velocity_x = gain * change_x + memory * velocity[i, 0, k]
            velocity_y = gain * change_y + memory * velocity[i, 1, k]
            velocity[i, 0, k] = velocity_x
            velocity[i, 1, k] = velocity_y
            vector[i, 0, k] = x + velocity_x
            vector[i, 1, k] = y + velocity_y
        _normalize(vector, block, k)


@inner
def _normalize(segments, block, k):
    """Bring segments to their lengths: with three divisions in one, 1/a = b c / (a b c)."""
    size, others, count = block.size, block.others, block.length.shape[0]
    for first in range(0, count, _SHARED):
        last = min(first + _SHARED, count)
        product = 1.0
        for i in range(first, last):
            x, y = segments[i, 0, k] + _NUDGE, segments[i, 1, k]
            segments[i, 0, k] = x
            size[i, k] = np.sqrt(x * x + y * y)
            others[i, k] = product
            product *= size[i, k]
        rest = 1.0 / product
        for m in range(first, last):
            i = first + last - 1 - m
            scale = block.length[i, k] * (others[i, k] * rest)
            rest *= size[i, k]
            segments[i, 0, k] *= scale
            segments[i, 1, k] *= scale


@inner
def _advance_late(block, share, gain, memory, lanes):
    """Do an iteration of the schedule "delayed": only the self term reads the new segments."""
    vector, pending, velocity, total = block.vector, block.pending, block.velocity, block.total
    own = 1.0 - share * (total.shape[0] - 2)  # (d − m)/d
    for k in range(lanes):
        _add_up(vector, total, k)
        _average_diagonals(vector, total, share, k)
        for i in range(velocity.shape[0]):
            x, y = pending[i, 0, k], pending[i, 1, k]
            triangles_x = total[i, 0, k] - total[i + 1, 0, k] - 2.0 * vector[i, 0, k]
            triangles_y = total[i, 1, k] - total[i + 1, 1, k] - 2.0 * vector[i, 1, k]
            velocity_x = gain * (share * triangles_x + own * x - x) + memory * velocity[i, 0, k]
            velocity_y = gain * (share * triangles_y + own * y - y) + memory * velocity[i, 1, k]
            velocity[i, 0, k] = velocity_x
            velocity[i, 1, k] = velocity_y
            vector[i, 0, k] = x
            vector[i, 1, k] = y
            pending[i, 0, k] = x + velocity_x
            pending[i, 1, k] = y + velocity_y
