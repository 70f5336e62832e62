"""The command line: one function for each command.

    mmc-gym compare | benchmark | adapt | report | train | play | record | list | show

A mistake of the user ends with one line on stderr and status 2, a failed cell of a grid with one
line and status 1, Ctrl-C with one line and status 130.  With `MMC_GYM_TRACEBACK=1` in the
environment each ends with the traceback instead, except Ctrl-C while modules are imported.
"""

from __future__ import annotations

import inspect
import os
import sys
import warnings
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from typing_extensions import override
from tyro.conf import Positional

from mmc_gym import _interrupts
from mmc_gym._console import make_console, print_written, progress_bar
from mmc_gym._errors import MismatchWarning, UserError, require, shown, unknown
from mmc_gym._files import import_modules, read_yaml, read_yaml_file
from mmc_gym._grid import CellError
from mmc_gym._tables import print_table, text_table

DESCRIPTION = "Compare agents that reach with a planar arm.  --version alone prints the version."
TRACEBACK = "MMC_GYM_TRACEBACK"
_PAIR = "NAME=VALUE with a value in YAML, such as control=joint_velocity"

_COMPARED = (
    *("mmc-body", "ik-body", "mmc", "mmc-classical", "ik-dls"),
    *("ppo", "sac", "tqc-her", "random"),
)
_WITH_ARGUMENT = ("adapt", "report", "train", "list", "show")


def _check_words(arguments: list[str]) -> None:
    """Raise a `UserError` for a misspelt command or option: tyro would list all options of all."""
    if not arguments or arguments[0].startswith("-"):
        return
    command, *others = arguments
    if command not in COMMANDS:
        raise unknown("command", command, COMMANDS)
    *parameters, more = inspect.signature(COMMANDS[command]).parameters.values()
    names = [parameter.name for parameter in parameters][command in _WITH_ARGUMENT :]
    names += [field.name for field in fields(more.default)]
    known = [f"--{'import' if name == 'imports' else name.replace('_', '-')}" for name in names]
    if others and not others[0].startswith("-") and command not in _WITH_ARGUMENT:
        also = f"; did you mean --agents {others[0]}?" if "--agents" in known else ""
        raise UserError(f"{command} must be followed by options, got {others[0]!r}{also}")
    for text in others:
        option = text.partition("=")[0]
        if option.startswith("--") and option.replace("_", "-") not in (*known, "--help"):
            raise unknown(f"option of {command}", option, known)


def _print_line(message: str) -> None:
    print(f"mmc-gym: {message}", file=sys.stderr)


# Types of options, as help texts show them.
def _arg(metavar: str, **others: Any) -> Any:
    def hint(default: str) -> str:
        return "" if default in ("", "''", "None") else f"(default: {default})"

    return tyro.conf.arg(metavar=metavar, help_behavior_hint=hint, **others)


Names = Annotated[tuple[str, ...], _arg("NAME...")]
Pairs = Annotated[tuple[str, ...], _arg("NAME=VALUE...")]
Modules = Annotated[tuple[str, ...], _arg("MODULE...", name="import")]
Text = Annotated[str | None, _arg("TEXT")]
Shares = Annotated[tuple[float, ...], _arg("X")]
Number = Annotated[int, _arg("N")]
OtherNumber = Annotated[int | None, _arg("N")]
Place = Annotated[Path, _arg("PATH")]
OtherPlace = Annotated[Path | None, _arg("PATH")]
Switch = Annotated[bool, tyro.conf.FlagCreatePairsOff, tyro.conf.arg(help_behavior_hint="")]


@dataclass(frozen=True)
class ImportOptions:
    """The option of commands that look things up by name."""

    imports: Modules = ()
    """Your own modules, imported first."""

    def load(self) -> dict[str, Any]:
        """Import the modules; return the arguments that functions of the package share."""
        import_modules(self.imports)
        return {}


