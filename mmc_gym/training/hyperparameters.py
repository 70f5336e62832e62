"""Hyperparameters: YAML files in rl_zoo3's form, those that ship and a user's own.

What an entry of such a file means is read by `Settings`.
"""

from __future__ import annotations

import ast
import inspect
import math
from collections.abc import Callable, Mapping
from copy import deepcopy
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any, cast

import yaml
from sb3_contrib import TQC
from stable_baselines3 import PPO, SAC, HerReplayBuffer
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper, VecNormalize

from mmc_gym.training.policies import ACTIVATIONS, POLICIES
from mmc_gym.training.vec_env import Residual


def read_mapping(key: str, value: Any) -> dict[str, Any]:
    """A mapping, or the text of one.

    Args:
        key: of the value, for messages.
        value: a mapping, or a text such as `"dict(a=1)"` or `"{'a': 1}"` of literals and classes of
            activations.

    Raises:
        ValueError: if it is neither.

    >>> read_mapping("policy_kwargs", "dict(activation_fn=nn.ReLU, net_arch=dict(pi=[64]))")
    {'activation_fn': 'relu', 'net_arch': {'pi': [64]}}
    """
    found = value
    if isinstance(value, str):
        try:
            found = _literal(ast.parse(value.strip(), mode="eval").body)
        except (ValueError, SyntaxError, TypeError, RecursionError) as error:
            raise ValueError(f"{key} must be a mapping of literals, got {value!r}") from error
    if not isinstance(found, dict) or not all(isinstance(name, str) for name in found):
        raise ValueError(f"{key} must be a mapping, got {value!r}")
    return found


def read_names(key: str, value: Any) -> list[tuple[str, dict[str, Any]]]:
    """Names with arguments: of a name, a mapping of one name to its arguments, or a list of them.

    Raises:
        ValueError: if it is none of these.

    >>> read_names("callback", ["a.B", {"a.C": {"size": 1}}])
    [('a.B', {}), ('a.C', {'size': 1})]
    """
    found = []
    for part in value if isinstance(value, list) else [] if value is None else [value]:
        if isinstance(part, dict) and len(part) == 1:
            name, arguments = next(iter(part.items()))
            found.append((name, read_mapping(key, arguments or {})))
        elif isinstance(part, str):
            found.append((part, {}))
        else:
            raise ValueError(
                f"{key} must be a name, or a mapping of one name to its arguments, got {part!r}"
            )
    return found


def _literal(node: ast.expr) -> Any:
    if isinstance(node, ast.Call):
        if not isinstance(node.func, ast.Name) or node.func.id != "dict" or node.args:
            raise ValueError(f"only dict is called, got {ast.unparse(node)}")
        return {str(each.arg): _literal(each.value) for each in node.keywords if _has_name(each)}
    if isinstance(node, ast.Dict):
        keys = [_literal(each) if each is not None else None for each in node.keys]
        return dict(zip(keys, map(_literal, node.values)))
    if isinstance(node, ast.List):
        return [_literal(each) for each in node.elts]
    if isinstance(node, ast.Attribute) and ast.unparse(node.value) in ("nn", "th.nn", "torch.nn"):
        return node.attr.lower()  # as the policies here name activations
    return ast.literal_eval(node)


def _has_name(keyword: ast.keyword) -> bool:
    if keyword.arg is None:
        raise ValueError("there is nothing to unpack")
    return True


Hyperparameters = dict[str, Any]

ALGORITHMS: dict[str, type[BaseAlgorithm]] = {"ppo": PPO, "sac": SAC, "tqc": TQC}


class EntropyDecay(BaseCallback):
    """Lets PPO's entropy bonus fall linearly, from `ent_coef` to 0 at the end of the training."""

    def _on_training_start(self) -> None:
        self._start = float(cast(PPO, self.model).ent_coef)

    def _on_rollout_start(self) -> None:
        model = cast(PPO, self.model)
        model.ent_coef = self._start * (1 - model.num_timesteps / model._total_timesteps)

    def _on_step(self) -> bool:
        return True


