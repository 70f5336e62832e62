"""Playable environments as frozen values: scenarios of this package, or environments of your own.

A user's text is parsed once (`parse_scenario`, `parse_environment`).  The value is then passed to
the environments, the settings of a store, an experiment's trials and the rows of a report.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass, field, fields, replace
from typing import Any, TypeAlias

import gymnasium as gym
import numpy as np
from gymnasium.vector import VectorEnv

from mmc_gym._errors import UserError, require, require_arguments, require_whole, shown
from mmc_gym.envs.changes import Change, Family
from mmc_gym.envs.names import (
    BASELINE,
    CHALLENGES,
    TASKS,
    TaskEntry,
    environment_id,
    parse_parts,
    task_ids,
)
from mmc_gym.interface import InterfacedEnv

EnvLike: TypeAlias = "str | Callable[..., gym.Env[Any, Any]]"
"""The name of a scenario, the id of an environment, "module:Id" as in Gymnasium, "module:function",
or a function or class that takes the arguments and returns an environment."""

AnyVectorEnv: TypeAlias = "VectorEnv[Any, Any, Any]"


@dataclass(frozen=True)
class Scenario:
    """A task of this package with perturbations, and the arguments of its environment."""

    task: TaskEntry
    changes: tuple[Change, ...] = ()  #: the perturbations
    #: more arguments of the environment, such as control, engine or fields of the arm
    arguments: Mapping[str, Any] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """The name for task and perturbations together, with strengths."""
        name = "+".join(named.name for named in self._named)
        return name.removesuffix(CHALLENGES.get(self.challenge, "")) + self.challenge

    @property
    def challenge(self) -> str:
        """The name of the challenge that its last perturbations are; empty if they are none."""
        name = "+".join(change.name for change in self.changes)
        return next((key for key, names in CHALLENGES.items() if name.endswith(names)), "")

    @property
    def description(self) -> str:
        """One line that describes task and perturbations."""
        return "; ".join(named.description for named in self._named)

    @property
    def _named(self) -> tuple[TaskEntry | Change, ...]:
        """The parts of the name; "random" is one of them only without perturbations."""
        is_implied = self.changes and self.task.name == BASELINE
        return self.changes if is_implied else (self.task, *self.changes)

    @property
    def family(self) -> str:
        """The name up to the last strength: "centre-out+delay"; empty without perturbations.

        A challenge is a family by itself, without a strength.
        """
        if not self.changes or self.challenge:
            return self.name if self.challenge else ""
        *before, last = self._named
        assert isinstance(last, Change)
        return "+".join((*(part.name for part in before), last.family.name))

    @property
    def strength(self) -> float | None:
        """The strength of the last perturbation, comparable within the family; None without one."""
        return self.changes[-1].number if self.changes and not self.challenge else None

    @property
    def unit(self) -> str:
        """The unit of the strength; empty without one."""
        return self.changes[-1].unit if self.changes and not self.challenge else ""

    @property
    def settings(self) -> dict[str, Any]:
        """The definition of the scenario for JSON; equal for equal scenarios."""
        suffix = self.changes[-1].suffix if self.changes else ""
        task = {} if self.task.is_shipped else {"task": self.task.task}
        changes = {"perturbations": self.changes} if self.changes else {}
        arguments = {**task, **changes, **self.arguments}
        return {
            "id": environment_id(self.task.name if self.task.is_shipped else BASELINE),
            "kwargs": as_json(arguments),
            "description": self.description,
            "family": self.family + suffix,
            "strength": self.strength,
            "unit": self.unit,
            "baseline": self.task.name if self.family else None,
        }

    def instances(self, episodes: int) -> list[dict[str, Any]]:
        """Return the reset options of all numbered trials, or of `episodes` that are drawn."""
        return _instances(self.task.task.trial_count, episodes)

    def with_arguments(self, **more: Any) -> Scenario:
        """Return the scenario with more arguments; a `UserError` if it sets one of them itself."""
        self.refuse(more, "task", *(["perturbations"] if self.changes else []))
        return replace(self, arguments={**self.arguments, **more})

    def refuse(self, arguments: Mapping[str, Any], *names: str) -> None:
        """Raise a `UserError` if one of the arguments is in `names`, which the scenario sets."""
        for name in names:
            if name in arguments:
                raise UserError(
                    f"{name} must be left out, as the scenario {self.name!r} sets it; a name may "
                    "have a task and several perturbations, such as 'centre-out+rotation-30'"
                )

    def make(self, control: str | None = None) -> gym.Env[Any, Any]:
        """Make the single environment, with another control mode if one is given."""
        env_id, arguments = self.for_gymnasium(control)
        return _gymnasium(gym.make, self.name, env_id, arguments)

    def make_vec(self, count: int, control: str | None = None) -> AnyVectorEnv | None:
        """Make the native vector environment; None if its arms do not end together."""
        env_id, arguments = self.for_gymnasium(control)
        if arguments.get("terminate_on_success"):
            return None
        envs: AnyVectorEnv = gym.make_vec(env_id, num_envs=count, **arguments)
        return envs.unwrapped

    def for_gymnasium(self, control: str | None = None) -> tuple[str, dict[str, Any]]:
        """Return the id and the arguments with which Gymnasium makes the environment."""
        arguments = {**self.arguments, **({} if control is None else {"control": control})}
        if self.changes:
            arguments["perturbations"] = self.changes
        if self.task.is_registered:
            return environment_id(self.task.name), arguments
        steps = self.task.task.episode_steps  # of your own task, which a worker does not know
        if steps != TASKS[BASELINE].task.episode_steps:
            arguments.setdefault("max_episode_steps", steps)
        return environment_id(), {**arguments, "task": self.task.task}


@dataclass(frozen=True)
class OwnEnvironment:
    """An environment that is given by its id, or made by your function; not a `Scenario`."""

    name: str
    env: EnvLike
    arguments: Mapping[str, Any] = field(default_factory=dict)
    interface: Any = None  #: for an environment that has none, see `InterfacedEnv`
    #: definition for JSON, and number of the task's trials; `inspected` sets both
    settings: Mapping[str, Any] = field(default_factory=dict)
    trial_count: int | None = None

    changes: tuple[Change, ...] = field(default=(), init=False)
    family: str = field(default="", init=False)

    @property
    def description(self) -> str:
        """One line that names the environment."""
        return f"environment {self.name}"

    def inspected(self) -> OwnEnvironment:
        """Return a copy with `settings` and `trial_count`; make the environment once to read them.

        Raises:
            UserError: if it is not a reaching environment, and has no interface.
        """
        from mmc_gym._identity import identity  # `import mmc_gym` loads no cloudpickle

        with closing(self.make()) as env:
            is_known = self.interface is not None or hasattr(env.unwrapped, "parameters")
            accepted = "a reaching environment, or one with an interface"
            require(is_known, "scenario", self.env, accepted)
            setup = getattr(env.unwrapped, "setup", None)
            entry, layers = env.spec and env.spec.entry_point, list[Any]([env])
            while isinstance(layer := layers[-1], gym.Wrapper | InterfacedEnv):
                layers.append(layer.env)
            settings = {
                "id": name_of(self.env),
                "kwargs": self.arguments,
                "code": identity(self.env, self.interface, entry, *map(type, layers)),
                "registered": [env.spec.kwargs, env.spec.additional_wrappers] if env.spec else [],
                **({"interface": env.parameters} if isinstance(env, InterfacedEnv) else {}),
                "description": self.description,
                "family": "",
                "strength": None,
                "unit": "",
                "baseline": None,
            }
        count = setup.task.trial_count if setup is not None else None
        return replace(self, settings=as_json(settings), trial_count=count)

    def instances(self, episodes: int) -> list[dict[str, Any]]:
        """Return the reset options of all numbered trials, or of `episodes` that are drawn."""
        return _instances(self.trial_count, episodes)

    def with_arguments(self, **more: Any) -> OwnEnvironment:
        """Return the environment with more arguments."""
        return replace(self, arguments={**self.arguments, **more})

    def make(self, control: str | None = None) -> gym.Env[Any, Any]:
        """Make the environment, with another control mode if one is given.

        If your environment then raises a `TypeError`, it is made without the argument `control`.
        """
        arguments = dict(self.arguments)
        try:
            env = self._made(arguments if control is None else {**arguments, "control": control})
        except TypeError as error:
            if control is None or self._is_ours:
                raise _not_accepted(self.name, error) from error
            arguments.pop("control", None)  # another mistake will be raised again
            return replace(self, arguments=arguments).make()
        return env if self.interface is None else InterfacedEnv(env, self.interface)

    def make_vec(self, count: int, control: str | None = None) -> AnyVectorEnv | None:
        """Make the native vector environment; None if there is none, or its arms end apart."""
        spec = gym.registry.get(name_of(self.env).rpartition(":")[2])
        has_none = self.interface is not None or spec is None or spec.vector_entry_point is None
        if has_none or self.arguments.get("terminate_on_success"):
            return None
        arguments = {**self.arguments, **({} if control is None else {"control": control})}
        envs: AnyVectorEnv = gym.make_vec(name_of(self.env), num_envs=count, **arguments)
        return envs.unwrapped

    @property
    def _is_ours(self) -> bool:
        """Whether its id is one of this package, whose environments take all arguments."""
        spec = gym.registry.get(self.env) if isinstance(self.env, str) else None
        return spec is not None and str(spec.entry_point).startswith("mmc_gym.envs.")

    def _made(self, arguments: dict[str, Any]) -> gym.Env[Any, Any]:
        make: Any = self.env
        if isinstance(make, str):
            from mmc_gym._files import import_object, look_here  # `import mmc_gym` loads no yaml

            look_here()
            try:
                return _gymnasium(gym.make, make, make, arguments)
            except _NoEnvironment:  # "module:function" is no id
                try:
                    make = import_object(make, "env") if ":" in make else None
                except UserError:
                    make = None
                if not callable(make):
                    raise
        if isinstance(make, gym.Env) or not callable(make):
            accepted = "an id, the name of a scenario, or a function that returns an environment"
            raise UserError(f"env must be {accepted}, got {shown(make)}")
        env: gym.Env[Any, Any] = make(**arguments)
        accepted = "a function that returns an environment"
        require(isinstance(env, gym.Env), name_of(self.env), env, accepted)
        return env


Playable: TypeAlias = Scenario | OwnEnvironment


def _instances(trial_count: int | None, episodes: int) -> list[dict[str, Any]]:
    if trial_count is None:
        return [{} for _ in range(episodes)]
    return [{"trial": trial} for trial in range(trial_count)]


# Parsing


def parse_scenario(name: str, /, **arguments: Any) -> Scenario:
    """Return the scenario of a name: a task, perturbations of any strength, or both.

    The name may also be the id of a task.

    >>> parse_scenario("longer-35-known").description
    'last segment 35 % longer, given to agents'
    >>> parse_scenario("centre-out+locked").name
    'centre-out+locked-2'
    """
    task, changes = parse_parts(name)
    return Scenario(task, changes).with_arguments(**arguments)


def parse_environment(
    env: EnvLike | Playable, arguments: Mapping[str, Any] | None = None, interface: Any = None
) -> Playable:
    """Return the scenario of a name, or another environment, as a value.

    Args:
        env: see `EnvLike`; modules in the working directory are found.  An id means the
            environment that is registered with it.
        arguments: for its constructor.
        interface: of your own environment, if it has none, see `InterfacedEnv`.
    """
    arguments = require_arguments("env_kwargs", arguments)
    if isinstance(env, Scenario | OwnEnvironment):
        return env.with_arguments(**arguments)
    playable: Playable
    if _is_name(env):
        playable = parse_scenario(str(env), **arguments)
    else:
        playable = OwnEnvironment(name_of(env), env, arguments, interface)
    refuse_interface(interface, playable)
    return playable


def find_scenario(env: EnvLike | Playable) -> Playable:
    """Parse an environment like `parse_environment`, but read a task's id as its scenario."""
    if isinstance(env, str) and env in task_ids():
        return parse_scenario(env)
    return parse_environment(env)


