"""Iterations of the network in the inverse task, compiled by numba: arms side by side in lanes.

`model` has the equations.  Two things make them cheap.  All triangles that a vector is part of are
summed at once: with S_i = Σ_k v_ik, the sum of all vectors from the node i (v_ki = −v_ik),

    Σ_{k≠i,j} (v_ik + v_kj) = S_i − S_j − 2 v_ij
    ⇒  ṽ_ij = (S_i − S_j)/d + (1 − (N + 1)/d) v_ij

which takes of the order of N² operations for all vectors, where a matrix takes N⁴.  (It also shows
why d = N + 1 needs a single iteration: (S_i − S_j)/(N + 1) are the vectors between the nodes that
fit best.)  And the arms of a block stay in the first-level cache for all iterations.

Lanes never mix, and no operation is reassociated or fused.  So the result of an arm does not depend
on its neighbours.  All computations are in float64, whatever the dtype of the state.

A block is a record of arrays whose shapes are part of its type.  So the compiler knows N, unrolls
the loops over nodes, and turns loops over lanes into vector instructions.  It compiles once for
each N, in a few seconds, and caches the result on disk.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, partial
from typing import Any

import numpy as np

from mmc_gym._compiling import compiled, inner
from mmc_gym.geometry import Floats
from mmc_gym.network.iteration import velocity_rule

LANES = 32  # arms in a block
_NUDGE = 1e-100  # gives the zero vector a direction, as `EuclideanNormalizer` does
_SHARED = 3  # segments share a division; more zero vectors would underflow together


@lru_cache(maxsize=256)
def compiled_iteration(network: Any) -> Callable[[Floats, int], None]:
    """Return `iterate` for an `MMCNetwork`, as a function of its last two arguments."""
    count, nodes = network.segment_count, network.segment_count + 1
    shapes = {
        # As `MMCState.values`, but always with velocities.
        "state": (nodes * count // 2 + count, 2),
        "total": (nodes, 2),  # S_i
        "length": (count,),
        "size": (count,),  # the length before normalization, see `_normalize`
        "others": (count,),
    }
    no_blocks = np.empty(0, [(name, np.float64, (*shape, LANES)) for name, shape in shapes.items()])
    rule = np.array([1 / network.damping, *velocity_rule(network)])
    return partial(iterate, no_blocks, np.array(network.segment_lengths), rule)


@compiled
def iterate(no_blocks, lengths, rule, values, times):
    """Iterate a state in place.

    Args:
        no_blocks: an empty array of blocks; its type says how many segments there are.
        lengths: of the segments, (N,).
        rule: 1/d, and the factors of `velocity_rule`.
        values: the state, (rows, 2, batch), see `MMCState`; R is held at its value.
        times: number of iterations.
    """
    blocks = np.zeros(1, no_blocks.dtype)
    for i in range(lengths.shape[0]):
        blocks[0].length[i] = lengths[i]
    for first in range(0, values.shape[2], LANES):
        block = blocks[0]  # here, because a record does not keep its array alive
        lanes = min(LANES, values.shape[2] - first)
        for row in range(values.shape[0]):
            for axis in range(2):
                for k in range(lanes):
                    block.state[row, axis, k] = values[row, axis, first + k]
        for _ in range(times):
            _advance(block, rule[0], rule[1], rule[2], lanes)
        for row in range(values.shape[0]):
            for axis in range(2):
                for k in range(lanes):
                    values[row, axis, first + k] = block.state[row, axis, k]


@inner
def _row(i, j, nodes):
    """Return the row of v_ij, i < j, in the order of `chain.vector_pairs`."""
    span = j - i
    return (span - 1) * nodes - span * (span - 1) // 2 + i


@inner
def _add_up(vector, total, k):
    """Write S_i of every node into `total`."""
    nodes = total.shape[0]
    for i in range(nodes):
        # The sum begins with a vector, because beginning with 0 takes one more addition.
        is_last = i == nodes - 1
        row = _row(i - 1, i, nodes) if is_last else _row(i, i + 1, nodes)
        for axis in range(2):
            x = -vector[row, axis, k] if is_last else vector[row, axis, k]
            for j in range(nodes):
                if i + 1 < j:
                    x += vector[_row(i, j, nodes), axis, k]
                elif j < i - is_last:
                    x -= vector[_row(j, i, nodes), axis, k]
            total[i, axis, k] = x


@inner
def _advance(block, share, gain, memory, lanes):
    """Do an iteration; R is held."""
    state, total = block.state, block.total
    velocity = state.shape[0] - block.length.shape[0]  # row where velocities begin
    nodes, gain = total.shape[0], gain * share
    own = 1.0 - share * nodes
    for k in range(lanes):
        _add_up(state, total, k)
        for i in range(nodes):
            for j in range(nodes):
                if i + 1 < j and j - i < nodes - 1:  # a diagonal: the mean of its computations
                    row = _row(i, j, nodes)
                    for axis in range(2):
                        mean = share * (total[i, axis, k] - total[j, axis, k])
                        state[row, axis, k] = mean + own * state[row, axis, k]
        for i in range(block.length.shape[0]):
            for axis in range(2):
                x = state[i, axis, k]
                change = total[i, axis, k] - total[i + 1, axis, k] - nodes * x
                speed = gain * change + memory * state[velocity + i, axis, k]
                state[velocity + i, axis, k] = speed
                state[i, axis, k] = x + speed
        _normalize(block, k)


@inner
def _normalize(block, k):
    """Bring segments to their lengths: with three divisions in one, 1/a = b c / (a b c)."""
    size, others, count = block.size, block.others, block.length.shape[0]
    segments = block.state  # its first rows
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
