"""List what is available, a line each, and describe one scenario in detail."""

from __future__ import annotations

import inspect
from collections.abc import Iterable, Iterator
from dataclasses import fields
from typing import TYPE_CHECKING, Any, NamedTuple

import gymnasium as gym

from mmc_gym.agents import AGENTS, AgentEntry
from mmc_gym.envs.perturbations import FAMILIES, Family
from mmc_gym.envs.scenarios import (
    PERTURBATION_NAMES,
    TASK_SCENARIOS,
    Scenario,
    environment_id,
    find_task,
    scenario,
)
from mmc_gym.envs.tasks import TASKS, Task

if TYPE_CHECKING:
    from mmc_gym.measures import Measure


class Listed(NamedTuple):
    """A line of a list: a name, its description, and what it needs or its unit."""

    name: str
    what: str
    needs: str


class Listing(list[str]):
    """Names; a notebook shows them as a table with descriptions.

    Attributes:
        headings: of the table's columns.
        rows: a line for each name.
    """

    def __init__(self, headings: Listed, rows: Iterable[Listed]) -> None:
        """Make the list of the names in `rows`."""
        self.headings, self.rows = headings, tuple(rows)
        super().__init__(row.name for row in self.rows)

    def _repr_html_(self) -> str:
        import pandas as pd

        return pd.DataFrame(self.rows, columns=self.headings).to_html(index=False, border=0)


def list_agents() -> Listing:
    """Return the names of all agents.

    >>> list_agents()[:3]
    ['mmc-body', 'ik-body', 'mmc']
    """
    return Listing(
        Listed("agent", "what it is", "needs"),
        (Listed(name, one.description, _needs_of_agent(one)) for name, one in AGENTS.items()),
    )


def _needs_of_agent(entry: AgentEntry) -> str:
    if entry.training_seeds:
        return f"{entry.control}, 3 joints"
    return "lengths, servo" if entry.knowledge.lengths.startswith("given") else "nothing"


def list_tasks() -> Listing:
    """Return the names of all tasks; `task=NAME` of an environment takes them."""
    rows = (Listed(name, TASK_SCENARIOS[name].description, _trials(TASKS[name])) for name in TASKS)
    return Listing(Listed("task", "what it is", "episodes"), rows)


def _trials(task: Task) -> str:
    count = "drawn" if task.trial_count is None else f"{task.trial_count} trials"
    return f"{task.episode_steps} steps, {count}"


def list_perturbations() -> Listing:
    """Return the names of all perturbations; `perturbations=[NAME]` takes them, of any strength.

    >>> list_perturbations().rows[1]
    Listed(name='rotation', what='cursor turned by 30° about the base', needs='°')
    """
    rows = (
        Listed(name, one.description.format(f"{one.default:g}"), _strength(one))
        for name, one in FAMILIES.items()
    )
    return Listing(Listed("perturbation", "what it is", "strength in"), rows)


def _strength(family: Family) -> str:
    return f"{family.unit}{', or -told' * (family.told is not None)}"


def list_scenarios() -> Listing:
    """Return the names of the benchmark's scenarios; any other strength works, too."""
    from mmc_gym.benchmark.suite import SCENARIOS

    rows = (
        Listed(name, one.description, _trials(find_task(one.task)))
        for name, one in {**SCENARIOS, **TASK_SCENARIOS}.items()
    )
    return Listing(Listed("scenario", "what it is", "episodes"), rows)


def list_measures() -> Listing:
    """Return the names of all measures of an episode, yours included."""
    from mmc_gym.measures import MEASURES

    rows = (Listed(name, one.full_label, _unit(one)) for name, one in MEASURES.items())
    return Listing(Listed("measure", "what it is", "unit"), rows)


def _unit(measure: Measure) -> str:
    unit = "" if measure.full_label != measure.label else measure.shown_unit
    best = "" if measure.best == "neither" else f"{measure.best} is good"
    arrived = "successes" if measure.successes_only else ""
    return ", ".join(filter(None, (unit, best, arrived)))


def find_scenario(name: str) -> Scenario:
    """Return the scenario of a name, or of an environment's id.

    Raises:
        UserError: for an unknown one.
    """
    named = {environment_id(one): one for one in (*TASKS, *PERTURBATION_NAMES)}
    return scenario(named.get(name.partition(":")[2] or name, name))


def describe(name: str) -> Iterator[tuple[str, str]]:
    """Yield headings and texts that describe a scenario.

    Args:
        name: of a task or a perturbation with any strength; or the id of an environment.

    Raises:
        UserError: for an unknown name.
    """
    found = find_scenario(name)
    env = found.make()
    setup: Any = env.get_wrapper_attr("setup")
    task = setup.task
    yield found.name, found.description
    yield "make it", "\n".join(_ways_to_make(found))
    task_name = setup.task_name or (type(task).__name__ if found.env else found.name)
    yield "task", f"{task_name}: {_about(task)}"
    for one in found.perturbations:
        yield "perturbation", f"{one}: {_about(one)}"
    yield "agents", "\n".join(_given(found, setup))
    trials = "are drawn" if task.trial_count is None else f"are those of {task.trial_count} trials"
    seconds = task.episode_steps * setup.given_body.control_step
    length = f"{task.episode_steps} steps of {setup.given_body.control_step:g} s ({seconds:g} s)"
    yield "episodes", f"{length}; starts and targets {trials}"
    for kind in ("action", "observation"):
        space = getattr(env, f"{kind}_space")
        low, high = space.low.min(), space.high.max()
        yield f"{kind}s", f"{space.shape[0]} numbers, {space.dtype}, within {low:g} and {high:g}"
    env.close()


def _about(thing: object) -> str:
    """Return the part of a docstring before the arguments."""
    text = inspect.getdoc(type(thing)) or ""
    return " ".join(text.partition("Attributes:")[0].split())


def _ways_to_make(found: Scenario) -> Iterator[str]:
    own = found.env_id if found.env else environment_id(found.name)
    default = environment_id(found.family + "-told" * found.told)
    is_default = found.family and found.strength == FAMILIES[found.family].default
    for env_id in (own, *([default] if is_default else [])):
        if env_id in gym.registry:
            yield f'gym.make("{env_id}")'
            break
    if found.family:
        yield f'gym.make("MMCReach-v0", perturbations=["{found.name}"])'
    yield f"mmc-gym benchmark --environments {found.name}"


def _given(found: Scenario, setup: Any) -> Iterator[str]:
    """Yield what agents are given, and how the simulated arm differs from that."""
    if not found.family:
        yield "are given the arm as it is"
        return
    if all(one.told for one in found.perturbations):
        yield "are given the perturbation"
    elif FAMILIES[found.family].told is None:
        yield "are not given the perturbation"
    else:
        yield f"are not given the perturbation; with {found.name}-told they are"
    for one in fields(setup.given_body):
        given, true = getattr(setup.given_body, one.name), getattr(setup.body, one.name)
        if given != true:
            yield f"{one.name}: {_short(true)}, given {_short(given)}"


def _short(value: Any) -> str:
    if isinstance(value, tuple):
        return f"({', '.join(map(_short, value))})"
    return f"{value:g}" if isinstance(value, float) else str(value)
