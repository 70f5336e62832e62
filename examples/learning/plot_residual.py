"""
What does a policy on top of the network save?
==============================================

It need not learn to reach. ``ppo-residual`` sees the action that the network proposes, and corrects
it. So it reaches from the first step, and only learns to be quicker. PPO alone has to learn
everything.
"""

import matplotlib.pyplot as plt

import mmc_gym
from mmc_gym.report.curves import read_cards

# %%
# During training each policy was evaluated in the same 200 episodes, and its card has the results.
# ``python -m studies.learners.train_all --names ppo-residual`` trains them, from a clone.

cards = read_cards()
for name in ("ppo-residual", "ppo"):
    first = cards[name][0].learning_curve[0]
    print(f"{name}: {first['success']:.0%} of the targets after {first['steps']:,} steps")

# %%
# The network proposes an action in every step. The policy learns only what to add to it.

comparison = mmc_gym.compare(["mmc", "ppo-residual", "ppo"], episodes=40)
print(comparison.to_frame()[["success", "time_to_target", "path_ratio", "joint_work"]].round(2))
alone = comparison.recorded["mmc"]
share = sum((episode.distances[1:] <= episode.tolerance).mean() for episode in alone) / len(alone)

# %%
# Five trainings of each. A policy that is quicker than the network is at the target for longer.

figure, panels = plt.subplots(1, 2, figsize=(9, 3.6), sharex=True, layout="constrained")
for name, line in {"ppo-residual": "-", "ppo": "--"}.items():
    for card in cards[name][:5]:
        steps = [row["steps"] / 1000 for row in card.learning_curve]
        for axes, score in zip(panels, ("success", "time_at_target")):
            scores = [100 * row[score] for row in card.learning_curve]
            label = name if card.seed == 0 else None
            axes.plot(steps, scores, line, color="black", linewidth=1, label=label)
panels[1].axhline(100 * share, color="tab:red", linestyle=":", label="mmc alone")
for axes, label in zip(panels, ("success [%]", "time at the target [%]")):
    axes.set(xlabel="environment steps [1,000]", ylabel=label, ylim=(-2, 102))
panels[1].legend()
plt.show()
