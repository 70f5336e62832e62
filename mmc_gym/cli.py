"""The command line: `mmc-gym compare | reproduce | train | play`."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

ENV_ID = "MMCReach-v0"


@dataclass(frozen=True)
class Compare:
    """Run agents over the same starts and targets; print a table, write data and figure."""

    agents: tuple[str, ...] = ("mmc", "mmc-classical", "mmc-neural", "ik-dls", "ppo", "random")
    """Names of agents, or module:function, called with the environment."""
    env: str = ENV_ID
    """Environment id."""
    episodes: int = 200
    """Episodes per agent."""
    seed: int = 0
    """Seed of the starts and targets."""
    out: Path = Path("runs/compare")
    """Folder for episodes.csv, the summary and the figure."""

    def run(self) -> None:
        """Compare."""
        from mmc_gym.evaluation.compare import compare

        compare(self.agents, self.env, self.episodes, self.seed, self.out)


@dataclass(frozen=True)
class Reproduce:
    """Run the paper's experiments; write figures, data, and a table beside what was published."""

    experiments: Annotated[tuple[str, ...], tyro.conf.Positional] = ()
    """Names of experiments (default: all)."""
    out: Path = Path("runs/reproduce")
    """Folder for figures, data and table; trained networks found in it are not trained again."""
    quick: bool = False
    """Run a small part of each experiment, to see that everything works."""
    seed: int = 0
    """Seed of everything random."""
    jobs: int | None = None
    """Number of processes (default: one per core)."""

    def run(self) -> None:
        """Reproduce."""
        from mmc_gym.paper.reproduce import reproduce

        reproduce(self.experiments, self.out, self.quick, self.seed, self.jobs)


@dataclass(frozen=True)
class Train:
    """Train an agent by its YAML hyperparameters; a killed training goes on with --resume."""

    algorithm: Annotated[str, tyro.conf.Positional]
    """What to train: ppo."""
    env: str = ENV_ID
    """Environment id."""
    seed: int = 0
    """Seed of everything random."""
    steps: int | None = None
    """Environment steps, instead of those in the YAML file."""
    out: Path | None = None
    """Folder for checkpoint and policy (default: runs/ALGORITHM-SEED)."""
    resume: bool = False
    """Go on from the checkpoint in the folder, if there is one."""

    def run(self) -> None:
        """Train, with a progress bar."""
        from rich.progress import (
            BarColumn,
            MofNCompleteColumn,
            TextColumn,
            TimeElapsedColumn,
            TimeRemainingColumn,
        )
        from rich.progress import Progress as Bar

        from mmc_gym.agents.training import Progress, Training, read_hyperparameters

        hyperparameters = read_hyperparameters(self.algorithm, self.env)
        if self.steps is not None:
            hyperparameters["n_timesteps"] = self.steps
        folder = self.out or Path("runs") / f"{self.algorithm}-{self.seed}"
        columns = (
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
        )
        with Bar(*columns, console=Console(stderr=True)) as bar:
            task = bar.add_task(f"{self.algorithm}, seed {self.seed}")

            def report(progress: Progress) -> None:
                bar.update(task, completed=progress.steps)
                if scores := progress.evaluation:
                    bar.console.print(
                        f"{progress.steps:>10,} steps  success {scores['success']:6.1%}  "
                        f"final distance {scores['final_distance']:.3f}  "
                        f"{scores['seconds']:6.0f} s"
                    )

            training = Training(hyperparameters, self.env, self.seed, folder, report)
            bar.update(task, total=training.total_steps)
            card = training.run(self.resume)
        print(
            f"{folder / self.algorithm}.safetensors: success {card.scores['success']:.1%} over "
            f"500 fixed episodes after {card.training_steps:,} steps in "
            f"{card.training_seconds:.0f} s"
        )


@dataclass(frozen=True)
class Play:
    """Open a window in which the mouse is the target of an agent's arm."""

    agent: str = "mmc"
    """Name of the agent to start with."""
    env: str = ENV_ID
    """Environment id."""
    seed: int | None = None
    """Seed of the first posture."""

    def run(self) -> None:
        """Play."""
        from mmc_gym.evaluation.play import play

        play(self.agent, self.env, self.seed)


Command = (
    Annotated[Compare, tyro.conf.subcommand("compare")]
    | Annotated[Reproduce, tyro.conf.subcommand("reproduce")]
    | Annotated[Train, tyro.conf.subcommand("train")]
    | Annotated[Play, tyro.conf.subcommand("play")]
)


def main(arguments: list[str] | None = None) -> None:
    """Run a command; a mistake of the user's ends with one line on stderr and status 2."""
    command: Compare | Reproduce | Train | Play = tyro.cli(Command, prog="mmc-gym", args=arguments)
    try:
        command.run()
    except (ValueError, FileExistsError, FileNotFoundError) as error:
        print(f"mmc-gym: {error}", file=sys.stderr)
        raise SystemExit(2) from error


if __name__ == "__main__":
    main()
