"""The command line.

    mmc-gym compare | reproduce | train | tune | curves | benchmark | report | play

A mistake of the user's ends with one line on stderr and status 2, a cell of a grid that failed with
one line and status 1, Ctrl-C with one line and status 130.  With `MMC_GYM_TRACEBACK=1` in the
environment, all end with the traceback.
"""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from mmc_gym._console import progress_bar

if TYPE_CHECKING:
    from rich.progress import Progress as Bar


@dataclass(frozen=True)
class Tune:
    """Let Optuna look for better constants; goes on where it stopped."""

    name: Annotated[str, tyro.conf.Positional]
    """What to tune: mmc, mmc-feedback, or what train takes."""
    trials: int = 20
    """Number of trials, those of earlier calls included."""
    steps: int = 200_000
    """Environment steps of each trial."""
    out: Path = Path("runs/tune")
    """Folder for trials and result."""

    def run(self) -> None:
        """Tune, with a progress bar."""
        from mmc_gym.training.tuning import tune

        with progress_bar() as bar:
            task = bar.add_task(f"trials of {self.name}", total=self.trials)

            def on_trial(number: int, value: float) -> None:
                bar.update(task, completed=number + 1)
                bar.console.print(f"trial {number:>3}  time at target {value:6.2%}")

            result = tune(self.name, self.trials, self.steps, self.out, on_trial)
        print(
            f"{result['name']}: time at target {result['best_value']:.2%} with {result['best']}; "
            f"{result['value_of_those_in_use']:.2%} with the constants in use"
        )


# Options of Train that --all has no use for, and that only --all has one for.
_FOR_ONE = ("env", "seed", "tensorboard")
_FOR_ALL = ("jobs", "cluster")


@dataclass(frozen=True)
class Train:
    """Train an agent by its YAML hyperparameters; a killed training goes on with --resume."""

    name: Annotated[str, tyro.conf.Positional] = ""
    """A name that ships, such as ppo or tqc-her, or a YAML file of one's own: my/ppo-mine.yml."""
    all: bool = False
    """Train every policy that ships with the package; goes on where it was interrupted."""
    env: str | None = None
    """Environment id, of those in the YAML file (default: the first)."""
    seed: int = 0
    """Seed of everything random."""
    steps: int | None = None
    """Environment steps, instead of those in the YAML file."""
    out: Path | None = None
    """Folder for checkpoint and policy (default: runs/NAME-SEED, or runs/train-all)."""
    resume: bool = False
    """Go on from the checkpoint in the folder, if there is one; --all always does."""
    tensorboard: Path | None = None
    """Folder for TensorBoard's logs."""
    device: str = "cpu"
    """Device that PyTorch computes on: cpu, cuda, cuda:1, auto."""
    jobs: int | None = None
    """With --all: how many trainings at once (default: one per core)."""
    cluster: str | None = None
    """With --all: "ray", or "ray://HOST:PORT", to train on a Ray cluster."""

    def run(self) -> None:
        """Train, with a progress bar."""
        from mmc_gym.training.hyperparameters import names

        if self.all == bool(self.name):
            raise ValueError(
                f"name must be one of {', '.join(names())}, or the path of a YAML file, "
                f"or else give --all, got {self.name!r}{' and --all' if self.all else ''}"
            )
        for option in _FOR_ONE if self.all else _FOR_ALL:
            if getattr(self, option) != getattr(Train, option):
                other = "a single training" if self.all else "--all"
                raise ValueError(f"--{option} is for {other} only, got {getattr(self, option)}")
        with progress_bar() as bar:
            (self._train_all if self.all else self._train_one)(bar)

    def _train_one(self, bar: Bar) -> None:
        from mmc_gym.agents.policy import FINAL_EPISODES
        from mmc_gym.training.hyperparameters import policy_name, read_hyperparameters
        from mmc_gym.training.training import Progress, Training

        env_id, hyperparameters = read_hyperparameters(self.name, self.env)
        if self.steps is not None:
            hyperparameters["n_timesteps"] = self.steps
        name = policy_name(self.name)
        folder = self.out or Path("runs") / f"{name}-{self.seed}"
        task = bar.add_task(f"{name}, seed {self.seed}")

        def report(progress: Progress) -> None:
            bar.update(task, completed=progress.steps)
            if scores := progress.evaluation:
                bar.console.print(
                    f"{progress.steps:>10,} steps  success {scores['success']:6.1%}  "
                    f"final distance {scores['final_distance']:.3f}  {scores['seconds']:6.0f} s"
                )

        training = Training(
            name,
            hyperparameters,
            env_id,
            self.seed,
            folder,
            report,
            device=self.device,
            tensorboard=self.tensorboard,
        )
        bar.update(task, total=training.total_steps)
        card = training.run(self.resume)
        bar.stop()
        print(
            f"{folder / card.file_stem}.safetensors: success {card.scores['success']:.1%} over "
            f"{FINAL_EPISODES} fixed episodes after {card.training_steps:,} steps in "
            f"{card.training_seconds:.0f} s"
        )

    def _train_all(self, bar: Bar) -> None:
        from mmc_gym.agents.policy import PolicyCard
        from mmc_gym.training.grid import shipped_cells, train_all

        policies = shipped_cells()
        task = bar.add_task("policies", total=len(policies))

        def on_policy(card: PolicyCard) -> None:
            bar.advance(task)
            bar.console.print(
                f"{card.file_stem:<16} success {card.scores['success']:6.1%}  "
                f"{card.training_steps:>10,} steps  {card.training_seconds:6.0f} s"
            )

        def on_note(note: str) -> None:
            bar.console.print(note, markup=False, highlight=False)

        train_all(
            policies,
            self.out or Path("runs/train-all"),
            steps=self.steps,
            device=self.device,
            jobs=self.jobs,
            cluster=self.cluster,
            on_policy=on_policy,
            on_note=on_note,
        )


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
        from mmc_gym.paper.run import reproduce

        reproduce(self.experiments, self.out, self.quick, self.seed, self.jobs)


