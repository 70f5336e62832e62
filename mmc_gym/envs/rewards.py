"""What a state is worth, and what is told of it: pure functions, for one arm or many.

Distances, successes and rewards are numbers, or arrays (n,) of n arms.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from operator import add, mul, sub
from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from mmc_gym.envs.spec import ReachSetup

Speeds: TypeAlias = "Sequence[Any] | NDArray[np.float64]"
Distance = TypeVar("Distance", float, NDArray[np.float64])


def dense_reward(distance: Distance) -> Distance:
    """Minus the distance from hand to target, in segment lengths."""
    return -distance


def sparse_reward(is_success: Any) -> Any:
    """0 where the task is done, −1 elsewhere."""
    return is_success - 1.0


def control_cost(speeds: Speeds, weight: float) -> Any:
    """Minus `weight` times the mean square of the joint speeds, as fractions of their limit.

    Args:
        speeds: of the joints, first axis; an array may have arms behind it.  Or their changes,
            for the cost of movements that are not smooth.
        weight: of the cost.
    """
    # Not sum(): from Python 3.12 on it adds floats more precisely than arrays.
    squares: Any = reduce(add, map(mul, speeds, speeds))
    return -weight * squares / len(speeds)


def reward_and_info(
    setup: ReachSetup,
    distance: Any,
    is_success: Any,
    speeds: Speeds,
    speeds_before: Speeds,
) -> tuple[Any, dict[str, Any]]:
    """The reward of a state, and the infos that it follows from.

    Args:
        setup: of the environment.
        distance: of the hand, or the cursor that stands for it, from the target.
        is_success: whether the task is done.
        speeds: of the joints, as fractions of their limit, first axis.
        speeds_before: the same one control step earlier.
    """
    reward_distance = dense_reward(distance)
    reward_control = control_cost(speeds, setup.control_weight)
    if setup.reward_type == "sparse":
        reward = sparse_reward(is_success)
    else:
        reward = reward_distance + reward_control
    info = {
        "distance": distance,
        "is_success": is_success,
        "reward_distance": reward_distance,
        "reward_control": reward_control,
    }
    if setup.smoothness_weight:
        info["reward_smoothness"] = control_cost(
            list(map(sub, speeds, speeds_before)), setup.smoothness_weight
        )
        if setup.reward_type == "dense":
            reward = reward + info["reward_smoothness"]
    return reward, info
