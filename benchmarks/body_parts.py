"""What each part of `mmc-body` is worth: success with all parts, without one of them, with none.

Episodes are paired: all agents meet the same postures, targets and noise.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import tyro
from rich.console import Console
from rich.progress import track
from rich.table import Table

import mmc_gym  # noqa: F401  registers the environments
from mmc_gym.agents.base import Agent
from mmc_gym.agents.body_model.agent import Parts, ik_body, mmc_body
from mmc_gym.benchmark.suite import find_scenarios
from mmc_gym.interface import ReachInterface
from mmc_gym.measures.rollout import evaluate

SCENARIOS = (
    "random",
    "pursuit",
    "double-step-200",
    "rotation-30",
    "longer-20",
    "locked-2",
    "locks-2",
    "force-field-60",
    "hand-mass-10",
    "gravity-60",
    "joint-noise-0.05",
    "vision-noise-0.1",
    "delay-200",
    "obstacles-2",
)
PARTS = {
    "filters": "no filters",
    "bridges_delay": "no delay",
    "identifies_body": "no body",
    "finds_locks": "no locks",
    "imagines": "no imagination",
    "drives": "no drive",
    "avoids": "no contacts",
}


@dataclass(frozen=True)
class Arguments:
    """What to measure.

    Attributes:
        scenarios: names, see `mmc-gym list scenarios`.
        episodes: of each agent in each scenario.
        seed: of the first episode.
        model: internal model of the agents.
    """

    scenarios: tuple[str, ...] = SCENARIOS
    episodes: int = 200
    seed: int = 30_000
    model: str = "mmc"


def agents(model: str) -> dict[str, Callable[[ReachInterface], Agent[Any]]]:
    """Return what makes each agent, by its heading."""
    build = {"mmc": mmc_body, "ik": ik_body}[model]
    without = {heading: Parts(**{part: False}) for part, heading in PARTS.items()}
    chosen = {"all": Parts(), **without, "none": Parts(**dict.fromkeys(PARTS, False))}
    return {heading: partial(build, parts=parts) for heading, parts in chosen.items()}


def main(arguments: Arguments) -> None:
    """Print the table."""
    table = Table(title=f"{arguments.model}-body: success %, {arguments.episodes} episodes")
    table.add_column("scenario")
    made = agents(arguments.model)
    for heading in made:
        table.add_column(heading, justify="right")
    for scenario in track(list(find_scenarios(arguments.scenarios).values()), transient=True):
        where = (scenario.env_id, {**scenario.arguments, "control": "joint_position"})
        scores = [
            evaluate(make, *where, arguments.episodes, arguments.seed) for make in made.values()
        ]
        table.add_row(scenario.name, *(f"{100 * score['success']:.1f}" for score in scores))
    Console(width=150).print(table)


if __name__ == "__main__":
    main(tyro.cli(Arguments))
