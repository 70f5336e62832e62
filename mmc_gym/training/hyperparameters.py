"""Hyperparameters: YAML files in rl_zoo3's form, which hold stable-baselines3's own arguments.

A file maps ids of environments to entries.  The keys of an entry are arguments of the algorithm's
constructor (see `mmc_gym.agents.policy.ALGORITHMS`), and

    n_timesteps       environment steps of the training
    n_envs            number of environments
    env_kwargs        arguments of the environment
    perturbations     one of them: what is drawn for each episode, such as [rotation--60..60]; or
                      [{one_of: [rotation--60..60, locks-1..3, null], weights: [2, 2, 1]}];
                      or a recipe that has them: a name that ships, or a file beside this one
    vec_env_wrapper   a wrapper around them, a mapping of it to its arguments, or a list of these
    memory            steps in each block of a memory of observations and actions, see `Memory`
    normalize         true, or arguments of `VecNormalize`, which is put around these
    noise_type        of actions in training: normal, or ornstein-uhlenbeck
    noise_std         its standard deviation

Values are those of the constructor, and checked by its annotations.  In addition, any schedule may
be `lin_START`, which falls linearly to 0; `policy_kwargs` and `normalize` may be a text, such as
`dict(net_arch=[64], activation_fn=nn.ReLU)` or `{'norm_reward': False}`; and classes are given by
the names in `Recipe.classes`.  No code from a file is run.
"""

from __future__ import annotations

import ast
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
from pkgutil import resolve_name
from typing import Annotated, Any, ClassVar, Literal

import gymnasium as gym
import numpy as np
from pydantic import BeforeValidator, ConfigDict, Field, TypeAdapter, ValidationError, create_model
from stable_baselines3 import HerReplayBuffer
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.noise import NormalActionNoise, OrnsteinUhlenbeckActionNoise
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper, VecMonitor, VecNormalize

from mmc_gym._errors import (
    UserError,
    explain,
    require,
    require_arguments,
    require_choice,
    require_known,
    require_whole,
    shown,
    unknown,
)
from mmc_gym._files import read_yaml_file
from mmc_gym.agents.policy import ALGORITHMS
from mmc_gym.benchmark.kinds import name_without
from mmc_gym.envs.changes import AnyChange, OneOf
from mmc_gym.envs.names import as_changes, as_plain
from mmc_gym.envs.perturbations import GROUPS
from mmc_gym.training.policies import ACTIVATIONS, TQCGoalPolicy
from mmc_gym.training.vec_env import Memory

NOISES = {"normal": NormalActionNoise, "ornstein-uhlenbeck": OrnsteinUhlenbeckActionNoise}
SUFFIXES = (".yml", ".yaml")
_SHIPPED = Path(str(files("mmc_gym.training") / "hyperparams"))

