"""Names of tasks and perturbations: the registries, and the only parser.

One grammar holds everywhere, in `mmc_gym.make`, commands, the benchmark, reports and file names:

    [<task>+]<perturbation>[-<strength>|-<low>..<high>][-at-<s>][-over-<s>][-known][+<perturbation>…]

    random, centre-out, rotation-30, centre-out+rotation-30, longer-35-known+delay-160
    rotation-40+rotation--80-at-1, gain-1.4-over-2

Any strength is accepted; a name without one has the family's default (`force-field` is
`force-field-60`).  From a range (`rotation--60..60`) each episode draws its strength.  With `-at-1`
it begins 1 s after the start; with `-over-2` it grows for 2 s from no change to its strength.  With
`-known`, agents are given the changed body.  Without a task, the task is "random".  The
same seeds then draw the same starts and targets as in `random`: episodes differ in the
perturbations alone.

A name is parsed once, where a user or a file gives it.  From there on, the code passes values: a
`TaskEntry`, and a `Change` for each perturbation.  Parsing looks names up; it imports nothing.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from functools import partial
from itertools import permutations
from typing import Any

import gymnasium as gym
import numpy as np

from mmc_gym._errors import UserError, nearest, require, require_known, unknown
from mmc_gym.envs import perturbations as perturbation_kinds
from mmc_gym.envs import tasks as task_kinds
from mmc_gym.envs.perturbations import (
    FOUR_DISCS,
    Channel,
    CursorGain,
    CursorJump,
    CursorMirror,
    EndpointFeedback,
    ErrorClamp,
    ForceField,
    Gravity,
    HandMass,
    JointNoise,
    LockedJoint,
    NoFeedback,
    Obstacles,
    OneOf,
    Perturbation,
    SegmentLength,
    SensoryDelay,
    Timed,
    VisionDelay,
    VisionNoise,
    VisuomotorRotation,
    drawn_fields,
)
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


@dataclass(frozen=True)
class Range:
    """A range of strengths, uniformly distributed."""

    low: float
    high: float
    whole: bool = False  #: whether only whole numbers are drawn

    def support(self) -> tuple[float, float]:
        """Return the least and the greatest strength."""
        return self.low, self.high

    def ppf(self, shares: Any) -> Any:
        """Return the strengths at the quantiles `shares` (0 to 1), in the same shape."""
        if self.whole:
            return np.minimum(self.low + np.floor((self.high - self.low + 1) * shares), self.high)
        return self.low + (self.high - self.low) * shares


@dataclass(frozen=True)
class Family:
    """Perturbations of one kind, which differ in strength."""

    name: str  #: the first part of their names
    unit: str  #: of the strength
    description: str  #: of a scenario, one line; `{}` stands for the strength
    default: float  #: strength of a name without one
    #: makes the perturbation of a strength
    make: Callable[[float], Perturbation] = field(compare=False)
    known: bool = False  #: whether agents can be given the change (`-known`)
    whole: bool = False  #: whether strengths are whole numbers: the number of a joint, or a count
    has_strength: bool = True  #: if not, there is one perturbation, without a number

    def with_strength(self, strength: float | Range, known: bool = False) -> Change:
        """Return the perturbation of this strength; if `known`, agents are given the changed body.

        From a `Range` each episode draws its strength.

        Raises:
            UserError: if there is no such strength, or if agents can never be given the change.
        """
        if known and not self.known:
            accepted = ", ".join(one.name for one in FAMILIES.values() if one.known)
            raise UserError(f"'-known' may follow {accepted} only, got it after {self.name!r}")
        if not self.has_strength and strength != self.default:
            raise UserError(f"{self.name} takes no strength, got {_digits(strength)}")
        name = f"{self.name}-{_digits(strength)}"
        if isinstance(strength, Range):
            accepted = "from a low to a higher strength, or to the same"
            fine = strength.low <= strength.high
            require(fine, f"the range of {self.name}", _digits(strength), accepted)
            accepted = "left out, as agents are given their arm once, not for each episode"
            require(not known, name, "-known", accepted)
            self.with_strength(strength.low)
            return replace(self.with_strength(strength.high), strength=None, range=strength)
        try:
            perturbation = self.make(strength)
        except (UserError, TypeError) as error:
            raise UserError(f"{name} has no such strength: {error}") from error
        accepted, name = "a Perturbation of the strength", f"what {self.name!r} makes"
        require(isinstance(perturbation, Perturbation), name, perturbation, accepted)
        perturbation.check_hooks()
        if self.known:
            perturbation = replace(perturbation, known=known)  # type: ignore[type-var]
        return Change(perturbation, self, strength)


@dataclass(frozen=True)
class Change:
    """A perturbation with its strength and its family, or one of your own without a family."""

    perturbation: Perturbation
    family: Family | None = None
    strength: float | None = None  #: comparable within the family
    range: Range | None = None  #: each episode draws a strength from it; `strength` is None

    @property
    def name(self) -> str:
        """The name for people and files: "longer-35-known"; without a family, the class's name."""
        strength = self.strength if self.range is None else self.range
        if self.family is None or strength is None:
            return type(self.perturbation).__name__
        number = f"-{_digits(strength)}" if self.family.has_strength else ""
        return f"{self.family.name}{number}{self.suffix}"

    @property
    def suffix(self) -> str:
        """The end of the name, after the strength: "-at-1-over-2", "-known", or empty."""
        timing = "".join(f"-{word}-{_digits(seconds)}" for word, seconds in self._timing)
        return timing + ("-known" if self._is_given else "")

    @property
    def _timing(self) -> list[tuple[str, float]]:
        """The pairs ("at", start) and ("over", duration of growth), s, without those that are 0."""
        one = self.perturbation
        timing = [("at", one.at), ("over", one.over)] if isinstance(one, Timed) else []
        return [(word, seconds) for word, seconds in timing if seconds]

    @property
    def _is_given(self) -> bool:
        return bool(self.family and self.family.known and self.known)

    @property
    def known(self) -> bool:
        """Whether agents are given the changed body."""
        return self.perturbation.known

    @property
    def is_drawn(self) -> bool:
        """Whether each episode draws its own strength or option."""
        one = self.perturbation
        return bool(self.range or hasattr(one, "ppf") or drawn_fields(one, self.untimed))

    @property
    def untimed(self) -> Perturbation:
        """The perturbation at full strength, without `Timed` around it."""
        one = self.perturbation
        return one.perturbation if isinstance(one, Timed) else one

    @property
    def unit(self) -> str:
        """The unit of the strength; empty without a family."""
        return self.family.unit if self.family else ""

    @property
    def description(self) -> str:
        """One line that says what changes, and when."""
        strength = self.strength if self.range is None else self.range
        if self.family is None or strength is None:
            return self.name
        parts = [self.family.description.format(_digits(strength))]
        if self.family.known:
            parts.append("given to agents" if self.known else "not given to agents")
        if self.range is not None:
            parts.append("drawn for each episode")
        words = {"at": "from {} s on", "over": "growing over {} s"}
        parts += [words[word].format(_digits(seconds)) for word, seconds in self._timing]
        return ", ".join(parts)

    def with_strength(self, strength: float) -> Change:
        """Return the same perturbation with another strength.

        Raises:
            UserError: if there is no such strength, or if the perturbation has no family.
        """
        if self.family is None:
            raise UserError(f"the perturbation {self.name} has no family, and so no strength")
        return self.family.with_strength(strength, self._is_given).timed(**dict(self._timing))

    def timed(self, at: float = 0.0, over: float = 0.0) -> Change:
        """Return the change, to begin `at` s after the start and grow for `over` s; see `Timed`."""
        if not at and not over:
            return self
        try:
            return replace(self, perturbation=Timed(self.perturbation, at, over))
        except UserError as error:
            raise UserError(f"{self.name} cannot begin or grow like this: {error}") from error


