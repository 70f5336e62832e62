"""Training reinforcement-learning agents with stable-baselines3, resumable bit for bit.

A training is cut into legs.  At the start of each leg the environments are reset and all
random generators are seeded anew, from the training's seed and the leg's number, and the state of
the training is written to a checkpoint (see `checkpoints`).  A training that was killed therefore
goes on from its last leg to the very policy that it would have reached.

All environments are one native vector environment.
"""

from __future__ import annotations

import platform
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any, cast

import gymnasium as gym
import numpy as np
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecMonitor, unwrap_vec_wrapper

from mmc_gym._files import check_folder
from mmc_gym._grid import one_torch_thread
from mmc_gym.agents.policy import (
    EVALUATION_EPISODES,
    FINAL_EPISODES,
    Algorithm,
    PolicyAgent,
    PolicyCard,
    save_policy,
)
from mmc_gym.agents.policy_network import PolicyNetwork
from mmc_gym.interface import ReachInterface
from mmc_gym.measures.rollout import evaluate
from mmc_gym.training.checkpoints import begin_episodes, load_checkpoint, read_head, save_checkpoint
from mmc_gym.training.hyperparameters import Hyperparameters, Settings, algorithm_of
from mmc_gym.training.policies import export_policy
from mmc_gym.training.vec_env import GymnasiumVecEnv, Residual

CHECKPOINT = "checkpoint.safetensors"
EVALUATIONS = 25


@dataclass(frozen=True)
class Progress:
    """How far a training is; with a new row of its learning curve, after an evaluation."""

    steps: int
    total_steps: int
    evaluation: dict[str, float] | None = None