_ENTRIES = TypeAdapter(Annotated[dict[str, dict[str, Any]], Field(min_length=1)])
_NOT_IN_FILES = ("self", "env", "seed", "device", "tensorboard_log", "_init_setup_model")


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

    def without(self, group: str) -> Recipe:
        """Return the recipe without the perturbations of a group, see `GROUPS`."""
        require_choice("without", group, GROUPS)
        arguments = self.hyperparameters.get("env_kwargs") or {}
        kept: list[AnyChange] = []
        changes = as_changes(arguments.get("perturbations", ()))
        for change in changes:
            options = change.options if isinstance(change, OneOf) else (change,)
            weights = change.weights if isinstance(change, OneOf) else (1.0,)
            pairs = zip(options, weights, strict=True)
            left = [(o, w) for o, w in pairs if not (o and o.family.group == group)]
            names = [option for option, _ in left]
            if len(left) > 1:
                kept.append(OneOf(*names, weights=[weight for _, weight in left]))
            else:
                kept += filter(None, names)
        accepted = f"the group of some, but not all, perturbations of {self.name}"
        require(bool(kept) and kept != changes, "without", group, accepted)
        recipe = self.with_changes(env_kwargs={**arguments, "perturbations": as_plain(kept)})
        return replace(recipe, name=name_without(self.name, group))

    @property
    def algorithm(self) -> str:
        """The algorithm: the name up to the first "-"."""
        name = self.name.partition("-")[0]
        if name not in ALGORITHMS:
            known = ", ".join(ALGORITHMS)
            raise UserError(f"name must begin with one of {known}, got {self.name!r}")
        return name

    @property
    def algorithm_class(self) -> type[BaseAlgorithm]:
        """The algorithm's class."""
        return resolve_name(ALGORITHMS[self.algorithm].path)

    @property
    def settings(self) -> dict[str, Any]:
        """All keys with their values, converted to what the constructor takes, or its defaults."""
        keys = _keys(self.algorithm_class)
        require_known(self.name, self.hyperparameters, keys)
        config = ConfigDict(arbitrary_types_allowed=True, allow_inf_nan=False)
        try:
            entry = create_model(self.name, __config__=config, **keys)
            # A copy, because stable-baselines3 changes its arguments.
            return dict(entry.model_validate(deepcopy(self.hyperparameters)))
        except ValidationError as error:
            raise UserError(f"hyperparameters of {self.name}: {explain(error)}") from error

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
            rollout = count * (steps if unit == "episode" else 1)
            # Hindsight learns from whole episodes: a leg must not end within one.
            rollout = math.lcm(rollout, steps) if settings["replay_buffer_class"] else rollout
        else:
            rollout = settings["n_steps"]
        whole: int = rollout * settings["n_envs"]
        return math.ceil(settings["n_timesteps"] / whole / evaluations) * whole

    def make_model(
        self, env: VecEnv, seed: int, device: str = "cpu", tensorboard: str | None = None
    ) -> BaseAlgorithm:
        """Return an untrained model, which logs to the folder `tensorboard`."""
        settings = self.settings
        # The constructor itself has the defaults of the keys that are not in the file.
        options = {key: settings[key] for key in self.hyperparameters if key not in _OUR_KEYS}
        try:
            for wrapper, arguments in settings["vec_env_wrapper"]:
                env = wrapper(env, **arguments)
            if settings["memory"]:
                env = Memory(env, settings["memory"])
            env = VecMonitor(env)  # inside, so that its returns are not normalized
            if settings["normalize"] is not None:
                env = VecNormalize(env, **{**settings["normalize"], "gamma": settings["gamma"]})
            if settings["noise_type"] is not None:
                mean = np.zeros(env.action_space.shape or ())
                noise = NOISES[settings["noise_type"]]
                options["action_noise"] = noise(mean, mean + settings["noise_std"])
            options |= {"seed": seed, "device": device, "tensorboard_log": tensorboard}
            return self.algorithm_class(env=env, **options)
        except UserError:
            raise
        except Exception as error:  # whatever the constructor says
            raise UserError(
                f"hyperparameters of {self.name} must be accepted by stable-baselines3, "
                f"got {shown(self.hyperparameters)}: {type(error).__name__}: {error}"
            ) from error


def _parse_number(value: Any) -> Any:
    """Return the number, or the schedule `lin_START`, that a text stands for; or the value."""
    if isinstance(value, str):
        with suppress(ValueError):  # to YAML 1e-3 is a text
            number = float(value.removeprefix("lin_"))
            # A schedule is a function of the part that remains, from 1 to 0.
            return partial(mul, number) if value.startswith("lin_") else number
    return value


def _class_from(base: type, *plain: str) -> Any:
    """Return the type of a key that names a class in `Recipe.classes` which derives from `base`.

    Names in `plain` stay texts.
    """

    def parse(name: Any) -> Any:
        known: dict[str, Any] = {text: text for text in plain}
        known |= {text: kind for text, kind in Recipe.classes.items() if issubclass(kind, base)}
        if name is None:
            return None
        if not isinstance(name, str) or name not in known:
            yours = "what a module of yours adds to Recipe.classes"
            raise ValueError(f"must be {', '.join(known)}, or {yours}")
        return known[name]

    return Annotated[Any, BeforeValidator(parse)]