def _is_name(env: object) -> bool:
    """Return whether a value is a text that is neither an id nor the address of a function."""
    return isinstance(env, str) and env not in gym.registry and not re.search(r":|-v\d+$", env)


def refuse_interface(interface: Any, *playables: Playable) -> None:
    """Raise a `UserError` if an interface is given for environments of this package."""
    shipped = [
        playable.name
        for playable in playables
        if isinstance(playable, Scenario) or playable._is_ours
    ]
    if interface is not None and shipped:
        names = ", ".join(shipped[:3]) + ", …" * (len(shipped) > 3)
        raise UserError(f"interface must be left out for scenarios of this package, got {names}")


def make(name: str, **arguments: Any) -> gym.Env[Any, Any]:
    """Make the environment of a scenario, or of an id, by `gym.make`.

    Args:
        name: a task with perturbations of any strength, such as "centre-out+rotation-30"; or an id.
        arguments: those of `gym.make` and of the environment, such as `render_mode`, `control` or
            `segment_lengths`.  `perturbations` may follow a name without any.

    >>> make("pursuit+delay-160", control="joint_velocity").spec.id
    'MMCReachPursuit-v0'
    """
    return parse_environment(name, arguments).make()


def make_vec(name: str, num_envs: int = 1, **arguments: Any) -> AnyVectorEnv:
    """Make many environments of a scenario, or of an id, by `gym.make_vec`; see `make`."""
    env_id, env_arguments = name, arguments
    if _is_name(name):
        env_id, env_arguments = parse_scenario(name, **arguments).for_gymnasium()
    return _gymnasium(gym.make_vec, name, env_id, {**env_arguments, "num_envs": num_envs})


