"""
How do I add my own measure?
============================

Decorate a function of an episode. It then appears in comparisons, benchmarks and their report, with
its label, its unit, and intervals.
"""

import matplotlib.pyplot as plt
import numpy as np

import mmc_gym
from mmc_gym.measures import Episode, measure

# %%
# An episode has arrays over its steps: hands, distances, joint angles, rewards and more. Times are
# in seconds, lengths in segment lengths.


@measure(label="half-way time", unit="s", best="low", shown=True, successes_only=True)
def half_way_time(episode: Episode) -> float:
    """Return the seconds until the hand has covered half of its way to the target."""
    half_way = episode.distances <= episode.distances[0] / 2
    return int(half_way.argmax()) * episode.control_step


# %%
# It is a column of the data like any other measure.

comparison = mmc_gym.compare(["mmc", "ik-dls", "minimum-jerk"], episodes=20)
print(comparison.to_frame()[["half_way_time", "time_to_target"]].round(2))

figure, axes = plt.subplots(figsize=(6, 3.6), layout="constrained")
lines = ("-", "--", ":", "-.")
for (agent, rows), line in zip(comparison.episodes.groupby("agent", sort=False), lines):
    times = np.sort(rows["half_way_time"])
    axes.step(times, np.arange(1, len(times) + 1) / len(times), line, where="post", label=agent)
axes.set(xlabel="half-way time [s]", ylabel="share of the episodes", ylim=(0, 1.02))
axes.legend()
plt.show()
