"""The reward, and the entries of `info` that explain it: of one arm in numbers, of n in arrays."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import reduce
from operator import add, mul, sub
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

Number = TypeVar("Number", float, NDArray[np.floating])
Numbers = Sequence[Any] | NDArray[np.floating]  # joints first
HALF_PRECISE = 0.05  # segment lengths


class RewardSettings(NamedTuple):
    """The numbers that the reward depends on."""

    control_weight: float
    precision_weight: float
    smoothness_weight: float
    is_sparse: bool


def precision(distance: Number, weight: float) -> Number:
    """Return the reward for precision: `weight` at distance 0, half of it at 0.05."""
    return weight * (HALF_PRECISE / (HALF_PRECISE + distance))


def reward_and_info(
    distance: Number,
    is_success: Any,
    speeds: Numbers,
    speeds_before: Numbers,
    settings: RewardSettings,
    number: Callable[[Any], Any] = np.float64,
) -> tuple[Number, dict[str, Any]]:
    """Return the reward of a state, and the entries of `info` that explain it.

    The distance is from the target to the hand, or to the cursor that stands for it.  Speeds of the
    joints, now and one control step earlier, are fractions of their limit, (N,) or (N, n).
    `number` gives what is in `info` a dtype, which an array has.
    """
    reward_control = _minus_mean_square(speeds, settings.control_weight)
    reward_precision = precision(distance, settings.precision_weight)
    info = {
        "distance": number(distance),
        "is_success": np.array(is_success),  # sync would make objects of numpy bools
        "reward_distance": number(-distance),
        "reward_precision": number(reward_precision),
        "reward_control": number(reward_control),
    }
    reward = -distance + reward_precision + reward_control
    if settings.smoothness_weight:
        changes = list(map(sub, speeds, speeds_before))
        reward_smoothness = _minus_mean_square(changes, settings.smoothness_weight)
        info["reward_smoothness"] = number(reward_smoothness)
        reward = reward + reward_smoothness
    return (is_success - 1.0 if settings.is_sparse else reward), info


def _minus_mean_square(speeds: Numbers, weight: float) -> Any:
    """Return minus `weight` times the mean square over the first axis."""
    # Not sum(): from Python 3.12 on it adds floats more precisely than arrays.
    squares: Any = reduce(add, map(mul, speeds, speeds))
    return -weight * squares / len(speeds)
