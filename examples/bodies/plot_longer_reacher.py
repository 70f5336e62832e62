"""
How well does an agent reach if a link is longer than given?
============================================================

Gymnasium's ``Reacher-v5`` takes another model, here one whose second link is 20 % longer, and
:doc:`../reacher` says how agents see and move its arm. ``mmc-body`` sees its hand as well as
its joints, and identifies the length. Plain inverse kinematics with the same servo does not.
"""

import tempfile
from pathlib import Path

import gymnasium as gym
import matplotlib.pyplot as plt
import numpy as np

from mmc_gym import make_agent

model = Path(gym.make("Reacher-v5").unwrapped.fullpath).read_text()
with tempfile.TemporaryDirectory() as folder:
    file = Path(folder) / "longer.xml"
    file.write_text(model.replace('pos="0.11 0 0"', 'pos="0.132 0 0"'))
    env = gym.make("Reacher-v5", xml_file=str(file))

# %%
# The last two numbers of an observation are the vector from the target to the hand, in metres.

distances = {}
for name in ("mmc-body", "ik-body", "ik-dls"):
    agent = make_agent(name, env, interface="examples.reacher:INTERFACE")
    distances[name] = np.zeros((20, 51))
    for seed, row in enumerate(distances[name]):
        observation, _ = env.reset(seed=seed)
        state, row[0] = None, np.hypot(*observation[8:])
        for step in range(1, 51):
            action, state = agent.predict(observation, state)
            observation, *_ = env.step(action)
            row[step] = np.hypot(*observation[8:])
    print(f"{name}: {1000 * np.median(distances[name][:, -1]):.1f} mm from the target")

# %%
# Thin lines are episodes, thick ones their median.

figure, panels = plt.subplots(1, 3, figsize=(9, 3.2), layout="constrained", sharey=True)
for axes, (name, rows) in zip(panels, distances.items()):
    axes.semilogy(np.arange(51) / 50, 1000 * rows.T, color="0.8", linewidth=0.7)
    axes.semilogy(np.arange(51) / 50, 1000 * np.median(rows, axis=0), color="black")
    axes.set(title=name, xlabel="time [s]", ylim=(0.1, 500))
panels[0].set_ylabel("distance to the target [mm]")
plt.show()
