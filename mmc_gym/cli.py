"""The command line: one function for each command.

    mmc-gym compare | benchmark | report | train | curves | play | record | list | show

A mistake of the user ends with one line on stderr and status 2, a failed cell of a grid with one
line and status 1, Ctrl-C with one line and status 130.  With `MMC_GYM_TRACEBACK=1` in the
environment each ends with the traceback instead.
"""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro
import yaml
from tyro.conf import Positional

from mmc_gym._console import make_console, print_list, progress_bar
from mmc_gym._errors import MismatchWarning, UserError, require
from mmc_gym._files import import_modules
from mmc_gym._grid import CellError

if TYPE_CHECKING:
    from mmc_gym.agents.policy import PolicyCard
    from mmc_gym.training.hyperparameters import Recipe
    from mmc_gym.training.training import TrainingProgress

DESCRIPTION = "Compare agents that reach with a planar arm.  --version alone prints the version."
TRACEBACK = "MMC_GYM_TRACEBACK"
_PAIR = "NAME=VALUE with a value in YAML, such as control=joint_velocity"

_app = tyro.extras.SubcommandApp()


# Options that commands share.


@dataclass(frozen=True)
class Imports:
    """The option of commands that look things up by name."""

    imports: Annotated[tuple[str, ...], tyro.conf.arg(name="import")] = ()
    """Your own modules to import first, which register environments, tasks, perturbations or
    measures."""

    def load(self) -> None:
        """Import the modules."""
        import_modules(self.imports)


@dataclass(frozen=True)
class World(Imports):
    """The options of commands that make environments."""

    env_kwargs: tuple[str, ...] = ()
    """Arguments of the environment: NAME=VALUE, values in YAML."""

    @property
    def arguments(self) -> dict[str, Any]:
        """The arguments of the environment; reading a value as YAML runs no code."""
        found = {}
        for text in self.env_kwargs:
            name, _, value = text.partition("=")
            try:
                require(name.isidentifier() and bool(value), "env-kwargs", text, _PAIR)
                found[name] = yaml.safe_load(value)
            except yaml.YAMLError as error:
                raise UserError(f"env-kwargs must be {_PAIR}, got {text!r}") from error
        return found


@dataclass(frozen=True)
class Played(World):
    """The options of commands in which agents play."""

    allow_pickle: bool = False
    """Load files that hold pickles, as .zip files of stable-baselines3 do: that runs whatever code
    they name."""


NO_IMPORTS, WORLD, PLAYED = Imports(), World(), Played()


@_app.command
def compare(
    agents: tuple[str, ...] = (
        "mmc-body",
        "ik-body",
        "mmc",
        "mmc-classical",
        "ik-dls",
        "ppo",
        "sac",
        "tqc-her",
        "random",
    ),
    env: str = "MMCReach-v0",
    episodes: int = 200,
    seed: int = 0,
    out: Path = Path("runs/compare"),
    given: Played = PLAYED,
) -> None:
    """Let agents play the same starts and targets; print a table, write data and figure.

    Args:
        agents: Names, files or folders of policies, .zip files of stable-baselines3, module:name;
            'runs/mine-*' for several trainings of one agent, LABEL=... for another name.
        env: Environment id, module:Id or module:function.
        episodes: Episodes per agent.
        seed: Seed of the starts and targets.
        out: Folder for episodes.csv, the summary and the figure.
    """
    from mmc_gym.benchmark import compare

    given.load()
    compare.compare(
        agents,
        env,
        episodes,
        seed,
        out,
        make_console(),
        env_kwargs=given.arguments,
        allow_pickle=given.allow_pickle,
    )


@_app.command
def benchmark(
    agents: tuple[str, ...] = (),
    environments: tuple[str, ...] = (),
    episodes: int = 100,
    seed: int = 0,
    out: Path = Path("runs/benchmark"),
    jobs: int | None = None,
    cluster: str | None = None,
    given: Played = PLAYED,
) -> None:
    """Let agents play many scenarios; keep all in a store, and print a ranking.

    Args:
        agents: Names (ppo: all its training seeds; ppo-3: one), and everything else that compare
            accepts (default: most that ship).
        environments: Names of scenarios, such as random or delay-100, or your own environments, by
            id, module:Id or module:function (default: all scenarios).
        episodes: Episodes in each scenario; numbered trials are played once each.
        seed: Seed of the starts and targets.
        out: Folder of the store; an existing benchmark is resumed, or added to.
        jobs: Number of cells at once (default: one per core).
        cluster: "ray", or "ray://HOST:PORT", to play on a Ray cluster instead of here.
    """
    from mmc_gym.benchmark import ranking, runner, suite

    given.load()
    with progress_bar() as bar:
        task = bar.add_task("cells")
        runner.benchmark(
            agents or suite.default_agents(),
            out,
            environments,
            episodes,
            seed,
            jobs=jobs,
            cluster=cluster,
            env_kwargs=given.arguments,
            allow_pickle=given.allow_pickle,
            on_progress=lambda cells: bar.update(task, completed=cells.done, total=cells.total),
        )
    ranking.print_ranking(make_console(), out)