@dataclass(frozen=True)
class EnvironmentOptions(ImportOptions):
    """The options of commands that make environments."""

    env_kwargs: Pairs = ()
    """Arguments of the environment, values in YAML."""

    @override
    def load(self) -> dict[str, Any]:
        super().load()
        env_kwargs: dict[str, Any] = {}
        for text in self.env_kwargs:
            name, _, value = text.partition("=")
            require(name.isidentifier() and bool(value), "env-kwargs", text, _PAIR)
            require(name not in env_kwargs, "env-kwargs", text, f"given once for {name}")
            try:
                env_kwargs[name] = read_yaml(value)  # runs no code
            except ValueError as error:
                raise UserError(f"env-kwargs must be {_PAIR}, got {shown(text)}: {error}") from None
        return {"env_kwargs": env_kwargs}


@dataclass(frozen=True)
class PlayOptions(EnvironmentOptions):
    """The options of commands in which agents play."""

    allow_pickle: Switch = False
    """Load .zip files of stable-baselines3, which may run code."""

    wrapper: Names = ()
    """module:function: wrappers of a model; LABEL=... of one."""

    statistics: Names = ()
    """File of a model's VecNormalize; LABEL=... of one."""

    @override
    def load(self) -> dict[str, Any]:
        loading = {"allow_pickle": self.allow_pickle, "wrapper": self.wrapper}
        return {**super().load(), **loading, "statistics": self.statistics}


NO_IMPORTS, IN_ENVIRONMENT, PLAYED = ImportOptions(), EnvironmentOptions(), PlayOptions()


def compare(
    agents: Names = _COMPARED,
    scenarios: Names = ("random",),
    focus: Names = (),
    episodes: Number = 200,
    seed: Number = 0,
    out: Place = Path("runs/compare"),
    interface: Text = None,
    explain: Switch = False,
    more: PlayOptions = PLAYED,
) -> None:
    """Let agents play the same starts and targets; print a table, write data and figure.

    Args:
        agents: Names; files or folders of policies; .zip files of stable-baselines3; module:name;
            'runs/mine-*' for several trainings of one agent; LABEL=... for another name.
        scenarios: One scenario, such as delay-150; or your own environment, by id, module:Id or
            module:function.
        focus: Agents to compare with each other one; yours by default.
        episodes: Episodes of each agent.
        seed: Seed of the starts and targets.
        out: Folder for the data and the figure.
        interface: module:name; where things are in your own observations.
        explain: Print all of how to read the numbers.
    """
    from mmc_gym.benchmark import compare

    shared = {**more.load(), "interface": interface, "focus": focus, "explain": explain}
    env = _only("scenarios", scenarios, "; benchmark plays several")
    compare.compare(agents, env, episodes, seed, out, make_console(), **shared)


def _only(option: str, values: tuple[str, ...], also: str = "") -> str:
    """Return the only value of an option."""
    if len(values) != 1:
        raise UserError(f"--{option} must be exactly one here{also}, got {' '.join(values)}")
    return values[0]


def benchmark(
    agents: Names = (),
    scenarios: Names = (),
    episodes: Number = 100,
    seed: Number = 0,
    out: Place = Path("runs/benchmark"),
    jobs: OtherNumber = None,
    cluster: Text = None,
    interface: Text = None,
    protocol: Annotated[Literal["", "generalisation", "kinds"], _arg("NAME")] = "",
    suite: Annotated[Literal["", "standard", "faults", "realworld"], _arg("NAME")] = "",
    more: PlayOptions = PLAYED,
) -> None:
    """Let agents play many scenarios; keep every episode in a store, print a ranking.

    Args:
        agents: Names (ppo: all seeds; ppo-3: one) and what compare accepts;
            if not given, all that ship but ppo-drawn and ppo-context.
        scenarios: Names, such as centre-out+delay-150, or your own by id,
            module:Id or module:function; all that ship, if not given.
        episodes: In each scenario; numbered trials once each.
        seed: Seed of the starts and targets.
        out: Folder of the store; an existing benchmark is resumed, or added to.
        jobs: Number of cells at once; one per core, if not given.
        cluster: ray, or ray://HOST:PORT, to play on a Ray cluster.
        interface: Of your own environments, see compare.
        protocol: generalisation: strengths inside, between and beyond the first
            trained ranges. kinds: groups that trainings met, or did not.
        suite: standard, faults or realworld: scenarios played besides.
    """
    from mmc_gym.agents import AGENTS, REFERENCE, resolve_all
    from mmc_gym.benchmark import generalisation, kinds, ranking, runner
    from mmc_gym.benchmark.suite import SUITES

    shared = {**more.load(), "interface": interface}
    failed: list[str] = []
    ranked = [name for name, entry in AGENTS.items() if entry.is_ranked]
    agents = agents or (*ranked, REFERENCE)
    if protocol == "kinds":
        scenarios = (*scenarios, *kinds.protocol())
    elif protocol:
        resolved_agents = resolve_all(agents, allow_pickle=shared["allow_pickle"])
        cards = [agent.card for agent in resolved_agents]
        scenarios = (*scenarios, *generalisation.protocol(cards))
    scenarios = (*scenarios, *SUITES.get(suite, ()))
    with progress_bar() as bar:
        task = bar.add_task("cells")

        def on_progress(progress: runner.Progress) -> None:
            bar.update(task, completed=progress.done, total=progress.total)
            if cell := progress.failed:
                failed.append(f"{cell.agent} in {cell.environment}: {cell.reason}")

        shared |= {"jobs": jobs, "cluster": cluster, "on_progress": on_progress}
        runner.benchmark(agents, out, scenarios, episodes, seed, **shared)
    ranking.print_ranking(make_console(), out)
    if failed:
        number = "a cell" if len(failed) == 1 else f"{len(failed)} cells"
        _print_line(f"{number} failed, and counts as no success: {failed[0]}")
        raise SystemExit(1)


