"""
How sure can I be of a learning curve?
======================================

That depends on how far training seeds differ. The cards of trained policies keep their evaluations;
the curve is the mean over the seeds, and its band a 95 % bootstrap interval over seeds and
episodes.
"""

import matplotlib.pyplot as plt

from mmc_gym.report.curves import curve_rows, mean_curves, read_cards

# %%
# These are the policies that ship. ``read_cards("runs/mine-*")`` reads your own, which ``mmc-gym
# train`` wrote.

cards = read_cards()
rows = curve_rows(cards)
print(rows.groupby("agent")["seed"].nunique().to_dict())

# %%
# Thin: single trainings of PPO. Thick: their mean, with the interval.

curves = mean_curves(rows, "steps")
figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.8), sharex=True, sharey=True)
figure.set_layout_engine("constrained")
for _, training in rows[rows["agent"] == "ppo"].groupby("seed"):
    left.plot(training["steps"], 100 * training["success"], color="0.6", linewidth=0.7)
for axes, agents in ((left, ["ppo"]), (right, ["ppo", "sac", "tqc-her", "ppo-residual"])):
    for agent, line in zip(agents, ("-", "--", "-.", ":")):
        mean = curves[curves["agent"] == agent]
        label = f"{agent} ({mean['seeds'].iloc[0]} seeds)"
        axes.plot(mean["steps"], 100 * mean["success"], line, linewidth=2, label=label)
        axes.fill_between(mean["steps"], 100 * mean["low"], 100 * mean["high"], alpha=0.25)
    axes.set(xlabel="environment steps", xscale="log")
figure.legend(*right.get_legend_handles_labels(), loc="outside upper center", ncols=4)
left.set_ylabel("success [%]")
plt.show()

# %%
# During learning a single training can be far from the mean; at the end all are alike.

half = rows[(rows["agent"] == "ppo") & (rows["steps"] < 80_000)].groupby("seed")["success"].last()
print(f"before 80,000 steps: {half.min():.0%} to {half.max():.0%}, by the seed alone")
