"""
Can an agent learn from success alone?
======================================

Yes, with hindsight (HER): a movement that missed its target teaches how to reach the place where it
ended. The reward of ``MMCReachGoal-v0`` is -1, or 0 at the target, as in gymnasium-robotics, and
stable-baselines3's ``HerReplayBuffer`` works as it is.
"""

import gymnasium as gym
import matplotlib.pyplot as plt
import torch
from stable_baselines3 import SAC, HerReplayBuffer

from mmc_gym.training.vec_env import GymnasiumVecEnv

torch.set_num_threads(1)  # for a network so small, threads wait for each other
settings = dict(buffer_size=100_000, learning_starts=1_600, gradient_steps=4, seed=0)
settings |= dict(gamma=0.95, tau=0.01, learning_rate=1e-3, policy_kwargs=dict(net_arch=[128, 128]))


def learner(**hindsight):
    arms = gym.make_vec("MMCReachGoal-v0", 16, engine="analytic", autoreset_mode="SameStep")
    return SAC("MultiInputPolicy", GymnasiumVecEnv(arms), **settings, **hindsight)


# %%
# Both learn for as long. The only difference is the buffer, which adds to each step four of the
# same movement with another goal: a place where the hand came to later.

plain = learner()
her = learner(
    replay_buffer_class=HerReplayBuffer,
    replay_buffer_kwargs=dict(n_sampled_goal=4, goal_selection_strategy="future"),
)
tests = gym.make_vec("MMCReachGoal-v0", 200, engine="analytic", autoreset_mode="Disabled")


def success(model):
    observation, info = tests.reset(seed=1)
    for _ in range(100):
        action, _ = model.predict(observation, deterministic=True)
        observation, _, _, _, info = tests.step(action)
    return info["is_success"].mean()


curves = {"with hindsight": [success(her)], "without": [success(plain)]}
for name, model in zip(curves, (her, plain)):
    for _ in range(4):
        model.learn(4_800, reset_num_timesteps=False)
        curves[name].append(success(model))
    print(f"{name}: {curves[name][-1]:.0%} of the targets after {model.num_timesteps:,} steps")

# %%
figure, axes = plt.subplots(figsize=(6, 3.6), layout="constrained")
for (name, curve), line in zip(curves.items(), ("o-", "s--")):
    axes.plot(range(0, 24_000, 4_800), [100 * one for one in curve], line, label=name)
axes.set(xlabel="environment steps", ylabel="success [%]", ylim=(-2, 102))
axes.legend()
plt.show()