def _digits(strength: float | Range) -> str:
    """Return a strength as text for a name: exact, and without an exponent (0.00001, not 1e-05)."""
    if isinstance(strength, Range):
        return f"{_digits(strength.low)}..{_digits(strength.high)}"
    return np.format_float_positional(strength, trim="-")


# Parsing

_CHANGE = re.compile(
    r"(?P<family>[a-z-]+?)(?:-(?P<strength>-?\d+(?:\.\d+)?)(?:\.\.(?P<high>-?\d+(?:\.\d+)?))?)?"
    r"(?:-at-(?P<at>\d+(?:\.\d+)?))?(?:-over-(?P<over>\d+(?:\.\d+)?))?(?P<known>-known)?"
)


def parse_parts(name: object) -> tuple[TaskEntry, tuple[Change, ...]]:
    """Return the task and the perturbations of a scenario's name, or of a task's id."""
    if not isinstance(name, str):
        raise _unknown(name, "scenario")
    first, *others = task_ids().get(name, name).split("+")
    if first not in TASKS:
        first, others = BASELINE, [first, *others]
    return TASKS[first], tuple(parse_change(one, "scenario") for one in others)


def parse_change(name: object, argument: str = "perturbations") -> Change:
    """Return the perturbation of a name; an error message mentions `argument`.

    >>> parse_change("longer-35-known").description
    'last segment 35 % longer, given to agents'
    >>> parse_change("rotation-30").with_strength(0.125).name
    'rotation-0.125'
    >>> parse_change("rotation--80-at-1").perturbation.at
    1.0
    """
    match = _CHANGE.fullmatch(name) if isinstance(name, str) else None
    if match is None or match["family"] not in FAMILIES:
        raise _unknown(name, argument)
    family = FAMILIES[match["family"]]
    strength: float | Range = family.default
    if match["strength"] is not None:
        strength = float(match["strength"])
    if match["high"] is not None:
        strength = Range(float(match["strength"]), float(match["high"]), family.whole)
    change = family.with_strength(strength, known=match["known"] is not None)
    return change.timed(float(match["at"] or 0), float(match["over"] or 0))


