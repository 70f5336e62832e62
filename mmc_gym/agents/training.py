"""Training reinforcement-learning agents with stable-baselines3, resumable bit for bit.

A training is cut into legs.  At the start of each leg the environments are reset and all
random generators are seeded anew, from the training's seed and the leg's number, and the state of
the training is written to a checkpoint (see `checkpoints`).  A training that was killed therefore
goes on from its last leg to the very policy that it would have reached.

All environments are one native vector environment.
"""

from __future__ import annotations

import math
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback

from mmc_gym._threads import one_torch_thread
from mmc_gym.agents.base import Agent, ReachInterface
from mmc_gym.agents.checkpoints import begin_episodes, load_checkpoint, read_head, save_checkpoint
from mmc_gym.agents.export import export_policy
from mmc_gym.agents.hyperparameters import (
    Hyperparameters,
    algorithm_of,
    make_callbacks,
    make_model,
)
from mmc_gym.agents.policy_network import PolicyNetwork
from mmc_gym.agents.reinforcement import (
    EVALUATION_EPISODES,
    FINAL_EPISODES,
    PolicyAgent,
    PolicyCard,
    save_policy,
)
from mmc_gym.agents.vec_env import GymnasiumVecEnv

CHECKPOINT = "checkpoint.safetensors"
EVALUATIONS = 25
EVALUATION_SEED = 1_000_000  # far from the seeds that a comparison starts from


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
        h = self.hyperparameters
        self.algorithm = algorithm_of(self.name)
        # Every leg starts where a rollout does; and where episodes do, if they are learned from
        # only when they are complete, as in hindsight.
        unit = h["n_envs"] * h.get("n_steps", h.get("train_freq", 1))
        if "replay_buffer_class" in h:
            unit = math.lcm(unit, h["n_envs"] * (gym.spec(self.env_id).max_episode_steps or 1))
        self.steps_per_leg = math.ceil(int(h["n_timesteps"]) / unit / self.evaluations) * unit
        self.total_steps = (
            math.ceil(int(h["n_timesteps"]) / self.steps_per_leg) * self.steps_per_leg
        )
        self._before = {"seconds": 0.0, "cpu_seconds": 0.0}

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
        with one_torch_thread():
            env = make_vec_env(self.env_id, self.hyperparameters["n_envs"], self._env_kwargs)
            self._interface = ReachInterface.of(env.vector_env)
            logs = str(self.tensorboard) if self.tensorboard else None
            model = make_model(
                self.algorithm, self.hyperparameters, env, self.seed, self.device, logs
            )
            PolicyAgent(*self._policy(model), self._interface)  # what cannot act is not trained
            if checkpoint.exists():
                self._load(model, checkpoint)
            self._started = {"seconds": time.perf_counter(), "cpu_seconds": time.process_time()}
            remaining = self.total_steps - model.num_timesteps
            if remaining > 0:
                callbacks = [_Legs(self), *make_callbacks(self.hyperparameters)]
                model.learn(
                    remaining,
                    callback=callbacks,
                    reset_num_timesteps=False,
                    tb_log_name=f"{self.name}-{self.seed}",
                )
                self.save(model)
            env.close()
            return self._finish(model)

    def save(self, model: BaseAlgorithm) -> None:
        """Evaluate the policy and write the checkpoint."""
        network, card = self._policy(model)
        scores = evaluate(network, card, EVALUATION_EPISODES)
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

    @property
    def _env_kwargs(self) -> dict[str, Any]:
        return dict(self.hyperparameters.get("env_kwargs", {}))

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
        for name, value in self._identity().items():
            if head.get(name) != value:
                raise ValueError(
                    f"{checkpoint} must have the same {name} to be resumed: "
                    f"it has {head.get(name)}, this training {value}"
                )
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
        card = PolicyCard(
            name=self.name,
            algorithm=self.algorithm,
            env_id=self.env_id,
            control=interface.control,
            segment_count=len(interface.segment_lengths),
            view=view,
            activation=network.activation,
            distribution=network.distribution,
            base_agent="mmc" if "vec_env_wrapper" in self.hyperparameters else "",
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
            scores=evaluate(network, card, FINAL_EPISODES),
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


def evaluate(network: PolicyNetwork, card: PolicyCard, episodes: int) -> dict[str, float]:
    """How the deterministic policy does over fixed episodes; see `evaluate_agent`."""

    def make(interface: ReachInterface) -> Agent[Any]:
        return PolicyAgent(network, card, interface)

    arguments = card.hyperparameters.get("env_kwargs", {})
    return evaluate_agent(make, card.env_id, arguments, episodes, EVALUATION_SEED)


def evaluate_agent(
    make: Callable[[ReachInterface], Agent[Any]],
    env_id: str,
    arguments: dict[str, Any],
    episodes: int,
    seed: int,
) -> dict[str, float]:
    """How an agent does over episodes that are played at once, each with an arm of its own.

    Args:
        make: makes the agent.
        env_id: environment that it acts in.
        arguments: of the environment.
        episodes: how many.
        seed: of the first episode; the others have the next ones.

    Returns:
        success: part of the episodes that end at the target.
        final_distance: mean, segment lengths.
        episode_return: mean.
        time_at_target: part of the time that is spent at the target.
        time_to_target: median over the successes, until the hand is there to stay, seconds; there
            is none without a success.
    """
    env = gym.make_vec(env_id, episodes, autoreset_mode="Disabled", **arguments)
    interface = ReachInterface.of(env)
    agent = make(interface)
    observations, infos = env.reset(seed=seed)
    state, over, step = None, np.zeros(episodes, dtype=bool), 0
    returns, at_target, last_away = (np.zeros(episodes) for _ in range(3))
    while not over.all():
        actions, state = agent.predict(observations, state, deterministic=True)
        observations, rewards, _, over, infos = env.step(actions)
        step += 1
        returns += rewards
        at_target += infos["is_success"]
        last_away[~infos["is_success"]] = step
    env.close()
    success = infos["is_success"]
    scores = {
        "success": float(success.mean()),
        "final_distance": float(infos["distance"].mean()),
        "episode_return": float(returns.mean()),
        "time_at_target": float(at_target.mean()) / step,
    }
    if success.any():
        steps = float(np.median(last_away[success])) + 1
        scores["time_to_target"] = round(steps * interface.control_step, 3)
    return scores


def make_vec_env(env_id: str, count: int, arguments: dict[str, Any]) -> GymnasiumVecEnv:
    """The native vector environment of `count` arms, for stable-baselines3."""
    env = gym.make_vec(env_id, count, autoreset_mode="SameStep", **arguments)
    return GymnasiumVecEnv(env)


def library_versions() -> dict[str, str]:
    """Versions of what a trained policy depends on, for its card."""
    names = ("mmc-gym", "gymnasium", "numpy", "pymunk", "stable-baselines3", "sb3-contrib", "torch")
    return {"python": platform.python_version(), **{name: version(name) for name in names}}
