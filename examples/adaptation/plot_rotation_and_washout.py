"""
How is a visuomotor rotation learned, and unlearned?
====================================================

The cursor is the hand, rotated by 30° about the start. An agent that learns from trial to trial
reaches straight again after some trials, and to the other side when the rotation is gone. Such an
after-effect shows that something was retained; an online correction leaves none.
"""

import matplotlib.pyplot as plt

import mmc_gym
from mmc_gym.experiments.experiment import Block, Experiment

# %%
# An experiment is data: blocks of trials. This one is shorter than ``rotation-30``, which ships.
# Each subject reaches for the eight targets in another order.

blocks = (Block("baseline", 8), Block("learning", 48, ("rotation-30",)), Block("washout", 16))
result = mmc_gym.run_experiment(Experiment("short", blocks), ["mmc-body", "ppo"], 4, jobs=1)

# %%
# The timeline above, learning below: how far hands turn against the cursor.

figure = plt.figure(figsize=(7, 4.5), layout="constrained")
result.plot(figure)
plt.show()

# %%
# ``trials`` is a data frame with a row for each trial; ``cursors`` and ``hands`` hold the paths of
# the same rows. Here are the cursors of eight trials at four times.

trials = result.trials
moments = {"baseline": 0, "first turned": 8, "last turned": 48, "first again": 56}
figure, axes = plt.subplots(1, 4, figsize=(8, 2.4), sharex=True, sharey=True, layout="constrained")
for axis, (name, first) in zip(axes, moments.items(), strict=True):
    at = (trials["agent"] == "mmc-body") & trials["trial"].between(first, first + 7)
    for path in result.cursors[at & (trials["subject"] == 0)]:
        axis.plot(*path.T, color="black", linewidth=1)
    axis.set(title=name, aspect="equal", xlabel="x [segment lengths]")
axes[0].set_ylabel("y [segment lengths]")
plt.show()

# %%
# The measures of learning, with 95 % intervals over subjects.

measures = result.measures.pivot(index="label", columns="agent", values=["estimate", "low", "high"])
print(measures["estimate"].round(2))