def parse_task(name: object) -> TaskEntry:
    """Return the task entry of a name."""
    if not isinstance(name, str) or name not in TASKS:
        raise unknown("task", name, TASKS, "a Task")
    return TASKS[name]


def as_change(value: object) -> Change:
    """Return the change that a name, an object, or what `as_plain` made of one stands for."""
    value = _from_plain(value) if isinstance(value, Mapping) else value
    if isinstance(value, OneOf):
        changes = (None if one is None else as_change(one) for one in value.options)
        return Change(OneOf(*changes, weights=value.weights))
    if isinstance(value, Perturbation):
        value.check_hooks()
        return Change(value)
    return value if isinstance(value, Change) else parse_change(value)


def as_task(value: object) -> Task:
    """Return a task given by name, as an object, or as what `as_plain` made of one."""
    value = _from_plain(value) if isinstance(value, Mapping) else value
    if isinstance(value, Task):
        value.check_hooks()
        return value
    return parse_task(value).task


# For files.  Only objects of this package and of scipy.stats are made from them.

_KINDS: dict[str, Any] = {
    name: kind
    for name, kind in {**vars(perturbation_kinds), **vars(task_kinds)}.items()
    if is_dataclass(kind) and isinstance(kind, type) and issubclass(kind, Perturbation | Task)
}


