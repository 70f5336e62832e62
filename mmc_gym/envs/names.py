"""Names of tasks and perturbations: the registries, and the only parser.

One grammar holds everywhere, in `mmc_gym.make`, commands, the benchmark, reports and file names:

    [<task>+]<perturbation>[-<strength>|-<low>..<high>][-of-<joint>][-for-<steps>]
             [-at-<s>][-over-<s>][-until-<s>][-known][+<perturbation>…]

    random, centre-out, rotation-30, centre-out+rotation-30, longer-35-known+delay-160
    rotation-40+rotation--80-at-1, gain-1.4-over-2

Any strength is accepted; a name without one has the family's default (`force-field` is
`force-field-60`).  From a range (`rotation--60..60`) each episode draws its strength.  With `-at-1`
it begins 1 s after the start; with `-over-2` it grows for 2 s from no change to its strength; with
`-until-1.5` it ends.  `-of-2` says which joint, motor or segment it is, from the base on;
with `-for-5` what happens by chance lasts five control steps.  With
`-known`, agents are given the changed body.  Without a task, the task is "random".  The
same seeds then draw the same starts and targets as in `random`: episodes differ in the
perturbations alone.

A name is parsed once, where a user or a file gives it.  From there on, the code passes values: a
`TaskEntry`, and a `Change` for each perturbation.  Parsing looks names up; it imports nothing.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from inspect import signature
from itertools import permutations
from typing import Any

import gymnasium as gym

from mmc_gym._errors import UserError, nearest, require, require_known, unknown
from mmc_gym.envs import tasks as task_kinds
from mmc_gym.envs.changes import AnyChange, Change, Family, InUnits, OneOf, Range, Walk
from mmc_gym.envs.perturbations import FAMILIES
from mmc_gym.envs.tasks import (
    DoubleStep,
    PointToPoint,
    Pursuit,
    RandomTarget,
    Task,
    ViaPoints,
    outward,
)

BASELINE = "random"
"""The task of names that state none.  Unperturbed, it is strength 0 of every family."""


@dataclass(frozen=True)
class TaskEntry:
    """A task with its name."""

    name: str  #: words with hyphens
    task: Task
    description: str = ""  #: one line

    @property
    def is_shipped(self) -> bool:
        """Whether the task is one of this package, so that every process knows its name."""
        return _SHIPPED_TASKS.get(self.name) == self

    @property
    def is_registered(self) -> bool:
        """Whether this process knows the task by its name, your registered tasks included."""
        return TASKS.get(self.name) == self


# Challenges

CHALLENGES = {
    "realworld-easy": "action-delay-60+delay-60+action-noise-0.1+observation-noise-0.1"
    "+dropped-numbers-0.01+held-numbers-0.01+longer-0..11",
    "realworld-medium": "action-delay-120+delay-120+action-noise-0.3+observation-noise-0.3"
    "+dropped-numbers-0.05-for-5+held-numbers-0.05-for-5+repeated-actions-1+longer-0..78",
    "realworld-hard": "action-delay-180+delay-180+action-noise-1+observation-noise-1"
    "+dropped-numbers-0.1-for-10+held-numbers-0.1-for-10+repeated-actions-1-for-2+longer-0..144",
}
"""Several perturbations under one name, each with the name of them all.

