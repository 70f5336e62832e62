"""`MMCReachGoal-v0`: the reaching arm as a goal environment."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from mmc_gym.envs.reach import MMCReachEnv
from mmc_gym.envs.rewards import dense_reward, sparse_reward
from mmc_gym.envs.spec import HasSetup, ReachSetup, RewardType
from mmc_gym.envs.workspace import REACH_TOLERANCE, Point


class GoalRewards(HasSetup):
    """What stable-baselines3 asks a goal environment for, so that it can relabel transitions."""

    def compute_reward(
        self, achieved_goal: NDArray[np.floating], desired_goal: NDArray[np.floating], info: Any
    ) -> Any:
        """Reward for hands (..., 2) and targets (..., 2), shape (...); `info` is not used."""
        del info
        offset = np.asarray(desired_goal, np.float64) - np.asarray(achieved_goal, np.float64)
        x, y = offset[..., 0], offset[..., 1]
        distance = np.sqrt(x * x + y * y)
        if self.reward_type == "sparse":
            return sparse_reward(distance <= self.success_distance)
        return dense_reward(distance)

    def compute_terminated(
        self, achieved_goal: NDArray[np.floating], desired_goal: NDArray[np.floating], info: Any
    ) -> Any:
        """False for every transition, shape (...): the hand must stay at the target."""
        del desired_goal, info
        return np.zeros(np.shape(achieved_goal)[:-1], dtype=bool)[()]

    def compute_truncated(
        self, achieved_goal: NDArray[np.floating], desired_goal: NDArray[np.floating], info: Any
    ) -> Any:
        """False for every transition, shape (...): the time limit alone truncates."""
        return self.compute_terminated(achieved_goal, desired_goal, info)


class MMCReachGoalEnv(GoalRewards, MMCReachEnv):
    """`MMCReachEnv` as a goal environment, for hindsight experience replay.

    As `MMCReach-v0`, but for:

    ## Observation Space
    `Dict`: `observation`, `Box(-1, 1, (9,), float32)` (cos and sin of the joint angles, joint
    velocities / 2π rad/s), `achieved_goal` (hand) and `desired_goal` (target), both
    `Box(-reach, reach, (2,), float64)` in segment lengths.

    ## Rewards
    Sparse by default.  There is no control cost: the reward is `compute_reward` of the two
    goals alone, so that replayed transitions can be relabelled.

    ## Version History
    * v0: initial version
    """

    def __init__(self, *, reward_type: RewardType = "sparse", **kwargs: Any) -> None:
        """Make the environment; the arguments are those of `MMCReachEnv`, less costs' weights.

        Raises:
            ValueError: if an argument is outside what it accepts.
        """
        super().__init__(reward_type=reward_type, **without_control_weight(kwargs))
        check_goals(self.setup)

    def _make_observation_space(self, count: int) -> spaces.Space[Any]:
        return goal_observation_space(self.setup)

    def _observation(self, posture: list[float], hand: Point, target: Point) -> Any:
        return {
            "observation": np.array(posture, dtype=np.float32),
            "achieved_goal": np.array(hand),
            "desired_goal": np.array(target),
        }


def goal_observation_space(setup: ReachSetup) -> spaces.Dict:
    """The observation space of `MMCReachGoal-v0`."""
    # Rounding may put a goal beyond the reach by as much as a target is allowed to be.
    border = setup.farthest * (1 + REACH_TOLERANCE)
    goal = spaces.Box(-border, border, (2,), np.float64)
    posture = spaces.Box(-1.0, 1.0, (3 * setup.joint_count,), np.float32)
    return spaces.Dict(observation=posture, achieved_goal=goal, desired_goal=goal)


def check_goals(setup: ReachSetup) -> None:
    """Raise a `ValueError` if the reward would not be a function of the observed goals."""
    if setup.noises or setup.delay or setup.task.advance == "reach":
        raise ValueError(
            "a goal environment must have a reward that is a function of the observed goals: no "
            f"noise, no delay and no via points, got task={setup.task}, "
            f"perturbations={setup.perturbations}"
        )


def without_control_weight(arguments: dict[str, Any]) -> dict[str, Any]:
    """The arguments with no weight for the control cost, or a `ValueError` if there is one."""
    for name in ("control_weight", "smoothness_weight"):
        if arguments.get(name, 0.0) != 0.0:
            raise ValueError(f"{name} must be 0: the reward is a function of the goals")
    return {**arguments, "control_weight": 0.0}