def _parse_wrappers(value: Any) -> Any:
    """Read the name of a wrapper, a mapping of the name to its arguments, or a list of these."""
    parts = value if isinstance(value, list) else [value] if value else []
    pairs = [[*part.items()] if isinstance(part, dict) else [(part, {})] for part in parts]
    return [pair for part in pairs for pair in part]


def _parse_mapping(value: Any) -> Any:
    """Read the text that rl_zoo3 evaluates to a mapping; return anything else as it is."""
    if isinstance(value, str):
        try:
            return _parse_keywords(ast.parse(value, mode="eval").body)
        except Exception:  # whatever a text that is no Python raises
            raise ValueError("must be a mapping, or a text such as dict(net_arch=[64])") from None
    return value


def _parse_normalization(value: Any) -> Any:
    """Read the arguments of `VecNormalize`, or true for none; false is None."""
    return {True: {}, False: None}[value] if isinstance(value, bool) else _parse_mapping(value)


def _parse_policy_options(value: Any) -> Any:
    """Read a mapping, or the text of one, with the name of an activation."""
    value = _parse_mapping(value)
    if isinstance(value, dict) and "activation_fn" in value:
        name = str(value["activation_fn"]).removeprefix("nn.").lower()
        if name not in ACTIVATIONS:
            raise ValueError(f"must have {' or '.join(ACTIVATIONS)} as activation_fn")
        return {**value, "activation_fn": ACTIVATIONS[name]}
    return value


def _parse_keywords(node: ast.expr) -> Any:
    """Return the value of `dict(key=value, ...)`, a name or a literal, without running it."""
    if isinstance(node, ast.Call) and ast.unparse(node.func) == "dict" and not node.args:
        return {str(keyword.arg): _parse_keywords(keyword.value) for keyword in node.keywords}
    return ast.unparse(node) if isinstance(node, ast.Attribute) else ast.literal_eval(node)


_Numeric = BeforeValidator(_parse_number)
_Count = Annotated[int, Field(ge=1), _Numeric]
_WRAPPER: Any = tuple[_class_from(VecEnvWrapper), dict[str, Any]]  # type: ignore[misc]
_OUR_KEYS: dict[str, Any] = {  # which are no arguments of the algorithm: type, default
    "n_timesteps": (_Count, ...),
    "n_envs": (_Count, 1),
    "env_kwargs": (dict[str, Any], {}),
    "vec_env_wrapper": (Annotated[list[_WRAPPER], BeforeValidator(_parse_wrappers)], []),
    "memory": (list[_Count], []),
    "normalize": (Annotated[dict[str, Any] | None, BeforeValidator(_parse_normalization)], None),
    "noise_type": (Literal["normal", "ornstein-uhlenbeck"] | None, None),
    "noise_std": (Annotated[float, Field(ge=0), _Numeric], 0.0),
}
_TYPES = {  # of arguments of algorithms, where their annotation says less
    "n_steps": _Count,
    "train_freq": _Count | tuple[_Count, Literal["step", "episode"]],
    "policy_kwargs": Annotated[dict[str, Any] | None, BeforeValidator(_parse_policy_options)],
    "replay_buffer_class": _class_from(HerReplayBuffer),
}


def _keys(algorithm: type[BaseAlgorithm]) -> dict[str, Any]:
    """Return the keys that an entry for the algorithm may have, as fields of a pydantic model."""
    keys: dict[str, Any] = {
        name: (_TYPES.get(name, Annotated[parameter.annotation, _Numeric]), parameter.default)
        for name, parameter in _parameters(algorithm).items()
    }
    alias = next(name for name in algorithm.policy_aliases if name.startswith("Mlp"))
    policy = _class_from(algorithm.policy_aliases[alias], alias)
    return {**keys, "policy": (policy, ...), **_OUR_KEYS}


