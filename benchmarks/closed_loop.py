"""What closing each loop buys: success and time to target of agents under every perturbation.

Episodes are paired: all agents meet the same postures, targets and noise.  Where a joint locks on
the way ("locks"), about a third of the targets are out of reach from then on.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import Any

import gymnasium as gym
import numpy as np
import tyro
from rich.console import Console
from rich.progress import track
from rich.table import Table

import mmc_gym  # registers the environments
from mmc_gym.agents.base import Agent
from mmc_gym.agents.closed_loop.agent import ClosedLoopInverseKinematicsAgent, closed_loop_mmc
from mmc_gym.agents.closed_loop.observer import Loops
from mmc_gym.agents.ik.iterative import damped_least_squares
from mmc_gym.envs.scenarios import PERTURBATION_NAMES, environment_id
from mmc_gym.interface import ReachInterface
from mmc_gym.measures.rollout import evaluate

AGENTS = (
    "mmc",
    "mmc-feedback",
    "mmc-delay",
    "mmc-lengths",
    "mmc-lock",
    "mmc-closed",
    "ik-dls",
    "ik-dls-feedback",
)
TUNING_SEED = 20_000
TUNING_SET = (
    "none",
    "force-field",
    "hand-mass",
    "rotation-30",
    "rotation-45",
    "longer-20",
    "longer-50",
    "shorter-20",
    "shorter-50",
    "locked",
    "locks",
    "joint-noise",
    "vision-noise",
    "delay-100",
    "obstacles",
)
WEIGHTS = (0.0, 0.125, 0.25, 0.5, 1.0)
RATES = (0.15, 0.3, 0.6, 1.0)

MakeAgent = Callable[[ReachInterface], Agent[Any]]


@dataclass(frozen=True)
class Arguments:
    """What to measure.

    Attributes:
        agents: names.
        perturbations: names; "none" is the arm as it is told.
        episodes: of each agent under each perturbation.
        seed: of the first episode; 20,000 and following are what the weights were tuned on.
        task: name of the task.
        control: control mode.
        steps: control steps of an episode.
        tune: print the table that weight and rate of the feedback were chosen by instead.
    """

    agents: tuple[str, ...] = AGENTS
    perturbations: tuple[str, ...] = ("none", *PERTURBATION_NAMES)
    episodes: int = 200
    seed: int = 30_000
    task: str = "random"
    control: str = "joint_position"
    steps: int = 100
    tune: bool = False


@dataclass(frozen=True)
class Outcome:
    """Of all episodes of an agent.

    Attributes:
        success: percent of episodes that end within the success distance.
        time: median time after which the hand stays there, of those that succeed, s.
    """

    success: float
    time: float


def settings(perturbation: str, arguments: Arguments) -> dict[str, Any]:
    """Return the arguments of the environment."""
    names = [] if perturbation == "none" else [perturbation]
    return {"perturbations": names, "control": arguments.control}


def measure(make: MakeAgent, perturbation: str, arguments: Arguments, seed: int) -> Outcome:
    """Let an agent play all episodes side by side."""
    scores = evaluate(
        make,
        environment_id(arguments.task),
        {**settings(perturbation, arguments), "max_episode_steps": arguments.steps},
        arguments.episodes,
        seed,
    )
    return Outcome(100 * scores["success"], scores.get("time_to_target", math.nan))


def comparison(arguments: Arguments) -> Table:
    """Agents by perturbations."""
    table = Table(title=f"success %, median time to target / s ({arguments.episodes} episodes)")
    table.add_column("perturbation")
    for name in arguments.agents:
        table.add_column(name, justify="right")
    for perturbation in track(arguments.perturbations, transient=True):
        cells = []
        for name in arguments.agents:
            env = gym.make(environment_id(arguments.task), **settings(perturbation, arguments))
            agent = mmc_gym.make_agent(name, env)
            outcome = measure(lambda _, a=agent: a, perturbation, arguments, arguments.seed)
            time = "–" if np.isnan(outcome.time) else f"{outcome.time:.2f}"
            cells.append(f"{outcome.success:.1f} {time:>4}")
        table.add_row(perturbation, *cells)
    return table


def tuning(arguments: Arguments) -> Table:
    """Weights and rates of the feedback, by mean success and by what is lost where most is."""
    makers: dict[str, Callable[[ReachInterface, Loops], Agent[Any]]] = {
        "mmc": closed_loop_mmc,
        "ik-dls": partial(ClosedLoopInverseKinematicsAgent, solver=damped_least_squares),
    }
    table = Table(title=f"feedback, {len(TUNING_SET)} conditions")
    for heading in ("agent", "weight", "rate", "mean success %", "largest loss", "where"):
        table.add_column(heading, justify="right")
    pairs = [(0.0, 0.0), *product(WEIGHTS, RATES)]
    for kind, (weight, rate) in track([*product(makers, pairs)], transient=True):
        loops = Loops(posture_weight=weight, hand_rate=rate)
        scores = np.array(
            [
                measure(
                    lambda told, k=kind, c=loops: makers[k](told, c),
                    perturbation,
                    arguments,
                    TUNING_SEED,
                ).success
                for perturbation in TUNING_SET
            ]
        )
        if not weight and not rate:
            open_loop = scores
        losses = open_loop - scores
        worst = int(losses.argmax())
        table.add_row(
            kind,
            f"{weight:g}",
            f"{rate:g}",
            f"{scores.mean():.1f}",
            f"{losses[worst]:.1f}",
            TUNING_SET[worst] if losses[worst] > 0 else "",
        )
    return table


def main(arguments: Arguments) -> None:
    """Print the table."""
    Console(width=160).print(tuning(arguments) if arguments.tune else comparison(arguments))


if __name__ == "__main__":
    main(tyro.cli(Arguments))
