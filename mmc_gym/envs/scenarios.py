"""Scenarios: a task with perturbations under one name, and how to make its environments.

One grammar holds everywhere, in `mmc_gym.make`, commands, the benchmark, reports and file names:

    [<task>+]<perturbation>[-<strength>][-known][+<perturbation>…]

    random, centre-out, rotation-30, centre-out+rotation-30, longer-35-known+delay-160

Any strength is accepted; a name without one has the family's default (`force-field` is
`force-field-60`).  With `-known`, agents are given the changed body.  Without a task it is
"random": an agent's episodes differ from those of `random` in the perturbations alone, because the
same seeds draw the same starts and targets.

Tasks have ids, in camel case: `MMCReachCentreOut-v0`.  Perturbations are arguments of all of them.
"""

from __future__ import annotations

import hashlib
import inspect
import json
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain
from typing import TYPE_CHECKING, Any, TypeAlias

import gymnasium as gym
import numpy as np
from gymnasium.vector import VectorEnv

from mmc_gym._errors import UserError, nearest, require, require_whole, shown, unknown
from mmc_gym._files import import_object, look_here
from mmc_gym.envs.perturbations import FAMILIES, Family, Perturbation
from mmc_gym.envs.tasks import TASKS, Task
from mmc_gym.interface import InterfacedEnv

if TYPE_CHECKING:
    from mmc_gym.envs.spec import ReachSetup

EnvLike: TypeAlias = "str | Callable[..., gym.Env[Any, Any]]"
"""The name of a scenario, the id of an environment, "module:Id" as in Gymnasium, "module:function",
or a function or class that takes the arguments and returns an environment."""

BASELINE = "random"
"""The scenario without perturbation: strength 0 of every family."""


def name_of(env: EnvLike) -> str:
    """Return the name of an environment for tables: its id, or the name of the function."""
    return env if isinstance(env, str) else getattr(env, "__name__", type(env).__name__)


def make(name: str, **arguments: Any) -> gym.Env[Any, Any]:
    """Make the environment of a scenario, or of an id, by `gym.make`.

    Args:
        name: a task with perturbations of any strength, such as "centre-out+rotation-30"; or an id.
        arguments: those of `gym.make` and of the environment, such as `render_mode`, `control` or
            `segment_lengths`.  `perturbations` may follow a name without any.

    >>> make("pursuit+delay-160", control="joint_velocity").spec.id
    'MMCReachPursuit-v0'
    """
    return make_environment(name, **arguments)


def make_vec(name: str, num_envs: int = 1, **arguments: Any) -> VectorEnv[Any, Any, Any]:
    """Make many environments of a scenario, or of an id, by `gym.make_vec`; see `make`."""
    env_id, given = _for_gymnasium(name, arguments)
    try:
        return gym.make_vec(env_id, num_envs=num_envs, **given)
    except (gym.error.Error, ImportError, TypeError) as error:
        raise _not_accepted(name, error) from error


def _for_gymnasium(env: str, arguments: dict[str, Any]) -> tuple[str, dict[str, Any]]:
    """Return the id of a name, and the arguments with those that the name sets."""
    if not isinstance(env, str) or ":" in env or env in gym.registry or _VERSION.search(env):
        return env, arguments
    found = scenario(env)
    found.refuse(arguments, "task", *(["perturbations"] if found.perturbations else []))
    return environment_id(found.task_name), {**found.named_perturbations, **arguments}


_VERSION = re.compile(r"-v\d+$")


def make_environment(
    env: EnvLike, control: str | None = None, **arguments: Any
) -> gym.Env[Any, Any]:
    """Make an environment.

    Args:
        env: see `EnvLike`; modules in the working directory are found.
        control: the control mode; None keeps that among the arguments, or the default.  It is left
            out if your own environment takes no such argument.
        arguments: for its constructor.
    """
    try:
        return _made(env, arguments if control is None else {**arguments, "control": control})
    except TypeError as error:
        spec = gym.registry.get(env) if isinstance(env, str) else None
        is_own = spec is None or not str(spec.entry_point).startswith("mmc_gym.envs.")
        if control is not None and is_own:
            return make_environment(env, **arguments)
        raise _not_accepted(env, error) from error


