"""What many arms of the analytic engine observe and are rewarded for, in one compiled pass.

It does what `ObservationLayout.encode` and `rewards` do, operation by operation.  Only the cosines
and sines of the joint angles come from the engine instead of the C library.  Either is right to a
unit in the last place of float64; so an observation differs, in the last place of its float32, once
in some hundred million values.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mmc_gym._compiling import compiled
from mmc_gym.body.analytic.arms import AnalyticArms
from mmc_gym.envs.rewards import HALF_PRECISE
from mmc_gym.envs.spec import ReachSetup
from mmc_gym.interface import NEAR

Floats = NDArray[np.float64]
WEIGHTS = ("precision_weight", "control_weight", "smoothness_weight")
SETTINGS = np.dtype([(name, np.float64) for name in ("speed_limit", "success_distance", *WEIGHTS)])


class CompiledOutcome:
    """Observations, rewards and infos of all arms, as `MMCReachVectorEnv` gives them."""

    def __init__(self, setup: ReachSetup, arms: AnalyticArms) -> None:
        """Prepare for the arms of an environment with observations as `Box`, without noise."""
        self._arms, self._is_sparse = arms, setup.reward_type == "sparse"
        self._settings = np.zeros(1, SETTINGS)
        self._settings["speed_limit"] = setup.told.speed_limit
        for name in ("success_distance", *WEIGHTS):
            self._settings[name] = getattr(setup, name)
        self._limits = setup.layout.limits if setup.may_exceed_reach else np.empty(0, np.float32)
        self._is_smooth = setup.smoothness_weight > 0.0

    def __call__(
        self,
        observation: NDArray[np.float32],
        *,
        hands: Floats,
        targets: Floats,
        may_succeed: NDArray[np.bool_],
        speeds: Floats,
    ) -> tuple[Floats, dict[str, Any]]:
        """Return rewards and infos; write observations, (n, 3 N + 6), and the `speeds` of now.

        Args:
            observation: where the observations go.
            hands: where they, or their cursors, are, (n, 2).
            targets: where they are, (n, 2).
            may_succeed: whether the target is the last one, (n,).
            speeds: of the joints one step earlier, as fractions of their limit, (n, N).
        """
        arms, count = self._arms, len(targets)
        numbers, is_success = np.empty((6, count)), np.empty(count, dtype=bool)
        see_and_reward(
            self._settings,
            self._limits,
            arms.joint_cosines,
            arms.joint_sines,
            arms.joint_velocities,
            hands,
            targets,
            may_succeed,
            speeds,
            observation,
            numbers,
            is_success,
        )
        distance, distance_cost, precision, control, smoothness, reward = numbers
        info = {
            "distance": distance,
            "is_success": is_success,
            "reward_distance": distance_cost,
            "reward_precision": precision,
            "reward_control": control,
        }
        if self._is_smooth:
            info["reward_smoothness"] = smoothness
        return is_success - 1.0 if self._is_sparse else reward, info


@compiled
def see_and_reward(
    settings,
    limits,
    cosines,
    sines,
    velocities,
    hands,
    targets,
    may_succeed,
    speeds,
    observation,
    numbers,
    is_success,
):
    """Do the work of `CompiledOutcome`; observations are clipped to `limits`, unless it is empty.

    `numbers` are distances and the dense rewards, (6, n): distance, the parts of the reward for
    distance, precision, control and smoothness, and their sum.
    """
    told = settings[0]
    joints = cosines.shape[1]
    end = 3 * joints
    for arm in range(cosines.shape[0]):
        seen = observation[arm]
        squares = changes = 0.0
        for joint in range(joints):
            speed = velocities[arm, joint] / told.speed_limit
            speed = min(max(speed, -1.0), 1.0)
            change = speed - speeds[arm, joint]
            squares += speed * speed
            changes += change * change
            speeds[arm, joint] = speed
            seen[joint] = cosines[arm, joint]
            seen[joints + joint] = sines[arm, joint]
            seen[2 * joints + joint] = speed
        target_x, target_y = targets[arm, 0], targets[arm, 1]
        x, y = target_x - hands[arm, 0], target_y - hands[arm, 1]
        distance = math.sqrt(x * x + y * y)
        cosine, sine = cosines[arm, 0], sines[arm, 0]
        x, y = cosine * x + sine * y, cosine * y - sine * x
        scale = NEAR + math.sqrt(x * x + y * y)
        seen[end] = cosine * target_x + sine * target_y
        seen[end + 1] = cosine * target_y - sine * target_x
        seen[end + 2] = x
        seen[end + 3] = y
        seen[end + 4] = x / scale
        seen[end + 5] = y / scale
        for place in range(limits.shape[0]):
            seen[place] = min(max(seen[place], -limits[place]), limits[place])
        precision = told.precision_weight * (HALF_PRECISE / (HALF_PRECISE + distance))
        control = -told.control_weight * squares / joints
        smoothness = -told.smoothness_weight * changes / joints
        reward = -distance + precision + control
        if told.smoothness_weight > 0.0:
            reward = reward + smoothness
        is_success[arm] = (distance <= told.success_distance) & may_succeed[arm]
        numbers[0, arm] = distance
        numbers[1, arm] = -distance
        numbers[2, arm] = precision
        numbers[3, arm] = control
        numbers[4, arm] = smoothness
        numbers[5, arm] = reward