def _parameters(kind: type) -> dict[str, inspect.Parameter]:
    """Return the parameters of a constructor; if it has `**kwargs`, with its base class's."""
    signature = inspect.signature(kind.__init__, eval_str=True).parameters  # type: ignore[misc]
    unnamed = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
    named = {name: value for name, value in signature.items() if value.kind not in unnamed}
    if len(named) < len(signature):  # it has `**kwargs`
        named = {**_parameters(kind.__base__ or object), **named}
    return {name: value for name, value in named.items() if name not in _NOT_IN_FILES}


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
        env_kwargs: more arguments of the environment; they replace those in the file.

    Raises:
        FileNotFoundError: if there is no such file.
    """
    require(isinstance(source, str), "name", source, "a name, or the path of a YAML file")
    recipe = _read(source, env_id)
    if more := require_arguments("env_kwargs", env_kwargs):
        recipe = _with_arguments(recipe, more)
    return recipe if steps is None else recipe.with_changes(n_timesteps=steps)


def _read(source: str, env_id: str | None = None, readers: tuple[Path, ...] = ()) -> Recipe:
    """Read an entry, with its perturbations among the arguments of the environment.

    `readers` are the files that take their perturbations from it, each those of the next.
    """
    path = Path(source)
    if path.suffix not in SUFFIXES:
        if source not in names():
            name = f"perturbations of {readers[-1].stem}" if readers else "name"
            raise unknown(name, source, names(), "the path of a YAML file")
        path = _SHIPPED / f"{source}.yml"
    elif readers:
        path = readers[-1].parent / path
    if path.resolve() in map(Path.resolve, readers):
        circle = ", ".join(reader.stem for reader in (*readers, path))
        raise UserError(f"perturbations must stand in one of these files, got a circle: {circle}")
    try:
        entries = _ENTRIES.validate_python(read_yaml_file(path))
    except ValidationError as error:
        raise UserError(f"{source} must map environments to entries: {explain(error)}") from error
    except ValueError as error:
        raise UserError(f"{source} must be YAML: {error}") from error
    if env_id is None:
        env_id = next(iter(entries))
        spec = gym.registry.get(env_id)  # of others some import what their arguments name
        is_ours = spec is None or str(spec.entry_point).startswith("mmc_gym.")
        accepted = "of this package, or said by yourself too (--env), since it may run any code"
        require(is_ours and ":" not in env_id, f"{source}: env", env_id, accepted)
    if env_id not in entries:
        raise unknown(f"env for {source}", env_id, entries)
    recipe = Recipe(path.stem, env_id, entries[env_id])
    if "perturbations" not in recipe.hyperparameters:
        return recipe
    drawn = recipe.hyperparameters.pop("perturbations")
    if isinstance(drawn, str) and _is_of_recipe(drawn):
        other = _read(drawn, None, (*readers, path)).hyperparameters.get("env_kwargs") or {}
        accepted = "those of a recipe that has some"
        require("perturbations" in other, f"perturbations of {path.stem}", drawn, accepted)
        drawn = other["perturbations"]
    return _with_arguments(recipe, {"perturbations": drawn})


def _is_of_recipe(name: str) -> bool:
    """Return whether a name is of a recipe, and thus begins with an algorithm, or of a file."""
    path = Path(name)
    return path.suffix in SUFFIXES or path.stem.partition("-")[0] in ALGORITHMS


def _with_arguments(recipe: Recipe, more: dict[str, Any]) -> Recipe:
    """Return the recipe with more arguments of the environment."""
    arguments = recipe.hyperparameters.get("env_kwargs") or {}
    return recipe.with_changes(env_kwargs={**arguments, **more})
