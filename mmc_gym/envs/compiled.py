"""A step of many arms of the analytic engine in one go: movement, observations and rewards.

Each thread takes its share of the arms through all of it: no thread has to read what another one
has just written.  What arms observe and are rewarded for is one compiled pass.  It does what
`ObservationLayout.encode` and `rewards` do, operation by operation.  Only the cosines and sines of
the joint angles come from the engine instead of the C library.  Either is right to a unit in the
last place of float64; so an observation differs, in the last place of its float32, once in some
hundred million values.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mmc_gym._compiling import compiled
from mmc_gym.body.analytic.arms import AnalyticArmBatch
from mmc_gym.envs.rewards import HALF_PRECISE
from mmc_gym.envs.spec import GoalSetup, ReachSetup
from mmc_gym.interface import NEAR

Floats = NDArray[np.float64]
WEIGHTS = ("precision_weight", "control_weight", "smoothness_weight")
SETTINGS = np.dtype([(name, np.float64) for name in ("speed_limit", "success_distance", *WEIGHTS)])


class CompiledStep:
    """Movements, observations, rewards and infos of all arms, as `MMCReachVectorEnv` gives them."""

    def __init__(self, setup: ReachSetup, arms: AnalyticArmBatch) -> None:
        """Prepare for the arms of an environment."""
        self._arms, self._action = arms, setup.action
        self._settings = np.zeros(1, SETTINGS)
        self._settings["speed_limit"] = setup.given_body.speed_limit
        for name in ("success_distance", *WEIGHTS):
            self._settings[name] = getattr(setup, name)
        # Goals are not clipped.
        is_clipped = setup.may_exceed_reach and not isinstance(setup, GoalSetup)
        self._limits = setup.layout.limits if is_clipped else np.empty(0, np.float32)
        self._is_sparse = setup.reward_type == "sparse"
        self._is_smooth = setup.smoothness_weight > 0.0

    def __call__(
        self,
        actions: NDArray[np.floating] | None,
        *,
        hands: Floats,
        targets: Floats,
        may_succeed: NDArray[np.bool_],
        speeds: Floats,
        observation: Any,
    ) -> tuple[Floats, dict[str, Any]]:
        """Return rewards and infos; write observations without noise, and the `speeds` of now.

        Args:
            actions: what the arms do first, (n, N); None if they have moved already.
            hands: where they, or their cursors, are, (n, 2); if the arms move, the very array in
                which these tell it.
            targets: where they are, (n, 2).
            may_succeed: whether the target is the last one, (n,).
            speeds: of the joints one step earlier, as fractions of their limit, (n, N).
            observation: where observations go, (n, 3 N + 6), or those of a goal environment.
        """
        arms, count = self._arms, len(targets)
        _, scale, is_relative = self._action
        numbers, is_success = np.empty((6, count)), np.empty(count, dtype=bool)
        end_effector, target = np.empty((count, 2)), np.empty((count, 2))
        copies, seen = [(end_effector, arms.end_effectors), (target, targets)], observation
        if isinstance(observation, dict):
            seen = observation["observation"]
            copies += (observation["achieved_goal"], hands), (observation["desired_goal"], targets)

        def advance(first: int, last: int) -> None:
            if actions is not None:
                arms.command_arms(actions, scale, is_relative, first, last)
                arms.step_arms(first, last)
            for copy, original in copies:
                copy[first:last] = original[first:last]
            see_and_reward(
                first,
                last,
                self._settings,
                self._limits,
                arms.joint_cosines,
                arms.joint_sines,
                arms.joint_velocities,
                hands,
                targets,
                may_succeed,
                speeds,
                seen,
                numbers,
                is_success,
            )

        arms.share_out(advance)
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
        info |= {"end_effector": end_effector, "target": target}
        return is_success - 1.0 if self._is_sparse else reward, info


@compiled
def see_and_reward(
    first,
    last,
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
    """Do the last part of `CompiledStep` for arms from `first` to before `last`.

    Observations are clipped to `limits`, unless it is empty.  Those of a goal environment end
    before the target.  `numbers` are distances and the dense rewards, (6, n): distance, the parts
    of the reward for distance, precision, control and smoothness, and their sum.
    """
    # Counted from 0: else numba would ask of each index whether it counts from the end.
    cosines, sines, velocities = cosines[first:last], sines[first:last], velocities[first:last]
    hands, targets, may_succeed = hands[first:last], targets[first:last], may_succeed[first:last]
    speeds, observation = speeds[first:last], observation[first:last]
    numbers, is_success = numbers[:, first:last], is_success[first:last]
    told = settings[0]
    joints = cosines.shape[1]
    end = 3 * joints
    for arm in range(last - first):
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
        if end < seen.shape[0]:
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
