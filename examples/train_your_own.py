"""Train a policy of stable-baselines3 on many arms at once; set it beside the MMC network."""

import gymnasium as gym
import torch
from stable_baselines3 import PPO

import mmc_gym
from mmc_gym.training.vec_env import GymnasiumVecEnv

ENV, EPISODES = "MMCReach-v0", 200
torch.set_num_threads(1)  # for a network so small, threads wait for each other


def success(agent):
    env = gym.make_vec(ENV, EPISODES)  # all episodes at once
    (observation, _), state, over = env.reset(seed=1), None, False
    while not over:
        action, state = agent.predict(observation, state, deterministic=True)
        observation, _, _, truncated, info = env.step(action)
        over = truncated.all()
    return f"{info['is_success'].mean():.1%} of {EPISODES} episodes end at the target"


arms = GymnasiumVecEnv(gym.make_vec(ENV, 1024, engine="analytic", autoreset_mode="SameStep"))
learning = dict(learning_rate=1e-3, n_steps=16, batch_size=2048, n_epochs=5, ent_coef=0.003)
policy = dict(net_arch=[128, 128], activation_fn=torch.nn.ReLU)
ppo = PPO("MlpPolicy", arms, gamma=0.9, **learning, policy_kwargs=policy, seed=0, device="cpu")
print("ppo, untrained:", success(ppo))
print("ppo, trained:", success(ppo.learn(500_000)))
print("mmc:", success(mmc_gym.make_agent("mmc", gym.make(ENV))))
