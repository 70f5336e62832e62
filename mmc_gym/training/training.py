"""Train policies with stable-baselines3, resumable bit for bit.

A training is cut into legs.  At the start of each leg the environments are reset, all random
generators are seeded from the training's seed and the leg's number, and the state of the training
is written to a checkpoint.  So a killed training resumes from its last leg, and ends with the same
policy as an uninterrupted one.
"""

from __future__ import annotations

import platform
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any, cast

import gymnasium as gym
import numpy as np
import torch
from stable_baselines3 import HerReplayBuffer
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv

from mmc_gym._errors import UserError, is_whole, missing, require, require_whole
from mmc_gym._files import check_folder
from mmc_gym._grid import one_torch_thread
from mmc_gym.agents.policy import (
    EVALUATION_EPISODES,
    FINAL_EPISODES,
    PolicyAgent,
    PolicyCard,
    file_stem,
    load_policy,
    save_policy,
)
from mmc_gym.agents.policy_network import PolicyNetwork
from mmc_gym.interface import ReachInterface, read_attribute
from mmc_gym.measures.rollout import evaluate
from mmc_gym.training.hyperparameters import Recipe, read_recipe
from mmc_gym.training.policies import export_policy, load_checkpoint, read_head, save_checkpoint
from mmc_gym.training.vec_env import GymnasiumVecEnv

CHECKPOINT = "checkpoint.safetensors"


@dataclass(frozen=True)
class TrainingProgress:
    """Progress of a training; `evaluation` is the learning curve's new row, None without one."""

    steps: int
    total_steps: int
    evaluation: dict[str, float] | None = None


