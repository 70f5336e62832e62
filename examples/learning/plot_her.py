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

from mmc_gym.training.policies import FlatObservation
from mmc_gym.training.vec_env import GymnasiumVecEnv

torch.set_num_threads(1)  # for a network so small, threads wait for each other

# %%
# Each step is also learned from with four other goals: places where the hand came to later in the
# same movement. ``FlatObservation`` shows a goal as ``MMCReach-v0`` shows its target, seen from the
# arm; without it learning takes longer.

hindsight = dict(
    replay_buffer_class=HerReplayBuffer,
    replay_buffer_kwargs=dict(n_sampled_goal=4, goal_selection_strategy="future"),
)
policy = dict(net_arch=[128, 128], features_extractor_class=FlatObservation)
policy |= dict(features_extractor_kwargs=dict(joint_count=3))
settings = dict(gamma=0.95, tau=0.01, learning_rate=1e-3, gradient_steps=4, target_entropy=-6.0)
settings |= dict(learning_starts=3_200, ent_coef="auto_0.05", seed=0, policy_kwargs=policy)
arms = gym.make_vec("MMCReachGoal-v0", 16, engine="analytic", autoreset_mode="SameStep")
model = SAC("MultiInputPolicy", GymnasiumVecEnv(arms), **hindsight, **settings)

# %%
# It is tested without exploration on other arms, each of which plays one episode of 100 steps.

tests = gym.make_vec("MMCReachGoal-v0", 200, engine="analytic", autoreset_mode="Disabled")
curve = []
while not curve or model.num_timesteps < 14_400:
    model.learn(4_800, reset_num_timesteps=False)
    observation, info = tests.reset(seed=1)
    for _ in range(100):
        action, _ = model.predict(observation, deterministic=True)
        observation, _, _, _, info = tests.step(action)
    curve.append((model.num_timesteps, info["is_success"].mean()))
print(f"{curve[-1][1]:.0%} of the targets after {curve[-1][0]:,} steps")

# %%
figure, axes = plt.subplots(figsize=(6, 3.6), layout="constrained")
axes.plot(*zip(*[(steps, 100 * share) for steps, share in curve]), "o-", color="black")
axes.set(xlabel="environment steps", ylabel="success [%]", ylim=(-2, 102))
plt.show()
