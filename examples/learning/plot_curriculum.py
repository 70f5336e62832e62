"""
How does training become harder as a policy becomes better?
===========================================================

The range that each episode draws its perturbation from grows as soon as the policy copes with its
border: automatic domain randomisation, a callback of twenty lines (Akkaya et al. 2019, *Solving
Rubik's cube with a robot hand*, https://arxiv.org/abs/1910.07113). Here it turns the cursor by up
to 80° after 600,000 steps.
"""

import matplotlib.pyplot as plt
import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback

import mmc_gym
from mmc_gym.training.vec_env import GymnasiumVecEnv

torch.set_num_threads(1)  # for a network so small, threads wait for each other
WIDEST, STEP = 90, 10  # degrees

# %%
# Episodes in the outer fifth of the range decide: it grows if more than 7 in 10 end at the target,
# and shrinks if fewer than 4 do. Arms take the new range as their next episodes begin.


class Widen(BaseCallback):
    """Widens the range of the cursor's turn, or narrows it."""

    def __init__(self):
        super().__init__()
        self.width, self.border, self.history = STEP, [], []

    def _on_step(self):
        for info in filter(None, self.locals["infos"]):  # of episodes that have ended
            if abs(info["context"]["rotation"]) > 0.8 * self.width:
                self.border.append(info["is_success"])
        if len(self.border) >= 50:
            share = np.mean(self.border)
            change = STEP if share > 0.7 else -STEP if share < 0.4 else 0
            self.width = int(np.clip(self.width + change, STEP, WIDEST))
            range_name = f"rotation-{-self.width}..{self.width}"
            self.training_env.set_attr("perturbations", range_name)
            self.history.append((self.num_timesteps, self.width, share))
            self.border.clear()
        return True


# %%
# The policy is shown the angle, on the scale of the widest range: so it can be right, not only
# robust.

shared = {"observe_context": f"rotation-{-WIDEST}..{WIDEST}", "engine": "analytic"}
first = f"rotation-{-STEP}..{STEP}"
arms = mmc_gym.make_vec(first, 256, autoreset_mode="SameStep", **shared)
settings = dict(n_steps=32, batch_size=1024, n_epochs=5, learning_rate=1e-3, gamma=0.9, seed=0)
policy = dict(net_arch=[128, 128], activation_fn=torch.nn.ReLU)
ppo = PPO("MlpPolicy", GymnasiumVecEnv(arms), **settings, ent_coef=0.003, policy_kwargs=policy)
widen = Widen()
ppo.learn(600_000, callback=widen)


# %%
# It is tested without exploration at single angles, half as far again as it was trained.


def success(degrees):
    tests = mmc_gym.make_vec(f"rotation-{degrees}", 200, autoreset_mode="Disabled", **shared)
    observation, info = tests.reset(seed=1)
    for _ in range(100):
        action, _ = ppo.predict(observation, deterministic=True)
        observation, _, _, _, info = tests.step(action)
    return info["is_success"].mean()


angles = range(-120, 121, 15)
found = {degrees: success(degrees) for degrees in angles}
print(f"trained up to {widen.width}°; 0°: {found[0]:.0%}, 60°: {found[60]:.0%}")

# %%
figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.4), layout="constrained")
steps, widths, _ = zip(*widen.history)
left.step([0, *(one / 1000 for one in steps)], [STEP, *widths], where="post", color="black")
left.set(xlabel="thousand environment steps", ylabel="widest turn in training [°]")
right.axvspan(-widen.width, widen.width, color="0.92")
right.plot(angles, [100 * found[one] for one in angles], "o-", color="black")
right.set(xlabel="turn of the cursor [°]", ylabel="success [%]", ylim=(-2, 102))
plt.show()
