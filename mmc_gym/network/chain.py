"""The kinematic chain: its nodes, the vectors between them, and their triangles.

A chain of N segments has the nodes p_0 (base) … p_N (end effector), and one vector
v_ij = p_j − p_i for every i < j: the segments L_i = v_{i−1,i}, the diagonals D, and the
end effector R = v_0N.  Every three nodes i < k < j close a triangle, v_ij = v_ik + v_kj::

            p_2 ──L_3── p_3
           ╱   ╲       ╱
         L_2    D_1   R          N = 3: v_01 v_12 v_23 | v_02 v_13 | v_03
         ╱        ╲  ╱                  L_1  L_2  L_3  | D_1  D_2  | R
       p_1 ──L_1── p_0

Vectors are ordered by the number of segments they span: first the N segments, last R.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from mmc_gym.geometry import Floats, node_positions

Pair = tuple[int, int]


def vector_pairs(segment_count: int) -> list[Pair]:
    """Return the node pairs (i, j) of the chain's N(N+1)/2 vectors, segments first, R last.

    >>> vector_pairs(3)
    [(0, 1), (1, 2), (2, 3), (0, 2), (1, 3), (0, 3)]
    """
    return [
        (start, start + span)
        for span in range(1, segment_count + 1)
        for start in range(segment_count + 1 - span)
    ]


def triangle_incidence(segment_count: int) -> NDArray[np.float64]:
    """Return the incidence ∂₂ of vectors and triangles, shape (vectors, triangles).

    The column of the triangle i < k < j states v_ij − v_ik − v_kj = 0.  A vector is part of
    m = N − 1 triangles, so every row has N − 1 entries that are not zero (1 or −1).
    """
    row = {pair: index for index, pair in enumerate(vector_pairs(segment_count))}
    triangles = list(combinations(range(segment_count + 1), 3))
    incidence = np.zeros((len(row), len(triangles)))
    for column, (i, k, j) in enumerate(triangles):
        incidence[row[i, j], column] = 1.0
        incidence[row[i, k], column] = -1.0
        incidence[row[k, j], column] = -1.0
    return incidence


def triangle_products(segment_count: int) -> NDArray[np.float64]:
    """Return ∂₂∂₂ᵀ, shape (vectors, vectors): the triangles that two vectors share."""
    incidence = triangle_incidence(segment_count)
    return incidence @ incidence.T


def chain_vectors(segments: Floats) -> Floats:
    """Return all vectors v_ij of a chain, (..., N(N+1)/2, 2), from segments (..., N, 2).

    They are in the order of `vector_pairs`.
    """
    starts, ends = np.array(vector_pairs(segments.shape[-2])).T
    nodes = node_positions(segments)
    return nodes[..., ends, :] - nodes[..., starts, :]


BEND = 0.02
"""Angle by which each joint of a straight arm is bent if it could not leave the line, rad."""
