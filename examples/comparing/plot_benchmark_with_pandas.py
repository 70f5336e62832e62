"""
How do I read a benchmark with pandas?
======================================

Its store is a folder of Parquet files with a row for each episode. ``read_episodes`` reads it into
a data frame, and so does pandas alone. The rest is a groupby.
"""

import tempfile

import matplotlib.pyplot as plt

from mmc_gym.benchmark.runner import benchmark
from mmc_gym.benchmark.store import read_episodes

# %%
# ``mmc-gym benchmark --agents mmc ik-dls mmc-body --scenarios …`` runs the same small benchmark.
# Usually you already have a folder, ``runs/benchmark``.

agents = ["mmc", "ik-dls", "mmc-body"]
scenarios = ["random", "rotation-2", "rotation-10", "longer-6", "locks-2", "hand-mass-6"]
with tempfile.TemporaryDirectory() as folder:
    benchmark(agents, folder, scenarios, episodes=20, jobs=1)
    episodes = read_episodes(folder)
print(episodes.shape, list(episodes.columns[:6]))

# %%
# Success by scenario, and the time to target of the episodes that reach it.

success = episodes.pivot_table(index="environment", columns="agent", values="success")
success = success.loc[scenarios, agents]
print(success.round(2))
print(episodes.groupby("agent")["time_to_target"].describe()[["count", "50%"]].round(2))

# %%
# The i-th episode has the same start and target in all scenarios, so agents can be compared in
# pairs.

figure, axes = plt.subplots(figsize=(9, 3.6), layout="constrained")
(100 * success).plot.bar(ax=axes, rot=0, color=["0.85", "0.55", "0.2"], edgecolor="black")
axes.set(xlabel="scenario", ylabel="success [%]")
axes.legend(loc="upper left", bbox_to_anchor=(1, 1))
pairs = episodes.pivot_table(
    index=["environment", "instance"], columns="agent", values="final_distance"
)
nearer = (pairs["mmc-body"] < pairs["mmc"]).mean()
print(f"mmc-body ends nearer to its target than mmc in {nearer:.0%} of the episodes")
plt.show()
