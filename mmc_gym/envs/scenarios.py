"""Scenarios: a task with perturbations under one name; and the ids of the environments.

One grammar holds everywhere, in `perturbations=[…]`, in the benchmark, reports and file names:

    <perturbation>[-<strength>][-told]      delay-150, longer-35-told, rotation-30, force-field

Any strength is accepted; without one it is the family's default (`force-field` is
`force-field-60`).  With `-told`, agents are told of the changed body.  In an id the name is in
camel case: `MMCReachLonger20Told-v0`.

Perturbations are met in the task "random", so that an agent's episodes under all of them differ
from those without in the perturbation alone: starts and targets are drawn from the same seeds.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Mapping
from contextlib import closing
from dataclasses import asdict, dataclass, field, is_dataclass, replace
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import VectorEnv

from mmc_gym._errors import UserError, nearest, require, unknown
from mmc_gym.envs.making import EnvLike, code_of, is_own, make_environment, name_of
from mmc_gym.envs.perturbations import (
    ForceField,
    Gravity,
    HandMass,
    JointNoise,
    LockedJoint,
    Obstacles,
    Perturbation,
    SegmentLength,
    SensoryDelay,
    VisionNoise,
    VisuomotorRotation,
)
from mmc_gym.envs.tasks import TASKS, Task, outward_task

BASELINE = "random"
"""The scenario without perturbation: strength 0 of every family."""


@dataclass(frozen=True)
class Family:
    """Perturbations of one kind, which differ in strength.

    Attributes:
        name: the first part of their names.
        description: of a scenario, in a line; `{}` stands for the strength.
        default: strength of a name without one.
        make: makes the perturbation of a strength.
        strengths: those of the benchmark.
        told: strengths of the benchmark that agents are told; None if they cannot be told.
        ids: names that have an id, the family's by default; if agents can be told, so have
            those with `-told`.
        whole: strengths are whole numbers, of a joint or a count.
    """

    name: str
    unit: str
    description: str
    default: float
    make: Callable[[float], Perturbation]
    strengths: tuple[float, ...] = ()
    told: tuple[float, ...] | None = None
    ids: tuple[str, ...] = ()
    whole: bool = False

    @property
    def scenarios(self) -> list[Scenario]:
        """The scenarios of the benchmark."""
        told = [self.scenario(strength, told=True) for strength in self.told or ()]
        return [*map(self.scenario, self.strengths), *told]

    def scenario(self, strength: float, told: bool = False) -> Scenario:
        """Return the scenario of a strength, in the task "random".

        Raises:
            UserError: if the strength makes no sense, or agents cannot be told.
        """
        if told and self.told is None:
            tellable = ", ".join(one.name for one in FAMILIES.values() if one.told is not None)
            raise UserError(f"'-told' may follow {tellable} only, got it after {self.name!r}")
        perturbation = self.make(strength)
        # Digits without exponent, as the grammar reads them.
        digits = np.format_float_positional(strength, trim="-")
        description = self.description.format(digits)
        if self.told is not None:
            description += f", agents {'are' if told else 'are not'} told"
            perturbation = replace(perturbation, told=told)  # type: ignore[type-var]
        return Scenario(
            name=f"{self.name}-{digits}{'-told' * told}",
            description=description,
            perturbations=(perturbation,),
            family=self.name,
            strength=strength,
            unit=self.unit,
            told=told,
        )


@dataclass(frozen=True)
class Scenario:
    """A task with perturbations, under one name.

    Attributes:
        name: the one name, with its strength.
        env: an environment of yours, in place of the task and the perturbations.
        env_kwargs: more arguments of the environment.
        family: of the perturbation; empty for a task.
        strength: of the perturbation, to be compared within its family.
        told: whether agents are told of the perturbation, where they can be.
    """

    name: str
    description: str
    task: str | Task = "random"
    perturbations: tuple[Perturbation, ...] = ()
    env: EnvLike | None = None
    env_kwargs: Mapping[str, Any] = field(default_factory=dict)
    family: str = ""
    strength: float | None = None
    unit: str = ""
    told: bool = False

    @property
    def env_id(self) -> str:
        """Gymnasium's id of the task, or the name of your own environment."""
        if self.env is not None:
            return name_of(self.env)
        return environment_id(self.task) if isinstance(self.task, str) else environment_id()

    @property
    def arguments(self) -> dict[str, Any]:
        """Arguments beside `env_id` that make the environment."""
        task = {} if isinstance(self.task, str) else {"task": self.task}
        changes = {"perturbations": self.perturbations} if self.perturbations else {}
        return {**task, **changes, **self.env_kwargs}

    def make(self, control: str | None = None) -> gym.Env[Any, Any]:
        """Make the single environment, with another control mode if one is given.

        Raises:
            UserError: if there is no such environment, or it does not take the arguments.
        """
        return make_environment(self.env or self.env_id, control, **self._with_steps)

    def make_vec(
        self, num_envs: int, control: str | None = None
    ) -> VectorEnv[Any, Any, Any] | None:
        """Make the native vector environment, with another control mode if one is given.

        Returns:
            None if it is an environment of yours that has none.
        """
        arguments = (
            self._with_steps if control is None else {**self._with_steps, "control": control}
        )
        if self.env is not None:
            spec = gym.registry.get(self.env_id.rpartition(":")[2])
            if spec is None or spec.vector_entry_point is None:
                return None
        return gym.make_vec(self.env_id, num_envs=num_envs, **arguments).unwrapped

    @property
    def _with_steps(self) -> dict[str, Any]:
        """The arguments, with the length of an episode where it is another than the id's."""
        if isinstance(self.task, Task) and self.task.episode_steps != TASKS["random"].episode_steps:
            return {**self.arguments, "max_episode_steps": self.task.episode_steps}
        return self.arguments

    @property
    def trial_count(self) -> int | None:
        """Number of its numbered trials; None: they are drawn."""
        if self.env is None:
            return find_task(self.task).trial_count
        with closing(self.make()) as env:
            setup = getattr(env.unwrapped, "setup", None)
            count: int | None = setup.task.trial_count if setup is not None else None
            return count

    def instances(self, episodes: int) -> list[dict[str, Any]]:
        """Return the reset options of all numbered trials, or of `episodes` that are drawn."""
        trials = self.trial_count
        if trials is None:
            return [{} for _ in range(episodes)]
        return [{"trial": trial} for trial in range(trials)]

    @property
    def settings(self) -> dict[str, Any]:
        """All that defines the scenario, ready for JSON; equal for equal scenarios."""
        return {
            "id": self.env_id,
            "kwargs": json.loads(json.dumps(self.arguments, default=_with_name)),
            **({} if self.env is None else self._own_settings),
            "description": self.description,
            "family": self.family + "-told" * self.told,
            "strength": self.strength,
            "unit": self.unit,
            "baseline": BASELINE if self.family else None,
        }

    @property
    def _own_settings(self) -> dict[str, Any]:
        with closing(self.make()) as env:
            kwargs = env.spec.kwargs if env.spec else {}
            registered = json.loads(json.dumps(kwargs, default=_with_name))
            return {"code": code_of(env), "registered": registered}