def adapt(
    experiment: Annotated[Positional[str], _arg("NAME")] = "rotation-30",
    agents: Names = ("mmc-body", "mmc", "ppo", "ppo-memory"),
    keep: Names = (),
    rate: Shares = (0.2,),
    retention: Shares = (0.98,),
    learners: OtherPlace = None,
    people: OtherPlace = None,
    subjects: Number = 20,
    seed: Number = 0,
    out: Place = Path("runs/adapt"),
    jobs: OtherNumber = None,
    more: PlayOptions = PLAYED,
) -> None:
    """Let agents learn over the trials of an experiment; print a table, write data and figure.

    Args:
        experiment: Of `list experiments`, or a YAML file.
        agents: See compare.
        keep: Agents that keep their whole memory, such as ppo-memory.
        rate: Share of an error learned; two: fast and slow.
        retention: Share of a state left at the next trial.
        learners: YAML file of what differs, as in "slow: {rate: 0.05}".
        people: CSV of your data in the figure: trial, adaptation.
        subjects: Subjects of each agent; each has another order.
        seed: Seed of the subjects.
        out: Folder; an interrupted run is resumed.
        jobs: Number of agents at once; one per core, if not given.
    """
    import pandas as pd

    from mmc_gym.experiments import trials
    from mmc_gym.experiments.experiment import find_experiment
    from mmc_gym.experiments.results import check_people

    shared, of_people = more.load(), None
    if people is not None:
        of_people = check_people(pd.read_csv(people), find_experiment(experiment))
    shared |= {"rate": rate, "retention": retention, "keep": keep, "jobs": jobs}
    shared["learners"] = None if learners is None else read_yaml_file(learners)
    with progress_bar() as bar:
        task = bar.add_task("agents")
        shared["on_progress"] = lambda done, total: bar.update(task, completed=done, total=total)
        result = trials.run_experiment(experiment, agents, subjects, seed, out, **shared)
    result = replace(result, people=of_people)
    result.print(make_console())
    print_written(make_console(), result.write(out))


def report(
    store: Positional[Place] = Path("runs/benchmark"),
    out: OtherPlace = None,
    focus: Names = (),
    format: Annotated[Literal["html", "md"], _arg("html|md")] = "html",
    yardstick: Annotated[str, _arg("NAME")] = "",
    more: ImportOptions = NO_IMPORTS,
) -> None:
    """Write the report of a benchmark or of experiments: one HTML file, complete in itself.

    Args:
        store: Folder of benchmark or adapt.
        out: The file to write; report.html or report.md in the store if not given.
        focus: The agents that the report is about; your own, or else the first, if not given.
        format: html, or md for the tables in Markdown, as in a pull request.
        yardstick: Agent to whom the others have regret, where one was trained on ranges; the best,
            if not given.
    """
    from mmc_gym import report

    more.load()
    file = out or store / f"report.{format}"
    report.write_report(store, file, focus=focus, format=format, yardstick=yardstick)
    print(f"wrote {file}")


