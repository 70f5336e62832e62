"""A policy of stable-baselines3 and the MMC network, evaluated by the same function."""

import gymnasium as gym
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.evaluation import evaluate_policy

import mmc_gym

STEPS = 8_192  # far too few: `mmc-gym train ppo` takes the time that it needs

env = make_vec_env("MMCReach-v0", n_envs=8, seed=0)
ppo = PPO("MlpPolicy", env, gamma=0.9, n_steps=128, batch_size=256, seed=0, device="cpu")
ppo.learn(STEPS)
mmc = mmc_gym.make_agent("mmc", gym.make("MMCReach-v0"))
for name, agent in (("ppo", ppo), ("mmc", mmc)):
    reward, spread = evaluate_policy(agent, env, n_eval_episodes=8)
    print(f"{name}: mean return {reward:.1f} ± {spread:.1f}")