def scenario(name: str) -> Scenario:
    """Return the scenario of a name: a task's, or a perturbation's with any strength.

    An environment of yours is one, too, by the name that `make_environment` takes: an id that is
    registered, "module:Id", or "module:function".

    Example:
        >>> scenario("longer-35-told").description
        'last segment 35 % longer, agents are told'
        >>> scenario("locked").name
        'locked-2'

    Raises:
        UserError: for an unknown name, or a strength that makes no sense.
    """
    if name in TASK_SCENARIOS:
        return TASK_SCENARIOS[name]
    if isinstance(name, str) and (":" in name or (name in gym.registry and is_own(name))):
        return own_scenario(name)
    return _perturbed("scenario", name)


def own_scenario(env: EnvLike, name: str = "") -> Scenario:
    """Return the scenario of an environment of yours, under its own name unless one is given.

    Raises:
        UserError: if there is no such environment.
    """
    with closing(make_environment(env)) as made:
        require(hasattr(made.unwrapped, "parameters"), "scenario", env, "a reaching environment")
    name = name or name_of(env)
    return Scenario(name, f"environment {name}", env=env)


def find_perturbation(value: object) -> Perturbation:
    """Return the perturbation of a name, or `value` itself if it is a perturbation.

    Raises:
        UserError: for an unknown name, a strength that makes no sense, or anything else.
    """
    if isinstance(value, Perturbation):
        return value
    return _perturbed("perturbations", value).perturbations[0]