def train(
    name: Annotated[Positional[str], _arg("NAME")] = "",
    env: Text = None,
    on: Text = None,
    seed: Number = 0,
    steps: OtherNumber = None,
    without: Annotated[str | None, _arg("GROUP")] = None,
    out: OtherPlace = None,
    resume: Switch = False,
    tensorboard: OtherPlace = None,
    device: Annotated[str, _arg("TEXT")] = "cpu",
    more: EnvironmentOptions = IN_ENVIRONMENT,
) -> None:
    """Train an agent with YAML hyperparameters; --resume continues a killed training.

    Args:
        name: A name that ships, such as ppo or tqc-her, or your own YAML file: my/ppo-mine.yml.
        env: One of the environment ids in the YAML file; the first, if not given.
        on: Perturbations to train under, drawn for each episode from ranges: rotation--60..60.
        seed: Seed of everything random.
        steps: Environment steps, instead of those in the YAML file.
        without: A group of perturbations to leave out, such as motors.
        out: Folder for checkpoint and policy; runs/NAME-SEED, if not given.
        resume: Continue from the checkpoint in the folder, or begin if there is none.
        tensorboard: Folder for TensorBoard's logs.
        device: For PyTorch: cpu, cuda, cuda:1, auto.
    """
    shared = more.load()
    if on is not None:
        from mmc_gym.envs.names import parse_parts

        entry, changes = parse_parts(on)
        accepted = "perturbations; a task is named by --env"
        require(bool(changes) and entry.name == "random", "on", on, accepted)
        shared["env_kwargs"]["perturbations"] = [change.name for change in changes]
    from mmc_gym.agents.policy import FINAL_EPISODES, file_stem
    from mmc_gym.benchmark.kinds import name_without
    from mmc_gym.training import training

    stem = Path(name).stem if without is None else name_without(Path(name).stem, without)
    folder = out or Path("runs") / file_stem(stem, seed)
    checkpoint = folder / training.CHECKPOINT
    if resume and not checkpoint.exists():
        _print_line(f"nothing to resume, as there is no {checkpoint}: training begins")
    with progress_bar() as bar:
        task = bar.add_task(folder.name)

        def report(progress: training.TrainingProgress) -> None:
            bar.update(task, completed=progress.steps, total=progress.total_steps)
            if scores := progress.evaluation:
                bar.console.print(
                    f"{progress.steps:>10,} steps  success {scores['success']:6.1%}  "
                    f"final distance {scores['final_distance']:.3f}  {scores['seconds']:6.0f} s"
                )

        shared |= {"env": env, "seed": seed, "steps": steps, "without": without}
        shared |= {"out": folder, "resume": resume, "tensorboard": tensorboard}
        shared |= {"device": device, "on_progress": report}
        card = training.train(name, **shared).card
    print(
        f"{folder / card.file_stem}.safetensors: success {card.scores['success']:.1%} over "
        f"{FINAL_EPISODES} fixed episodes after {card.training_steps:,} steps in "
        f"{card.training_seconds:.0f} s"
    )


def play(
    agents: Names = ("mmc",),
    scenarios: Names = ("random",),
    seed: OtherNumber = None,
    more: PlayOptions = PLAYED,
) -> None:
    """Open a window in which the mouse is the target of an agent's arm.

    Args:
        agents: The agent to start with, see compare.
        scenarios: The scenario, see compare.
        seed: Seed of the first posture.
    """
    from mmc_gym.envs.render import open_display

    open_display(must_be_seen=True)  # at once: what follows takes a while to load
    from mmc_gym.record import play

    shared = more.load()
    play(_only("agents", agents), _only("scenarios", scenarios), seed, **shared)


def list_(
    what: Positional[
        Literal[
            "agents", "tasks", "perturbations", "scenarios", "suites", "experiments", "measures"
        ]
    ],
    more: ImportOptions = NO_IMPORTS,
) -> None:
    """List the available agents, tasks, ..., a line each: name, description and needs.

    Args:
        what: The things to list.
    """
    from mmc_gym import listing

    more.load()
    names: listing.Listing = getattr(listing, f"list_{what}")()
    print_table(make_console(), names.table)