They are the combined challenges of the Real-World RL suite (Dulac-Arnold, Levine, Mankowitz et al.
2021, Machine Learning 110:2419): delays of 3, 6 and 9 control steps; noise of actions and observed
numbers; numbers dropped and held; each action applied once, twice or three times; and a longer
segment, by as much as the walker's thigh.  Rewards are not late, and no numbers without meaning are
observed.
"""

# Parsing

_CHANGE = re.compile(
    r"(?P<family>[a-z-]+?)(?:-(?P<strength>-?\d+(?:\.\d+)?)(?:\.\.(?P<high>-?\d+(?:\.\d+)?))?)?"
    r"(?:-of-(?P<of>-?\d+))?(?:-for-(?P<steps>\d+))?"
    r"(?:-at-(?P<at>\d+(?:\.\d+)?))?(?:-over-(?P<over>\d+(?:\.\d+)?))?(?:-until-(?P<until>\d+(?:\.\d+)?))?"
    r"(?P<known>-known)?"
)


def parse_parts(name: object) -> tuple[TaskEntry, tuple[Change, ...]]:
    """Return the task and the perturbations of a scenario's name, or of a task's id."""
    if not isinstance(name, str):
        raise _unknown(name, "scenario")
    first, *others = task_ids().get(name, name).split("+")
    if first not in TASKS:
        first, others = BASELINE, [first, *others]
    words = [part for other in others for part in CHALLENGES.get(other, other).split("+")]
    return TASKS[first], tuple(parse_change(word, "scenario") for word in words)


def parse_change(name: object, argument: str = "perturbations") -> Change:
    """Return the perturbation of a name; an error message mentions `argument`.

    >>> parse_change("longer-35-known").description
    'last segment 35 % longer, given to agents'
    >>> parse_change("rotation-30").with_strength(0.125).name
    'rotation-0.125'
    >>> parse_change("rotation--80-at-1").at
    1.0
    """
    match = _CHANGE.fullmatch(name) if isinstance(name, str) else None
    if match is None or match["family"] not in FAMILIES:
        raise _unknown(name, argument)
    family = FAMILIES[match["family"]]
    low = family.default if match["strength"] is None else float(match["strength"])
    high = match["high"]
    strength = low if high is None else Range(low, float(high), family.whole)
    try:
        words = ("of", "steps", "at", "over", "until")
        numbers = {word: float(match[word]) for word in words if match[word]}
        return family(strength, known=match["known"] is not None, **numbers)
    except UserError as error:
        raise UserError(f"{argument} {name!r} is not possible: {error}") from error


def parse_task(name: object) -> TaskEntry:
    """Return the task entry of a name."""
    if not isinstance(name, str) or name not in TASKS:
        raise unknown("task", name, TASKS, "a Task")
    return TASKS[name]


def as_change(value: object) -> AnyChange:
    """Return the change that a name, an object, or what `as_plain` made of one stands for."""
    value = _from_plain(value) if isinstance(value, Mapping) else value
    if isinstance(value, OneOf):
        changes = [None if option is None else as_change(option) for option in value.options]
        is_flat = not any(isinstance(option, OneOf) for option in changes)
        require(is_flat, "OneOf", value, "without another OneOf in it")
        return OneOf(*changes, weights=value.weights)
    if isinstance(value, Family):
        return value()
    return value if isinstance(value, Change) else parse_change(value)


def as_changes(perturbations: Any) -> list[AnyChange]:
    """Return one perturbation, or several, as a list of changes."""
    if isinstance(perturbations, str | Mapping) or not isinstance(perturbations, Sequence):
        perturbations = (perturbations,)
    changes: list[AnyChange] = []
    for perturbation in perturbations:
        if isinstance(perturbation, str) and perturbation in CHALLENGES:
            changes += map(parse_change, CHALLENGES[perturbation].split("+"))
        else:
            changes.append(as_change(perturbation))
    return changes


def as_task(value: object) -> Task:
    """Return a task given by name, as an object, or as what `as_plain` made of one."""
    value = _from_plain(value) if isinstance(value, Mapping) else value
    if isinstance(value, Task):
        value.check_hooks()
        return value
    return parse_task(value).task


# For files.  Only objects of this package and of scipy.stats are made from them.

_TASK_KINDS: dict[str, Any] = {
    name: kind
    for name, kind in vars(task_kinds).items()
    if is_dataclass(kind) and isinstance(kind, type) and issubclass(kind, Task)
}


def as_plain(value: Any) -> Any:
    """Return an argument as a file can hold it: changes by name, or else by their numbers.

    Objects of your own classes stay as they are.

    >>> as_plain([parse_change("gain-2"), FAMILIES["rotation"](5, centre=(0, 1))])
    ['gain-2', {'family': 'rotation', 'strength': 5.0, 'centre': [0, 1]}]
    """
    if isinstance(value, list | tuple):
        return [as_plain(each) for each in value]
    if isinstance(value, OneOf):
        return {"one_of": as_plain(value.options), "weights": list(value.weights)}
    if isinstance(value, Change):
        if value.is_named:
            return value.name
        times = {"at": value.at, "over": value.over, "known": value.known}
        times |= {} if value.until == math.inf else {"until": value.until}
        more = {name: number for name, number in times.items() if number} | dict(value.settings)
        plain = {name: as_plain(number) for name, number in more.items()}
        return {"family": value.family.name, "strength": as_plain(value.strength), **plain}
    if isinstance(value, Range | InUnits | Walk):
        return {field.name: as_plain(getattr(value, field.name)) for field in fields(value)}
    if hasattr(value, "dist"):  # a frozen distribution of scipy.stats
        return {"name": value.dist.name, "args": list(value.args), **value.kwds}
    if _TASK_KINDS.get(type(value).__name__) is not type(value):
        return value
    entries = {field.name: as_plain(getattr(value, field.name)) for field in fields(value)}
    return {"name": type(value).__name__, **entries}


def _from_plain(value: Any) -> Any:
    """Return what `as_plain` made plain; raise a `UserError` if it is nothing of the kind."""
    if isinstance(value, list | tuple):
        return tuple(map(_from_plain, value))
    if not isinstance(value, Mapping):
        return value
    if "one_of" in value:
        require_known("a mixture", value, ("one_of", "weights"))
        accepted = "a list of perturbations; null is no change"
        require(isinstance(value["one_of"], list | tuple), "one_of", value["one_of"], accepted)
        return OneOf(*value["one_of"], weights=value.get("weights"))
    named = ("name", "args", "family")
    entries = {key: _from_plain(each) for key, each in value.items() if key not in named}
    kind: Any = FAMILIES.get(str(value.get("family"))) or _TASK_KINDS.get(str(value.get("name")))
    args = value.get("args")
    if entries.keys() == {"low", "high", "whole"}:
        kind = Range
    elif entries.keys() == {"low", "high", "step", "kind"}:
        kind = Walk
    elif entries.keys() == {"distribution", "factor", "offset"}:
        kind = InUnits
    elif args is not None:
        from scipy import stats  # `import mmc_gym` loads none of it

        kind = getattr(stats, str(value.get("name")), None)
        kind = kind if isinstance(kind, stats.rv_continuous | stats.rv_discrete) else None
    accepted = "of a class of this package or scipy.stats; a name that you register is kept, too"
    require(kind is not None, "an object from a file", value, accepted)
    try:
        return kind(*(args or ()), **entries)
    except (TypeError, ValueError) as error:
        raise UserError(f"an object from a file is not possible, got {value}: {error}") from error


def _unknown(name: object, argument: str) -> UserError:
    """Return the error for an unknown name; it suggests the nearest known one."""
    text = name if isinstance(name, str) else ""
    if text in TASKS:
        return UserError(f"{text!r} is a task, which comes first: '{text}+rotation-30'")
    if text in CHALLENGES:
        return UserError(f"{text!r} is several perturbations, and none of a mixture")
    endings = "-<strength> -of-<joint> -for-<steps> -at-<s> -over-<s> -until-<s> -known"
    if re.search("-(of|for|until)-", text) and text.startswith(
        tuple(f"{key}-" for key in FAMILIES)
    ):
        return UserError(f"{argument} {text!r} must have its endings in this order: {endings}")
    known, also = [*FAMILIES, *CHALLENGES], "a Change"
    if argument == "scenario":
        known, also = [*TASKS, *FAMILIES, *CHALLENGES], "several (centre-out+rotation-30)"
    elif "+" in text:
        also = f"a list such as {text.split('+')}"
    word, *strength = re.split("(-(?:-?[0-9].*|(?:of|for|at|over|until)-.*|known))$", text)
    guess = nearest(word, known)
    meant = guess + "".join(strength)
    guess = meant if guess in FAMILIES and _CHANGE.fullmatch(meant) else guess
    return unknown(argument, name, known, "one with a strength (delay-160)", also, guess=guess)


# Tasks


def _paper_task() -> PointToPoint:
    """Return the paper's 420 movements between 21 targets at three radii and seven angles."""
    points = tuple(
        (radius / 3 * math.cos(angle * math.pi / 6), radius / 3 * math.sin(angle * math.pi / 6))
        for radius in (1, 2, 3)
        for angle in range(7)
    )
    return PointToPoint(points, tuple(permutations(range(21), 2)))