def names() -> list[str]:
    """The names that there are hyperparameters for."""
    folder = files("mmc_gym.training") / "hyperparams"
    found = (entry.name for entry in folder.iterdir())
    return sorted(name.removesuffix(".yml") for name in found if name.endswith(".yml"))


def policy_name(name: str) -> str:
    """The name of what is trained: that of shipped hyperparameters, or of a file without folder."""
    return Path(name).stem if _is_path(name) else name


def read_hyperparameters(name: str, env_id: str | None = None) -> tuple[str, Hyperparameters]:
    """The environment and the hyperparameters of that name.

    Args:
        name: of those that ship, see `names`, or the path of a YAML file.
        env_id: the environment; None for the first that the file has.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: if there are no hyperparameters of that name or for that environment, or the
            file is no mapping of environments to hyperparameters.
    """
    if _is_path(name):
        text = Path(name).read_text(encoding="utf-8")
    elif name in names():
        path = files("mmc_gym.training") / "hyperparams" / f"{name}.yml"
        text = path.read_text(encoding="utf-8")
    else:
        raise ValueError(
            f"name must be one of {', '.join(names())}, or the path of a YAML file, got {name!r}"
        )
    try:
        entries = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise ValueError(f"{name} must be YAML: {error}") from error
    if not isinstance(entries, dict) or not entries:
        raise ValueError(f"{name} must map environments to hyperparameters, got {entries!r}")
    env_id = env_id or str(next(iter(entries)))
    if env_id not in entries:
        found = ", ".join(map(str, entries))
        raise ValueError(f"env must be one of {found} for {name}, got {env_id!r}")
    entry = entries[env_id]
    if not isinstance(entry, dict):
        raise ValueError(f"{name} must have hyperparameters for {env_id}, got {entry!r}")
    return env_id, entry


def algorithm_of(name: str) -> str:
    """The algorithm that hyperparameters of that name are for: what stands before the first "-".

    Raises:
        ValueError: if there is no such algorithm.
    """
    algorithm = name.partition("-")[0]
    if algorithm not in ALGORITHMS:
        raise ValueError(f"name must begin with one of {', '.join(ALGORITHMS)}, got {name!r}")
    return algorithm


def _is_path(name: str) -> bool:
    return name.endswith((".yml", ".yaml"))


_WRAPPERS: dict[str, type[VecEnvWrapper]] = {f"{Residual.__module__}.Residual": Residual}
_CALLBACKS: dict[str, type[BaseCallback]] = {
    f"{EntropyDecay.__module__}.EntropyDecay": EntropyDecay
}
_REPLAY_BUFFERS = {"HerReplayBuffer": HerReplayBuffer}

# Entries that are not arguments of the algorithm.
_OWN = ("n_timesteps", "n_envs", "env_kwargs", "vec_env_wrapper", "normalize", "callback", "policy")
# Arguments of the algorithm that are given otherwise, or are objects.
_NO_OPTIONS = {
    *("self", "policy", "env", "tensorboard_log", "seed", "device", "_init_setup_model"),
    *("action_noise", "rollout_buffer_class", "rollout_buffer_kwargs"),
}
_SCHEDULES = ("learning_rate", "clip_range", "clip_range_vf")
_MAPPINGS = ("policy_kwargs", "replay_buffer_kwargs")
_AT_LEAST_ONE = (
    *("n_timesteps", "n_envs", "n_steps", "train_freq", "batch_size", "n_epochs", "buffer_size"),
)
_NORMALIZE = ("norm_obs", "norm_reward", "clip_obs", "clip_reward", "gamma", "epsilon")

Named = tuple[Callable[..., Any], dict[str, Any]]