@_app.command
def report(store: Path = Path("runs/benchmark"), out: Path | None = None) -> None:
    """Write the report of a benchmark: one HTML file that needs nothing beside it.

    Args:
        store: Folder of the benchmark.
        out: The file to write (default: report.html in the store).
    """
    from mmc_gym import report

    print(f"wrote {report.write_report(store, out or store / 'report.html')}")


@_app.command
def train(
    name: Positional[str] = "",
    all: bool = False,
    env: str | None = None,
    seed: int = 0,
    steps: int | None = None,
    out: Path | None = None,
    resume: bool = False,
    tensorboard: Path | None = None,
    device: str = "cpu",
    jobs: int | None = None,
    cluster: str | None = None,
    given: World = WORLD,
) -> None:
    """Train an agent with YAML hyperparameters; --resume continues a killed training.

    Args:
        name: A name that ships, such as ppo or tqc-her, or your own YAML file: my/ppo-mine.yml.
        all: Train every policy that ships (ppo-memory is a study); resumes where interrupted.
        env: One of the environment ids in the YAML file (default: the first).
        seed: Seed of everything random.
        steps: Environment steps, instead of those in the YAML file.
        out: Folder for checkpoint and policy (default: runs/NAME-SEED, or runs/train-all).
        resume: Continue from the checkpoint in the folder, if there is one; --all always does.
        tensorboard: Folder for TensorBoard's logs.
        device: Device that PyTorch computes on: cpu, cuda, cuda:1, auto.
        jobs: With --all: number of trainings at once (default: one per core).
        cluster: With --all: "ray", or "ray://HOST:PORT", to train on a Ray cluster.
    """
    given.load()
    from mmc_gym.training.hyperparameters import names, read_recipe

    if all == bool(name):
        raise UserError(
            f"name must be one of {', '.join(names())}, or the path of a YAML file, "
            f"or else give --all, got {name!r}{' and --all' if all else ''}"
        )
    if all:
        env_kwargs = " ".join(given.env_kwargs)
        _only_for(
            "a single training", env=env, seed=seed, tensorboard=tensorboard, env_kwargs=env_kwargs
        )
        _train_all(out or Path("runs/train-all"), steps, device, jobs, cluster)
    else:
        _only_for("--all", jobs=jobs, cluster=cluster)
        recipe = read_recipe(name, env, steps, given.arguments)
        _train_one(recipe, seed, out, resume, tensorboard, device)


def _only_for(other: str, **options: Any) -> None:
    """Raise a `UserError` if an option of `train` is given that is for something else only."""
    for name, value in options.items():
        if value:
            raise UserError(f"--{name.replace('_', '-')} is for {other} only, got {value}")


def _train_one(
    recipe: Recipe,
    seed: int,
    out: Path | None,
    resume: bool,
    tensorboard: Path | None,
    device: str,
) -> None:
    from mmc_gym.agents.policy import FINAL_EPISODES, file_stem
    from mmc_gym.training.training import Training

    folder = out or Path("runs") / file_stem(recipe.name, seed)
    with progress_bar() as bar:
        task = bar.add_task(f"{recipe.name}, seed {seed}")

        def report(progress: TrainingProgress) -> None:
            bar.update(task, completed=progress.steps)
            if scores := progress.evaluation:
                bar.console.print(
                    f"{progress.steps:>10,} steps  success {scores['success']:6.1%}  "
                    f"final distance {scores['final_distance']:.3f}  {scores['seconds']:6.0f} s"
                )

        training = Training(recipe, seed, folder, report, device=device, tensorboard=tensorboard)
        bar.update(task, total=training.total_steps)
        card = training.run(resume)
    print(
        f"{folder / card.file_stem}.safetensors: success {card.scores['success']:.1%} over "
        f"{FINAL_EPISODES} fixed episodes after {card.training_steps:,} steps in "
        f"{card.training_seconds:.0f} s"
    )


def _train_all(
    out: Path, steps: int | None, device: str, jobs: int | None, cluster: str | None
) -> None:
    from mmc_gym.training import training

    policies = training.shipped_policies()
    with progress_bar() as bar:
        task = bar.add_task("policies", total=len(policies))

        def on_policy(card: PolicyCard) -> None:
            bar.advance(task)
            bar.console.print(
                f"{card.file_stem:<16} success {card.scores['success']:6.1%}  "
                f"{card.training_steps:>10,} steps  {card.training_seconds:6.0f} s"
            )

        training.train_all(
            policies,
            out,
            steps=steps,
            device=device,
            jobs=jobs,
            cluster=cluster,
            on_policy=on_policy,
        )