def find_task(value: object) -> Task:
    """Return the task of a name, or `value` itself if it is a task.

    Raises:
        UserError: for an unknown name, or anything else.
    """
    if isinstance(value, Task):
        return value
    if not isinstance(value, str) or value not in TASKS:
        raise unknown("task", value, TASKS, "a Task", guess=_object_of(value, Task))
    return TASKS[value]


def environment_id(name: str = "random") -> str:
    """Return the id of a task or a perturbation: `MMCReachLonger20Told-v0` of `longer-20-told`."""
    words = "" if name == "random" else "".join(word.capitalize() for word in name.split("-"))
    return f"MMCReach{words}-v0"


def register_all() -> None:
    """Register every environment with Gymnasium."""
    _register("MMCReachGoal-v0", TASKS["random"], {}, kind="MMCReachGoal")
    for name, task in TASKS.items():
        _register(environment_id(name), task, {} if name == "random" else {"task": name})
    for name in PERTURBATION_NAMES:
        _register(environment_id(name), TASKS["random"], {"perturbations": [name]})


def _register(env_id: str, task: Task, arguments: dict[str, Any], kind: str = "MMCReach") -> None:
    gym.registry.pop(env_id, None)  # of a module that is read again
    gym.register(
        id=env_id,
        entry_point=f"mmc_gym.envs.reach:{kind}Env",
        vector_entry_point=f"mmc_gym.envs.vector:{kind}VectorEnv",
        max_episode_steps=task.episode_steps,
        kwargs=arguments,  # names, not objects: Gymnasium's specs stay serialisable
    )


_NAME = re.compile(r"(?P<family>[a-z-]+?)(?:-(?P<strength>-?\d+(?:\.\d+)?))?(?P<told>-told)?")


def _perturbed(argument: str, name: object) -> Scenario:
    """Return the scenario of a perturbation's name; an error names the argument."""
    match = _NAME.fullmatch(name) if isinstance(name, str) else None
    if match is None or match["family"] not in FAMILIES:
        tasks = tuple(TASK_SCENARIOS) if argument == "scenario" else ()
        also = ["one with a strength (delay-150)", *([] if tasks else ["a Perturbation"])]
        guess = _guess(name, tasks) if isinstance(name, str) else _object_of(name, Perturbation)
        raise unknown(argument, name, (*tasks, *FAMILIES), *also, guess=guess)
    family = FAMILIES[match["family"]]
    strength = family.default if match["strength"] is None else float(match["strength"])
    return family.scenario(strength, told=match["told"] is not None)


def _guess(name: str, tasks: Iterable[str]) -> str:
    """Return the task, or the perturbation, that a wrong name is close to, or is the id of."""
    for known in (*tasks, *PERTURBATION_NAMES):
        if name == environment_id(known):
            return known
    words = [word for word in re.findall("[a-z]+", name.lower()) if word != "told"]
    if not (family := nearest("-".join(words), FAMILIES)):
        return nearest(name, tasks)
    strength = re.findall(r"\d+(?:\.\d+)?", name)[:1]
    return "-".join([family, *strength, *["told"] * ("told" in name)])


def _object_of(value: object, base: type) -> str:
    """Return how an object is made, if a class was given in its place; else ""."""
    return f"{value.__name__}()" if isinstance(value, type) and issubclass(value, base) else ""


