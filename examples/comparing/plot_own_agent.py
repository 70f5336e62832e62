"""
How do I compare my own agent?
==============================

Anything with the ``predict`` of stable-baselines3 is an agent, and so is a plain function of the
observation. Pass it to ``mmc_gym.compare``: it plays the same episodes as the others.
"""

import matplotlib.pyplot as plt
import numpy as np

import mmc_gym

# %%
# This one follows the Jacobian transpose: each joint turns in proportion to how much nearer it
# brings the hand. The first six observations are cosines and sines of the joint angles, and those
# with index 11 and 12 the offset to the target, in the first segment's frame. An action turns each
# joint, between −1 and 1.


def transpose(observation):
    cosines, sines = observation[:3], observation[3:6]
    bends = np.arctan2(sines, cosines)
    bends[0] = 0.0  # in the first segment's frame
    directions = np.cumsum(bends)
    segments = np.stack([np.cos(directions), np.sin(directions)], axis=-1)
    to_hand = np.cumsum(segments[::-1], axis=0)[::-1]  # from each joint to the hand
    x, y = observation[11:13]
    return np.clip(1.5 * (to_hand[:, 0] * y - to_hand[:, 1] * x), -1, 1)


# %%
# The keys of a mapping name the agents. The result prints a table of all measures with intervals,
# and its ``plot()`` draws hand paths and speeds.

comparison = mmc_gym.compare({"mine": transpose, "mmc": "mmc"}, episodes=40)
print(comparison.headline)
print(comparison.to_frame()[["success", "time_to_target", "path_ratio", "velocity_peaks"]].round(2))

# %%
# The table of episodes is a data frame. Here it shows that the same episodes are hard for both.

times = comparison.episodes.pivot(index="episode", columns="agent", values="time_to_target")
figure, axes = plt.subplots(figsize=(4.6, 4.4), layout="constrained")
axes.plot(times["mmc"], times["mine"], "o", fillstyle="none")
axes.axline((0, 0), slope=1, color="0.6", linestyle=":", label="as quick")
axes.set(xlabel="time to target of mmc [s]", ylabel="time to target of mine [s]")
axes.set(xlim=(0, 1.7), ylim=(0, 1.7), aspect="equal")
axes.legend()
plt.show()
