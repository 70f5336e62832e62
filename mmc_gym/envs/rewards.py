"""What a state is worth: pure functions, for one distance or an array of them."""

from __future__ import annotations

from collections.abc import Sequence
from operator import mul
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Distance = TypeVar("Distance", float, NDArray[np.float64])


def dense_reward(distance: Distance) -> Distance:
    """Minus the distance from hand to target, in segment lengths."""
    return -distance


def sparse_reward(is_success: Any) -> Any:
    """0 where the task is done, −1 elsewhere."""
    return is_success - 1.0


def control_cost(speeds: Sequence[Any] | NDArray[np.float64], weight: float) -> Any:
    """Minus `weight` times the mean square of the joint speeds, as fractions of their limit.

    Args:
        speeds: of the joints, first axis; an array may have arms behind it.
        weight: of the cost.
    """
    squares: Any = sum(map(mul, speeds, speeds))
    return -weight * squares / len(speeds)