def _with_name(value: Any) -> dict[str, Any]:
    """Return the fields of a task or a perturbation, and the name of its class.

    Of yours also a digest of its code: another one plays another scenario.
    """
    plain = vars(value) if hasattr(value, "__dict__") else {"value": repr(value)}
    values = asdict(value) if is_dataclass(value) and not isinstance(value, type) else plain
    code = code_of(value)
    return {"name": type(value).__name__, **values, **({"code": code} if code else {})}


_WORDS = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")


def register_task(name: str, task: Task, description: str = "") -> None:
    """Give a task of yours a name: in ids, arguments, the benchmark, the report and file names.

    Args:
        name: such as "near-targets", whose id is `MMCReachNearTargets-v0`.
        task: an object of your class.
        description: a line for the report.

    Raises:
        UserError: if the name is no such word, or stands for another task or a perturbation.
    """
    known = TASKS.get(name)
    free = name not in FAMILIES and (known is None or _is_same(known, task))
    fine = isinstance(name, str) and _WORDS.fullmatch(name) is not None and free
    require(fine, "name", name, "words of a-z and 0-9 with hyphens, that no other task has")
    require(isinstance(task, Task), "task", task, "an object of a class derived from Task")
    TASKS[name] = task
    # The object, not its name: a worker need not know what is registered here.
    TASK_SCENARIOS[name] = Scenario(name, description or name.replace("-", " "), task)
    _register(environment_id(name), task, {"task": name})


def register_perturbation(family: Family) -> None:
    """Give perturbations of yours a name: in ids, arguments, the benchmark, report and file names.

    Raises:
        UserError: if the name is no word, or stands for others.
    """
    known = FAMILIES.get(family.name)
    free = family.name not in TASKS and (known is None or _is_same(known.make, family.make))
    fine = re.fullmatch("[a-z]+(-[a-z]+)*", family.name) is not None and free
    require(fine, "name", family.name, "words of a-z with hyphens, that no other family has")
    family.scenario(family.default)  # which says what is wrong with it
    FAMILIES[family.name] = family
    for name in _ids(family):
        _register(environment_id(name), TASKS["random"], {"perturbations": [name]})


def _is_same(known: Any, made: Any) -> bool:
    """Tell whether it comes again: from a notebook's cell that is run twice, say."""

    def origin(thing: Any) -> tuple[str, str]:
        kind = thing if hasattr(thing, "__qualname__") else type(thing)
        return kind.__module__, kind.__qualname__

    return origin(known) == origin(made) and not origin(made)[0].startswith("mmc_gym.")


def _joint(strength: float, time: float = 0.0) -> LockedJoint:
    fine = strength >= 1 and strength == int(strength)
    require(fine, "the joint that locks", strength, "a whole number from 1 (at the base) on")
    return LockedJoint(int(strength) - 1, time)


def _obstacles(strength: float) -> Obstacles:
    fine = strength in range(1, len(_DISCS) + 1)
    require(fine, "the number of obstacles", strength, f"a whole number from 1 to {len(_DISCS)}")
    return Obstacles(_DISCS[: int(strength)])


def _ids(family: Family) -> list[str]:
    """Return the names of a family that have an id."""
    return [
        name
        for untold in family.ids or (family.name,)
        for name in ([untold] if family.told is None else [untold, f"{untold}-told"])
    ]


_DISCS = ((1.5, 1.0, 0.25), (-1.5, 1.0, 0.25), (1.5, -1.0, 0.25), (-1.5, -1.0, 0.25))

