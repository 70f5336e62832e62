"""What a state is worth: pure functions, for one distance or an array of them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Distance = TypeVar("Distance", float, NDArray[np.float64])


def dense_reward(distance: Distance) -> Distance:
    """Minus the distance from hand to target, in segment lengths."""
    return -distance


def sparse_reward(distance: Distance, success_distance: float) -> Distance:
    """0 where the hand is within `success_distance` of the target, −1 elsewhere."""
    return (distance <= success_distance) - 1.0  # type: ignore[return-value]


def control_cost(speeds: Iterable[Any], count: int, weight: float) -> Any:
    """Minus `weight` times the mean square of the joint speeds, as fractions of their limit.

    Args:
        speeds: one number, or one array over arms, for each of the `count` joints.
        count: how many joints there are.
        weight: of the cost.
    """
    squares: Any = sum(speed * speed for speed in speeds)
    return -weight * squares / count
