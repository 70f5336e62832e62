"""Hyperparameters: YAML files in rl_zoo3's form, which hold stable-baselines3's own arguments.

A file maps ids of environments to entries.  The keys of an entry are arguments of the algorithm's
constructor (`PPO`, `SAC` or `TQC`), and

    n_timesteps       environment steps of the training
    n_envs            number of environments
    env_kwargs        arguments of the environment
    vec_env_wrapper   a wrapper around them, a mapping of it to its arguments, or a list of these

Values are those of the constructor.  In addition, any schedule may be `lin_START`, which falls
linearly to 0; `policy_kwargs` may be a text `dict(net_arch=[64], activation_fn=nn.ReLU)`; and
classes are given by the names in `Recipe.classes`.  No code from a file is run.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Mapping
from contextlib import suppress
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import partial
from importlib.resources import files
from operator import mul
from pathlib import Path
from typing import Annotated, Any, ClassVar

import gymnasium as gym
from pydantic import ConfigDict, Field, ValidationError, create_model
from sb3_contrib import TQC
from stable_baselines3 import PPO, SAC, HerReplayBuffer
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper, VecMonitor

from mmc_gym._errors import UserError, explain, require, require_whole, shown, unknown
from mmc_gym._files import read_yaml, read_yaml_file
from mmc_gym.agents.policy import Algorithm
from mmc_gym.training.policies import ACTIVATIONS, TQCGoalPolicy

ALGORITHMS: dict[Algorithm, type[BaseAlgorithm]] = {"ppo": PPO, "sac": SAC, "tqc": TQC}
SUFFIXES = (".yml", ".yaml")
_SHIPPED = Path(str(files("mmc_gym.training") / "hyperparams"))

Count = Annotated[int, Field(ge=1)]
_OWN: dict[str, Any] = {  # keys that are not arguments of the algorithm: type, default
    "n_timesteps": (Count, ...),
    "policy": (Any, ...),
    "n_envs": (Count, 1),
    "env_kwargs": (dict[str, Any], {}),
    "vec_env_wrapper": (Any, None),
}
_OURS = ("self", "env", "seed", "device", "tensorboard_log", "_init_setup_model")  # not in files


@dataclass(frozen=True)
class Recipe:
    """An entry of a hyperparameter file."""

    name: str  #: of the file, without folder and suffix; it begins with the algorithm's
    env_id: str  #: the environment to train in
    hyperparameters: dict[str, Any]  #: the entry of the file for it

    #: policies, wrappers and replay buffers that the entry may name; a module of yours may add some
    classes: ClassVar[dict[str, type]] = {
        f"{TQCGoalPolicy.__module__}.{TQCGoalPolicy.__name__}": TQCGoalPolicy,
        "HerReplayBuffer": HerReplayBuffer,
    }

    def with_changes(self, **changes: Any) -> Recipe:
        """Return the recipe with other hyperparameters."""
        return replace(self, hyperparameters={**self.hyperparameters, **changes})

    @property
    def algorithm(self) -> Algorithm:
        """The algorithm: the name up to the first "-"."""
        name = self.name.partition("-")[0]
        if name not in ALGORITHMS:
            known = ", ".join(ALGORITHMS)
            raise UserError(f"name must begin with one of {known}, got {self.name!r}")
        return name

    @property
    def algorithm_class(self) -> type[BaseAlgorithm]:
        """The algorithm's class."""
        return ALGORITHMS[self.algorithm]

    @property
    def settings(self) -> dict[str, Any]:
        """All keys with their values, converted to what the constructor takes, or its defaults."""
        parameters = _parameters(self.algorithm_class)
        fields = {**{key: (one.annotation, one.default) for key, one in parameters.items()}, **_OWN}
        for key in self.hyperparameters:
            if key not in fields:
                raise unknown(f"{self.name}: hyperparameter", key, fields)
        try:
            # A copy, because stable-baselines3 changes its arguments.
            given = {key: self._read(key, deepcopy(v)) for key, v in self.hyperparameters.items()}
            config = ConfigDict(arbitrary_types_allowed=True, allow_inf_nan=False)
            checked = create_model(self.name, __config__=config, **fields).model_validate(given)
        except ValidationError as error:
            raise UserError(f"hyperparameters of {self.name}: {explain(error)}") from error
        return dict(checked)

    def steps_per_leg(self, evaluations: int) -> int:
        """Return the environment steps of a leg: whole rollouts, between two evaluations."""
        settings = self.settings
        try:
            episode_steps = gym.spec(self.env_id).max_episode_steps or 1
        except gym.error.Error as error:
            raise UserError(f"env must be the id of an environment: {error}") from error
        # If episodes never ended, evaluations would not either.
        episode_steps = settings["env_kwargs"].get("max_episode_steps", episode_steps)
        steps = require_whole("max_episode_steps", episode_steps)
        if issubclass(self.algorithm_class, OffPolicyAlgorithm):
            frequency = settings["train_freq"]
            count, unit = frequency if isinstance(frequency, tuple) else (frequency, "step")
            rollout = require_whole("train_freq", count) * (steps if unit == "episode" else 1)
            # Hindsight learns from whole episodes: a leg must not end within one.
            rollout = math.lcm(rollout, steps) if settings["replay_buffer_class"] else rollout
        else:
            rollout = require_whole("n_steps", settings["n_steps"])
        whole: int = rollout * settings["n_envs"]
        leg: int = math.ceil(settings["n_timesteps"] / whole / evaluations) * whole
        return leg

    def make_model(
        self, env: VecEnv, seed: int, device: str = "cpu", tensorboard: str | None = None
    ) -> BaseAlgorithm:
        """Return an untrained model, which logs to the folder `tensorboard`."""
        settings = self.settings
        # The constructor itself has the defaults of the keys that are not in the file.
        options = {key: settings[key] for key in self.hyperparameters if key not in _OWN}
        try:
            for wrap in settings["vec_env_wrapper"] or ():
                env = wrap(env)
            return self.algorithm_class(
                settings["policy"],
                VecMonitor(env),
                **options,
                seed=seed,
                device=device,
                tensorboard_log=tensorboard,
            )
        except UserError:
            raise
        except Exception as error:  # whatever the constructor says
            raise UserError(
                f"hyperparameters of {self.name} must be accepted by stable-baselines3, "
                f"got {shown(self.hyperparameters)}: {type(error).__name__}: {error}"
            ) from error

    def _read(self, key: str, value: Any) -> Any:
        """Convert a value of the file to what Python code would give to the constructor."""
        if isinstance(value, str):
            with suppress(ValueError):  # a number; to YAML 1e-3 is a text
                number = float(value.removeprefix("lin_"))
                # A schedule is a function of the part that remains, from 1 to 0.
                return partial(mul, number) if value.startswith("lin_") else number
        if key == "policy" and value != "MlpPolicy":
            plain = self.algorithm_class.policy_aliases["MlpPolicy"]
            return self._class(key, value, plain, "MlpPolicy")
        if key == "replay_buffer_class" and value is not None:
            return self._class(key, value, HerReplayBuffer)
        if key == "vec_env_wrapper" and value is not None:
            return [self._wrapper(part) for part in (value if isinstance(value, list) else [value])]
        if key == "policy_kwargs":
            return self._policy_options(value)
        return value

    def _class(self, key: str, name: object, base: type, *also: str) -> Any:
        known = {each: kind for each, kind in self.classes.items() if issubclass(kind, base)}
        if not isinstance(name, str) or name not in known:
            yours = "what a module of yours adds to Recipe.classes"
            raise unknown(f"{self.name}: {key}", name, (*also, *known), yours)
        return known[name]

    def _wrapper(self, part: Any) -> partial[VecEnvWrapper]:
        """Read the name of a wrapper, or a mapping of it to its arguments."""
        has_arguments = isinstance(part, dict) and len(part) == 1
        name, arguments = next(iter(part.items())) if has_arguments else (part, None)
        kind, arguments = self._class("vec_env_wrapper", name, VecEnvWrapper), arguments or {}
        require(isinstance(arguments, dict), f"{self.name}: {name}", arguments, "a mapping")
        return partial(kind, **arguments)

    def _policy_options(self, value: Any) -> Any:
        if isinstance(value, str):  # a mapping of YAML, but for the brackets
            text = value.replace("dict(", "{").replace(")", "}").replace("=", ": ")
            with suppress(ValueError):
                value = read_yaml(text)
        if isinstance(value, dict) and "activation_fn" in value:
            name = str(value["activation_fn"]).removeprefix("nn.").lower()
            known = {str(each): kind for each, kind in ACTIVATIONS.items()}
            if name not in known:
                raise unknown(f"{self.name}: activation_fn", value["activation_fn"], known)
            value["activation_fn"] = known[name]
        return value