@dataclass(frozen=True)
class Report:
    """Write the report of a benchmark: one HTML file that needs nothing beside it."""

    store: Path = Path("runs/benchmark")
    """Folder of the benchmark."""
    out: Path | None = None
    """The file to write (default: report.html in the store)."""

    def run(self) -> None:
        """Write."""
        from mmc_gym.report import write_report

        print(f"wrote {write_report(self.store, self.out or self.store / 'report.html')}")


@dataclass(frozen=True)
class Play:
    """Open a window in which the mouse is the target of an agent's arm."""

    agent: str = "mmc"
    """Name of the agent to start with."""
    env: str = "MMCReach-v0"
    """Environment id."""
    seed: int | None = None
    """Seed of the first posture."""

    def run(self) -> None:
        """Play."""
        from mmc_gym.play import play

        play(self.agent, self.env, self.seed)


@dataclass(frozen=True)
class Curves:
    """Learning curves over training seeds; print a table, write it with data and figure."""

    folder: Path | None = None
    """Folder of trained policies (default: those that ship with the package)."""
    out: Path = Path("runs/curves")
    """Folder for curves.csv, trainings.csv, the table and the figure."""

    def run(self) -> None:
        """Draw."""
        from mmc_gym.training.curves import learning_curves

        learning_curves(self.folder, self.out)


@dataclass(frozen=True)
class Compare:
    """Run agents over the same starts and targets; print a table, write data and figure."""

    agents: tuple[str, ...] = (
        "mmc",
        "mmc-classical",
        "mmc-neural",
        "ik-dls",
        "ppo",
        "sac",
        "tqc-her",
        "random",
    )
    """Names of agents, or module:function, called with the environment."""
    env: str = "MMCReach-v0"
    """Environment id."""
    episodes: int = 200
    """Episodes per agent."""
    seed: int = 0
    """Seed of the starts and targets."""
    out: Path = Path("runs/compare")
    """Folder for episodes.csv, the summary and the figure."""

    def run(self) -> None:
        """Compare."""
        from mmc_gym.benchmark.compare import compare

        compare(self.agents, self.env, self.episodes, self.seed, self.out)


@dataclass(frozen=True)
class Benchmark:
    """Let agents play a battery of environments; keep all in a store, and print a ranking."""

    agents: tuple[str, ...] = ()
    """Names (ppo: all its training seeds; ppo-3: one), module:function, or LABEL=NAME."""
    environments: tuple[str, ...] = ()
    """Names of environments of the battery (default: all)."""
    episodes: int = 100
    """Episodes in each environment; numbered trials are played once each."""
    seed: int = 0
    """Seed of the starts and targets."""
    out: Path = Path("runs/benchmark")
    """Folder of the store; a benchmark that is there goes on, or is added to."""
    jobs: int | None = None
    """How many cells at once (default: one per core)."""
    cluster: str | None = None
    """Where, if not here: "ray", or "ray://HOST:PORT", to play on a Ray cluster."""

    def run(self) -> None:
        """Play, with a progress bar, and print the ranking."""
        from mmc_gym._console import make_console
        from mmc_gym.benchmark.entries import default_agents
        from mmc_gym.benchmark.ranking import print_ranking
        from mmc_gym.benchmark.runner import Progress, benchmark

        with progress_bar() as bar:
            task = bar.add_task("cells")

            def report(progress: Progress) -> None:
                bar.update(task, completed=progress.done, total=progress.total)

            benchmark(
                self.agents or default_agents(),
                self.out,
                self.environments,
                self.episodes,
                self.seed,
                jobs=self.jobs,
                cluster=self.cluster,
                on_progress=report,
            )
        print_ranking(make_console(), self.out)


TRACEBACK = "MMC_GYM_TRACEBACK"

Command = (
    Annotated[Compare, tyro.conf.subcommand("compare")]
    | Annotated[Reproduce, tyro.conf.subcommand("reproduce")]
    | Annotated[Train, tyro.conf.subcommand("train")]
    | Annotated[Tune, tyro.conf.subcommand("tune")]
    | Annotated[Curves, tyro.conf.subcommand("curves")]
    | Annotated[Benchmark, tyro.conf.subcommand("benchmark")]
    | Annotated[Report, tyro.conf.subcommand("report")]
    | Annotated[Play, tyro.conf.subcommand("play")]
)


def main(arguments: list[str] | None = None) -> None:
    """Run a command."""
    command: Compare | Reproduce | Train | Tune | Curves | Benchmark | Report | Play = tyro.cli(
        Command, prog="mmc-gym", args=arguments
    )
    try:
        command.run()
    except KeyboardInterrupt:
        if os.environ.get(TRACEBACK):
            raise
        print("mmc-gym: interrupted", file=sys.stderr)
        raise SystemExit(130) from None
    except Exception as error:
        from mmc_gym._grid import CellError

        if os.environ.get(TRACEBACK) or not isinstance(error, (ValueError, OSError, CellError)):
            raise
        message, status = str(error), 2
        if isinstance(error, CellError):
            message, status = f"{message.splitlines()[0]} (where, tells {TRACEBACK}=1)", 1
        print(f"mmc-gym: {message}", file=sys.stderr)
        raise SystemExit(status) from error


if __name__ == "__main__":
    main()
