"""
What happens when a joint locks on the way?
===========================================

A network that only imagines its arm continues as if nothing had happened, and misses. `mmc-body`,
which also senses its arm, identifies the locked joint and reaches with the others.
"""

import gymnasium as gym
import matplotlib.pyplot as plt
import numpy as np

import mmc_gym
from mmc_gym.geometry import node_positions, segments_from_joint_angles

# %%
# `locks-2` locks the second joint after 0.2 s. Starts and targets are drawn from seeds; both agents
# get the same 50, and a vector environment plays them all at once.

SEEDS = range(50)
SETTINGS = dict(control="joint_position", perturbations=["locks-2"])
AGENTS = {"mmc": "-", "mmc-body": "--"}
episodes = {}
for name in AGENTS:
    envs = gym.make_vec("MMCReach-v0", len(SEEDS), **SETTINGS)
    episodes[name] = mmc_gym.run_episodes(mmc_gym.make_agent(name, envs), envs, SEEDS)
    reached = [episode.distances[-1] <= episode.tolerance for episode in episodes[name]]
    print(f"{name}: {np.mean(reached):.0%} of {len(SEEDS)} targets reached")

# %%
# The first movement in which they differ: postures at the start (thin), when the joint locks, and
# at the end (thick). A ring marks the locked joint.

mine, theirs = ([episode.distances[-1] for episode in episodes[name]] for name in AGENTS)
seed = next(seed for seed in SEEDS if theirs[seed] < 0.05 and mine[seed] > 0.5)
figure, panels = plt.subplots(1, 3, figsize=(11, 3.8), layout="constrained")
for axes, (name, line) in zip(panels, AGENTS.items()):
    episode = episodes[name][seed]
    nodes = node_positions(segments_from_joint_angles(episode.joint_angles, (1.0, 1.0, 1.0)))
    for step, width in ((0, 1), (10, 2), (-1, 4)):
        axes.plot(*nodes[step].T, "o-", color="0.3", linewidth=width, markersize=width + 2)
        axes.plot(*nodes[step, 1], "o", color="tab:red", markersize=14, fillstyle="none")
    axes.plot(*episode.hands.T, line, color="tab:blue")
    axes.plot(*episode.target, "x", color="black", markersize=12, markeredgewidth=2)
    axes.set(title=name, xlabel="x [segment lengths]", ylabel="y [segment lengths]")
    axes.set(xlim=(-2.2, 2.2), ylim=(-2.2, 2.2), aspect="equal")
    times = np.arange(len(episode.distances)) * episode.control_step
    panels[2].plot(times, episode.distances, line, color="tab:blue", label=name)
panels[2].axvline(0.2, color="tab:red", linestyle=":", label="the joint locks")
panels[2].set(xlabel="time [s]", ylabel="distance to target [segment lengths]")
panels[2].legend()
plt.show()