def _parameters(kind: type) -> dict[str, inspect.Parameter]:
    """Return the parameters of a constructor, with those of the base class that it accepts."""
    own = inspect.signature(kind.__init__, eval_str=True).parameters  # type: ignore[misc]
    unnamed = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
    named = {name: one for name, one in own.items() if one.kind not in unnamed}
    inherited = _parameters(kind.__base__ or object) if len(named) < len(own) else {}
    return {name: one for name, one in (inherited | named).items() if name not in _OURS}


def names() -> list[str]:
    """Return the names of the files that ship."""
    return sorted(path.stem for path in _SHIPPED.glob("*.yml"))


def read_recipe(
    source: str,
    env_id: str | None = None,
    steps: int | None = None,
    env_kwargs: Mapping[str, Any] | None = None,
) -> Recipe:
    """Read an entry of a hyperparameter file.

    Args:
        source: the name of a file that ships, see `names`, or the path of your own YAML file.
        env_id: the environment; None for the first in the file, which must be of this package.
        steps: environment steps of the training, instead of `n_timesteps`.
        env_kwargs: arguments of the environment, beside those in the file.

    Raises:
        FileNotFoundError: if there is no such file.
    """
    require(isinstance(source, str), "name", source, "a name, or the path of a YAML file")
    path = Path(source)
    if path.suffix not in SUFFIXES:
        if source not in names():
            raise unknown("name", source, names(), "the path of a YAML file")
        path = _SHIPPED / f"{source}.yml"
    try:
        entries = read_yaml_file(path)
    except ValueError as error:
        raise UserError(f"{source} must be YAML: {error}") from error
    if not isinstance(entries, dict) or not entries:
        raise UserError(f"{source} must map environments to hyperparameters, got {entries!r}")
    if env_id is None:
        env_id = next(iter(entries))
        spec = gym.registry.get(env_id)  # of others some import what their arguments name
        is_own = spec is None or str(spec.entry_point).startswith("mmc_gym.")
        accepted = "of this package, or said by yourself too (--env), since it may run any code"
        require(is_own and ":" not in env_id, f"{source}: env", env_id, accepted)
    if env_id not in entries:
        raise unknown(f"env for {source}", env_id, entries)
    entry = entries[env_id]
    if not isinstance(entry, dict):
        raise UserError(f"{source} must have hyperparameters for {env_id}, got {entry!r}")
    recipe = Recipe(path.stem, env_id, entry)
    if env_kwargs is not None:
        require(isinstance(env_kwargs, Mapping), "env_kwargs", env_kwargs, "a mapping")
    if env_kwargs:
        recipe = recipe.with_changes(env_kwargs={**(entry.get("env_kwargs") or {}), **env_kwargs})
    return recipe if steps is None else recipe.with_changes(n_timesteps=steps)
