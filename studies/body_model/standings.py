"""Compare the agents of a benchmark: success by family, and each agent with each other.

The tables are read from stores of `mmc-gym benchmark`.  The yardstick, which is given its true
body, has a separate store, because it is not a rival:

    mmc-gym benchmark
    mmc-gym benchmark --out runs/known-body \
        --agents known-body=studies.body_model.known_body:KnownBody
    python -m studies.body_model.standings

Success is the mean over the scenarios of a family, with 95 % intervals over training seeds and
instances.  "24 35 0" means: clearly better than the rival in 24 scenarios, no clear difference in
35, clearly worse in none.  A difference is clear if its 95 % interval (paired by instance) excludes
0, and reaches more than half a unit of the last digit shown.  A scenario counts if both agents have
a value in at least half of their episodes.  The last table lists the scenarios in which the success
of the best rival is more than 2 points higher.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd
import tyro
from rich.console import Console
from rich.table import Table

from mmc_gym.agents.registry import REFERENCE
from mmc_gym.benchmark.statistics import Bootstrap, Estimate
from mmc_gym.benchmark.store import read_episodes, read_manifest
from mmc_gym.measures import MEASURES, Measure, leave_out_failures
from studies.tables import table_of

COLUMNS = ("known-body", "mmc-body", "ik-body", "optimal-control", "ppo-memory", "ppo", "mmc")
BEHIND = 0.02  # success by which the best rival is ahead
PRESENT = 0.5  # share of its episodes in which an agent must have a value
COMMON = 5  # fewest instances on which two agents are compared
NO_RIVALS = ("random", REFERENCE)


@dataclass(frozen=True)
class Arguments:
    """Print the standings."""

    # folders of `mmc-gym benchmark`; rivals are the agents of the first
    stores: tuple[Path, ...] = (Path("runs/benchmark"), Path("runs/known-body"))
    # columns of the table of success by family; those that did not play are left out
    agents: tuple[str, ...] = COLUMNS
    focus: tuple[str, ...] = ("mmc-body",)  # the agents that are compared with each of the others


def by_family(arguments: Arguments) -> Table:
    """Return the table of success by family."""
    stores = [store for store in arguments.stores if store.is_dir()]
    episodes = pd.concat([read_episodes(store) for store in stores], ignore_index=True)
    agents = [agent for agent in arguments.agents if agent in set(episodes["agent"])]
    environments = read_manifest(arguments.stores[0]).environments
    families: dict[str, list[str]] = {}
    for key, settings in environments.items():
        families.setdefault(settings.get("family") or "tasks, unperturbed", []).append(key)
    families["all"] = list(environments)
    table = []
    for family, keys in families.items():
        rows = episodes[episodes["environment"].isin(keys) & episodes["agent"].isin(agents)]
        bootstrap = Bootstrap.of(rows, "success")
        cells = {}
        for agent in agents:
            success = bootstrap.estimate(agent, "mean")
            interval = f"[{100 * success.low:.0f}, {100 * success.high:.0f}]"
            cells[agent] = f"{100 * success.estimate:.1f} {interval}"
        table.append({"family": f"{family} ({len(keys)})", **cells})
    return table_of(table, "success %, mean over the scenarios of a family")


def difference(episodes: pd.DataFrame, measure: Measure, pair: Sequence[str]) -> Estimate | None:
    """Return by how much the first agent of a pair exceeds the second in a measure, in a scenario.

    None if too few of its episodes have a value.
    """
    rows = episodes[episodes["agent"].isin(pair)]
    has_value = rows[measure.name].notna()
    shares = has_value.groupby(rows["agent"]).mean()
    if shares.reindex(list(pair), fill_value=0.0).min() < PRESENT:
        return None
    has_both = rows[has_value].groupby("instance")["agent"].nunique().eq(2)
    common = has_both.index[has_both]
    if len(common) < COMMON:
        return None
    compared = rows[measure.name].where(rows["instance"].isin(common))
    bootstrap = Bootstrap.of(rows.assign(**{measure.name: compared}), measure.name)
    return bootstrap.difference(*pair, measure.statistic)


def judge(estimate: Estimate, measure: Measure) -> str:
    """Return "better", "worse" or "unclear" for a difference, by its interval."""
    low, high = estimate.low, estimate.high
    if measure.best != "high":
        low, high = -high, -low
    hidden = 0.5 * 10.0**-measure.decimals
    if max(-low, high) <= hidden:
        return "unclear"
    return "better" if low > 0 else "worse" if high < 0 else "unclear"


def against_each(agent: str, episodes: pd.DataFrame) -> Table:
    """Return the table of scenarios in which an agent is better, not clearly different, worse."""
    measures = [
        measure
        for measure in MEASURES.values()
        if measure.shown and measure.best != "neither" and measure.name in episodes
    ]
    by_scenario = [rows for _, rows in episodes.groupby("environment", sort=False)]
    table = []
    for rival in rivals_of(agent, episodes):
        row = {"": rival}
        for measure in measures:
            differences = [difference(rows, measure, (agent, rival)) for rows in by_scenario]
            counts = Counter(judge(gap, measure) for gap in differences if gap is not None)
            row[measure.label] = f"{counts['better']} {counts['unclear']} {counts['worse']}"
        table.append(row)
    title = f"{agent} is clearly better, not clearly different, clearly worse than …"
    return table_of(table or [{"": "no rival"}], title)


def behind(agent: str, episodes: pd.DataFrame) -> Table:
    """Return the table of scenarios in which the best rival is ahead."""
    table = []
    for environment, rows in episodes.groupby("environment", sort=False):
        means = rows.groupby("agent", sort=False)["success"].mean()
        rivals = [rival for rival in rivals_of(agent, episodes) if rival in means]
        if agent not in means or not rivals:
            continue
        best = max(rivals, key=lambda rival: means[rival])
        gap = difference(rows, MEASURES["success"], (agent, best))
        if gap is not None and gap.estimate < -BEHIND - 1e-9:
            estimate, low, high = (100 * value for value in (gap.estimate, gap.low, gap.high))
            row = {
                "scenario": str(environment),
                agent: f"{100 * means[agent]:.1f}",
                "best rival": best,
                "its success": f"{100 * means[best]:.1f}",
                "difference": f"{estimate:.1f} [{low:.0f}, {high:.0f}]",
            }
            table.append(row)
    title = f"{agent} is more than {100 * BEHIND:g} points behind the best rival"
    return table_of(table or [{"scenario": "none"}], title)


def rivals_of(agent: str, episodes: pd.DataFrame) -> list[str]:
    """Return the agents to compare with: all others but the random one and the ideal hand."""
    return [other for other in episodes["agent"].unique() if other not in (agent, *NO_RIVALS)]


def main(arguments: Arguments) -> None:
    episodes = leave_out_failures(read_episodes(arguments.stores[0]))
    console = Console(width=170)
    console.print(by_family(arguments))
    for agent in arguments.focus:
        console.print(against_each(agent, episodes), behind(agent, episodes))


if __name__ == "__main__":
    main(tyro.cli(Arguments))
