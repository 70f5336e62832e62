"""Gymnasium environments over the simulated arm.  Importing this package registers them."""

import gymnasium as gym

gym.register(
    id="MMCReach-v0",
    entry_point="mmc_gym.envs.reach:MMCReachEnv",
    max_episode_steps=100,
)
gym.register(
    id="MMCReachGoal-v0",
    entry_point="mmc_gym.envs.reach_goal:MMCReachGoalEnv",
    max_episode_steps=100,
)
