"""
Can I simulate a million arms?
==============================

Yes. States and targets are arrays with a batch axis, so one call runs a million networks, or
thousands of arms. Here this shows where in its workspace the network is quick.
"""

import time

import gymnasium as gym
import matplotlib.pyplot as plt
import numpy as np

import mmc_gym
from mmc_gym.network import MMCNetwork

# %%
# A million targets all over the disc, from one posture. The network keeps float32, which is twice
# as fast.

COUNT, ITERATIONS = 1_000_000, 20
random = np.random.default_rng(0)
radius, angle = 3 * np.sqrt(random.random(COUNT)), random.uniform(-np.pi, np.pi, COUNT)
targets = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1).astype(np.float32)
network = MMCNetwork(damping=4)
posture = np.array([0.3, 0.6, 0.6], np.float32)
start = network.state_from_joint_angles(posture)

begin = time.perf_counter()
end = network.run(start, network.inverse(targets), ITERATIONS)
seconds = time.perf_counter() - begin
distance = np.linalg.norm(end.end_effector - targets, axis=-1)
print(f"{COUNT:,} networks, {ITERATIONS} iterations each: {seconds:.1f} s")
print(f"{(distance < 0.05).mean():.1%} are within 0.05 of their targets")

# %%
# Targets at the rim, for which the arm must stretch, and targets behind the arm take longer.

figure, axes = plt.subplots(figsize=(5.6, 4.6), layout="constrained")
hexagons = axes.hexbin(*targets.T, C=distance, gridsize=90, vmin=0, vmax=0.3, cmap="Greys")
axes.plot(*start.nodes.T, "o-", color="tab:blue", linewidth=3, label="start")
axes.set(xlabel="target x [segment lengths]", ylabel="target y [segment lengths]", aspect="equal")
figure.colorbar(hexagons, label=f"distance after {ITERATIONS} iterations [segment lengths]")
axes.legend(loc="upper left")
plt.show()

# %%
# The same with bodies: 2,000 simulated arms, driven by as many networks, for half a second.

envs = gym.make_vec("MMCReach-v0", 2_000, engine="analytic")
agent = mmc_gym.make_agent("mmc", envs)
observations, info = envs.reset(seed=0)
state = None
for _ in range(25):
    actions, state = agent.predict(observations, state)
    observations, rewards, terminated, truncated, info = envs.step(actions)
print(f"{info['is_success'].mean():.1%} of {envs.num_envs:,} arms are at their targets after 0.5 s")