def _made(env: EnvLike, arguments: dict[str, Any]) -> gym.Env[Any, Any]:
    make: Any = env
    if isinstance(env, str):
        look_here()
        env_id, given = _for_gymnasium(env, arguments)
        if (steps := given.get("max_episode_steps")) not in (None, -1):  # -1: no limit
            require_whole("max_episode_steps", steps)
        try:
            return gym.make(env_id, **given)
        except UserError:
            raise
        except (gym.error.Error, ImportError) as error:  # "module:function" is no id
            try:
                make = import_object(env, "env") if ":" in env else None
            except UserError:
                make = None
            if not callable(make):
                raise _not_accepted(env, error) from error
    if isinstance(make, gym.Env) or not callable(make):
        accepted = "an id, the name of a scenario, or a function that returns an environment"
        raise UserError(f"env must be {accepted}, got {shown(make)}")
    made: gym.Env[Any, Any] = make(**arguments)
    require(isinstance(made, gym.Env), name_of(env), made, "a function that returns an environment")
    return made


def _not_accepted(env: EnvLike, error: Exception) -> UserError:
    return UserError(
        "env must be a reaching environment such as 'MMCReach-v0', or a scenario such as "
        f"'rotation-30', got {name_of(env)!r}: {error}"
    )


def code_of(thing: Any) -> str:
    """Return the SHA-256 of the source of an object's class, and of the environment it wraps.

    It is empty if none of these classes is yours.  It does not notice changes of imported code.
    """
    kinds = [type(thing)]
    while isinstance(thing, gym.Wrapper | InterfacedEnv):
        thing = thing.env
        kinds.append(type(thing))
    code = ""
    for kind in kinds:
        if not kind.__module__.startswith(("mmc_gym.", "gymnasium.")):
            try:
                code += inspect.getsource(kind)
            except (OSError, TypeError):  # typed into an interpreter, or compiled
                code += kind.__qualname__
    return hashlib.sha256(code.encode()).hexdigest() if code else ""


