"""
How does training become harder as a policy becomes better?
===========================================================

The range from which an episode draws its perturbation grows when the policy copes with its border:
automatic domain randomisation (Akkaya et al. 2019, https://arxiv.org/abs/1910.07113). Here it turns
the cursor by up to 80° after 600,000 steps. The policy is shown the angle.
"""

import matplotlib.pyplot as plt
import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback

import mmc_gym
from mmc_gym.training.vec_env import GymnasiumVecEnv

torch.set_num_threads(1)  # for a network so small, threads wait for each other
arguments = {"observe_context": "rotation--90..90", "engine": "analytic"}


class Widen(BaseCallback):
    """Turns by up to 10° more if 7 in 10 of the widest succeed, and 10° less below 4 in 10."""

    def _init_callback(self):
        self.width, self.border, self.widths = 10, [], [(0, 10)]

    def _on_step(self):
        for info in filter(None, self.locals["infos"]):  # of episodes that have ended
            if abs(info["context"]["rotation"]) > 0.8 * self.width:
                self.border.append(info["is_success"])
        if len(self.border) >= 50:
            share = np.mean(self.border)
            self.width += 10 * (int(share > 0.7 and self.width < 90) - int(share < 0.4))
            self.width = max(self.width, 10)
            self.training_env.set_attr("perturbations", f"rotation-{-self.width}..{self.width}")
            self.widths.append((self.num_timesteps, self.width))
            self.border.clear()
        return True


arms = mmc_gym.make_vec("rotation--10..10", 256, autoreset_mode="SameStep", **arguments)
settings = dict(n_steps=32, batch_size=1024, n_epochs=5, learning_rate=1e-3, gamma=0.9, seed=0)
policy = dict(net_arch=[128, 128], activation_fn=torch.nn.ReLU)
ppo = PPO("MlpPolicy", GymnasiumVecEnv(arms), **settings, ent_coef=0.003, policy_kwargs=policy)
ppo.learn(600_000, callback=(widen := Widen()))

tests = {angle: mmc_gym.make_vec(f"rotation-{angle}", 200, **arguments) for angle in (0, 60, 120)}
shares = []
for angle, test in tests.items():
    observation, info = test.reset(seed=1)
    for _ in range(99):
        observation, *_, info = test.step(ppo.predict(observation, deterministic=True)[0])
    shares.append(f"{angle}°: {np.mean(info['distance'] <= 0.05):.0%}")
print(f"trained up to {widen.width}°; {', '.join(shares)}")

plt.step(*zip(*widen.widths), where="post", color="black")
plt.gca().set(xlabel="environment steps", ylabel="widest turn in training [°]")
plt.show()
