"""
How does the network settle in space?
=====================================

A robot's arm is a chain of hinges in space: ``HingeArm`` describes one, here the seven hinges of a
Franka Emika Panda. The network is asked for a posture with the hand at a place. Eight networks that
start from different postures settle at once, each within the limits of its joints; the arm is
redundant, so each finds its own posture. One is stuck at its limits: ``solve`` starts from many.
"""

import matplotlib.pyplot as plt
import numpy as np

from mmc_gym.robots import HingeArm, HingeNetwork

STARTS, SHOWN, LAST = 8, (0, 5, 60), 60
arm = HingeArm.named("panda")
network = HingeNetwork(arm, damping=5.0, velocity_decay=0.5)
target = np.array([0.45, 0.25, 0.5])  # metres

# %%
# A state holds all postures; a task is what the network is clamped to.

random = np.random.default_rng(0)
states = [network.state(random.uniform(*arm.limits.T, (STARTS, 7)))]
clamps = network.clamp(position=np.tile(target, (STARTS, 1)))
for _ in range(LAST):
    states.append(network.run(states[-1], clamps, 1))
postures = np.array([state.joint_angles for state in states])
distances = np.linalg.norm(arm.forward(postures)[..., :3, 3] - target, axis=-1)
spread = np.ptp(postures[-1], axis=0).max()
print(f"after {LAST} iterations: {(distances[-1] < 1e-3).sum()} of {STARTS} hands within 1 mm")
print(f"postures differ by up to {spread:.1f} rad in a joint")

# %%
# Base, shoulder, elbow, wrist and hand of the eight arms: at the start, on the way, and settled.

figure = plt.figure(figsize=(11, 9))
for place, iteration in enumerate(SHOWN, start=1):
    axes = figure.add_subplot(2, 2, place, projection="3d")
    for number, nodes in enumerate(arm.nodes(postures[iteration])):
        nodes = np.vstack([np.zeros(3), nodes])
        line = ("-", "--", "-.", ":")[number % 4]
        axes.plot(*nodes.T, line, color=plt.cm.viridis(number / STARTS), marker="o", linewidth=2)
    axes.plot(*target, "kx", markersize=14, markeredgewidth=3, zorder=9)
    axes.set(title=f"iteration {iteration}", xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    axes.set(xlim=(-0.7, 0.7), ylim=(-0.7, 0.7), zlim=(0, 1.1))
    axes.set_box_aspect((1.4, 1.4, 1.1), zoom=1.15)
axes = figure.add_axes((0.6, 0.09, 0.37, 0.36))
for number, way in enumerate(distances.T):
    line = ("-", "--", "-.", ":")[number % 4]
    axes.semilogy(way, line, color=plt.cm.viridis(number / STARTS), linewidth=2)
axes.set(xlabel="iteration", ylabel="distance of the hand from the target [m]")
figure.subplots_adjust(left=0.02, right=0.96, bottom=0.04, top=0.96, wspace=0.05)
plt.show()
