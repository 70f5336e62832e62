"""Hyperparameters: YAML files in rl_zoo3's form, and what they mean to stable-baselines3.

A file maps ids of environments to entries.  `read_recipe` reads one, and `Recipe.settings` checks
it: `PPOSettings`, `SACSettings` and `TQCSettings` have a field for each key.
"""

from __future__ import annotations

import ast
import inspect
import math
from abc import abstractmethod
from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import yaml
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PlainValidator,
    StrictBool,
    ValidationError,
    field_validator,
)
from sb3_contrib import TQC
from stable_baselines3 import PPO, SAC, HerReplayBuffer
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper, VecMonitor, VecNormalize
from typing_extensions import override

from mmc_gym._errors import UserError, explain, require, unknown
from mmc_gym.agents.policy import Algorithm
from mmc_gym.training.policies import ACTIVATIONS, POLICIES
from mmc_gym.training.randomised import Memory, RandomScenarios
from mmc_gym.training.taught import TaughtPolicy, TaughtPPO
from mmc_gym.training.vec_env import Residual


@dataclass(frozen=True)
class Rate:
    """A rate over the course of a training: constant, or falling linearly to 0 ("lin_START")."""

    start: float
    falls: bool = False

    def __call__(self, progress_remaining: float) -> float:
        """Return the rate where this part of the training remains."""
        return self.start * progress_remaining if self.falls else self.start


