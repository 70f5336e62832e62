"""
How far does learning in one direction generalise?
==================================================

A visuomotor rotation is learned at one target, straight ahead. Probes at eight targets show how
much of it is applied there. In a probe an error clamp keeps the cursor on the straight line,
whatever the hand does, so nothing is learned from it.
"""

import matplotlib.pyplot as plt
import numpy as np

import mmc_gym
from mmc_gym.experiments.experiment import Block, Experiment, Probe

# %%
# Every second trial is a probe, before and after learning.

around = tuple(90.0 + np.array([0, -90, -45, -22.5, 22.5, 45, 90, 180]))
probes = (Probe("transfer", 2, ("clamp-0",), around),)
turned = ("rotation-30",)
experiment = Experiment(
    "short-generalisation",
    (
        Block("baseline", 16, targets=(90,), probes=probes),
        Block("learning", 40, turned, targets=(90,)),
        Block("probing", 32, turned, targets=(90,), probes=probes),
    ),
)
print(repr(experiment))
result = mmc_gym.run_experiment(experiment, ["mmc-body"], subjects=4, jobs=1)

# %%
# The direction of the hand after 0.2 s, less that before learning.

trials = result.trials.copy()
ways = (result.hands[:, 10] - result.hands[:, 0]) @ (1, 1j)
towards = np.exp(1j * np.radians(trials["target_angle"].to_numpy()))
trials["turn"] = np.degrees(np.angle(ways / towards))
trials["offset"] = (trials["target_angle"] - 90 + 180) % 360 - 180
probed = trials[trials["probe"] == "transfer"].pivot_table("turn", "offset", "phase")
learned = probed["baseline"] - probed["probing"]
print(learned.round(1).to_dict())

# %%
# People apply less of it the farther a target is from the trained one. A model of the body knows
# one turn for all directions: it is applied everywhere.

figure, axes = plt.subplots(figsize=(5, 3.2), layout="constrained")
axes.plot(learned.index, learned, "o-", color="black")
axes.axhline(30, color="0.6", linestyle=":", label="complete")
axes.set(xlabel="target, from the trained one [°]", ylabel="turn that is applied [°]", ylim=(0, 36))
axes.legend()
plt.show()