@dataclass(frozen=True)
class Settings:
    """An entry of a hyperparameter file, as stable-baselines3 takes it.

    Attributes:
        algorithm: that learns.
        policy: that it trains.
        steps: environment steps of the whole training, at least.
        env_count: how many environments it learns from at once.
        env_kwargs: their arguments.
        wrapper: around them, with its arguments; None for none.
        normalize: arguments of `VecNormalize`; None for none.
        callbacks: each with its arguments.
        options: arguments of the algorithm, its defaults where the entry says nothing.
    """

    algorithm: type[BaseAlgorithm]
    policy: type[BasePolicy]
    steps: int
    env_count: int
    env_kwargs: dict[str, Any]
    wrapper: Named | None
    normalize: dict[str, Any] | None
    callbacks: tuple[Named, ...]
    options: dict[str, Any]

    @classmethod
    def read(cls, algorithm: str, hyperparameters: Mapping[str, Any]) -> Settings:
        """Those of an entry.

        Args:
            algorithm: a key of `ALGORITHMS`.
            hyperparameters: the entry, which is left as it is.

        Raises:
            ValueError: if it has unknown keys, lacks `n_timesteps` or `policy`, or a value is none
                that the key takes.
        """
        h = deepcopy(dict(hyperparameters))  # stable-baselines3 adds to what it is given
        kind = ALGORITHMS[algorithm]
        defaults = _defaults(kind)
        if unknown := [key for key in h if key not in (*_OWN, *defaults)]:
            known = ", ".join((*_OWN, *defaults))
            raise ValueError(f"hyperparameters must be among {known}, got {', '.join(unknown)}")
        if missing := [key for key in ("n_timesteps", "policy") if key not in h]:
            raise ValueError(f"hyperparameters must have {' and '.join(missing)}")
        options = {**defaults, **{key: h[key] for key in h if key not in _OWN}}
        options = {key: _option(key, value, defaults[key]) for key, value in options.items()}
        base = kind.policy_aliases["MlpPolicy"]
        policies = {name: policy for name, policy in POLICIES.items() if issubclass(policy, base)}
        wrappers = _named("vec_env_wrapper", h.get("vec_env_wrapper"), _WRAPPERS)
        if len(wrappers) > 1:
            raise ValueError(f"vec_env_wrapper must be one at most, got {h['vec_env_wrapper']}")
        return cls(
            kind,
            _looked_up("policy", h["policy"], policies),
            _number("n_timesteps", h["n_timesteps"], 0),
            _number("n_envs", h.get("n_envs", 1), 0),
            read_mapping("env_kwargs", h.get("env_kwargs") or {}),
            wrappers[0] if wrappers else None,
            _normalize(h.get("normalize"), options["gamma"]),
            tuple(_named("callback", h.get("callback"), _CALLBACKS)),
            options,
        )

    def steps_per_leg(self, episode_steps: int, evaluations: int) -> int:
        """Environment steps between two evaluations, where a rollout ends.

        Episodes end there as well, if they are learned from only when they are complete, as in
        hindsight.

        Args:
            episode_steps: of every episode.
            evaluations: about how many there shall be.
        """
        rollout, unit = self.options.get("train_freq", self.options["n_steps"]), "step"
        if isinstance(rollout, tuple):
            rollout, unit = rollout
        if unit == "episode":
            rollout *= episode_steps
        if self.options.get("replay_buffer_class") is not None:
            rollout = math.lcm(rollout, episode_steps)
        whole = int(rollout) * self.env_count
        return math.ceil(self.steps / whole / evaluations) * whole

    def make_model(
        self, env: VecEnv, seed: int, device: str = "cpu", tensorboard: str | None = None
    ) -> BaseAlgorithm:
        """An untrained model.

        Args:
            env: to train in.
            seed: of everything random.
            device: to train on, as torch names it.
            tensorboard: folder for TensorBoard's logs.

        Raises:
            ValueError: if the algorithm or the policy does not take the options.
        """
        if self.wrapper is not None:
            wrapper, arguments = self.wrapper
            env = wrapper(env, **arguments)
        if self.normalize is not None:
            env = VecNormalize(env, **self.normalize)
        options = deepcopy(self.options)
        for key in set(options) & set(_SCHEDULES):
            options[key] = None if options[key] is None else schedule(options[key])
        try:
            return self.algorithm(
                self.policy,
                env,
                seed=seed,
                device=device,
                tensorboard_log=tensorboard,
                **options,
            )
        except (TypeError, AssertionError) as error:
            name = self.algorithm.__name__
            raise ValueError(f"{name} does not take these hyperparameters: {error}") from error

    def make_callbacks(self) -> list[BaseCallback]:
        """The callbacks that the entry asks for."""
        return [callback(**arguments) for callback, arguments in self.callbacks]


