"""`MMCReachGoal-v0` as a vector environment."""

from __future__ import annotations

from typing import Any

from gymnasium import spaces

from mmc_gym.envs.perturbations import Readings
from mmc_gym.envs.reach_goal import (
    GoalRewards,
    check_goals,
    goal_observation_space,
    without_control_weight,
)
from mmc_gym.envs.spec import RewardType
from mmc_gym.envs.vector import MMCReachVectorEnv
from mmc_gym.interface import encode_posture


class MMCReachGoalVectorEnv(GoalRewards, MMCReachVectorEnv):
    """`MMCReachGoalEnv` as a vector environment; see `MMCReachVectorEnv`."""

    def __init__(
        self, num_envs: int = 1, *, reward_type: RewardType = "sparse", **kwargs: Any
    ) -> None:
        """Make the environment; the arguments are those of `MMCReachVectorEnv`.

        Raises:
            ValueError: if an argument is outside what it accepts.
        """
        super().__init__(num_envs, reward_type=reward_type, **without_control_weight(kwargs))
        check_goals(self.setup)

    def _make_observation_space(self) -> spaces.Space[Any]:
        return goal_observation_space(self.setup)

    def _observe(self, readings: Readings) -> Any:
        return {
            "observation": encode_posture(self.setup, readings),
            "achieved_goal": readings.hand.copy(),
            "desired_goal": readings.target.copy(),
        }