@dataclass
class Training:
    """A training in one environment, by the hyperparameters of a YAML file.

    Attributes:
        name: of the hyperparameters; begins with the algorithm's.
        hyperparameters: an entry of the YAML file (see `read_hyperparameters`).
        env_id: the environment.
        seed: of everything random.
        folder: where the checkpoint and the trained policy are written.
        report: called after every rollout and every evaluation.
        evaluations: how often the policy is evaluated and a checkpoint written, about.
        device: that torch computes on.
        tensorboard: folder for TensorBoard's logs; None for none.
    """

    name: str
    hyperparameters: Hyperparameters
    env_id: str
    seed: int
    folder: Path
    report: Callable[[Progress], None] = lambda progress: None
    evaluations: int = EVALUATIONS
    device: str = "cpu"
    tensorboard: Path | None = None
    curve: list[dict[str, float]] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Check everything that can be, before anything is trained.

        Raises:
            ValueError: if a hyperparameter, the environment or the device is none that there is.
        """
        if self.evaluations < 1:
            raise ValueError(f"evaluations must be at least 1, got {self.evaluations}")
        self.device = usable_device(self.device)
        self.algorithm = algorithm_of(self.name)
        self.settings = Settings.read(self.algorithm, self.hyperparameters)
        if "env_kwargs" in self.hyperparameters:  # which readers of a card take for a mapping
            env_kwargs = {"env_kwargs": self.settings.env_kwargs}
            self.hyperparameters = {**self.hyperparameters, **env_kwargs}
        try:
            episode_steps = gym.spec(self.env_id).max_episode_steps or 1
        except gym.error.Error as error:
            raise ValueError(f"env must be the id of an environment: {error}") from error
        self.steps_per_leg = self.settings.steps_per_leg(episode_steps, self.evaluations)
        self.total_steps = -(-self.settings.steps // self.steps_per_leg) * self.steps_per_leg
        self._before = {"seconds": 0.0, "cpu_seconds": 0.0}

    def run(self, resume: bool = False) -> PolicyCard:
        """Train, or go on training, and write the policy.

        Raises:
            FileExistsError: if there is a checkpoint or the policy, and `resume` is not set.
            ValueError: if the folder is a file, the environment is none to train in, or the
                checkpoint is damaged or that of another training.
        """
        check_folder(self.folder, "out")
        checkpoint = self.folder / CHECKPOINT
        if checkpoint.exists() and not resume:
            raise FileExistsError(
                f"{checkpoint} exists already: resume it, or choose another folder"
            )
        for file in self.policy_files:
            if file.exists() and not resume:
                raise FileExistsError(f"{file} exists already: choose another folder, or delete it")
        if checkpoint.exists():
            self.check_checkpoint()
        with one_torch_thread():
            env = make_vec_env(self.env_id, self.settings.env_count, self.settings.env_kwargs)
            self._interface = ReachInterface.of(env.vector_env)
            logs = str(self.tensorboard) if self.tensorboard else None
            # The monitor, which has TensorBoard show returns, sees the rewards as they are.
            model = self.settings.make_model(VecMonitor(env), self.seed, self.device, logs)
            PolicyAgent(*self._policy(model), self._interface)  # what cannot act is not trained
            if checkpoint.exists():
                self._load(model, checkpoint)
            self._started = {"seconds": time.perf_counter(), "cpu_seconds": time.process_time()}
            remaining = self.total_steps - model.num_timesteps
            if remaining > 0:
                callbacks = [_Legs(self), *self.settings.make_callbacks()]
                model.learn(
                    remaining,
                    callback=callbacks,
                    reset_num_timesteps=False,
                    tb_log_name=f"{self.name}-{self.seed}",
                )
                self.save(model)
            env.close()
            return self._finish(model)

    @property
    def policy_files(self) -> tuple[Path, Path]:
        """Where the trained policy is written."""
        stem = f"{self.name}-{self.seed}"
        return self.folder / f"{stem}.safetensors", self.folder / f"{stem}.json"

    def check_checkpoint(self) -> None:
        """Raise a `ValueError` if the checkpoint is damaged or that of another training."""
        checkpoint = self.folder / CHECKPOINT
        head, here = read_head(checkpoint), self._identity()
        differences = [
            difference
            for name, value in here.items()
            if head.get(name) != value
            for difference in _differences(name, head.get(name), value)
        ]
        if differences:
            raise ValueError(
                f"{checkpoint} is that of another training, with {', '.join(differences)}: "
                f"resume it with what it had, delete {self.folder}, or choose another folder"
            )

    def save(self, model: BaseAlgorithm) -> None:
        """Evaluate the policy and write the checkpoint."""
        network, card = self._policy(model)
        scores = _scores(network, card, EVALUATION_EPISODES)
        self.curve.append({"steps": model.num_timesteps, **self._times(), **scores})
        if self.tensorboard is not None:
            for name, value in scores.items():
                model.logger.record(f"evaluation/{name}", value)
            model.logger.dump(model.num_timesteps)
        head = {**self._identity(), **self._times(), "curve": self.curve}
        save_checkpoint(model, head, self.folder / CHECKPOINT)
        self.report(Progress(model.num_timesteps, self.total_steps, self.curve[-1]))

    def begin_leg(self, model: BaseAlgorithm) -> None:
        """Reset the environments and seed everything random from the seed and the step count."""
        leg = model.num_timesteps // self.steps_per_leg
        seed = int(np.random.SeedSequence([self.seed, leg]).generate_state(1)[0])
        env = model.get_env()
        assert env is not None
        model.set_random_seed(seed)
        model._last_obs = env.reset()  # type: ignore[assignment]
        model._last_episode_starts = np.ones(env.num_envs, dtype=bool)
        begin_episodes(model)

    def _identity(self) -> dict[str, Any]:
        """What must be equal for a checkpoint to belong to this training."""
        return {
            "name": self.name,
            "env_id": self.env_id,
            "seed": self.seed,
            "evaluations": self.evaluations,
            "device": self.device,
            "hyperparameters": self.hyperparameters,
            "versions": library_versions(),
        }

    def _load(self, model: BaseAlgorithm, checkpoint: Path) -> None:
        head = read_head(checkpoint)
        load_checkpoint(model, checkpoint)
        self.curve = head["curve"]
        self._before = {name: head[name] for name in self._before}

    def _times(self) -> dict[str, float]:
        now = {"seconds": time.perf_counter(), "cpu_seconds": time.process_time()}
        return {
            name: round(self._before[name] + now[name] - self._started[name], 1) for name in now
        }

    def _policy(self, model: BaseAlgorithm) -> tuple[PolicyNetwork, PolicyCard]:
        """The policy as it is now, with a card that has no scores yet."""
        interface = self._interface
        network, view = export_policy(model.policy)
        env = model.get_env()
        assert env is not None
        residual = unwrap_vec_wrapper(env, Residual)
        card = PolicyCard(
            name=self.name,
            algorithm=cast(Algorithm, self.algorithm),
            env_id=self.env_id,
            control=interface.control,
            segment_count=len(interface.segment_lengths),
            view=view,
            activation=network.activation,
            distribution=network.distribution,
            base_agent="" if residual is None else residual.base_agent,
            hyperparameters=self.hyperparameters,
            seed=self.seed,
            training_steps=model.num_timesteps,
            training_seconds=0.0,
            training_cpu_seconds=0.0,
            versions=library_versions(),
            scores={},
            learning_curve=[],
        )
        return network, card

    def _finish(self, model: BaseAlgorithm) -> PolicyCard:
        network, card = self._policy(model)
        card = replace(
            card,
            training_seconds=self.curve[-1]["seconds"],
            training_cpu_seconds=self.curve[-1]["cpu_seconds"],
            scores=_scores(network, card, FINAL_EPISODES),
            learning_curve=self.curve,
        )
        save_policy(network, card, self.folder)
        return card


class _Legs(BaseCallback):
    """Checkpoint and fresh start between one leg and the next."""

    def __init__(self, training: Training) -> None:
        super().__init__()
        self._training = training
        self._first = True

    def _on_rollout_start(self) -> None:
        model, training = self.model, self._training
        if model.num_timesteps % training.steps_per_leg == 0:
            if not self._first:  # where a training starts or goes on, nothing is new to save
                training.save(model)
            training.begin_leg(model)
            self._first = False

    def _on_rollout_end(self) -> None:
        training = self._training
        training.report(Progress(self.num_timesteps, training.total_steps))

    def _on_step(self) -> bool:
        return True


def make_vec_env(env_id: str, count: int, arguments: dict[str, Any]) -> GymnasiumVecEnv:
    """The native vector environment of `count` arms, for stable-baselines3.

    Raises:
        ValueError: if it is no reaching environment, or does not take the arguments.
    """
    try:
        env = gym.make_vec(env_id, count, autoreset_mode="SameStep", **arguments)
    except TypeError as error:
        raise ValueError(
            f"env must be a reaching environment that takes {arguments}, got {env_id}: {error}"
        ) from error
    return GymnasiumVecEnv(env)


def usable_device(name: str) -> str:
    """The device of that name; that which torch prefers for "auto".

    Raises:
        ValueError: if torch knows no such device, or has none here.
    """
    if name == "auto":
        name = "cuda" if torch.cuda.is_available() else "cpu"
    try:
        torch.ones(1, device=torch.device(name)).item()
    except (RuntimeError, AssertionError, NotImplementedError) as error:
        reason = str(error).partition("\n")[0]
        raise ValueError(
            f"device must be one that PyTorch can use here, such as cpu, got {name!r}: {reason}"
        ) from error
    return name


def _differences(name: str, there: Any, here: Any) -> Iterator[str]:
    """What two values of an entry of a checkpoint's head differ in, in words."""
    if isinstance(there, dict) and isinstance(here, dict):
        for key in sorted({*there, *here}):
            if there.get(key) != here.get(key):
                hint = ", see --steps" if key == "n_timesteps" else ""
                yield f"{key} {there.get(key)} (here {here.get(key)}{hint})"
    else:
        yield f"{name} {there} (here {here})"


def library_versions() -> dict[str, str]:
    """Versions of what a trained policy depends on, for its card."""
    names = ("mmc-gym", "gymnasium", "numpy", "pymunk", "stable-baselines3", "sb3-contrib", "torch")
    return {"python": platform.python_version(), **{name: version(name) for name in names}}


def _scores(network: PolicyNetwork, card: PolicyCard, episodes: int) -> dict[str, float]:
    """Evaluate a policy in the environment that it is trained in."""
    arguments = card.hyperparameters.get("env_kwargs", {})
    return evaluate(partial(PolicyAgent, network, card), card.env_id, arguments, episodes)
