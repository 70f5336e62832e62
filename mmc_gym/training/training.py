"""Train policies with stable-baselines3, resumable bit for bit.

A training is cut into legs.  At the start of each leg the environments are reset, all random
generators are seeded from the training's seed and the leg's number, and the state of the training
is written to a checkpoint.  So a training that was killed goes on from its last leg, and ends with
the same policy as one that was not.
"""

from __future__ import annotations

import platform
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
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
from stable_baselines3.common.vec_env import VecEnv, unwrap_vec_wrapper

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
from mmc_gym.training.checkpoints import load_checkpoint, read_head, save_checkpoint
from mmc_gym.training.hyperparameters import Recipe, read_recipe
from mmc_gym.training.policies import export_policy
from mmc_gym.training.randomised import Memory
from mmc_gym.training.vec_env import GymnasiumVecEnv, Residual

CHECKPOINT = "checkpoint.safetensors"


@dataclass(frozen=True)
class TrainingProgress:
    """How far a training is, and the last row of its learning curve if it was just evaluated."""

    steps: int
    total_steps: int
    evaluation: dict[str, float] | None = None


@dataclass
class Training:
    """A training in one environment, by the hyperparameters of a YAML file.

    Attributes:
        seed: of everything random.
        folder: where the checkpoint and the trained policy are written.
        report: called after every rollout and every evaluation.
        evaluations: about how often the policy is evaluated and a checkpoint written.
        device: that torch computes on.
        tensorboard: folder for TensorBoard's logs; None for none.
        curve: a row for each evaluation.
        interface: what its agent is told; known once it runs.
    """

    recipe: Recipe
    seed: int
    folder: Path
    report: Callable[[TrainingProgress], None] = lambda progress: None
    evaluations: int = 25
    device: str = "cpu"
    tensorboard: Path | None = None
    curve: list[dict[str, float]] = field(default_factory=list, init=False)

    def __post_init__(self) -> None:
        """Check all that can be checked before anything is trained.

        Raises:
            UserError: if a hyperparameter, the environment or the device is not accepted, or an
                extra is missing.
        """
        require_whole("evaluations", self.evaluations)
        fine = is_whole(self.seed) and 0 <= self.seed < 2**32
        require(fine, "seed", self.seed, "from 0 to 2**32 - 1")
        if self.tensorboard is not None and find_spec("tensorboard") is None:
            raise missing("a log for TensorBoard", "tensorboard", "training")
        self.device = usable_device(self.device)
        self.settings = self.recipe.settings
        try:
            episode_steps = gym.spec(self.recipe.env_id).max_episode_steps or 1
        except gym.error.Error as error:
            raise UserError(f"env must be the id of an environment: {error}") from error
        self.steps_per_leg = self.settings.steps_per_leg(episode_steps, self.evaluations)
        self.total_steps = -(-self.settings.n_timesteps // self.steps_per_leg) * self.steps_per_leg

    @property
    def checkpoint(self) -> Path:
        """The file that a training goes on from."""
        return self.folder / CHECKPOINT

    @property
    def policy_files(self) -> tuple[Path, Path]:
        """The files of the trained policy."""
        label = file_stem(self.recipe.name, self.seed)
        return self.folder / f"{label}.safetensors", self.folder / f"{label}.json"

    def run(self, resume: bool = False) -> PolicyCard:
        """Train, or go on training, and write the policy.

        Raises:
            FileExistsError: if there is a checkpoint or the policy, and `resume` is not set.
            UserError: if the folder is a file, the environment is none to train in, or the
                checkpoint is damaged or that of another training.
        """
        head = self._prepare(resume)
        with one_torch_thread():
            env = make_vec_env(self.recipe.env_id, self.settings.n_envs, self.settings.env_kwargs)
            self._world = env.vector_env
            self.interface = ReachInterface.of(self._world)
            logs = str(self.tensorboard) if self.tensorboard else None
            model = self.settings.make_model(env, self.seed, self.device, logs)
            try:
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

    def read_checkpoint_head(self) -> dict[str, Any]:
        """Return the head of the checkpoint.

        Raises:
            UserError: if it is damaged or that of another training.
        """
        head, here = read_head(self.checkpoint), self._identity()
        differences = [
            difference
            for name, value in here.items()
            if head.get(name) != value
            for difference in _differences(name, head.get(name), value)
        ]
        if differences:
            raise UserError(
                f"{self.checkpoint} is that of another training, with {', '.join(differences)}: "
                f"resume it with what it had, delete {self.folder}, or choose another folder"
            )
        return head

    def save(self, model: BaseAlgorithm) -> None:
        """Evaluate the policy and write the checkpoint."""
        network, card = self._policy(model)
        scores = evaluate_policy(network, card, EVALUATION_EPISODES)
        self.curve.append({"steps": model.num_timesteps, **self._times(), **scores})
        if self.tensorboard is not None:
            for name, value in scores.items():
                model.logger.record(f"evaluation/{name}", value)
            model.logger.dump(model.num_timesteps)
        head = {**self._identity(), **self._times(), "curve": self.curve}
        save_checkpoint(model, head, self.checkpoint)
        self.report(TrainingProgress(model.num_timesteps, self.total_steps, self.curve[-1]))

    def begin_leg(self, model: BaseAlgorithm) -> None:
        """Reset the environments and seed everything random from the seed and the step count."""
        leg = model.num_timesteps // self.steps_per_leg
        seed = int(np.random.SeedSequence([self.seed, leg]).generate_state(1)[0])
        env = _env_of(model)
        model.set_random_seed(seed)
        model._last_obs = env.reset()  # type: ignore[assignment]
        model._last_episode_starts = np.ones(env.num_envs, dtype=bool)
        buffer = getattr(model, "replay_buffer", None)
        if isinstance(buffer, HerReplayBuffer):  # it finds goals in episodes, and new ones begin
            buffer._current_ep_start[:] = buffer.pos

    def _prepare(self, resume: bool) -> dict[str, Any] | None:
        """Check the folder; return the head of its checkpoint, None if there is none."""
        check_folder(self.folder, "out")
        for file in (self.checkpoint, *self.policy_files):
            if file.exists() and not resume:
                hint = "resume it, or " if file == self.checkpoint else ""
                raise FileExistsError(
                    f"{file} exists already: {hint}choose another folder, or delete it"
                )
        return self.read_checkpoint_head() if self.checkpoint.exists() else None

    def _identity(self) -> dict[str, Any]:
        """Return what must be equal for a checkpoint to belong to this training."""
        return {
            "name": self.recipe.name,
            "env_id": self.recipe.env_id,
            "seed": self.seed,
            "evaluations": self.evaluations,
            "device": self.device,
            "hyperparameters": self.recipe.hyperparameters,
            "versions": library_versions(),
        }

    def _times(self) -> dict[str, float]:
        return {name: round(now - self._started[name], 1) for name, now in _now().items()}

    def _policy(self, model: BaseAlgorithm) -> tuple[PolicyNetwork, PolicyCard]:
        """Return the policy as it is now, with a card that has no scores yet."""
        network, view = export_policy(model.policy)
        residual = unwrap_vec_wrapper(_env_of(model), Residual)
        memory = unwrap_vec_wrapper(_env_of(model), Memory)
        card = PolicyCard(
            name=self.recipe.name,
            algorithm=self.recipe.algorithm,
            env_id=self.recipe.env_id,
            control=self.interface.control,
            segment_count=len(self.interface.segment_lengths),
            view=view,
            activation=network.activation,
            distribution=network.distribution,
            base_agent="" if residual is None else residual.base_agent,
            hyperparameters=self.recipe.hyperparameters,
            seed=self.seed,
            training_steps=model.num_timesteps,
            training_seconds=0.0,
            training_cpu_seconds=0.0,
            versions=library_versions(),
            scores={},
            learning_curve=[],
            engine=read_attribute(self._world, "engine"),
            body=read_attribute(self._world, "unperturbed"),
            blocks=() if memory is None else memory.blocks,
        )
        return network, card


def train(
    name: str | Path,
    *,
    env: str | None = None,
    seed: int = 0,
    steps: int | None = None,
    out: Path | str | None = None,
    resume: bool = False,
    tensorboard: Path | str | None = None,
    device: str = "cpu",
    env_kwargs: Mapping[str, Any] | None = None,
    on_progress: Callable[[TrainingProgress], None] = lambda progress: None,
) -> PolicyAgent:
    """Train an agent, as `mmc-gym train` does.

    Args:
        name: of hyperparameters that ship, such as "ppo"; or the path of your own YAML file.
        env: id of an environment, of those in the file; the first if None.
        seed: of everything random.
        steps: environment steps, in place of those in the file.
        out: folder for checkpoint and policy; None writes none, and `agent.save` does later.
        resume: whether to go on from the checkpoint in the folder.
        tensorboard: folder for TensorBoard's logs.
        device: that torch computes on.
        env_kwargs: arguments of the environment, beside those in the file.
        on_progress: called after every rollout and every evaluation.

    Returns:
        The trained agent, with its `card`; it acts without torch.

    Raises:
        FileExistsError: if the folder holds a training, and `resume` is not set.
        UserError: if an argument is not accepted.
    """
    recipe = read_recipe(str(name), env, steps, env_kwargs)
    logs = None if tensorboard is None else Path(tensorboard)
    with tempfile.TemporaryDirectory() as nowhere:
        training = Training(
            recipe, seed, Path(out or nowhere), on_progress, device=device, tensorboard=logs
        )
        training.run(resume)
        return PolicyAgent(*load_policy(training.policy_files[0]), training.interface)


def _now() -> dict[str, float]:
    return {"seconds": time.perf_counter(), "cpu_seconds": time.process_time()}


def _env_of(model: BaseAlgorithm) -> VecEnv:
    return cast(VecEnv, model.get_env())


class _Legs(BaseCallback):
    """A checkpoint and a fresh start between one leg and the next."""

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
    """Return the native vector environment of `count` arms, for stable-baselines3.

    Raises:
        UserError: if it is no reaching environment, or does not take the arguments.
    """
    try:
        env = gym.make_vec(env_id, count, autoreset_mode="SameStep", **arguments)
    except TypeError as error:
        raise UserError(
            f"env must be a reaching environment that takes {arguments}, got {env_id}: {error}"
        ) from error
    return GymnasiumVecEnv(env)


def usable_device(name: str) -> str:
    """Return the name of a device that torch can use here; "auto" for the best one.

    Raises:
        UserError: if torch has no such device here.
    """
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


def _differences(name: str, there: Any, here: Any) -> Iterator[str]:
    """Say what an entry of a checkpoint's head differs in."""
    if isinstance(there, dict) and isinstance(here, dict):
        for key in sorted({*there, *here}):
            if there.get(key) != here.get(key):
                hint = ", see --steps" if key == "n_timesteps" else ""
                yield f"{key} {there.get(key)} (here {here.get(key)}{hint})"
    else:
        yield f"{name} {there} (here {here})"


def library_versions() -> dict[str, str]:
    """Return the versions of what a trained policy depends on, for its card."""
    names = ("mmc-gym", "gymnasium", "numpy", "pymunk", "stable-baselines3", "sb3-contrib", "torch")
    return {"python": platform.python_version(), **{name: version(name) for name in names}}


def evaluate_policy(network: PolicyNetwork, card: PolicyCard, episodes: int) -> dict[str, float]:
    """Evaluate a policy in the environment that it is trained in, but always on pymunk."""
    given = card.hyperparameters.get("env_kwargs", {})
    arguments = {name: value for name, value in given.items() if name != "engine"}
    return evaluate(partial(PolicyAgent, network, card), card.env_id, arguments, episodes)