def schedule(value: float | str) -> Callable[[float], float]:
    """Of the part of the training that remains: a constant, or "lin_X", from X down to 0."""
    if isinstance(value, str) and value.startswith("lin_"):
        start = float(value.removeprefix("lin_"))
        return lambda progress_remaining: start * progress_remaining
    constant = float(value)
    return lambda progress_remaining: constant


def _defaults(algorithm: type[BaseAlgorithm]) -> dict[str, Any]:
    parameters = inspect.signature(algorithm).parameters.values()
    return {each.name: each.default for each in parameters if each.name not in _NO_OPTIONS}


def _option(key: str, value: Any, default: Any) -> Any:
    """The value of an argument of the algorithm, checked as far as its default tells its kind."""
    if value is None and default is None:
        return None
    if key in _MAPPINGS:
        arguments = read_mapping(key, value)
        if "activation_fn" in arguments:
            _looked_up("activation_fn", arguments["activation_fn"], ACTIVATIONS)
        return arguments
    if key == "replay_buffer_class":
        return _looked_up(key, value, _REPLAY_BUFFERS)
    if key == "train_freq" and isinstance(value, (list, tuple)):
        if len(value) != 2 or value[1] not in ("step", "episode"):
            raise ValueError(f"{key} must be N, [N, step] or [N, episode], got {value!r}")
        return (_number(key, value[0], default), value[1])
    if isinstance(default, bool):
        if not isinstance(value, bool):
            raise ValueError(f"{key} must be true or false, got {value!r}")
        return value
    prefix = "lin_" if key in _SCHEDULES else "auto_" if isinstance(default, str) else ""
    if prefix and isinstance(value, str) and f"{value}_".startswith(prefix):
        if value != "auto" and _parsed(value.removeprefix(prefix)) is None:
            raise ValueError(f"{key} must be a number, or {prefix}NUMBER, got {value!r}")
        return value
    return _number(key, value, default)


def _number(key: str, value: Any, default: Any) -> Any:
    """A number, also of a text (YAML's 1e-3 is one); a whole one, if the default is."""
    number = _parsed(value)
    if number is None:
        raise ValueError(f"{key} must be a number, got {value!r}")
    if isinstance(default, int):
        if number != int(number):
            raise ValueError(f"{key} must be a whole number, got {value!r}")
        number = int(number)
    if number < 1 and key in _AT_LEAST_ONE:
        raise ValueError(f"{key} must be at least 1, got {value!r}")
    return number


def _parsed(value: Any) -> float | None:
    """The finite number that a value is or spells; None for others."""
    if isinstance(value, str):
        try:
            value = float(value)
        except ValueError:
            return None
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return value if is_number and math.isfinite(value) else None


def _normalize(value: Any, gamma: float) -> dict[str, Any] | None:
    """Arguments of `VecNormalize`, of true, false, a mapping or its text."""
    if value is None or value is False:
        return None
    arguments = {"gamma": gamma, **({} if value is True else read_mapping("normalize", value))}
    if unknown := set(arguments) - set(_NORMALIZE):
        raise ValueError(
            f"normalize must have keys among {', '.join(_NORMALIZE)}, got {', '.join(unknown)}"
        )
    if arguments.get("norm_obs", True):
        raise ValueError(
            "normalize must have norm_obs: false, for observations lie within -1 and 1, and a "
            f"policy is kept without statistics of them, got {value!r}"
        )
    return arguments


def _named(key: str, value: Any, table: Mapping[str, Callable[..., Any]]) -> list[Named]:
    """What a value names, with its arguments, which must be those that it takes."""
    found = []
    for name, arguments in read_names(key, value):
        kind = _looked_up(key, name, table)
        first = (None,) if table is _WRAPPERS else ()  # the environment
        try:
            inspect.signature(kind).bind(*first, **arguments)
        except TypeError as error:
            raise ValueError(f"{key} {name} does not take {arguments}: {error}") from error
        found.append((kind, arguments))
    return found


def _looked_up(key: str, name: Any, table: Mapping[Any, Any]) -> Any:
    if not isinstance(name, str) or name not in table:
        raise ValueError(f"{key} must be one of {', '.join(table)}, got {name!r}")
    return table[name]
