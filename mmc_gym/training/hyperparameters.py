"""Hyperparameters: YAML files in rl_zoo3's form, those that ship and a user's own.

What an entry of such a file means is read by `Settings`.
"""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path
from typing import Any, cast

import yaml
from sb3_contrib import TQC
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback

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
