"""Training reinforcement-learning agents with stable-baselines3, resumable bit for bit.

A training is cut into legs.  At the start of each leg the environments are reset and all
random generators are seeded anew, from the training's seed and the leg's number, and the
policy, its optimizer and the step count are written to a checkpoint.  A training that was
killed therefore goes on from its last leg to the very policy that it would have reached.

All environments are one native vector environment.
"""

from __future__ import annotations

import json
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from typing import Any, cast

import gymnasium as gym
import numpy as np
import safetensors.torch
import yaml
from safetensors import SafetensorError
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.utils import set_random_seed
from stable_baselines3.common.vec_env import VecNormalize

from mmc_gym._files import write_atomically
from mmc_gym.agents.base import ReachInterface
from mmc_gym.agents.ppo import make_model, plain_weights, schedule
from mmc_gym.agents.reinforcement import PolicyCard, make_policy, save_policy
from mmc_gym.agents.vec_env import GymnasiumVecEnv
from mmc_gym.network.training import one_thread

CHECKPOINT = "checkpoint.safetensors"
EVALUATION_SEED = 1_000_000  # far from the seeds that a comparison starts from


@dataclass(frozen=True)
class Progress:
    """How far a training is; with a new row of its learning curve, after an evaluation."""

    steps: int
    total_steps: int
    evaluation: dict[str, float] | None = None


