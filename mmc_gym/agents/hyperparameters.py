"""Hyperparameters: YAML files in rl_zoo3's form, and the models of stable-baselines3 they describe.

What the files may name is looked up in the tables here; nothing is imported or evaluated.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import deepcopy
from importlib.resources import files
from typing import Any, cast

import yaml
from sb3_contrib import TQC
from stable_baselines3 import PPO, SAC, HerReplayBuffer
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv, VecNormalize

from mmc_gym.agents.residual import Residual
from mmc_gym.agents.torch_policies import POLICIES

Hyperparameters = dict[str, Any]

ALGORITHMS: dict[str, type[BaseAlgorithm]] = {"ppo": PPO, "sac": SAC, "tqc": TQC}
_WRAPPERS = {f"{Residual.__module__}.Residual": Residual}
_REPLAY_BUFFERS = {"HerReplayBuffer": HerReplayBuffer}
# Entries that are not arguments of the algorithm.
_NOT_OPTIONS = {
    "n_timesteps",
    "n_envs",
    "env_kwargs",
    "vec_env_wrapper",
    "normalize",
    "callback",
    "policy",
}
_SCHEDULES = ("learning_rate", "clip_range")


class EntropyDecay(BaseCallback):
    """Lets PPO's entropy bonus fall linearly, from `ent_coef` to 0 at the end of the training."""

    def _on_training_start(self) -> None:
        self._start = float(cast(PPO, self.model).ent_coef)

    def _on_rollout_start(self) -> None:
        model = cast(PPO, self.model)
        model.ent_coef = self._start * (1 - model.num_timesteps / model._total_timesteps)

    def _on_step(self) -> bool:
        return True


_CALLBACKS: dict[str, type[BaseCallback]] = {f"{__name__}.EntropyDecay": EntropyDecay}


def names() -> list[str]:
    """The names that there are hyperparameters for."""
    folder = files("mmc_gym.agents") / "hyperparams"
    found = (entry.name for entry in folder.iterdir())
    return sorted(name.removesuffix(".yml") for name in found if name.endswith(".yml"))


def read_hyperparameters(name: str, env_id: str | None = None) -> tuple[str, Hyperparameters]:
    """The environment and the shipped hyperparameters of that name.

    Args:
        name: see `names`.
        env_id: the environment; None for the first that the file has.

    Raises:
        ValueError: if there are none.
    """
    if name not in names():
        raise ValueError(f"name must be one of {', '.join(names())}, got {name!r}")
    path = files("mmc_gym.agents") / "hyperparams" / f"{name}.yml"
    entries: dict[str, Hyperparameters] = yaml.safe_load(path.read_text())
    env_id = env_id or next(iter(entries))
    if env_id not in entries:
        raise ValueError(f"env must be one of {', '.join(entries)} for {name}, got {env_id!r}")
    return env_id, entries[env_id]


def algorithm_of(name: str) -> str:
    """The algorithm that hyperparameters of that name are for: what stands before the first "-".

    Raises:
        ValueError: if there is no such algorithm.
    """
    algorithm = name.partition("-")[0]
    if algorithm not in ALGORITHMS:
        raise ValueError(f"name must begin with one of {', '.join(ALGORITHMS)}, got {name!r}")
    return algorithm


def make_model(
    algorithm: str,
    hyperparameters: Mapping[str, Any],
    env: VecEnv,
    seed: int,
    device: str = "cpu",
    tensorboard: str | None = None,
) -> BaseAlgorithm:
    """An untrained model.

    Args:
        algorithm: a key of `ALGORITHMS`.
        hyperparameters: an entry of a YAML file.
        env: to train in.
        seed: of everything random.
        device: to train on, as torch names it.
        tensorboard: folder for TensorBoard's logs.

    Raises:
        ValueError: if the hyperparameters name something that is not in the tables here.
    """
    h = deepcopy(dict(hyperparameters))  # stable-baselines3 adds to what it is given
    if "vec_env_wrapper" in h:
        env = _named("vec_env_wrapper", h, _WRAPPERS)(env)
    if "normalize" in h:
        env = VecNormalize(env, gamma=h["gamma"], **h["normalize"])
    options = {name: value for name, value in h.items() if name not in _NOT_OPTIONS}
    for name in set(options) & set(_SCHEDULES):
        options[name] = schedule(options[name])
    if "replay_buffer_class" in options:
        options["replay_buffer_class"] = _named("replay_buffer_class", options, _REPLAY_BUFFERS)
    policy = h["policy"]
    return ALGORITHMS[algorithm](
        _named("policy", h, POLICIES) if "." in policy else policy,
        env,
        seed=seed,
        device=device,
        tensorboard_log=tensorboard,
        **options,
    )


def make_callbacks(hyperparameters: Mapping[str, Any]) -> list[BaseCallback]:
    """The callbacks that an entry of a YAML file asks for.

    Raises:
        ValueError: if it names one that is not in the table here.
    """
    asked = hyperparameters.get("callback", [])
    return [_named("callback", {"callback": name}, _CALLBACKS)() for name in asked]


def schedule(value: float | str) -> Callable[[float], float]:
    """Of the part of the training that remains: a constant, or "lin_X", from X down to 0."""
    if isinstance(value, str) and value.startswith("lin_"):
        start = float(value.removeprefix("lin_"))
        return lambda progress_remaining: start * progress_remaining
    constant = float(value)
    return lambda progress_remaining: constant


def _named(name: str, values: Mapping[str, Any], table: Mapping[str, Any]) -> Any:
    if values[name] not in table:
        raise ValueError(f"{name} must be one of {', '.join(table)}, got {values[name]!r}")
    return table[values[name]]
