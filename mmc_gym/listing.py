"""List what is available, a line each, and describe one scenario in detail."""

from __future__ import annotations

import inspect
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import fields
from typing import TYPE_CHECKING, Any, NamedTuple

from mmc_gym._errors import UserError
from mmc_gym._tables import Table, text_table, to_html
from mmc_gym.agents import AGENTS, AgentEntry
from mmc_gym.envs.changes import Change
from mmc_gym.envs.episodes import EXAMPLES
from mmc_gym.envs.names import TASKS, environment_id
from mmc_gym.envs.perturbations import FAMILIES
from mmc_gym.envs.scenarios import Playable, Scenario, find_scenario, name_of
from mmc_gym.envs.tasks import Task

if TYPE_CHECKING:
    from mmc_gym.measures import Measure


class Listed(NamedTuple):
    """A line of a list."""

    name: str
    what: str
    needs: str


class Listing(list[str]):
    """Names; a notebook shows them as a table with `headings` and `rows`, a line for each name."""

    def __init__(self, headings: Listed, rows: Iterable[Listed]) -> None:
        self.headings, self.rows = headings, tuple(rows)
        super().__init__(row.name for row in self.rows)

    @property
    def table(self) -> Table:
        """The headings and rows as a table of texts."""
        return text_table(self.rows, self.headings)

    def _repr_html_(self) -> str:
        return to_html(self.table)


def list_agents() -> Listing:
    """Return the names of all agents.

    >>> list_agents()[:3]
    ['mmc-body', 'ik-body', 'mmc']
    """

    def needs(entry: AgentEntry) -> str:
        if entry.training_seeds:
            return f"{entry.control}, 3 joints"
        return "lengths, servo" if entry.knowledge.lengths.startswith("given") else "nothing"

    rows = (Listed(name, entry.description, needs(entry)) for name, entry in AGENTS.items())
    return Listing(Listed("agent", "what it is", "needs"), rows)


def list_tasks() -> Listing:
    """Return the names of all tasks; `task=NAME` of an environment takes them."""
    rows = (Listed(name, entry.description, _episodes(entry.task)) for name, entry in TASKS.items())
    return Listing(Listed("task", "what it is", "episodes"), rows)


def _episodes(task: Task) -> str:
    count = "drawn" if task.trial_count is None else f"{task.trial_count} trials"
    return f"{task.episode_steps} steps, {count}"


def list_perturbations() -> Listing:
    """Return the names of all perturbations; `perturbations=[NAME]` takes them, of any strength.

    >>> next(row for row in list_perturbations().rows if row.name == "rotation")
    Listed(name='rotation', what='cursor turned by 30°', needs='°')
    """
    rows = []
    for name, family in FAMILIES.items():
        what = family.description.format(f"{family.default:g}")
        rows.append(Listed(name, what, ", ".join((family.unit, *family.endings))))
    return Listing(Listed("perturbation", "what it is", "strength in, endings"), rows)


def list_scenarios() -> Listing:
    """Return the names of the benchmark's scenarios and of all tasks without perturbations.

    Perturbations of any other strength work, too.
    """
    from mmc_gym.benchmark.suite import SCENARIOS

    scenarios = SCENARIOS | {name: Scenario(task) for name, task in TASKS.items()}
    rows = (
        Listed(name, scenario.description, _episodes(scenario.task.task))
        for name, scenario in scenarios.items()
    )
    return Listing(Listed("scenario", "what it is", "episodes"), rows)


def list_suites() -> Listing:
    """Return the names of the benchmark's suites and protocols: scenarios that belong together."""
    from mmc_gym.benchmark.suite import SUITES

    suites = {
        "standard": "tasks, and perturbations of cursor, body and senses",
        "faults": "motors and senses that fail, in a few strengths each",
        "realworld": "the combined challenges of the Real-World RL suite",
    }
    rows = [Listed(name, suites[name], f"--suite, {len(SUITES[name])}") for name in SUITES]
    what = "strengths inside, between and beyond the trained ranges"
    rows.append(Listed("generalisation", what, "--protocol"))
    rows.append(Listed("kinds", "groups that trainings met, or did not", "--protocol"))
    return Listing(Listed("suite", "what it is", "option, scenarios"), rows)


def list_experiments() -> Listing:
    """Return the names of experiments over trials, each of any strength."""
    from mmc_gym.experiments.experiment import EXPERIMENTS, find_experiment

    rows = []
    for name in EXPERIMENTS:
        experiment = find_experiment(name)
        rows.append(Listed(name, experiment.description, f"{len(experiment.schedule)} trials"))
    return Listing(Listed("experiment", "what it is", "length"), rows)


def list_measures() -> Listing:
    """Return the names of all measures of an episode, yours included."""
    from mmc_gym.measures import MEASURES

    rows = (Listed(name, measure.full_label, _unit(measure)) for name, measure in MEASURES.items())
    return Listing(Listed("measure", "what it is", "unit"), rows)