def show(
    scenario: Annotated[Positional[str], _arg("NAME")],
    out: OtherPlace = None,
    more: ImportOptions = NO_IMPORTS,
) -> None:
    """Describe a scenario or an experiment: how to make it, what happens, what agents are given.

    Args:
        scenario: Name of a task, of a perturbation with any strength (delay-150), or an id; or
            that of an experiment.
        out: A .png to write, with the first five episodes of the scenario, what they drew above.
    """
    from mmc_gym import listing

    more.load()
    print_table(make_console(), text_table(listing.describe(scenario)))
    if out is not None:
        from mmc_gym.record import picture_draws

        print(f"wrote {picture_draws(scenario, out)}")


def record(
    agents: Names = ("mmc",),
    scenarios: Names = ("random",),
    episodes: Number = 1,
    seed: Number = 0,
    out: Place = Path("runs/film.gif"),
    every: Number = 1,
    interface: Text = None,
    more: PlayOptions = PLAYED,
) -> None:
    """Write a film of agents at work, side by side, as .gif or .mp4; this needs no display.

    Args:
        agents: The agents, see compare.
        scenarios: The scenario, see compare.
        episodes: How many episodes follow each other.
        seed: Seed of the starts and targets; the episodes are those of compare.
        out: The file to write; .mp4 needs the extra "video".
        every: Control steps from one picture to the next; more make a smaller file.
        interface: Of your own environment, see compare.
    """
    from mmc_gym.record import record

    shared = {**more.load(), "interface": interface, "every": every}
    env = _only("scenarios", scenarios)
    with progress_bar() as bar:
        task = bar.add_task("episodes", total=episodes * len(agents))
        record(out, agents, env, episodes, seed, lambda _: bar.advance(task), **shared)
    print(f"wrote {out}")


COMMANDS: dict[str, Callable[..., None]] = {
    command.__name__.rstrip("_"): command
    for command in (compare, benchmark, adapt, report, train, play, list_, show, record)
}


def main(arguments: list[str] | None = None) -> None:
    """Run a command."""
    try:
        try:
            _interrupts.is_running = True
            _run(list(sys.argv[1:] if arguments is None else arguments))
        finally:
            _interrupts.is_running = False
            _flush()
    except BrokenPipeError:  # the reader, such as `head`, has closed the pipe
        raise SystemExit(1) from None
    except (Exception, KeyboardInterrupt) as error:
        message, status = str(error), 2
        if isinstance(error, KeyboardInterrupt) or _interrupts.has_come:
            message, status = "interrupted", 130
        elif isinstance(error, CellError):
            message, status = f"{message.splitlines()[0]} ({TRACEBACK}=1 shows the traceback)", 1
        elif isinstance(error, OSError) and error.strerror:
            message = f"{error.filename}: {error.strerror}"
        elif not isinstance(error, UserError | OSError):
            raise
        if os.environ.get(TRACEBACK):
            raise
        _print_line(message)
        raise SystemExit(status) from error


def _run(arguments: list[str]) -> None:
    if arguments == ["--version"]:
        print(f"mmc-gym {version('mmc-gym')}")
        return
    _check_words(arguments)
    config = (tyro.conf.OmitArgPrefixes,)  # --env-kwargs, not --more.env-kwargs
    with warnings.catch_warnings():
        warnings.showwarning = partial(_show_warning, warnings.showwarning)
        tyro.extras.subcommand_cli_from_dict(
            COMMANDS, prog="mmc-gym", args=arguments, description=DESCRIPTION, config=config
        )


def _flush() -> None:
    """Print what waits; if that fails, drop it, or it fails again when Python ends."""
    try:
        sys.stdout.flush()
    except OSError as error:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        error.filename = "standard output"
        raise


def _show_warning(
    usual: Callable[..., None], message: Warning | str, category: type[Warning], *place: Any
) -> None:
    """Print a `MismatchWarning` as errors are printed: without its place in the code."""
    if issubclass(category, MismatchWarning):
        _print_line(str(message))
    else:
        usual(message, category, *place)


if __name__ == "__main__":
    main()
