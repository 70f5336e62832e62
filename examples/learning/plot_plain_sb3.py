"""
How long does plain PPO take from nothing to 95 %?
==================================================

About 12 s on one core, if it learns on many arms at once. Nothing else here is special: PPO of
stable-baselines3 with its ``MlpPolicy``, and a native vector environment on the compiled engine
(extra ``fast``).
"""

import time

import gymnasium as gym
import matplotlib.pyplot as plt
import torch
from stable_baselines3 import PPO

from mmc_gym.training.vec_env import GymnasiumVecEnv

torch.set_num_threads(1)  # for a network so small, threads wait for each other
arms = gym.make_vec("MMCReach-v0", 128, engine="analytic", autoreset_mode="SameStep")
settings = dict(n_steps=64, batch_size=1024, n_epochs=5, learning_rate=1e-3, gamma=0.9, seed=0)
policy = dict(net_arch=[128, 128], activation_fn=torch.nn.ReLU)
ppo = PPO("MlpPolicy", GymnasiumVecEnv(arms), **settings, ent_coef=0.003, policy_kwargs=policy)

# %%
# It is tested without exploration on other arms, each of which plays one episode of 100 steps.

tests = gym.make_vec("MMCReach-v0", 200, engine="analytic", autoreset_mode="Disabled")


def success():
    observation, info = tests.reset(seed=1)
    for _ in range(100):
        action, _ = ppo.predict(observation, deterministic=True)
        observation, _, _, _, info = tests.step(action)
    return info["is_success"].mean()


# %%
# Learn in parts, until 95 % of the arms end at their targets.

begin, curve = time.perf_counter(), [(0, success())]
while curve[-1][1] < 0.95 and ppo.num_timesteps < 600_000:
    ppo.learn(24_576, reset_num_timesteps=False)
    curve.append((ppo.num_timesteps, success()))
steps, successes = zip(*curve)
seconds = time.perf_counter() - begin
print(f"{successes[-1]:.1%} of the targets after {steps[-1]:,} steps and {seconds:.0f} s")

# %%
# ``ppo.save`` saves it, and ``mmc_gym.compare({"mine": ppo, "mmc": "mmc"})`` compares it with the
# network.

figure, axes = plt.subplots(figsize=(6, 3.6), layout="constrained")
axes.plot(steps, [100 * share for share in successes], "o-", color="black")
axes.axhline(95, color="0.5", linestyle=":")
axes.set(xlabel="environment steps", ylabel="success [%]", ylim=(-2, 102))
plt.show()