def _number(value: Any) -> float:
    """Read a number, or the text of one, such as 1e-3 to YAML."""
    try:
        number = math.nan if isinstance(value, bool) else float(value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not math.isfinite(number):
        raise ValueError("must be a number")
    return number


def _tagged(value: Any, tag: str) -> tuple[bool, float]:
    """Read a number greater than 0, that may stand behind a tag: "lin_0.1" with the tag "lin_"."""
    is_tagged = isinstance(value, str) and value.startswith(tag)
    try:
        number = _number(value.removeprefix(tag) if is_tagged else value)
    except ValueError:
        number = 0.0
    if number <= 0:
        raise ValueError(f"must be a number greater than 0, or {tag}NUMBER")
    return is_tagged, number


def _rate(value: Any) -> Rate:
    falls, start = _tagged(value, "lin_")
    return Rate(start, falls)


def _entropy(value: Any) -> str | float:
    if value == "auto":
        return "auto"
    is_learned, number = _tagged(value, "auto_")
    return str(value) if is_learned else number


def _frequency(value: Any) -> tuple[int, str]:
    count, unit = value if isinstance(value, list) and len(value) == 2 else (value, "step")
    if type(count) is not int or count < 1 or unit not in ("step", "episode"):
        raise ValueError("must be N, [N, step] or [N, episode], of at least 1")
    return count, unit


def _layers(value: Any) -> Any:
    for sizes in value.values() if isinstance(value, dict) else [value]:
        if not isinstance(sizes, list) or not all(type(n) is int and n > 0 for n in sizes):
            raise ValueError("must be sizes of layers of at least 1: a list, or one for each part")
    return value


class _Literals(ast.NodeTransformer):
    """Turn `dict(a=1)` into `{"a": 1}`, and `nn.ReLU` into "relu"; all else stays."""

    def visit_Call(self, node: ast.Call) -> ast.AST:
        self.generic_visit(node)
        is_dict = isinstance(node.func, ast.Name) and node.func.id == "dict" and not node.args
        if not is_dict or any(each.arg is None for each in node.keywords):
            return node
        keys: list[ast.expr | None] = [ast.Constant(each.arg) for each in node.keywords]
        return ast.Dict(keys, [each.value for each in node.keywords])

    def visit_Attribute(self, node: ast.Attribute) -> ast.AST:
        is_layer = isinstance(node.value, ast.Name) and node.value.id == "nn"
        return ast.Constant(node.attr.lower()) if is_layer else node


def _mapping(value: Any) -> Any:
    """Read a text such as "dict(net_arch=[64], activation_fn=nn.ReLU)"; literals, never code."""
    if not isinstance(value, str):
        return value
    try:
        return ast.literal_eval(_Literals().visit(ast.parse(value.strip(), mode="eval")))
    except (ValueError, SyntaxError, TypeError, RecursionError):
        raise ValueError("must be a mapping of literals") from None


def _normalized(value: Any) -> Any:
    if value is None or value is False:
        return None
    arguments = {} if value is True else _mapping(value)
    if isinstance(arguments, dict) and arguments.get("norm_obs", True) is not False:
        raise ValueError(
            "must have norm_obs: false, for a policy is kept without statistics of observations"
        )
    return arguments


def _limited(arguments: dict[str, Any]) -> dict[str, Any]:
    """Refuse environments whose episodes never end."""
    steps = arguments.get("max_episode_steps", 1)
    if type(steps) is not int or steps < 1:
        raise ValueError("must have a whole number of at least 1 for max_episode_steps, if any")
    return arguments


def _looked_up(name: Any, table: Mapping[str, Any]) -> Any:
    if not isinstance(name, str) or name not in table:
        raise ValueError(f"must be one of {', '.join(table)}")
    return table[name]


def _wrappers(value: Any) -> list[partial[VecEnvWrapper]]:
    """Read the name of a wrapper, a mapping of it to its arguments, or a list of these."""
    parts = value if isinstance(value, list) else [] if value is None else [value]
    return [_wrapper(part) for part in parts]


def _wrapper(part: Any) -> partial[VecEnvWrapper]:
    has_arguments = isinstance(part, dict) and len(part) == 1
    name, arguments = next(iter(part.items())) if has_arguments else (part, None)
    make, arguments = _looked_up(name, _WRAPPERS), arguments or {}
    try:
        inspect.signature(make).bind(None, **arguments)
    except TypeError as error:
        raise ValueError(f"must have arguments that {name} takes: {error}") from error
    return partial(make, **arguments)


def _replay_buffer(name: Any) -> Any:
    return _looked_up(name, {"HerReplayBuffer": HerReplayBuffer})


def _target_entropy(value: Any) -> str | float:
    return "auto" if value == "auto" else _number(value)


Real = Annotated[float, BeforeValidator(_number)]
Positive = Annotated[Real, Field(gt=0)]
NotNegative = Annotated[Real, Field(ge=0)]
Share = Annotated[Real, Field(ge=0, le=1)]
Whole = Annotated[int, BeforeValidator(_number)]
Natural = Annotated[Whole, Field(ge=0)]
Count = Annotated[Whole, Field(ge=1)]
AnyRate = Annotated[Rate, PlainValidator(_rate)]

_WRAPPERS: dict[str, type[VecEnvWrapper]] = {
    f"{kind.__module__}.{kind.__name__}": kind for kind in (Residual, RandomScenarios, Memory)
}


class _Keys(BaseModel):
    """The keys of a mapping, each with the values that it accepts."""

    model_config = ConfigDict(extra="forbid", frozen=True, arbitrary_types_allowed=True)


class Normalization(_Keys):
    """Arguments of `VecNormalize`."""

    norm_obs: Literal[False]
    norm_reward: StrictBool = True
    clip_obs: Positive = 10.0
    clip_reward: Positive = 10.0
    gamma: Share = 0.99
    epsilon: Positive = 1e-8


class PolicyOptions(_Keys, extra="allow"):
    """Arguments of a policy; any others are checked by the policy itself."""

    net_arch: Annotated[Any, PlainValidator(_layers)] = None
    activation_fn: Literal["relu", "tanh"] | None = None
    log_std_init: Real = 0.0
    n_critics: Count = 2
    n_quantiles: Count = 25


class ReplayOptions(_Keys, extra="allow"):
    """Arguments of a replay buffer; any others are checked by the buffer itself."""

    n_sampled_goal: Count = 4
    goal_selection_strategy: Literal["future", "final", "episode"] = "future"


class Settings(_Keys):
    """The keys that all algorithms have; their defaults are those of the algorithm."""

    algorithm: ClassVar[type[BaseAlgorithm]]

    n_timesteps: Count
    policy: str
    n_envs: Count = 1
    env_kwargs: Annotated[dict[str, Any], AfterValidator(_limited)] = {}
    vec_env_wrapper: Annotated[list[partial[VecEnvWrapper]], PlainValidator(_wrappers)] = []
    normalize: Annotated[Normalization | None, BeforeValidator(_normalized)] = None

    learning_rate: AnyRate = Rate(3e-4)
    gamma: Share = 0.99
    use_sde: StrictBool = False
    sde_sample_freq: Annotated[Whole, Field(ge=-1)] = -1
    stats_window_size: Count = 100
    policy_kwargs: Annotated[PolicyOptions | None, BeforeValidator(_mapping)] = None
    verbose: Natural = 0

    @field_validator("policy")
    @classmethod
    def _known(cls, name: str) -> str:
        _looked_up(name, cls._policies())
        return name

    @classmethod
    def _policies(cls) -> dict[str, type[BasePolicy]]:
        plain = cls.algorithm.policy_aliases["MlpPolicy"]
        ours = {name: kind for name, kind in POLICIES.items() if issubclass(kind, plain)}
        return {"MlpPolicy": plain, **ours}

    @abstractmethod
    def rollout(self, episode_steps: int) -> int:
        """Return the steps of each environment between updates, in episodes of `episode_steps`."""

    def steps_per_leg(self, episode_steps: int, evaluations: int) -> int:
        """Return the environment steps between two of about so many evaluations: whole rollouts.

        `env_kwargs` may have another number of steps of an episode.
        """
        episode_steps = self.env_kwargs.get("max_episode_steps", episode_steps)
        whole = self.rollout(episode_steps) * self.n_envs
        return math.ceil(self.n_timesteps / whole / evaluations) * whole

    def make_model(
        self, env: VecEnv, seed: int, device: str = "cpu", tensorboard: str | None = None
    ) -> BaseAlgorithm:
        """Return an untrained model, which logs to the folder `tensorboard`.

        The wrappers come around the environment in the order that they are listed in.

        Raises:
            UserError: if the algorithm or the policy does not take the options.
        """
        for wrap in self.vec_env_wrapper:
            env = wrap(env)
        # It shows TensorBoard the rewards before `VecNormalize` scales them.
        env = VecMonitor(env)
        if self.normalize is not None:
            env = VecNormalize(env, **{"gamma": self.gamma, **_given(self.normalize)})
        options = {key: value for key, value in _given(self).items() if key not in _OWN}
        options |= {"seed": seed, "device": device, "tensorboard_log": tensorboard}
        if activation := options.get("policy_kwargs", {}).get("activation_fn"):
            options["policy_kwargs"]["activation_fn"] = ACTIVATIONS[activation]
        try:
            policy = self._policies()[self.policy]
            algorithm = TaughtPPO if policy is TaughtPolicy else self.algorithm
            return algorithm(policy, env, **options)
        except (TypeError, AssertionError) as error:
            name = self.algorithm.__name__
            raise UserError(f"{name} does not take these hyperparameters: {error}") from error


# Keys that are not arguments of the algorithm.
_OWN = ("n_timesteps", "n_envs", "env_kwargs", "vec_env_wrapper", "normalize", "policy")


def _given(keys: BaseModel) -> dict[str, Any]:
    """Return the keys that the file has; without the others, which later versions may not have."""
    found = {key: getattr(keys, key) for key in keys.model_fields_set}
    return {key: _given(v) if isinstance(v, BaseModel) else v for key, v in found.items()}


class PPOSettings(Settings):
    """The keys of PPO."""

    algorithm: ClassVar[type[BaseAlgorithm]] = PPO

    n_steps: Count = 2048
    batch_size: Count = 64
    n_epochs: Count = 10
    gae_lambda: Share = 0.95
    clip_range: AnyRate = Rate(0.2)
    clip_range_vf: AnyRate | None = None
    normalize_advantage: StrictBool = True
    ent_coef: NotNegative = 0.0
    vf_coef: NotNegative = 0.5
    max_grad_norm: Positive = 0.5
    target_kl: Positive | None = None
    lessons: Share = 0.5
    lesson_epochs: Count = 2

    @override
    def rollout(self, episode_steps: int) -> int:
        return self.n_steps


class SACSettings(Settings):
    """The keys of SAC."""

    algorithm: ClassVar[type[BaseAlgorithm]] = SAC

    buffer_size: Count = 1_000_000
    learning_starts: Natural = 100
    batch_size: Count = 256
    tau: Share = 0.005
    train_freq: Annotated[tuple[int, str], PlainValidator(_frequency)] = (1, "step")
    gradient_steps: Annotated[Whole, Field(ge=-1)] = 1
    replay_buffer_class: Annotated[Any, PlainValidator(_replay_buffer)] | None = None
    replay_buffer_kwargs: Annotated[ReplayOptions | None, BeforeValidator(_mapping)] = None
    optimize_memory_usage: StrictBool = False
    n_steps: Count = 1
    ent_coef: Annotated[str | float, PlainValidator(_entropy)] = "auto"
    target_update_interval: Count = 1
    target_entropy: Annotated[str | float, PlainValidator(_target_entropy)] = "auto"
    use_sde_at_warmup: StrictBool = False

    @override
    def rollout(self, episode_steps: int) -> int:
        count, unit = self.train_freq
        steps = count * episode_steps if unit == "episode" else count
        # Hindsight learns from whole episodes only: a leg must not end amid one.
        return steps if self.replay_buffer_class is None else math.lcm(steps, episode_steps)


class TQCSettings(SACSettings):
    """The keys of TQC."""

    algorithm: ClassVar[type[BaseAlgorithm]] = TQC

    top_quantiles_to_drop_per_net: Natural = 2


AnySettings = PPOSettings | SACSettings
SETTINGS: dict[Algorithm, type[AnySettings]] = {
    "ppo": PPOSettings,
    "sac": SACSettings,
    "tqc": TQCSettings,
}


@dataclass(frozen=True)
class Recipe:
    """An entry of a hyperparameter file.

    Attributes:
        name: of the file, without folder and suffix; it begins with the algorithm's.
        env_id: the environment to train in.
        hyperparameters: the entry of the file for it.
    """

    name: str
    env_id: str
    hyperparameters: dict[str, Any]

    def with_changes(self, **changes: Any) -> Recipe:
        """Return the recipe with other hyperparameters."""
        return replace(self, hyperparameters={**self.hyperparameters, **changes})

    @property
    def algorithm(self) -> Algorithm:
        """The algorithm: the name up to the first "-".

        Raises:
            UserError: if there is no such algorithm.
        """
        algorithm = self.name.partition("-")[0]
        if algorithm not in SETTINGS:
            known = ", ".join(SETTINGS)
            raise UserError(f"name must begin with one of {known}, got {self.name!r}")
        return algorithm

    @property
    def settings(self) -> AnySettings:
        """The hyperparameters, checked.

        Raises:
            UserError: if a key is unknown or missing, or does not accept its value.
        """
        kind, keys = SETTINGS[self.algorithm], self.hyperparameters
        for key in keys:
            if key not in kind.model_fields:
                raise unknown("hyperparameter", key, kind.model_fields)
        try:
            # stable-baselines3 adds to what it is given.
            return kind.model_validate(deepcopy(keys))
        except ValidationError as error:
            raise UserError(f"hyperparameters of {self.name}: {explain(error)}") from error


SUFFIXES = (".yml", ".yaml")
_SHIPPED = Path(str(files("mmc_gym.training") / "hyperparams"))


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
        env_id: the environment; None for the first in the file.
        steps: environment steps of the training, instead of `n_timesteps`.
        env_kwargs: arguments of the environment, beside those in the file.

    Raises:
        FileNotFoundError: if there is no such file.
        UserError: if there is no such name or environment, or the file is no such mapping.
    """
    require(isinstance(source, str), "name", source, "a name, or the path of a YAML file")
    path = Path(source)
    if path.suffix not in SUFFIXES:
        if source not in names():
            raise unknown("name", source, names(), "the path of a YAML file")
        path = _SHIPPED / f"{source}.yml"
    try:
        entries = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise UserError(f"{source} must be YAML: {error}") from error
    if not isinstance(entries, dict) or not entries:
        raise UserError(f"{source} must map environments to hyperparameters, got {entries!r}")
    env_id = env_id or str(next(iter(entries)))
    if env_id not in entries:
        raise unknown(f"env for {source}", env_id, entries)
    entry = entries[env_id]
    if not isinstance(entry, dict):
        raise UserError(f"{source} must have hyperparameters for {env_id}, got {entry!r}")
    recipe = Recipe(path.stem, env_id, entry)
    if env_kwargs:
        recipe = recipe.with_changes(env_kwargs={**(entry.get("env_kwargs") or {}), **env_kwargs})
    return recipe if steps is None else recipe.with_changes(n_timesteps=steps)