@dataclass(frozen=True)
class Scenario:
    """A task with perturbations, under one name."""

    name: str  #: the one name, with its strength
    description: str
    task: str | Task = "random"
    perturbations: tuple[Perturbation, ...] = ()
    env: EnvLike | None = None  #: your own environment, in place of task and perturbations
    #: more arguments of the environment
    env_kwargs: Mapping[str, Any] = field(default_factory=dict)
    #: of your own environment, if it says nothing of one, see `InterfacedEnv`
    interface: Any = None
    #: the name up to the strength of the last perturbation, such as "delay" or "centre-out+delay";
    #: empty for a task
    family: str = ""
    strength: float | None = None  #: of the last perturbation, comparable within the family
    unit: str = ""
    known: bool = False  #: whether agents are given what the last perturbation changes

    @property
    def task_name(self) -> str:
        """The name of the task, which is that of the scenario without perturbations."""
        return self.task if isinstance(self.task, str) else self.name.partition("+")[0]

    @property
    def named_perturbations(self) -> dict[str, list[str]]:
        """The argument that gives the perturbations by name; empty without any."""
        count = len(self.perturbations)
        return {"perturbations": self.name.split("+")[-count:]} if count else {}

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

    def refuse(self, arguments: Iterable[str], *own: str) -> None:
        """Raise a `UserError` if one of the arguments is in `own`, which the scenario sets."""
        for name in own if self.env is None else ():
            if name in arguments:
                raise UserError(
                    f"{name} must be left out, as the scenario {self.name!r} sets it; a name may "
                    "have a task and several perturbations, such as 'centre-out+rotation-30'"
                )

    def make(self, control: str | None = None) -> gym.Env[Any, Any]:
        """Make the single environment, see `make_environment`."""
        made = make_environment(self.env or self.env_id, control, **self._with_steps)
        return made if self.interface is None else InterfacedEnv(made, self.interface)

    def make_vec(
        self, num_envs: int, control: str | None = None
    ) -> VectorEnv[Any, Any, Any] | None:
        """Make the native vector environment, with another control mode if one is given.

        Returns:
            None if it is your own environment and has no vector environment.
        """
        if self.interface is not None:
            return None
        arguments = self._with_steps | ({} if control is None else {"control": control})
        if self.env is not None:
            spec = gym.registry.get(self.env_id.rpartition(":")[2])
            if spec is None or spec.vector_entry_point is None:
                return None
        return gym.make_vec(self.env_id, num_envs=num_envs, **arguments).unwrapped

    @property
    def _with_steps(self) -> dict[str, Any]:
        """The arguments, with the length of an episode if it differs from that of the id."""
        if isinstance(self.task, Task) and self.task.episode_steps != TASKS["random"].episode_steps:
            return {**self.arguments, "max_episode_steps": self.task.episode_steps}
        return self.arguments

    @property
    def trial_count(self) -> int | None:
        """Number of its numbered trials; None if they are drawn."""
        if self.env is None:
            return find_task(self.task).trial_count
        with closing(self.make()) as env:
            setup: ReachSetup | None = getattr(env.unwrapped, "setup", None)
            return None if setup is None else setup.task.trial_count

    def instances(self, episodes: int) -> list[dict[str, Any]]:
        """Return the reset options of all numbered trials, or of `episodes` that are drawn."""
        trials = self.trial_count
        if trials is None:
            return [{} for _ in range(episodes)]
        return [{"trial": trial} for trial in range(trials)]

    @property
    def settings(self) -> dict[str, Any]:
        """The definition of the scenario for JSON; equal for equal scenarios."""
        own: dict[str, Any] = {}
        if self.env is not None:
            with closing(self.make()) as env:
                registered = env.spec.kwargs if env.spec else {}
                own = {"code": code_of(env), "registered": _as_json(registered)}
                if isinstance(env, InterfacedEnv):
                    own |= _as_json({"interface": env.parameters})
        return {
            "id": self.env_id,
            "kwargs": _as_json(self.arguments),
            **own,
            "description": self.description,
            "family": self.family + "-known" * self.known,
            "strength": self.strength,
            "unit": self.unit,
            "baseline": self.task_name if self.family else None,
        }


def scenario(name: str, interface: Any = None) -> Scenario:
    """Return the scenario of a name: a task, perturbations of any strength, or both.

    The name may also be the id of a task, or that of your own environment, as `make_environment`
    takes it: a registered id, "module:Id", or "module:function"; one that is not of this package
    needs an `interface` (`InterfacedEnv`).

    >>> scenario("longer-35-known").description
    'last segment 35 % longer, given to agents'
    >>> scenario("centre-out+locked").name
    'centre-out+locked-2'
    """
    if not isinstance(name, str):
        raise _unknown(name)
    name = {environment_id(task): task for task in TASK_SCENARIOS}.get(name, name)
    if ":" in name or name in gym.registry:
        return own_scenario(name, interface=interface)
    first, *others = name.split("+")
    if first not in TASK_SCENARIOS:
        first, others = BASELINE, [first, *others]
    return _joined(
        TASK_SCENARIOS[first], [perturbation_scenario(one, "scenario") for one in others]
    )


def _joined(task: Scenario, changes: Sequence[Scenario]) -> Scenario:
    """Return the scenario of a task under the perturbations of other scenarios."""
    if not changes:
        return task
    *before, last = changes
    before = [*([] if task.name == BASELINE else [task]), *before]
    return replace(
        last,
        name="+".join(one.name for one in (*before, last)),
        description="; ".join(one.description for one in (*before, last)),
        task=task.task,
        perturbations=tuple(chain.from_iterable(one.perturbations for one in changes)),
        family="+".join((*(one.name for one in before), last.family)),
    )