@dataclass
class Training:
    """A training of PPO in one environment, by the hyperparameters of a YAML file.

    Attributes:
        hyperparameters: an entry of the YAML file (see `read_hyperparameters`).
        env_id: the environment.
        seed: of everything random.
        folder: where the checkpoint and the trained policy are written.
        report: called after every rollout and every evaluation.
    """

    hyperparameters: dict[str, Any]
    env_id: str
    seed: int
    folder: Path
    report: Callable[[Progress], None] = lambda progress: None
    curve: list[dict[str, float]] = field(default_factory=list)

    def __post_init__(self) -> None:
        h = self.hyperparameters
        self.steps_per_leg = h["rollouts_per_leg"] * h["n_envs"] * h["n_steps"]
        # Whole legs, so that every leg starts where a rollout does.
        self.total_steps = -(-int(h["n_timesteps"]) // self.steps_per_leg) * self.steps_per_leg
        self.entropy_bonus = schedule(h["ent_coef"])
        self._seconds_before = 0.0

    def run(self, resume: bool = False) -> PolicyCard:
        """Train, or go on training, and write the policy.

        Raises:
            FileExistsError: if there is a checkpoint and `resume` is not set.
            ValueError: if the checkpoint is damaged or that of another training.
        """
        checkpoint = self.folder / CHECKPOINT
        if checkpoint.exists() and not resume:
            raise FileExistsError(
                f"{checkpoint} exists already: resume it, or choose another folder"
            )
        with one_thread():
            model = self._make_model()
            if checkpoint.exists():
                self._load(model, checkpoint)
            self._started = time.perf_counter()
            remaining = self.total_steps - model.num_timesteps
            if remaining > 0:
                model.learn(remaining, callback=_Legs(self), reset_num_timesteps=False)
                self.save(model)
            return self._finish(model)

    def save(self, model: PPO) -> None:
        """Evaluate the policy and write the checkpoint."""
        scores = evaluate(model.policy, self.env_id, self.hyperparameters)
        self.curve.append(
            {"steps": model.num_timesteps, "seconds": round(self._seconds(), 1), **scores}
        )
        state = model.policy.optimizer.state_dict()["state"]
        tensors = {f"policy.{name}": value for name, value in model.policy.state_dict().items()}
        for index, moments in state.items():
            tensors |= {f"optimizer.{index}.{name}": value for name, value in moments.items()}
        tensors = {name: tensor.contiguous() for name, tensor in tensors.items()}
        head = {
            **self._identity(),
            "steps": model.num_timesteps,
            "updates": model._n_updates,
            "seconds": self._seconds(),
            "curve": self.curve,
            "reward_statistics": _reward_statistics(model),
        }
        content = safetensors.torch.save(tensors, metadata={"training": json.dumps(head)})
        write_atomically(self.folder / CHECKPOINT, content)
        self.report(Progress(model.num_timesteps, self.total_steps, self.curve[-1]))

    def begin_leg(self, model: PPO) -> None:
        """Reset the environments and seed everything random from the seed and the step count."""
        leg = model.num_timesteps // self.steps_per_leg
        seed = int(np.random.SeedSequence([self.seed, leg]).generate_state(1)[0])
        set_random_seed(seed)
        env = model.get_env()
        assert env is not None
        env.seed(seed)
        model._last_obs = env.reset()  # type: ignore[assignment]
        model._last_episode_starts = np.ones(env.num_envs, dtype=bool)

    def _make_model(self) -> PPO:
        h = self.hyperparameters
        env = make_vec_env(self.env_id, h["n_envs"], h.get("env_kwargs", {}))
        return make_model(h, env, self.seed)

    def _identity(self) -> dict[str, Any]:
        """What must be equal for a checkpoint to belong to this training."""
        return {
            "env_id": self.env_id,
            "seed": self.seed,
            "hyperparameters": self.hyperparameters,
            "versions": library_versions(),
        }

    def _load(self, model: PPO, checkpoint: Path) -> None:
        try:
            with safetensors.safe_open(checkpoint, framework="pt") as file:
                head = json.loads(file.metadata()["training"])
                tensors = {name: file.get_tensor(name) for name in file.keys()}
        except (SafetensorError, KeyError, TypeError, ValueError) as error:
            raise ValueError(f"{checkpoint} does not hold a training: {error}") from error
        for name, value in self._identity().items():
            if head[name] != value:
                raise ValueError(
                    f"{checkpoint} must have the same {name} to be resumed: "
                    f"it has {head[name]}, this training {value}"
                )
        policy, optimizer = {}, model.policy.optimizer.state_dict()
        for name, tensor in tensors.items():
            kind, _, rest = name.partition(".")
            if kind == "policy":
                policy[rest] = tensor
            else:
                index, _, moment = rest.partition(".")
                optimizer["state"].setdefault(int(index), {})[moment] = tensor
        model.policy.load_state_dict(policy)
        model.policy.optimizer.load_state_dict(optimizer)
        model.num_timesteps = head["steps"]
        model._n_updates = head["updates"]
        if isinstance(model.env, VecNormalize):
            statistics = model.env.ret_rms
            statistics.mean, statistics.var, statistics.count = head["reward_statistics"]
        self.curve = head["curve"]
        self._seconds_before = head["seconds"]

    def _seconds(self) -> float:
        return self._seconds_before + time.perf_counter() - self._started

    def _finish(self, model: PPO) -> PolicyCard:
        h = self.hyperparameters
        env = gym.make(self.env_id, **h.get("env_kwargs", {}))
        interface = ReachInterface.of(env)
        card = PolicyCard(
            algorithm="ppo",
            env_id=self.env_id,
            control=interface.control,
            segment_count=len(interface.segment_lengths),
            hidden_units=h["policy_kwargs"]["net_arch"],
            activation=h["policy_kwargs"]["activation_fn"],
            hyperparameters=h,
            seed=self.seed,
            training_steps=model.num_timesteps,
            training_seconds=round(self.curve[-1]["seconds"], 1),
            versions=library_versions(),
            scores={},
            learning_curve=self.curve,
        )
        policy = make_policy(card)
        policy.load_state_dict(plain_weights(model))
        card = replace(card, scores=evaluate(policy, self.env_id, h, episodes=500))
        save_policy(policy, card, self.folder)
        return card


class _Legs(BaseCallback):
    """Checkpoint and fresh start between one leg and the next."""

    def __init__(self, training: Training) -> None:
        super().__init__()
        self._training = training
        self._first = True

    def _on_rollout_start(self) -> None:
        model, training = cast(PPO, self.model), self._training
        if model.num_timesteps % training.steps_per_leg == 0:
            if not self._first:  # where a training starts or goes on, nothing is new to save
                training.save(model)
            training.begin_leg(model)
            self._first = False
        model.ent_coef = training.entropy_bonus(1 - model.num_timesteps / training.total_steps)

    def _on_rollout_end(self) -> None:
        training = self._training
        training.report(Progress(self.num_timesteps, training.total_steps))

    def _on_step(self) -> bool:
        return True


def read_hyperparameters(algorithm: str, env_id: str) -> dict[str, Any]:
    """The shipped hyperparameters of an algorithm in an environment.

    Raises:
        ValueError: if there are none.
    """
    path = files("mmc_gym.agents") / "hyperparams" / f"{algorithm}.yml"
    if not path.is_file():
        raise ValueError(f"algorithm must be 'ppo', got {algorithm!r}")
    entries = yaml.safe_load(path.read_text())
    if env_id not in entries:
        raise ValueError(f"env must be one of {', '.join(entries)} for {algorithm}, got {env_id!r}")
    return cast("dict[str, Any]", entries[env_id])


def evaluate(
    policy: BasePolicy, env_id: str, hyperparameters: dict[str, Any], episodes: int = 100
) -> dict[str, float]:
    """Success and mean final distance of the deterministic policy over fixed episodes.

    All episodes run at once, each with an arm of its own.
    """
    env = make_vec_env(env_id, episodes, hyperparameters.get("env_kwargs", {}))
    env.seed(EVALUATION_SEED)
    observations = env.reset()
    running = np.ones(episodes, dtype=bool)
    success, distance = np.zeros(episodes), np.zeros(episodes)
    while running.any():
        actions, _ = policy.predict(observations, deterministic=True)  # type: ignore[arg-type]
        observations, _, dones, infos = env.step(actions)
        for index in np.flatnonzero(running & dones):
            success[index] = infos[index]["is_success"]
            distance[index] = infos[index]["distance"]
        running &= ~dones
    env.close()
    return {"success": float(success.mean()), "final_distance": float(distance.mean())}


def make_vec_env(env_id: str, count: int, arguments: dict[str, Any]) -> GymnasiumVecEnv:
    """The native vector environment of `count` arms, for stable-baselines3."""
    env = gym.make_vec(env_id, count, autoreset_mode="SameStep", **arguments)
    return GymnasiumVecEnv(env)


def library_versions() -> dict[str, str]:
    """Versions of what a trained policy depends on, for its card."""
    names = ("mmc-gym", "gymnasium", "numpy", "pymunk", "stable-baselines3", "torch")
    return {"python": platform.python_version(), **{name: version(name) for name in names}}


def _reward_statistics(model: PPO) -> list[float] | None:
    """Mean, variance and count that the rewards are scaled by, if they are."""
    if not isinstance(model.env, VecNormalize):
        return None
    statistics = model.env.ret_rms
    return [float(statistics.mean), float(statistics.var), float(statistics.count)]