def _unit(measure: Measure) -> str:
    """Return the unit of a measure, which of its values are good, and if only successes count."""
    unit = "" if measure.full_label != measure.label else measure.shown_unit
    best = "" if measure.best == "neither" else f"{measure.best} is good"
    arrived = "successes" if measure.successes_only else ""
    return ", ".join(filter(None, (unit, best, arrived)))


def describe(name: str) -> Iterator[tuple[str, str]]:
    """Yield headings and texts that describe what has a name: scenario, experiment, or both."""
    if name in AGENTS and name not in TASKS:
        raise UserError(
            f"scenario {name!r} is not accepted: it is an agent. `mmc-gym list agents` describes "
            "it, `mmc-gym list scenarios` has what can be shown"
        )
    from mmc_gym.experiments.experiment import find_experiment

    rows: list[tuple[str, str]] = []
    try:
        experiment = str(find_experiment(name))
        rows = [("experiment", experiment), ("run it", f"mmc-gym adapt {name}")]
    except UserError:
        if name.endswith((".yml", ".yaml")):  # nothing else is in a file
            raise
    try:
        scenario = find_scenario(name)
    except UserError:
        if not rows:
            raise
    else:
        yield from _describe_scenario(scenario)
    yield from rows


def _describe_scenario(scenario: Playable) -> Iterator[tuple[str, str]]:
    """Yield headings and texts that describe a scenario, or an environment of your own."""
    env = scenario.make()
    setup: Any = env.get_wrapper_attr("setup")
    task, control_step = setup.task, setup.given_body.control_step
    yield scenario.name, scenario.description
    yield "make it", "\n".join(_ways_to_make(scenario))
    task_name = scenario.task.name if isinstance(scenario, Scenario) else type(task).__name__
    yield "task", f"{task_name}: {_about(type(task))}"
    for change in scenario.changes:
        about = [change.family.apply, *([Change] if change.is_timed else [])]
        yield "perturbation", f"{change.name}: {' '.join(map(_about, about))}"
    if setup.episodes.is_drawn:
        contexts = [env.reset(seed=seed)[1]["context"] for seed in range(EXAMPLES)]
        yield "for example", "\n".join(map(_context_line, contexts))
    headings = {"delay": "delay", "vision_delay": "delay of sight"}
    headings["action_delay"] = "delay of actions"
    for column, delay in setup.limits.delays.items():
        if delay:
            yield headings[column], f"{delay} control steps, {1000 * delay * control_step:g} ms"
    yield "agents", "\n".join(_given(scenario, setup))
    trials = "are drawn" if task.trial_count is None else f"are those of {task.trial_count} trials"
    steps = task.episode_steps
    length = f"{steps} steps of {control_step:g} s ({steps * control_step:g} s)"
    yield "episodes", f"{length}; starts and targets {trials}"
    for kind in ("action", "observation"):
        space = getattr(env, f"{kind}_space")
        low, high = space.low.min(), space.high.max()
        yield f"{kind}s", f"{space.shape[0]} numbers, {space.dtype}, within {low:g} and {high:g}"
    env.close()


def _about(described: object) -> str:
    """Return the docstring of a class or function in one line, without its "Attributes" section."""
    text = inspect.getdoc(described) or ""
    return " ".join(text.partition("Attributes:")[0].split())


def _context_line(context: Mapping[str, float]) -> str:
    return ", ".join(f"{name} {value:.3g}" for name, value in context.items() if value == value)


def _ways_to_make(scenario: Playable) -> Iterator[str]:
    """Yield code and commands; the first line needs nothing but the name."""
    names = ", ".join(f'"{change.name}"' for change in scenario.changes)
    changes = f", perturbations=[{names}]" if names else ""
    if isinstance(scenario, Scenario):
        env_id = environment_id(scenario.task.name)
    else:
        env_id = name_of(scenario.env)
    yield f'mmc_gym.make("{scenario.name}")'
    yield f'gym.make("{env_id}"{changes})'
    yield f"mmc-gym benchmark --scenarios {scenario.name}"


def _given(scenario: Playable, setup: Any) -> Iterator[str]:
    """Yield what agents are given, and how the simulated arm differs from that."""
    if not scenario.changes:
        yield "are given the arm as it is"
        return
    for change in scenario.changes:
        subject = "the perturbation" if len(scenario.changes) == 1 else change.name
        can_be_given = change.family.known and not (change.known or change.is_drawn)
        hint = f"; with {change.name}-known they are" if can_be_given else ""
        yield f"are {'' if change.known else 'not '}given {subject}{hint}"
    for field in fields(setup.given_body) if not setup.episodes.is_drawn else ():
        given_value = getattr(setup.given_body, field.name)
        true_value = getattr(setup.first.body, field.name)
        if given_value != true_value:
            yield f"{field.name}: {_short(true_value)}, given {_short(given_value)}"


def _short(value: Any) -> str:
    if isinstance(value, tuple):
        return f"({', '.join(map(_short, value))})"
    return f"{value:g}" if isinstance(value, float) else str(value)
