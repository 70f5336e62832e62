"""Rewards, and the infos that explain them: pure functions, for one arm or many.

Distances, successes and rewards are numbers, or arrays (n,) of n arms.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from operator import add, mul, sub
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mmc_gym.envs.spec import ReachSetup

Floats = NDArray[np.float64]
Speeds: TypeAlias = "Sequence[Any] | Floats"
HALF_PRECISE = 0.05  # segment lengths


def distances(hands: Floats, targets: Floats) -> Floats:
    """Return the distances (...) from hands (..., 2) to targets (..., 2)."""
    # The single environment does the same operations with floats, and gets the same bits.
    offset = targets - hands
    x, y = offset[..., 0], offset[..., 1]
    return np.asarray(np.sqrt(x * x + y * y))[()]


def control_cost(speeds: Speeds, weight: float) -> Any:
    """Return minus `weight` times the mean square, over the first axis, of joint speeds.

    Speeds are fractions of their limit; or their changes, for movements that are not smooth.
    """
    # Not sum(): from Python 3.12 on it adds floats more precisely than arrays.
    squares: Any = reduce(add, map(mul, speeds, speeds))
    return -weight * squares / len(speeds)


def precision(setup: ReachSetup, distance: Any) -> Any:
    """Return the reward for precision: its weight on the target, and half of it 0.05 away."""
    return setup.precision_weight * (HALF_PRECISE / (HALF_PRECISE + distance))


def goal_reward(setup: ReachSetup, distance: Any) -> Any:
    """Return the reward without costs, as dense as set up, or 0 at the target and −1 elsewhere."""
    if setup.reward_type == "sparse":
        return (distance <= setup.success_distance) - 1.0
    return -distance + precision(setup, distance)


def reward_and_info(
    setup: ReachSetup, distance: Any, is_success: Any, speeds: Speeds, speeds_before: Speeds
) -> tuple[Any, dict[str, Any]]:
    """Return the reward of a state, and the infos that it follows from.

    Args:
        setup: of the environment.
        distance: of the hand, or the cursor that stands for it, from the target.
        is_success: whether the task is done.
        speeds: of the joints, as fractions of their limit, first axis.
        speeds_before: the same one control step earlier.
    """
    reward_control = control_cost(speeds, setup.control_weight)
    is_sparse = setup.reward_type == "sparse"
    reward_precision = precision(setup, distance)
    dense = -distance + reward_precision + reward_control
    reward = is_success - 1.0 if is_sparse else dense
    info = {
        "distance": distance,
        "is_success": is_success,
        "reward_distance": -distance,
        "reward_precision": reward_precision,
        "reward_control": reward_control,
    }
    if setup.smoothness_weight:
        changes = list(map(sub, speeds, speeds_before))
        info["reward_smoothness"] = control_cost(changes, setup.smoothness_weight)
        if not is_sparse:
            reward = reward + info["reward_smoothness"]
    return reward, info