def as_plain(value: Any) -> Any:
    """Return an argument as a file can hold it: changes by name, or else by class and fields.

    Objects of your own classes stay as they are.

    >>> as_plain([parse_change("gain-2"), OneOf(LockedJoint(0), None)])[1]["one_of"]
    [{'name': 'LockedJoint', 'joint': 0, 'time': 0.0, 'known': False}, None]
    """
    if isinstance(value, list | tuple):
        return [as_plain(one) for one in value]
    if isinstance(value, Change):
        return value.name if value.family is not None else as_plain(value.perturbation)
    if isinstance(value, OneOf):
        return {"one_of": as_plain(value.options), "weights": list(value.weights)}
    if hasattr(value, "dist"):  # a frozen distribution of scipy.stats
        return {"name": value.dist.name, "args": list(value.args), **value.kwds}
    if _KINDS.get(type(value).__name__) is not type(value):
        return value
    own = {one.name: as_plain(getattr(value, one.name)) for one in fields(value)}
    return {"name": type(value).__name__, **own}


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
    given = {key: _from_plain(one) for key, one in value.items() if key not in ("name", "args")}
    kind: Any = _KINDS.get(str(value.get("name")))
    args = value.get("args")
    if args is not None:
        from scipy import stats  # `import mmc_gym` loads none of it

        kind = getattr(stats, str(value.get("name")), None)
        kind = kind if isinstance(kind, stats.rv_continuous | stats.rv_discrete) else None
    accepted = "of a class of this package or scipy.stats; a name that you register is kept, too"
    require(kind is not None, "an object from a file", value, accepted)
    try:
        return kind(*(args or ()), **given)
    except (TypeError, ValueError) as error:
        raise UserError(f"an object from a file is not possible, got {value}: {error}") from error


def _unknown(name: object, argument: str) -> UserError:
    """Return the error for an unknown name; it suggests the nearest known one."""
    text = name if isinstance(name, str) else ""
    if text in TASKS:
        return UserError(f"{text!r} is a task, which comes first: '{text}+rotation-30'")
    known, also = [*FAMILIES], "a Perturbation"
    if argument == "scenario":
        known, also = [*TASKS, *FAMILIES], "several (centre-out+rotation-30)"
    elif "+" in text:
        also = f"a list such as {text.split('+')}"
    word, *strength = re.split("(-(?:-?[0-9].*|at-.*|over-.*|known))$", text)
    guess = nearest(word, known)
    meant = guess + "".join(strength)
    guess = meant if guess in FAMILIES and _CHANGE.fullmatch(meant) else guess
    return unknown(argument, name, known, "one with a strength (delay-160)", also, guess=guess)


# Families


def _longer(percent: float) -> SegmentLength:
    return SegmentLength(1 + percent / 100)


def _shorter(percent: float) -> SegmentLength:
    fine = bool(np.all(percent < 100))
    require(fine, "the change of the segment's length", percent, "less than 100 %")
    return SegmentLength(1 - percent / 100)


def _seconds(ms: float) -> float:
    require(bool(np.all((ms >= 0) & (ms <= 1e6))), "the delay", ms, "from 0 to 1000000 ms")
    return ms / 1000


def _delay(ms: float) -> SensoryDelay:
    return SensoryDelay(_seconds(ms))


def _no_feedback(_: float) -> NoFeedback:
    return NoFeedback()


def _endpoint_feedback(_: float) -> EndpointFeedback:
    return EndpointFeedback()


def _vision_delay(ms: float) -> VisionDelay:
    return VisionDelay(_seconds(ms))


def _locked(number: float, time: float = 0.0) -> LockedJoint:
    fine = bool(np.all(np.isfinite(number) & (number >= 1) & (np.floor(number) == number)))
    require(fine, "the joint that locks", number, "a whole number from 1 (at the base) on")
    joints: Any = np.asarray(number).astype(int) - 1  # of many arms, or of one
    return LockedJoint(joints if joints.ndim else int(joints), time)


def _obstacles(count: float) -> Obstacles:
    fine = count in range(1, len(FOUR_DISCS) + 1)
    accepted = f"a whole number from 1 to {len(FOUR_DISCS)}"
    require(fine, "the number of obstacles", count, accepted)
    return Obstacles(FOUR_DISCS[: int(count)])