@dataclass
class Training:
    """A training in one environment, with the hyperparameters of a YAML file.

    To train another learner, override `make_model` and `export`.
    """

    recipe: Recipe
    seed: int  #: seed of all random generators
    folder: Path  #: where the checkpoint and the trained policy are written
    #: called after every rollout and every evaluation
    report: Callable[[TrainingProgress], None] = lambda progress: None
    evaluations: int = 25  #: approximate number of evaluations, each followed by a checkpoint
    device: str = "cpu"  #: the device of torch, such as "cpu"
    tensorboard: Path | str | None = None  #: folder for TensorBoard's logs
    #: the learning curve, a row for each evaluation
    curve: list[dict[str, float]] = field(default_factory=list, init=False)

    def __post_init__(self) -> None:
        require_whole("evaluations", self.evaluations)
        is_seed = is_whole(self.seed) and 0 <= self.seed < 2**32
        require(is_seed, "seed", self.seed, "from 0 to 2**32 - 1")
        if self.tensorboard is not None and find_spec("tensorboard") is None:
            raise missing("a log for TensorBoard", "tensorboard", "training")
        self.device = usable_device(self.device)
        self.steps_per_leg = self.recipe.steps_per_leg(self.evaluations)
        steps = self.recipe.settings["n_timesteps"]
        self.total_steps = -(-steps // self.steps_per_leg) * self.steps_per_leg

    @property
    def checkpoint(self) -> Path:
        """The file from which a training resumes."""
        return self.folder / CHECKPOINT

    @property
    def policy_files(self) -> tuple[Path, Path]:
        """The two files of the trained policy: its network (.safetensors) and its card (.json)."""
        label = file_stem(self.recipe.name, self.seed)
        return self.folder / f"{label}.safetensors", self.folder / f"{label}.json"

    def run(self, resume: bool = False) -> PolicyCard:
        """Train, from the checkpoint if there is one; write the policy, and return its card.

        Raises:
            FileExistsError: if a checkpoint or the policy exists and `resume` is not set, or if the
                policy exists without a checkpoint.
            UserError: if the policy could not act, or the checkpoint is damaged or of another
                training.
        """
        check_folder(self.folder, "out")
        for file in (self.checkpoint, *self.policy_files):
            if file.exists() and not (resume and self.checkpoint.exists()):
                hint = "resume it, or " if file == self.checkpoint else ""
                message = f"{file} exists already: {hint}choose another folder, or delete it"
                raise FileExistsError(message)
        head = self.find_checkpoint()
        with one_torch_thread():
            settings = self.recipe.settings
            env = make_vec_env(self.recipe.env_id, settings["n_envs"], settings["env_kwargs"])
            self._env = env.vector_env
            self.interface = ReachInterface.of(self._env)  #: of the environment
            model = self.make_model(env)
            try:  # fail now, not after hours, if the policy could not act
                PolicyAgent(*self._policy(model), self.interface)
            except ValueError as error:
                raise UserError(f"hyperparameters must give a policy that acts: {error}") from error
            self._started = _now()
            if head is not None:
                load_checkpoint(model, head, self.checkpoint)
                self.curve = head["curve"]
                self._started = {name: now - head[name] for name, now in _now().items()}
            if (remaining := self.total_steps - model.num_timesteps) > 0:
                model.learn(
                    remaining,
                    callback=_Legs(self),
                    reset_num_timesteps=False,
                    tb_log_name=file_stem(self.recipe.name, self.seed),
                )
                self.save(model)
            env.close()
            network, card = self._policy(model)
            card = replace(
                card,
                training_seconds=self.curve[-1]["seconds"],
                training_cpu_seconds=self.curve[-1]["cpu_seconds"],
                scores=evaluate_policy(network, card, FINAL_EPISODES),
                learning_curve=self.curve,
            )
            save_policy(network, card, self.folder)
            return card

    def make_model(self, env: VecEnv) -> BaseAlgorithm:
        """Return the untrained model for an environment."""
        logs = str(self.tensorboard) if self.tensorboard else None
        return self.recipe.make_model(env, self.seed, self.device, logs)

    def export(self, model: BaseAlgorithm) -> tuple[PolicyNetwork, dict[str, Any]]:
        """Return the current network of the policy, and its card's fields about the inputs.

        Raises:
            ValueError: if the policy has layers that a `PolicyNetwork` cannot have.
        """
        network = export_policy(model.policy, model.get_vec_normalize_env())
        blocks = tuple(self.recipe.settings["memory"])
        return network, {"base_agent": getattr(model.get_env(), "base_agent", ""), "blocks": blocks}

    def find_checkpoint(self) -> dict[str, Any] | None:
        """Return the checkpoint's head, None without one; a `UserError` if another training's."""
        if not self.checkpoint.exists():
            return None
        head = read_head(self.checkpoint)
        here, there = self._identity(), head.get("identity", {})
        differences = [
            f"{name} {there.get(name)} (here {here.get(name)})"
            for name in there | here
            if there.get(name) != here.get(name)
        ]
        if differences:
            raise UserError(
                f"{self.checkpoint} is of another training, with {', '.join(differences)}: "
                f"resume it with its own arguments, delete {self.folder}, or choose another folder"
            )
        return head

    def save(self, model: BaseAlgorithm) -> None:
        """Evaluate the policy, extend the learning curve, and write the checkpoint."""
        network, card = self._policy(model)
        scores = evaluate_policy(network, card, EVALUATION_EPISODES)
        self.curve.append({"steps": model.num_timesteps, **self._times(), **scores})
        if self.tensorboard is not None:
            for name, value in scores.items():
                model.logger.record(f"evaluation/{name}", value)
            model.logger.dump(model.num_timesteps)
        head = {"identity": self._identity(), **self._times(), "curve": self.curve}
        save_checkpoint(model, head, self.checkpoint)
        self.report(TrainingProgress(model.num_timesteps, self.total_steps, self.curve[-1]))

    def begin_leg(self, model: BaseAlgorithm) -> None:
        """Begin a leg of the training: reset the environments, and seed all random generators.

        The seed is derived from the training's seed and the leg's number.
        """
        leg = model.num_timesteps // self.steps_per_leg
        seed = int(np.random.SeedSequence([self.seed, leg]).generate_state(1)[0])
        env = cast(VecEnv, model.get_env())
        model.set_random_seed(seed)
        model._last_obs = env.reset()  # type: ignore[assignment]
        model._last_episode_starts = np.ones(env.num_envs, dtype=bool)
        if normalizer := model.get_vec_normalize_env():
            model._last_original_obs = normalizer.get_original_obs()
        if noise := getattr(model, "action_noise", None):
            noise.reset()
        buffer = getattr(model, "replay_buffer", None)
        if isinstance(buffer, HerReplayBuffer):  # it has to know where episodes begin
            buffer._current_ep_start[:] = buffer.pos

    def _identity(self) -> dict[str, Any]:
        """Return the settings that a checkpoint of this training must have."""
        return {
            "name": self.recipe.name,
            "env_id": self.recipe.env_id,
            "seed": self.seed,
            "evaluations": self.evaluations,
            "device": self.device,
            **self.recipe.hyperparameters,
            **library_versions(),
        }

    def _times(self) -> dict[str, float]:
        return {name: round(now - self._started[name], 1) for name, now in _now().items()}

    def _policy(self, model: BaseAlgorithm) -> tuple[PolicyNetwork, PolicyCard]:
        """Return the current network of the policy, and a card that has no scores yet."""
        network, inputs = self.export(model)
        card = PolicyCard(
            name=self.recipe.name,
            algorithm=self.recipe.algorithm,
            env_id=self.recipe.env_id,
            control=self.interface.control,
            segment_count=len(self.interface.segment_lengths),
            activation=network.activation,
            distribution=network.distribution,
            hyperparameters=self.recipe.hyperparameters,
            seed=self.seed,
            training_steps=model.num_timesteps,
            training_seconds=0.0,
            training_cpu_seconds=0.0,
            versions=library_versions(),
            scores={},
            learning_curve=[],
            view="arm",
            engine=read_attribute(self._env, "engine"),
            body=read_attribute(self._env, "unperturbed"),
            context=read_attribute(self._env, "context_scale") or [],
            **inputs,
        )
        return network, card


def train(
    name: str | Path,
    *,
    env: str | None = None,
    seed: int = 0,
    steps: int | None = None,
    without: str | None = None,
    out: Path | str | None = None,
    resume: bool = False,
    tensorboard: Path | str | None = None,
    device: str = "cpu",
    env_kwargs: Mapping[str, Any] | None = None,
    on_progress: Callable[[TrainingProgress], None] = lambda progress: None,
) -> PolicyAgent:
    """Train an agent as `mmc-gym train` does, with its options as arguments; return the agent.

    Without a folder `out` no files are kept; `agent.save` can write the policy later.  `env_kwargs`
    are added to those in the file of hyperparameters.  `on_progress` is called after every rollout
    and every evaluation.  The returned agent has a `card`, and acts without torch.

    Raises:
        FileExistsError: if the folder holds a training, and `resume` is not set.
    """
    recipe = read_recipe(str(name), env, steps, env_kwargs)
    recipe = recipe if without is None else recipe.without(without)
    with tempfile.TemporaryDirectory() as nowhere:
        folder = check_folder(nowhere if out is None else out, "out")
        training = Training(
            recipe, seed, folder, on_progress, device=device, tensorboard=tensorboard
        )
        training.run(resume)
        return PolicyAgent(*load_policy(training.policy_files[0]), training.interface)


def _now() -> dict[str, float]:
    return {"seconds": time.perf_counter(), "cpu_seconds": time.process_time()}


class _Legs(BaseCallback):
    """Write a checkpoint at the end of each leg, and begin the next one."""

    def __init__(self, training: Training) -> None:
        super().__init__()
        self._training = training

    def _on_rollout_start(self) -> None:
        model, training = self.model, self._training
        if model.num_timesteps % training.steps_per_leg == 0:
            saved = training.curve[-1]["steps"] if training.curve else 0
            if model.num_timesteps > saved:
                training.save(model)
            training.begin_leg(model)

    def _on_rollout_end(self) -> None:
        training = self._training
        training.report(TrainingProgress(self.num_timesteps, training.total_steps))

    def _on_step(self) -> bool:
        return True


def make_vec_env(env_id: str, count: int, arguments: dict[str, Any]) -> GymnasiumVecEnv:
    """Make a native vector environment of `count` arms, adapted to stable-baselines3."""
    try:
        env = gym.make_vec(env_id, count, autoreset_mode="SameStep", **arguments)
    except TypeError as error:
        raise UserError(
            f"env must be a reaching environment that takes {arguments}, got {env_id}: {error}"
        ) from error
    return GymnasiumVecEnv(env)


def usable_device(name: str) -> str:
    """Return `name`, or for "auto" the best device; raise a `UserError` if torch cannot use it."""
    if name == "auto":
        name = "cuda" if torch.cuda.is_available() else "cpu"
    try:
        torch.ones(1, device=torch.device(name)).item()
    except (RuntimeError, AssertionError, NotImplementedError) as error:
        reason = str(error).partition("\n")[0]
        raise UserError(
            f"device must be one that PyTorch can use here, such as cpu, got {name!r}: {reason}"
        ) from error
    return name


def library_versions() -> dict[str, str]:
    """Return the versions of Python and of the packages that a training depends on, by name."""
    names = ("mmc-gym", "gymnasium", "numpy", "pymunk", "stable-baselines3", "sb3-contrib", "torch")
    return {"python": platform.python_version(), **{name: version(name) for name in names}}


def evaluate_policy(network: PolicyNetwork, card: PolicyCard, episodes: int) -> dict[str, float]:
    """Return a policy's scores in its training environment, on the default engine (pymunk)."""
    arguments = {**card.hyperparameters.get("env_kwargs", {})}
    arguments.pop("engine", None)
    return evaluate(partial(PolicyAgent, network, card), card.env_id, arguments, episodes)
