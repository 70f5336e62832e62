"""Reaching tasks: where targets come from, what counts as success, and what it is worth.

Pure functions; nothing here touches the arm.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from operator import mul
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from mmc_gym.network.chain import reachable_radii, segments_from_joint_angles

# A target within 1e-9 reaches of the border counts as reachable: rounding puts them there.
REACH_TOLERANCE = 1e-9
_CELLS = 60  # grid cells across the reach, where joint limits shape the reachable set

Distance = TypeVar("Distance", float, NDArray[np.float64])


def sample_target(
    segment_lengths: Sequence[float], random: np.random.Generator
) -> tuple[float, float]:
    """A target drawn area-uniformly from the disc or ring that the hand can reach."""
    inner, outer = reachable_radii(segment_lengths)
    radius = math.sqrt(random.uniform(inner**2, outer**2))
    angle = random.uniform(-math.pi, math.pi)
    return radius * math.cos(angle), radius * math.sin(angle)


@lru_cache(maxsize=8)  # a vector of environments asks once for each
def reachable_hands(
    segment_lengths: tuple[float, ...], joint_limits: tuple[tuple[float, float], ...]
) -> list[NDArray[np.float64]]:
    """Hand positions that an arm with joint limits reaches, grouped by cells of a square grid.

    Draw a cell, then a position in it, for targets that are area-uniform up to the size of a
    cell (a thirtieth of the reach) and reachable without exception.

    Returns:
        One array (n, 2) per cell that the hand can reach.
    """
    random = np.random.default_rng(0)
    low, high = np.array(joint_limits).T
    angles = random.uniform(low, high, size=(100_000, len(low)))
    hands = segments_from_joint_angles(angles, segment_lengths).sum(axis=-2)
    reach = reachable_radii(segment_lengths)[1]
    columns, rows = ((hands / reach + 1) / 2 * _CELLS).astype(int).T
    cells = rows * (_CELLS + 1) + columns
    order = np.argsort(cells, kind="stable")
    borders = np.flatnonzero(np.diff(cells[order])) + 1
    return np.split(hands[order], borders)


def is_reachable(target: Sequence[float], segment_lengths: Sequence[float]) -> bool:
    """Whether the hand of an arm with continuous joints can be at `target` (x, y)."""
    inner, outer = reachable_radii(segment_lengths)
    slack = REACH_TOLERANCE * outer
    return inner - slack <= math.hypot(*target) <= outer + slack


def nearest_reachable(
    point: Sequence[float], segment_lengths: Sequence[float]
) -> tuple[float, float]:
    """The point nearest to `point` (x, y) that an arm with continuous joints can reach."""
    x, y = point
    distance = math.hypot(x, y)
    inner, outer = reachable_radii(segment_lengths)
    if inner <= distance <= outer:
        return x, y
    radius = inner if distance < inner else outer
    angle = math.atan2(y, x)  # defined at the base too, and no division by a tiny distance
    return radius * math.cos(angle), radius * math.sin(angle)


def dense_reward(distance: Distance) -> Distance:
    """Minus the distance from hand to target, in segment lengths."""
    return -distance


def sparse_reward(distance: Distance, success_distance: float) -> Distance:
    """0 where the hand is within `success_distance` of the target, −1 elsewhere."""
    return (distance <= success_distance) - 1.0  # type: ignore[return-value]


def control_cost(speeds: Sequence[float], weight: float) -> float:
    """Minus `weight` times the mean square of the joint speeds, as fractions of their limit."""
    squares: float = sum(map(mul, speeds, speeds))
    return -weight * squares / len(speeds)