class _NoEnvironment(UserError):
    """Gymnasium cannot make an environment."""


def _gymnasium(
    make: Callable[..., Any], name: str, env_id: str, arguments: Mapping[str, Any]
) -> Any:
    """Call `gym.make` or `gym.make_vec`; an error message names the environment."""
    if (steps := arguments.get("max_episode_steps")) not in (None, -1):  # -1: no limit
        require_whole("max_episode_steps", steps)
    try:
        return make(env_id, **arguments)
    except UserError:
        raise
    except (gym.error.Error, ImportError) as error:
        raise _not_accepted(name, error) from error


def _not_accepted(name: str, error: Exception) -> _NoEnvironment:
    return _NoEnvironment(
        "env must be a reaching environment such as 'MMCReach-v0', or a scenario such as "
        f"'rotation-30', got {name!r}: {error}"
    )


def name_of(env: EnvLike) -> str:
    """Return the name of an environment for tables: its id, or the name of the function."""
    return env if isinstance(env, str) else getattr(env, "__name__", type(env).__name__)


# Identity, for stores


def as_json(arguments: Mapping[str, Any]) -> Any:
    """Return arguments as plain values that JSON can hold.

    A task or a perturbation becomes its fields, the name of its class and, if it is your own, the
    `identity` of its code: changed code is another scenario.
    """
    from mmc_gym._identity import identity, is_own

    def code(kind: Any) -> dict[str, str]:
        return {"code": identity(kind)} if is_own(kind.__module__) else {}

    def is_never(value: Any) -> bool:
        return isinstance(value, float) and value == math.inf

    def declared(value: Any) -> dict[str, Any]:
        if "__dataclass_fields__" in vars(type(value)):  # inherited fields may not be all
            declared_fields = {field.name: getattr(value, field.name) for field in fields(value)}
            # JSON has no infinite numbers: what never ends has no end.
            return {name: each for name, each in declared_fields.items() if not is_never(each)}
        return dict(vars(value)) if hasattr(value, "__dict__") else {"value": repr(value)}

    def plain(value: Any) -> Any:
        if isinstance(value, np.ndarray | np.generic):
            return value.tolist()
        if hasattr(value, "dist"):  # a frozen distribution of scipy.stats
            kind = type(value.dist)
            return {"name": value.dist.name, "args": value.args, **value.kwds, **code(kind)}
        if isinstance(value, Family):
            return {"name": value.name, **code(value.apply)}
        if callable(value):
            return {"name": name_of(value), "code": identity(value)}
        return {"name": type(value).__name__, **declared(value), **code(type(value))}

    return json.loads(json.dumps(arguments, default=plain))