def perturbed(family: Family, strength: float, known: bool = False) -> Scenario:
    """Return the scenario of a perturbation, in the task "random"."""
    if known and not family.known:
        accepted = ", ".join(one.name for one in FAMILIES.values() if one.known)
        raise UserError(f"'-known' may follow {accepted} only, got it after {family.name!r}")
    # Digits without exponent, as the grammar reads them.
    digits = np.format_float_positional(strength, trim="-")
    try:
        perturbation = family.make(strength)
    except (UserError, TypeError) as error:
        raise UserError(f"{family.name}-{digits} has no such strength: {error}") from error
    accepted, name = "a Perturbation of the strength", f"what {family.name!r} makes"
    require(isinstance(perturbation, Perturbation), name, perturbation, accepted)
    perturbation.check_hooks()
    description = family.description.format(digits)
    if family.known:
        description += f", {'given' if known else 'not given'} to agents"
        perturbation = replace(perturbation, known=known)  # type: ignore[type-var]
    return Scenario(
        name=f"{family.name}-{digits}{'-known' * known}",
        description=description,
        perturbations=(perturbation,),
        family=family.name,
        strength=strength,
        unit=family.unit,
        known=known,
    )


def own_scenario(env: EnvLike, name: str = "", interface: Any = None) -> Scenario:
    """Return the scenario of your own environment, under its own name unless one is given."""
    with closing(make_environment(env)) as made:
        is_known = interface is not None or hasattr(made.unwrapped, "parameters")
        require(is_known, "scenario", env, "a reaching environment, or one with an interface")
    name = name or name_of(env)
    return Scenario(name, f"environment {name}", env=env)


def find_perturbation(value: object) -> Perturbation:
    """Return the perturbation of a name, or `value` itself if it is a perturbation."""
    if isinstance(value, Perturbation):
        value.check_hooks()
        return value
    return perturbation_scenario(value).perturbations[0]


def find_task(value: object) -> Task:
    """Return the task of a name, or `value` itself if it is a task."""
    if isinstance(value, Task):
        value.check_hooks()
        return value
    if not isinstance(value, str) or value not in TASKS:
        raise unknown("task", value, TASKS, "a Task")
    return TASKS[value]


def environment_id(name: str = BASELINE) -> str:
    """Return the id of a task: `MMCReachCentreOut-v0` of `centre-out`."""
    words = "" if name == "random" else "".join(word.capitalize() for word in name.split("-"))
    return f"MMCReach{words}-v0"


def register_all() -> None:
    """Register every environment with Gymnasium."""
    _register("MMCReachGoal-v0", TASKS["random"], {}, kind="MMCReachGoal")
    for name, task in TASKS.items():
        _register(environment_id(name), task, {} if name == "random" else {"task": name})


def _register(env_id: str, task: Task, arguments: dict[str, Any], kind: str = "MMCReach") -> None:
    gym.registry.pop(env_id, None)  # of a module that is read again
    gym.register(
        id=env_id,
        entry_point=f"mmc_gym.envs.reach:{kind}Env",
        vector_entry_point=f"mmc_gym.envs.vector:{kind}VectorEnv",
        max_episode_steps=task.episode_steps,
        kwargs=arguments,  # names, not objects: Gymnasium's specs stay serialisable
    )


_NAME = re.compile(r"(?P<family>[a-z-]+?)(?:-(?P<strength>-?\d+(?:\.\d+)?))?(?P<known>-known)?")


def perturbation_scenario(name: object, argument: str = "perturbations") -> Scenario:
    """Return the scenario of one perturbation's name, which is looked up and never imported.

    So it may come from a file.  An error names the argument.
    """
    match = _NAME.fullmatch(name) if isinstance(name, str) else None
    if match is None or match["family"] not in FAMILIES:
        raise _unknown(name, argument)
    family = FAMILIES[match["family"]]
    strength = family.default if match["strength"] is None else float(match["strength"])
    return perturbed(family, strength, known=match["known"] is not None)