_EIGHT = [k / 8 * math.tau for k in range(8)]
_CENTRE_OUT = PointToPoint(*outward([0.2], _EIGHT))
_DISTANCES = PointToPoint(*outward([0.1, 0.2, 0.3, 0.4], _EIGHT))

_TASKS = (
    TaskEntry("random", RandomTarget(), "random starts and targets"),
    TaskEntry("paper", _paper_task(), "the paper's 420 movements between 21 targets"),
    # After Georgopoulos, Kalaska, Caminiti & Massey (1982), J. Neurosci. 2:1527.
    TaskEntry("centre-out", _CENTRE_OUT, "eight targets around a point"),
    TaskEntry("distances", _DISTANCES, "eight directions at each of four distances"),
    TaskEntry("double-step-100", DoubleStep(delay=0.1), "target jumps after 0.1 s"),
    TaskEntry("double-step-200", DoubleStep(delay=0.2), "target jumps after 0.2 s"),
    TaskEntry("pursuit", Pursuit(), "target moves along sums of sines"),
    TaskEntry("via-points", ViaPoints(), "three targets, one after the other"),
)
TASKS: dict[str, TaskEntry] = {entry.name: entry for entry in _TASKS}
"""The tasks by name."""


# Registration.  Users may register their names again, as in a notebook, but no shipped name.

