"""
How does the network scale from two to ten segments?
====================================================

The same equations hold for any number of segments N: N (N + 1) / 2 vectors, and N − 1 triangles
for each. Arms with more segments need more iterations. With the damping d = N + 1 the linear part
of the network settles without oscillation.
"""

import matplotlib.pyplot as plt
import numpy as np

from mmc_gym.network import MMCNetwork

ITERATIONS, ARMS = 300, 200
random = np.random.default_rng(0)

# %%
# All arms have the length three, so that their tasks are the same: random postures and targets.

radius, angle = 3 * np.sqrt(random.uniform(0, 0.9, ARMS)), random.uniform(0, 2 * np.pi, ARMS)
targets = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)
figure, (left, right) = plt.subplots(1, 2, figsize=(9, 4), layout="constrained")
for count, line in zip((2, 3, 4, 6, 8, 10), ("-", "--", "-.", ":", (0, (5, 1)), (0, (1, 3)))):
    network = MMCNetwork((3 / count,) * count, damping=count + 1)
    start = network.state_from_joint_angles(random.uniform(-1, 1, (ARMS, count)))
    way = network.trajectory(start, network.inverse(targets), ITERATIONS)
    distance = np.linalg.norm(way.segments.sum(axis=-2) - targets, axis=-1)
    median = np.median(distance, axis=1)
    left.plot(median, linestyle=line, label=f"N = {count}")
    needed = int((median < 0.05).argmax()) + 1
    print(f"N = {count}: {start.vectors.shape[-2]} vectors, {needed} iterations to 0.05")
    if count in (3, 10):
        right.plot(*way.state.nodes[0].T, "o-", linewidth=2, label=f"N = {count}")
right.plot(*targets[0], "x", color="black", markersize=12, markeredgewidth=2, label="target")
left.set(xlabel="iteration", ylabel="median distance to target [length of arm / 3]")
left.set(yscale="log", ylim=1e-4)
right.set(xlabel="x [length of arm / 3]", ylabel="y [length of arm / 3]", aspect="equal")
right.set_xlim(-1.5, 1.5)
left.legend()
right.legend(loc="upper right")
plt.show()
