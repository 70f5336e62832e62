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
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, replace
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import VectorEnv

from mmc_gym._errors import UserError, nearest, require, unknown
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
    """

    name: str
    unit: str
    description: str
    default: float
    make: Callable[[float], Perturbation]
    strengths: tuple[float, ...]
    told: tuple[float, ...] | None = None
    ids: tuple[str, ...] = ()

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
        family: of the perturbation; empty for a task.
        strength: of the perturbation, to be compared within its family.
        told: whether agents are told of the perturbation, where they can be.
    """

    name: str
    description: str
    task: str | Task = "random"
    perturbations: tuple[Perturbation, ...] = ()
    family: str = ""
    strength: float | None = None
    unit: str = ""
    told: bool = False

    @property
    def env_id(self) -> str:
        """Gymnasium's id of the task."""
        return environment_id(self.task) if isinstance(self.task, str) else environment_id()

    @property
    def arguments(self) -> dict[str, Any]:
        """Arguments beside `env_id` that make the environment."""
        task = {} if isinstance(self.task, str) else {"task": self.task}
        return {**task, **({"perturbations": self.perturbations} if self.perturbations else {})}

    def make(self, control: str | None = None) -> gym.Env[Any, Any]:
        """Make the single environment, with another control mode if one is given."""
        return gym.make(self.env_id, **self._with(control))

    def make_vec(self, num_envs: int, control: str | None = None) -> VectorEnv[Any, Any, Any]:
        """Make the native vector environment, with another control mode if one is given."""
        return gym.make_vec(self.env_id, num_envs=num_envs, **self._with(control)).unwrapped

    def _with(self, control: str | None) -> dict[str, Any]:
        return self.arguments if control is None else {**self.arguments, "control": control}

    def instances(self, episodes: int) -> list[dict[str, Any]]:
        """Return the reset options of all numbered trials, or of `episodes` that are drawn."""
        trials = find_task(self.task).trial_count
        if trials is None:
            return [{} for _ in range(episodes)]
        return [{"trial": trial} for trial in range(trials)]

    @property
    def settings(self) -> dict[str, Any]:
        """All that defines the scenario, ready for JSON; equal for equal scenarios."""
        return {
            "id": self.env_id,
            "kwargs": json.loads(json.dumps(self.arguments, default=_with_name)),
            "description": self.description,
            "family": self.family + "-told" * self.told,
            "strength": self.strength,
            "unit": self.unit,
            "baseline": BASELINE if self.family else None,
        }


def scenario(name: str) -> Scenario:
    """Return the scenario of a name: a task's, or a perturbation's with any strength.

    Example:
        >>> scenario("longer-35-told").description
        'last segment 35 % longer, agents are told'
        >>> scenario("locked").name
        'locked-2'

    Raises:
        UserError: for an unknown name, or a strength that makes no sense.
    """
    return TASK_SCENARIOS[name] if name in TASK_SCENARIOS else _perturbed("scenario", name)


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
    """Return the fields of a task or a perturbation, and the name of its class."""
    return {"name": type(value).__name__, **asdict(value)}


def _joint(strength: float, time: float = 0.0) -> LockedJoint:
    fine = strength >= 1 and strength == int(strength)
    require(fine, "the joint that locks", strength, "a whole number from 1 (at the base) on")
    return LockedJoint(int(strength) - 1, time)


def _obstacles(strength: float) -> Obstacles:
    fine = strength in range(1, len(_DISCS) + 1)
    require(fine, "the number of obstacles", strength, f"a whole number from 1 to {len(_DISCS)}")
    return Obstacles(_DISCS[: int(strength)])


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
            strengths=(1.0, 2.0, 3.0),
            told=(1.0, 2.0, 3.0),
        ),
        Family(
            name="locks",
            unit="joint",
            description="joint {} (from the base) locked after 0.2 s",
            default=2.0,
            make=lambda joint: _joint(joint, time=0.2),
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
    name
    for family in FAMILIES.values()
    for untold in family.ids or (family.name,)
    for name in ([untold] if family.told is None else [untold, f"{untold}-told"])
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