_SHIPPED_TASKS = dict(TASKS)
_SHIPPED = frozenset((*TASKS, *FAMILIES, *CHALLENGES))


def environment_id(task: str = BASELINE) -> str:
    """Return the environment id of a task: `MMCReachCentreOut-v0` for `centre-out`."""
    words = "" if task == BASELINE else "".join(word.capitalize() for word in task.split("-"))
    return f"MMCReach{words}-v0"


def task_ids() -> dict[str, str]:
    """Return a mapping from environment ids to names of tasks."""
    return {environment_id(name): name for name in TASKS}


def register_all() -> None:
    """Register every environment with Gymnasium."""
    _register("MMCReachGoal-v0", TASKS[BASELINE], kind="MMCReachGoal")
    for entry in TASKS.values():
        _register(environment_id(entry.name), entry)


def _register(env_id: str, entry: TaskEntry, kind: str = "MMCReach") -> None:
    gym.registry.pop(env_id, None)  # if it was registered before, as by a reloaded module
    # Names, not objects, so that Gymnasium's specs can be written to files.
    arguments: dict[str, Any] = {} if entry.name == BASELINE else {"task": entry.name}
    gym.register(
        id=env_id,
        entry_point=f"mmc_gym.envs.reach:{kind}Env",
        vector_entry_point=f"mmc_gym.envs.vector:{kind}VectorEnv",
        max_episode_steps=entry.task.episode_steps,
        kwargs=arguments,
    )


def register_task(name: str, task: Task, description: str = "") -> None:
    """Register your own task under a name, for ids, arguments, the benchmark and the report.

    Args:
        name: words with hyphens that name no family and no task of this package, such as
            "near-targets"; its id is `MMCReachNearTargets-v0`.
        task: an object of your class.
        description: one line for the report.
    """
    is_free = isinstance(name, str) and name not in {*FAMILIES, *_SHIPPED}
    is_name = is_free and re.fullmatch("[a-z][a-z0-9]*(-[a-z0-9]+)*", name) is not None
    require(is_name, "name", name, "words of a-z and 0-9 with hyphens, that no other task has")
    require(isinstance(task, Task), "task", task, "an object of a class derived from Task")
    TASKS[name] = entry = TaskEntry(name, task, description or name.replace("-", " "))
    _register(environment_id(name), entry)


def perturbation(
    name: str,
    *,
    unit: str = "",
    default: float = 1.0,
    neutral: float | None = None,
    description: str = "",
    low: float = -math.inf,
    high: float = math.inf,
    whole: bool = False,
    known: bool = False,
) -> Callable[[Callable[..., None]], Family]:
    """Register your own family of perturbations, a function that overwrites columns of arms.

    It is drawn, timed, native in vectors and shown as context without more::

        @mmc_gym.perturbation("heavy-middle", unit="times", default=2, neutral=1)
        def heavy_middle(arms, factor):
            arms.segment_masses[:, 1] *= factor


        mmc_gym.make("centre-out+heavy-middle-1..3")

    Args:
        name: words with hyphens that name no task and no family of this package.
        unit: of the strength.
        default: the strength of a name without one.
        neutral: the strength that changes nothing; without one it cannot grow (`-over-`).
        description: a line for lists and the report; `{}` stands for the strength.
        low: the least strength.
        high: the greatest strength.
        whole: whether strengths are whole numbers.
        known: whether agents can be given the change (`-known`), which must be one of the body.

    Returns:
        A decorator of a function of `(arms, strength)`: `mmc_gym.envs.arms.Arms` of n arms, and
        their strengths, (n,).  It returns the `Family`, which makes a perturbation of a strength.
    """
    is_free = isinstance(name, str) and name not in {*TASKS, *_SHIPPED}
    pattern = "[a-z]+(-[a-z]+)*(?<!-of)(?<!-for)(?<!-at)(?<!-over)(?<!-until)"
    is_name = is_free and re.fullmatch(pattern, name) is not None
    require(is_name, "name", name, "words of a-z with hyphens, that no task or other family has")
    words = description or f"{name.replace('-', ' ')} {{}} {unit}".strip()

    def register(apply: Callable[..., None]) -> Family:
        parameters = [*signature(apply).parameters.values()] if callable(apply) else []
        are_optional = all(each.default is not each.empty for each in parameters[2:])
        is_function = len(parameters) >= 2 and are_optional
        require(is_function, name, apply, "a function of (arms, strength)")
        facts = {"neutral": neutral, "low": low, "high": high, "whole": whole, "known": known}
        family = Family(name, unit, words, float(default), apply, **facts)  # type: ignore[arg-type]
        family()  # raises an error if the default is not accepted
        FAMILIES[name] = family
        return family

    return register
