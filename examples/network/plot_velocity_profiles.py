"""
Do its movements look like those of people?
===========================================

Not without help. The speed of people is bell-shaped. The kinematic network is fastest in its first
iterations and then slows down; velocities in the network (its dynamics) soften the start. A time
base, which scales every iteration, makes the speed bell-shaped.
"""

import matplotlib.pyplot as plt
import numpy as np

from mmc_gym.network import MMCNetwork
from mmc_gym.network.time_base import minimum_jerk, share, timed_step

ITERATIONS = 40
target = [-1.0, 1.5]
posture = [0.3, 0.6, 0.6]

kinematic = MMCNetwork()
dynamic = MMCNetwork(dynamics="paper", velocity_decay=0.92)
ways = {}
for name, network in {"kinematic": kinematic, "dynamic (paper)": dynamic}.items():
    start = network.state_from_joint_angles(posture)
    ways[name] = network.trajectory(start, network.inverse(target), ITERATIONS).segments

# %%
# In each iteration the time base demands the share of the way that a minimum-jerk movement covers.

state = start = kinematic.state_from_joint_angles(posture)
postures = []
for part in share(np.arange(1, ITERATIONS + 1), ITERATIONS):
    state = timed_step(kinematic, state, target, part)
    postures.append(state.segments)
ways["kinematic on a time base"] = np.stack(postures)

# %%
# For comparison, the speed of an ideal hand without an arm.

figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
for (name, segments), line in zip(ways.items(), ("-", "--", "-.")):
    hands = np.vstack([start.end_effector, segments.sum(axis=-2)])
    speed = np.linalg.norm(np.diff(hands, axis=0), axis=-1)
    axes.plot(np.arange(ITERATIONS) + 0.5, speed, line, label=name)
    left = np.linalg.norm(hands[-1] - target)
    print(f"{name}: fastest in iteration {speed.argmax() + 1}, {left:.3f} left at the end")

covered = minimum_jerk(np.arange(ITERATIONS + 1) / ITERATIONS)
length = np.linalg.norm(start.end_effector - target)
ideal = np.diff(covered) * length
axes.plot(np.arange(ITERATIONS) + 0.5, ideal, ":", color="black", label="minimum jerk")
axes.set(xlabel="iteration", ylabel="hand speed [segment lengths/iteration]", ylim=(0, None))
axes.legend()
plt.show()