@_app.command
def curves(folder: Path | None = None, out: Path = Path("runs/curves")) -> None:
    """Draw learning curves over training seeds; write figure and data, print where they end.

    Args:
        folder: Folder of trained policies (default: those that ship with the package).
        out: Folder for curves.csv and the figure.
    """
    from mmc_gym.training.curves import learning_curves

    learning_curves(folder, out)


@_app.command
def play(
    agent: str = "mmc",
    env: str = "MMCReach-v0",
    seed: int | None = None,
    given: Played = PLAYED,
) -> None:
    """Open a window in which the mouse is the target of an agent's arm.

    Args:
        agent: The agent to start with, see compare.
        env: Environment id, module:Id or module:function.
        seed: Seed of the first posture.
    """
    from mmc_gym.envs.render import open_display

    open_display(must_be_seen=True)  # at once: what follows takes a while to load
    from mmc_gym import play

    given.load()
    play.play(agent, env, seed, env_kwargs=given.arguments, allow_pickle=given.allow_pickle)


@_app.command(name="list")
def list_(
    what: Positional[Literal["agents", "tasks", "perturbations", "scenarios", "measures"]],
    given: Imports = NO_IMPORTS,
) -> None:
    """List the available agents, tasks, ..., a line each: name, description and needs.

    Args:
        what: The things to list.
    """
    from mmc_gym import listing

    given.load()
    found: listing.Listing = getattr(listing, f"list_{what}")()
    print_list(make_console(), found.rows, found.headings)


@_app.command
def show(scenario: Positional[str], given: Imports = NO_IMPORTS) -> None:
    """Describe a scenario: how to make it, what happens in it, and what agents are given.

    Args:
        scenario: Name of a task, of a perturbation with any strength (delay-150), or an id.
    """
    from mmc_gym import listing

    given.load()
    print_list(make_console(), listing.describe(scenario))


@_app.command
def record(
    out: Positional[Path],
    agent: str = "mmc",
    env: str = "MMCReach-v0",
    episodes: int = 1,
    seed: int = 0,
    given: Played = PLAYED,
) -> None:
    """Write a film of an agent at work, as .gif or .mp4; this needs no display.

    Args:
        out: The file to write; .mp4 needs the extra "video".
        agent: The agent, see compare.
        env: Environment id, module:Id or module:function.
        episodes: How many episodes follow each other.
        seed: Seed of the starts and targets; the episodes are those of compare.
    """
    from mmc_gym.record import record

    given.load()
    with progress_bar() as bar:
        task = bar.add_task("episodes", total=episodes)
        record(
            out,
            agent,
            env,
            episodes,
            seed,
            lambda _: bar.advance(task),
            env_kwargs=given.arguments,
            allow_pickle=given.allow_pickle,
        )
    print(f"wrote {out}")


def main(arguments: list[str] | None = None) -> None:
    """Run a command."""
    if (sys.argv[1:] if arguments is None else arguments) == ["--version"]:
        print(f"mmc-gym {version('mmc-gym')}")
        return
    try:
        config = (tyro.conf.OmitArgPrefixes,)  # --env-kwargs, not --given.env-kwargs
        with warnings.catch_warnings():
            warnings.showwarning = partial(_show_warning, warnings.showwarning)
            _app.cli(prog="mmc-gym", args=arguments, description=DESCRIPTION, config=config)
    except BrokenPipeError:  # the reader, such as `head`, has closed the pipe
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise SystemExit(1) from None
    except KeyboardInterrupt:
        if os.environ.get(TRACEBACK):
            raise
        print("mmc-gym: interrupted", file=sys.stderr)
        raise SystemExit(130) from None
    except (UserError, OSError, CellError) as error:
        if os.environ.get(TRACEBACK):
            raise
        message, status = str(error), 2
        if isinstance(error, CellError):
            message = f"{message.splitlines()[0]} ({TRACEBACK}=1 shows the traceback)"
            status = 1
        print(f"mmc-gym: {message}", file=sys.stderr)
        raise SystemExit(status) from error


def _show_warning(
    usual: Callable[..., None],
    message: Warning | str,
    category: type[Warning],
    *place: Any,
) -> None:
    """Print a `MismatchWarning` as errors are printed: without its place in the code."""
    if issubclass(category, MismatchWarning):
        print(f"mmc-gym: {message}", file=sys.stderr)
    else:
        usual(message, category, *place)


if __name__ == "__main__":
    main()