FAMILIES: dict[str, Family] = {
    family.name: family
    for family in (
        Family(
            name="force-field",
            unit="mass/s",
            description="viscous curl field of {} at the hand",
            default=60.0,
            make=ForceField,
            strengths=(30.0, 60.0, 90.0),
        ),
        Family(
            name="rotation",
            unit="°",
            description="cursor turned by {}° about the base",
            default=30.0,
            make=VisuomotorRotation,
            strengths=(15.0, 30.0, 45.0, 60.0),
            ids=("rotation-30", "rotation-45"),
        ),
        Family(
            name="hand-mass",
            unit="segment masses",
            description="hand carries {} segment masses",
            default=3.0,
            make=HandMass,
            strengths=(1.0, 3.0, 10.0),
        ),
        Family(
            name="longer",
            unit="%",
            description="last segment {} % longer",
            default=20.0,
            make=lambda percent: SegmentLength(1 + percent / 100),
            strengths=(10.0, 20.0, 50.0),
            told=(20.0, 50.0),
            ids=("longer-10", "longer-20", "longer-50"),
        ),
        Family(
            name="shorter",
            unit="%",
            description="last segment {} % shorter",
            default=20.0,
            make=lambda percent: SegmentLength(1 - percent / 100),
            strengths=(10.0, 20.0, 50.0),
            told=(20.0, 50.0),
            ids=("shorter-10", "shorter-20", "shorter-50"),
        ),
        Family(
            name="locked",
            unit="joint",
            description="joint {} (from the base) locked from the start",
            default=2.0,
            make=_joint,
            whole=True,
            strengths=(1.0, 2.0, 3.0),
            told=(1.0, 2.0, 3.0),
        ),
        Family(
            name="locks",
            unit="joint",
            description="joint {} (from the base) locked after 0.2 s",
            default=2.0,
            make=lambda joint: _joint(joint, time=0.2),
            whole=True,
            strengths=(1.0, 2.0, 3.0),
            told=(2.0,),
        ),
        Family(
            name="joint-noise",
            unit="rad",
            description="noise of joint angles, {} rad",
            default=0.02,
            make=JointNoise,
            strengths=(0.01, 0.02, 0.05),
        ),
        Family(
            name="joint-noise-speed",
            unit="s",
            description="noise of joint angles, {} s of joint speed",
            default=0.01,
            make=lambda std: JointNoise(0.0, speed_std=std),
            strengths=(0.01, 0.03),
        ),
        Family(
            name="vision-noise",
            unit="lengths",
            description="noise of the seen hand and target, {} segment lengths",
            default=0.03,
            make=VisionNoise,
            strengths=(0.01, 0.03, 0.1),
        ),
        Family(
            name="vision-noise-distance",
            unit="of distance",
            description="noise of the seen hand and target, {} of their distance",
            default=0.05,
            make=lambda std: VisionNoise(0.0, distance_std=std),
            strengths=(0.05, 0.15),
        ),
        Family(
            name="delay",
            unit="ms",
            description="all senses late by {} ms",
            default=100.0,
            make=lambda ms: SensoryDelay(ms / 1000),
            strengths=(20.0, 40.0, 100.0, 200.0, 400.0),
            ids=("delay-40", "delay-100", "delay-200"),
        ),
        Family(
            name="obstacles",
            unit="discs",
            description="fixed discs stop the arm, {}",
            default=2.0,
            make=_obstacles,
            whole=True,
            strengths=(1.0, 2.0, 4.0),
        ),
        Family(
            name="gravity",
            unit="lengths/s²",
            description="arm hangs in a gravity of {} segment lengths/s²",
            default=60.0,
            make=Gravity,
            strengths=(10.0, 60.0, 120.0),
        ),
    )
}
"""The families of perturbations by name."""

PERTURBATION_NAMES: tuple[str, ...] = tuple(
    name for family in FAMILIES.values() for name in _ids(family)
)
"""Names of perturbations that have an id of their own."""

TASK_SCENARIOS: dict[str, Scenario] = {
    one.name: one
    for one in (
        Scenario("random", "random starts and targets", "random"),
        Scenario("paper", "the paper's 420 movements between 21 targets", "paper"),
        Scenario("centre-out", "eight targets around a point", "centre-out"),
        Scenario(
            "distances",
            "eight directions at each of four distances",
            outward_task([0.1, 0.2, 0.3, 0.4]),
        ),
        Scenario("double-step-100", "target jumps after 0.1 s", "double-step-100"),
        Scenario("double-step-200", "target jumps after 0.2 s", "double-step-200"),
        Scenario("pursuit", "target moves along sums of sines", "pursuit"),
        Scenario("via-points", "three targets, one after the other", "via-points"),
    )
}
"""The scenarios without perturbation, by name."""