_JOINT: Any = {"known": True, "whole": True}
_FAMILIES = (  # name, unit, description, default, make
    Family("force-field", "mass/s", "viscous curl field of {} at the hand", 60.0, ForceField),
    Family("channel", "mass/s", "walls along the way, as for a curl field of {}", 60.0, Channel),
    Family("rotation", "°", "cursor turned by {}°", 30.0, VisuomotorRotation),
    Family("gain", "times", "cursor {} times as far as the hand", 1.4, CursorGain),
    Family("mirror", "° of the axis", "cursor mirrored at an axis of {}°", 90.0, CursorMirror),
    Family("clamp", "°", "cursor clamped to a direction {}° from the target", 15.0, ErrorClamp),
    Family(
        "cursor-jump", "% of the way", "cursor jumps across the way by {} % of it", 10.0, CursorJump
    ),
    Family("hand-mass", "segment masses", "hand carries {} segment masses", 3.0, HandMass),
    Family("longer", "%", "last segment {} % longer", 20.0, _longer, known=True),
    Family("shorter", "%", "last segment {} % shorter", 20.0, _shorter, known=True),
    Family(
        "locked", "joint", "joint {} (from the base) locked from the start", 2.0, _locked, **_JOINT
    ),
    Family(
        "locks",
        "joint",
        "joint {} (from the base) locked after 0.2 s",
        2.0,
        partial(_locked, time=0.2),
        **_JOINT,
    ),
    Family("joint-noise", "rad", "noise of joint angles, {} rad", 0.02, JointNoise),
    Family(
        "joint-noise-speed",
        "s",
        "noise of joint angles, {} s of joint speed",
        0.01,
        partial(JointNoise, 0.0),
    ),
    Family(
        "vision-noise",
        "lengths",
        "noise of the seen hand and target, {} segment lengths",
        0.03,
        VisionNoise,
    ),
    Family(
        "vision-noise-distance",
        "of distance",
        "noise of the seen hand and target, {} of their distance",
        0.05,
        partial(VisionNoise, 0.0),
    ),
    Family("delay", "ms", "all senses late by {} ms", 100.0, _delay),
    Family("vision-delay", "ms", "sight of hand and target late by {} ms", 100.0, _vision_delay),
    Family(
        "no-feedback", "", "hand not seen after the start", 1.0, _no_feedback, has_strength=False
    ),
    Family(
        "endpoint-feedback",
        "",
        "hand seen at the end of the movement only",
        1.0,
        _endpoint_feedback,
        has_strength=False,
    ),
    Family("obstacles", "discs", "fixed discs stop the arm, {}", 2.0, _obstacles, whole=True),
    Family(
        "gravity", "lengths/s²", "arm hangs in a gravity of {} segment lengths/s²", 60.0, Gravity
    ),
)
FAMILIES: dict[str, Family] = {one.name: one for one in _FAMILIES}
"""The families of perturbations by name."""


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
TASKS: dict[str, TaskEntry] = {one.name: one for one in _TASKS}
"""The tasks by name."""


# Registration.  Users may register their names again, as in a notebook, but no shipped name.

_SHIPPED_TASKS = dict(TASKS)
_SHIPPED = frozenset((*TASKS, *FAMILIES))


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
    fine = isinstance(name, str) and name not in {*FAMILIES, *_SHIPPED}
    fine = fine and re.fullmatch("[a-z][a-z0-9]*(-[a-z0-9]+)*", name) is not None
    require(fine, "name", name, "words of a-z and 0-9 with hyphens, that no other task has")
    require(isinstance(task, Task), "task", task, "an object of a class derived from Task")
    TASKS[name] = entry = TaskEntry(name, task, description or name.replace("-", " "))
    _register(environment_id(name), entry)


def register_perturbation(family: Family) -> None:
    """Register your own family, for scenarios, arguments, the benchmark and the report.

    The family's name must be words with hyphens that name no task and no family of this package.
    """
    require(isinstance(family, Family), "family", family, "a Family")
    fine = family.name not in {*TASKS, *_SHIPPED}
    fine = fine and re.fullmatch("[a-z]+(-[a-z]+)*(?<!-at)(?<!-over)", family.name) is not None
    require(fine, "name", family.name, "words of a-z with hyphens, that no other family has")
    family.with_strength(family.default)  # raises an error if the family is not consistent
    FAMILIES[family.name] = family