def _unknown(name: object, argument: str = "scenario") -> UserError:
    """Return the error that a name is unknown, with what may have been meant."""
    if isinstance(name, str) and name in TASK_SCENARIOS:
        return UserError(f"{name!r} is a task, which stands first: '{name}+rotation-30'")
    also, known = ["one with a strength (delay-160)"], list(FAMILIES)
    if argument == "perturbations" and "+" in str(name):
        also.append(f"a list such as {str(name).split('+')}")
    elif argument == "perturbations":
        also.append("a Perturbation")
    else:
        known = [*TASK_SCENARIOS, *FAMILIES]
        also.append("several (centre-out+rotation-30)")
    word = re.split("-(?=-?[0-9]|known$)", name)[0] if isinstance(name, str) else ""
    guess = nearest(word, known)
    if guess in FAMILIES and "+" not in str(name):  # with the strength that was given
        guess += str(name)[len(word) :]
    return unknown(argument, name, known, *also, guess=guess)


def _as_json(arguments: dict[str, Any]) -> Any:
    """Return arguments as JSON has them.

    A task or a perturbation becomes its fields, the name of its class and, if it is your own, a
    digest of its code: changed code is another scenario.
    """

    def fields(value: Any) -> Any:
        if isinstance(value, np.ndarray | np.generic):
            return value.tolist()
        kept = {"value": repr(value)} if not hasattr(value, "__dict__") else vars(value)
        # A cached property appears among the others once it has been read.
        cached = {name for name in kept if isinstance(_declared(value, name), cached_property)}
        plain = {name: one for name, one in kept.items() if name not in cached}
        code = code_of(value)
        return {"name": type(value).__name__, **plain, **({"code": code} if code else {})}

    return json.loads(json.dumps(arguments, default=fields))


def _declared(value: Any, name: str) -> Any:
    """Return what the class of a value says of an attribute; None if nothing."""
    return inspect.getattr_static(type(value), name, None)


_SHIPPED = frozenset((*TASKS, *FAMILIES))  # yours may be registered again, as in a notebook


def register_task(name: str, task: Task, description: str = "") -> None:
    """Name your own task, for its id, arguments, the benchmark, the report and file names.

    Args:
        name: words with hyphens that nothing else is called by, such as "near-targets", whose id is
            `MMCReachNearTargets-v0`.
        task: an object of your class.
        description: a line for the report.
    """
    fine = isinstance(name, str) and name not in {*FAMILIES, *_SHIPPED}
    fine = fine and re.fullmatch("[a-z][a-z0-9]*(-[a-z0-9]+)*", name) is not None
    require(fine, "name", name, "words of a-z and 0-9 with hyphens, that no other task has")
    require(isinstance(task, Task), "task", task, "an object of a class derived from Task")
    TASKS[name] = task
    # The object, not its name: a worker need not know what is registered here.
    TASK_SCENARIOS[name] = Scenario(name, description or name.replace("-", " "), task)
    _register(environment_id(name), task, {"task": name})


def register_perturbation(family: Family) -> None:
    """Name your own perturbations, for scenarios, arguments, the benchmark and the report.

    The family's name is words with hyphens that no task and no family of this package is called by.
    """
    require(isinstance(family, Family), "family", family, "a Family")
    fine = family.name not in {*TASKS, *_SHIPPED}
    fine = fine and re.fullmatch("[a-z]+(-[a-z]+)*", family.name) is not None
    require(fine, "name", family.name, "words of a-z with hyphens, that no other family has")
    perturbed(family, family.default)  # raises an error if the family is not consistent
    FAMILIES[family.name] = family


TASK_SCENARIOS: dict[str, Scenario] = {
    one.name: one
    for one in (
        Scenario("random", "random starts and targets", "random"),
        Scenario("paper", "the paper's 420 movements between 21 targets", "paper"),
        Scenario("centre-out", "eight targets around a point", "centre-out"),
        Scenario("distances", "eight directions at each of four distances", "distances"),
        Scenario("double-step-100", "target jumps after 0.1 s", "double-step-100"),
        Scenario("double-step-200", "target jumps after 0.2 s", "double-step-200"),
        Scenario("pursuit", "target moves along sums of sines", "pursuit"),
        Scenario("via-points", "three targets, one after the other", "via-points"),
    )
}
"""The scenarios without perturbation, by name."""
