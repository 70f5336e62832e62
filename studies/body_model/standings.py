"""Who stands where in the battery: success by family, agents against each of their rivals.

The tables are read from stores of `mmc-gym benchmark`.  The yardstick that is told the truth about
its body has a store of its own, as it is nobody's rival:

    mmc-gym benchmark
    mmc-gym benchmark --out runs/known-body \
        --agents known-body=studies.body_model.known_body:KnownBody
    python -m studies.body_model.standings

Success is the mean over the scenarios of a family, with 95 % intervals over training seeds and
instances.  "24 35 0" against a rival: clearly better in 24 scenarios, no clear difference in 35,
clearly worse in none.  Only scenarios count in which both have a value in half of their episodes.
The last table has the scenarios in which some rival is ahead in success by more than 2 points.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pandas as pd
import tyro
from rich.console import Console
from rich.table import Table

from mmc_gym.benchmark.statistics import Bootstrap
from mmc_gym.benchmark.store import read_episodes
from mmc_gym.report.results import read_results
from mmc_gym.report.scores import SUCCESS, Estimates

COLUMNS = ("known-body", "mmc-body", "ik-body", "optimal-control", "ppo-memory", "ppo", "mmc")
BEHIND = 0.02


@dataclass(frozen=True)
class Arguments:
    """What to print.

    Attributes:
        stores: folders of `mmc-gym benchmark`; rivals are those of the first.
        agents: the columns of success by family, as far as they took part.
        focus: the agents that are compared with each of the others.
    """

    stores: tuple[Path, ...] = (Path("runs/benchmark"), Path("runs/known-body"))
    agents: tuple[str, ...] = COLUMNS
    focus: tuple[str, ...] = ("mmc-body",)


def by_family(arguments: Arguments, estimates: Estimates) -> Table:
    """Return success by family."""
    stores = [store for store in arguments.stores if store.is_dir()]
    episodes = pd.concat([read_episodes(store) for store in stores], ignore_index=True)
    there = set(episodes["agent"])
    agents = [agent for agent in arguments.agents if agent in there]
    families: dict[str, list[str]] = {}
    for key, environment in estimates.results.environments.items():
        families.setdefault(environment.family or "tasks, unperturbed", []).append(key)
    families["all"] = list(estimates.results.environments)
    table = Table(title="success %, mean over the scenarios of a family")
    table.add_column("family", no_wrap=True)
    for agent in agents:
        table.add_column(agent, justify="right")
    for family, keys in families.items():
        if family == "all":
            table.add_section()
        rows = episodes[episodes["environment"].isin(keys) & episodes["agent"].isin(agents)]
        bootstrap = Bootstrap.of(rows, "success")
        found = [bootstrap.estimate(agent, "mean") for agent in agents]
        table.add_row(
            f"{family} ({len(keys)})",
            *(
                f"{100 * one.estimate:.1f} [{100 * one.low:.0f}, {100 * one.high:.0f}]"
                for one in found
            ),
        )
    return table


def against_each(agent: str, estimates: Estimates) -> Table:
    """Return in how many scenarios an agent is better, not clearly different, and worse."""
    shown = [one for one in estimates.results.measures if one.best != "neither"]
    against = estimates.against_each(agent, shown)
    measures = [one for one in shown if any(found[one.name] for found in against.values())]
    table = Table(title=f"{agent} is clearly better, not clearly different, clearly worse than …")
    table.add_column("", no_wrap=True)
    for measure in measures:
        table.add_column(measure.label, justify="right")
    for rival, by_measure in against.items():
        cells = []
        for measure in measures:
            found = by_measure[measure.name]
            cells.append(f"{found['better']} {found['unclear'] + found['equal']} {found['worse']}")
        table.add_row(rival, *cells)
    return table


def behind(agent: str, estimates: Estimates) -> Table:
    """Return where the best rival is ahead, with the interval of the difference."""
    rivals = [
        other
        for other in estimates.results.agents
        if estimates.results.kind(other) not in ("baseline", "ideal") and other != agent
    ]
    table = Table(title=f"{agent} is more than {100 * BEHIND:g} points behind the best rival")
    for heading in ("scenario", agent, "best rival", "its success", "difference"):
        table.add_column(heading, justify="left" if heading == "scenario" else "right")
    for environment in estimates.results.environments:
        one = estimates.compare(environment, SUCCESS, agent, rivals)
        if one is not None and one.difference.estimate < -BEHIND - 1e-9:
            difference, low, high = (100 * value for value in one.difference)
            table.add_row(
                environment,
                f"{100 * one.mine.estimate:.1f}",
                one.rival,
                f"{100 * one.theirs.estimate:.1f}",
                f"{difference:.1f} [{low:.0f}, {high:.0f}]",
            )
    return table


def main(arguments: Arguments) -> None:
    """Print the tables."""
    estimates = Estimates(read_results(arguments.stores[0]))
    console = Console(width=170)
    console.print(by_family(arguments, estimates))
    for agent in arguments.focus:
        console.print(against_each(agent, estimates), behind(agent, estimates))


if __name__ == "__main__":
    main(tyro.cli(Arguments))
