"""A policy of stable-baselines3 and the MMC network, evaluated by the same function."""

import gymnasium as gym
from stable_baselines3 import PPO
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor

import mmc_gym
from mmc_gym.training.vec_env import GymnasiumVecEnv

STEPS = 8_192  # far too few: `mmc-gym train ppo` takes the time that it needs

# Many arms in one native vector environment, as stable-baselines3 wants them.
arms = GymnasiumVecEnv(gym.make_vec("MMCReach-v0", 64, autoreset_mode="SameStep"))
ppo = PPO("MlpPolicy", arms, gamma=0.9, n_steps=32, batch_size=256, seed=0, device="cpu")
ppo.learn(STEPS)
env = Monitor(gym.make("MMCReach-v0"))
mmc = mmc_gym.make_agent("mmc", env)
for name, agent in (("ppo", ppo), ("mmc", mmc)):
    reward, spread = evaluate_policy(agent, env, n_eval_episodes=8)
    print(f"{name}: mean return {reward:.1f} ± {spread:.1f}")
