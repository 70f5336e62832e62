"""
What is learned from an error that no movement changes?
=======================================================

In an error clamp the cursor misses the target by a fixed angle, whatever the hand does. People who
are told to ignore it still turn their hand away, by much the same angle for all sizes of the error.
A body model that learns a share of every error is different: the larger the error, the farther it
turns, and of the smallest it learns little.
"""

import matplotlib.pyplot as plt
import numpy as np

import mmc_gym
from mmc_gym.experiments.experiment import Block, Experiment

# %%
# One experiment for each size of the error, with the same subjects. Hands are measured after 0.2 s.

hands = {}
for degrees in (3.75, 7.5, 15.0):
    phases = Block("baseline", 8), Block("clamp", 24, (f"clamp-{degrees:g}",)), Block("washout", 8)
    result = mmc_gym.run_experiment(Experiment("short-clamp", phases), ["mmc-body"], 2, jobs=1)
    ways = (result.hands[:, 10] - result.hands[:, 0]) @ (1, 1j)
    towards = np.exp(1j * np.radians(result.trials["target_angle"].to_numpy()))
    turns = -np.degrees(np.angle(ways / towards))
    hands[degrees] = turns.reshape(2, -1).mean(axis=0)
    print(f"clamp of {degrees:g}°: hands turned by {hands[degrees][24:32].mean():.0f}°")

# %%
# The hands turn away from the cursor, and come back in the washout.

figure, axes = plt.subplots(figsize=(6, 3.4), layout="constrained")
for degrees, turns in hands.items():
    axes.plot(turns, label=f"{degrees:g}°")
for begin in (7.5, 31.5):
    axes.axvline(begin, color="0.7", linewidth=0.8)
axes.set(xlabel="trial", ylabel="hand, away from the cursor [°]")
axes.legend(title="error clamp")
plt.show()
