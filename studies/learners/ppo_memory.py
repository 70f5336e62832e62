"""Train `ppo-memory`: a policy with a memory learns to act like one that is given the truth.

A policy that has to identify noise, delays and its body from a memory learns slowly from rewards.
One that is given the truth learns fast, and can say in any state what it would do.  So a teacher
(actor and critic) that is given the truth first learns by PPO.  Then its student acts, and learns
from its memory to do what the teacher would do in the same state.  It minimizes weighted squared
errors on the states that the student itself visits (dataset aggregation with the latest rollout
only).

    python -m studies.learners.ppo_memory --seed 0 --out runs/ppo-memory-0   # 7 minutes
    python -m studies.learners.ppo_memory --seed 0 --steps 100000            # a short run

The three policies that ship were trained in this way, with the seeds 0 to 2.  An interrupted
training resumes with --resume.

Sources: Peng, Andrychowicz, Zaremba & Abbeel (2018), Sim-to-real transfer of robotic control with
dynamics randomization, ICRA, https://arxiv.org/abs/1710.06537 (a memory, random dynamics).  Ross,
Gordon & Bagnell (2011), A reduction of imitation learning and structured prediction to no-regret
online learning, AISTATS, https://arxiv.org/abs/1011.0686.  Lee, Hwangbo, Wellhausen, Koltun &
Hutter (2020), Learning quadrupedal locomotion over challenging terrain, Science Robotics 5:eabc5986
(a teacher that is given the truth, a student with a memory).
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias

import gymnasium as gym
import numpy as np
import torch
import tyro
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor, create_mlp
from stable_baselines3.common.type_aliases import PyTorchObs, Schedule
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper, unwrap_vec_wrapper
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs, VecEnvStepReturn
from typing_extensions import override

from mmc_gym import UserError
from mmc_gym.agents.policy_network import History, PolicyNetwork
from mmc_gym.envs.scenarios import Scenario
from mmc_gym.geometry import turned_back
from mmc_gym.interface import ObservationLayout, ReachInterface, relative_speeds
from mmc_gym.training.hyperparameters import Recipe, read_recipe
from mmc_gym.training.policies import export_network
from mmc_gym.training.training import Training, TrainingProgress
from studies.learners.random_scenarios import RandomScenarios

Float32 = NDArray[np.float32]
VectorEnv: TypeAlias = gym.vector.VectorEnv[Any, Any, Any]

HYPERPARAMETERS = Path(__file__).with_name("ppo-memory.yml")
HERE = "studies.learners.ppo_memory"
TARGET_JUMP = 0.1
"""A target that moves by more than this in a step has jumped, segment lengths."""
NOISE = 0.05
"""Standard deviation of a student's noise, so that it visits slightly more than its own states."""
CALM = 0.004
"""Mean square of actions at which an error counts half as much as at rest.  Errors of small actions
count more, because actions are small at the target, where success is decided."""


class Truth(gym.vector.VectorWrapper[Any, Any, Any]):
    """A vector of reaching environments whose observations are followed by the truth.

    The truth is

        the observation without noise and delay; the target's velocity, in the observation's frame;
        the cursor's turn (sine, cosine − 1); curl of the force field / 100, hand's mass / 10,
        gravity / 100; segment lengths − 1; which joints are locked now

    It does not include obstacles.
    """

    def __init__(self, env: VectorEnv) -> None:
        super().__init__(env)
        reaching: Any = env.unwrapped
        self._setup, self._arms = reaching.setup, reaching.arms
        count, body, turn = self._setup.joint_count, self._setup.body, self._setup.cursor
        angle = 0.0 if turn is None else np.radians(turn.degrees)
        curl = 0.0 if body.force_field is None else body.force_field[0][1]
        forces = curl / 100, body.hand_mass / 10, body.gravity[1] / 100
        lengths = np.array(body.segment_lengths) - 1
        self._body = np.array([np.sin(angle), np.cos(angle) - 1, *forces, *lengths])
        self._locks = np.isin(np.arange(count), body.lockable_joints)
        self._step = 0

    @override
    def reset(self, **arguments: Any) -> tuple[Any, dict[str, Any]]:
        observation, infos = self.env.reset(**arguments)
        self._targets, self._step = infos["target"], 0
        return self._with_truth(observation, infos), infos

    @override
    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        observation, *outcome, infos = self.env.step(actions)
        self._step += 1
        return self._with_truth(observation, infos), *outcome, infos

    def _with_truth(self, seen: Float32, infos: dict[str, Any]) -> Float32:
        setup, arms, targets = self._setup, self._arms, infos["target"]
        hands = infos.get("cursor", infos["end_effector"])
        speeds = relative_speeds(arms.joint_velocities, setup.given_body.speed_limit)
        true = setup.layout.encode(arms.joint_angles, speeds, hand=hands, target=targets)
        moved, self._targets = targets - self._targets, targets
        moved[np.abs(moved).max(axis=-1) > TARGET_JUMP] = 0.0
        count = setup.joint_count
        x, y = moved.T / setup.given_body.control_step
        velocity = turned_back(x, y, true[:, 0], true[:, count])
        locked = self._locks & (setup.lock_step is not None and self._step >= setup.lock_step)
        body = np.broadcast_to((*self._body, *locked), (len(true), len(self._body) + count))
        truth = (seen, true, np.stack(velocity, axis=-1), body)
        return np.concatenate(truth, axis=-1, dtype=np.float32)


def truth_size(joint_count: int) -> int:
    """Return the number of values that `Truth` adds."""
    return ObservationLayout(joint_count, 1.0).size + 2 + 2 + 3 + 2 * joint_count


def lengthened(space: spaces.Space[Any], count: int) -> spaces.Box:
    """Return the space of observations that are followed by `count` unbounded values."""
    assert isinstance(space, spaces.Box)
    unbounded = np.full(count, np.inf, np.float32)
    low, high = np.concatenate((space.low, -unbounded)), np.concatenate((space.high, unbounded))
    return spaces.Box(low, high, dtype=np.float32)


class TruthfulScenarios(RandomScenarios):
    """`RandomScenarios`, two at once at times, whose observations are followed by the `Truth`.

    With probability `twice` a second scenario is drawn and joined to the first, if its perturbation
    is of another kind and they do not both have a task.
    """

    def __init__(self, venv: VecEnv, twice: float = 0.0, **options: Any) -> None:
        self._twice = twice
        super().__init__(venv, **options)
        size = truth_size(venv.action_space.shape[0])  # type: ignore[index]
        self.observation_space = lengthened(venv.observation_space, size)

    @override
    def make_group(self, drawn: Scenario, share: float = 1.0) -> VectorEnv:
        return Truth(super().make_group(drawn, share))

    @override
    def draw_group(self, share: float) -> VectorEnv:
        while True:
            drawn = self.draw()
            try:
                return self.make_group(drawn, share)
            except UserError as error:
                if len(drawn.changes) < 2 and drawn.task.name == "random":
                    raise
                # The task cannot be done under these perturbations: draw another.
                warnings.warn(f"scenarios that do not go together: {error}", stacklevel=2)

    @override
    def draw(self) -> Scenario:
        first = super().draw()
        if self._random.random() >= self._twice:
            return first
        second = super().draw()
        kinds = {type(one.perturbation) for one in first.changes}
        fits = kinds.isdisjoint(type(one.perturbation) for one in second.changes)
        if second.task != "random" and first.task == "random":
            first, second = second, first
        if not fits or second.task != "random":
            return first
        return replace(first, changes=first.changes + second.changes)


class Memory(VecEnvWrapper):
    """A reaching environment whose observations are followed by a `History` in blocks.

    The truth, if there is any, comes after the history.
    """

    def __init__(self, venv: VecEnv, blocks: Sequence[int]) -> None:
        self.blocks = tuple(blocks)
        self._history = History(ReachInterface.of(venv).layout, self.blocks)
        super().__init__(venv, lengthened(venv.observation_space, self._history.size))

    @override
    def reset(self) -> VecEnvObs:
        observation = self.venv.reset()
        assert isinstance(observation, np.ndarray)
        self._memory = self._history.start(observation)
        return self._show(observation, self._memory)

    @override
    def step_async(self, actions: NDArray[Any]) -> None:
        done = np.asarray(actions, np.float32)
        self._memory = self._history.extended(self._now, done, self._memory)
        self.venv.step_async(actions)

    @override
    def step_wait(self) -> VecEnvStepReturn:
        observation, rewards, dones, infos = self.venv.step_wait()
        assert isinstance(observation, np.ndarray)
        if dones.any():
            ended = np.flatnonzero(dones)
            last = np.array([infos[index]["terminal_observation"] for index in ended])
            memory = self._memory[ended]
            endings = self._with_memory(last, self._history.observed(last, memory), memory)
            for index, ending in zip(ended, endings, strict=True):
                infos[index]["terminal_observation"] = ending
            self._memory[ended] = self._history.start(observation[ended])
        return self._show(observation, self._memory), rewards, dones, infos

    def _show(self, observation: Float32, memory: Float32) -> Float32:
        self._now = self._history.observed(observation, memory)
        return self._with_memory(observation, self._now, memory)

    def _with_memory(self, observation: Float32, now: Float32, memory: Float32) -> Float32:
        seen, more = np.split(observation, [self._history.layout.size], axis=-1)
        return np.concatenate((seen, self._history.recall(now, memory), more), -1)


class TruthLayer(BaseFeaturesExtractor):
    """Extract the truth, the last `size` values of an observation."""

    def __init__(self, observation_space: spaces.Box, size: int) -> None:
        super().__init__(observation_space, size)

    @override
    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        return observations[..., -self.features_dim :]


class TaughtPolicy(ActorCriticPolicy):
    """A teacher (actor and critic) that sees the truth, and a student that sees all other values.

    Observations end with the truth.  The hidden layers of the student are `net_arch`; those of the
    teacher's actor, and of its critic, are `teacher`.

    Attributes:
        student: the student's network; its last layer gives actions.
        inputs: number of values that the student sees; they come first.
        student_acts: whether the student or the teacher acts when actions are collected; `predict`
            always asks the student.
    """

    def __init__(
        self,
        observation_space: spaces.Box,
        action_space: spaces.Box,
        lr_schedule: Schedule,
        net_arch: Sequence[int] = (128, 128),
        teacher: Sequence[int] = (128, 128),
        **options: Any,
    ) -> None:
        size = truth_size(action_space.shape[0])
        self.inputs = observation_space.shape[0] - size
        self._student_layers = list(net_arch)
        self.student_acts = False
        options["features_extractor_class"] = TruthLayer
        options["features_extractor_kwargs"] = {"size": size}
        options["net_arch"] = list(teacher)
        super().__init__(observation_space, action_space, lr_schedule, **options)

    @override
    def _build(self, lr_schedule: Schedule) -> None:
        actions = int(np.prod(self.action_space.shape or ()))
        layers = create_mlp(self.inputs, actions, self._student_layers, self.activation_fn)
        self.student = torch.nn.Sequential(*layers)  # before the optimizer of all is made
        noise = torch.full((actions,), math.log(NOISE))
        self.student_log_std = torch.nn.Parameter(noise, requires_grad=False)
        super()._build(lr_schedule)

    def student_actions(self, obs: torch.Tensor) -> torch.Tensor:
        """Return the student's actions, not clipped."""
        actions: torch.Tensor = self.student(obs[..., : self.inputs])
        return actions

    def teacher_actions(self, obs: torch.Tensor) -> torch.Tensor:
        """Return the mean actions of the teacher, clipped."""
        truth = self.features_extractor(obs)
        means: torch.Tensor = self.action_net(self.mlp_extractor.forward_actor(truth))
        return means.clamp(-1.0, 1.0)

    @override
    def forward(
        self, obs: torch.Tensor, deterministic: bool = False
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        if not self.student_acts:
            return super().forward(obs, deterministic)
        actions = self.student_actions(obs)
        if not deterministic:
            actions = actions + NOISE * torch.randn_like(actions)
        unused = actions[:, :1]  # in place of values and probabilities, which only PPO needs
        return actions, unused, unused[:, 0]

    @override
    def _predict(self, observation: PyTorchObs, deterministic: bool = False) -> torch.Tensor:
        assert isinstance(observation, torch.Tensor)
        actions = self.student_actions(observation)
        return actions if deterministic else actions + NOISE * torch.randn_like(actions)


class TaughtPPO(PPO):
    """PPO for the teacher of a `TaughtPolicy`, then lessons for its student.

    The student acts and learns in the share `lessons` of the steps, at the end, and passes through
    a rollout `lesson_epochs` times, like PPO's `n_epochs`.  The schedule of the learning rate runs
    twice: for PPO, and then for the lessons.
    """

    policy: TaughtPolicy

    def __init__(
        self, *arguments: Any, lessons: float = 0.5, lesson_epochs: int = 2, **options: Any
    ) -> None:
        super().__init__(*arguments, **options)
        self.lessons, self.lesson_epochs = lessons, lesson_epochs

    @override
    def collect_rollouts(self, *arguments: Any, **options: Any) -> bool:
        passed = self.num_timesteps / self._total_timesteps
        self.policy.student_acts = passed >= 1.0 - self.lessons
        return super().collect_rollouts(*arguments, **options)

    @override
    def train(self) -> None:
        passed, first = self.num_timesteps / self._total_timesteps, 1.0 - self.lessons
        if self.policy.student_acts:
            self._current_progress_remaining = (1.0 - passed) / self.lessons
            self._teach()
        else:
            self._current_progress_remaining = max(0.0, 1.0 - passed / first)
            super().train()

    def _teach(self) -> None:
        """Train the student to do what the teacher would have done in the student's states."""
        policy = self.policy
        self._update_learning_rate(policy.optimizer)
        buffer = self.rollout_buffer
        seen = buffer.observations.reshape(-1, buffer.obs_shape[0])
        observations = torch.as_tensor(seen, device=self.device)
        with torch.no_grad():
            right = policy.teacher_actions(observations)
        losses = []
        for _ in range(self.lesson_epochs):
            for batch in torch.split(torch.randperm(len(seen)), self.batch_size):
                wanted, actions = right[batch], policy.student_actions(observations[batch])
                # Actions are clipped to ±1, so one beyond a wanted bound is not wrong.
                beyond = (wanted * actions >= 1.0) & (wanted.abs() >= 1.0)
                errors = torch.where(beyond, 0.0, actions - wanted).square()
                loss = (errors / (CALM + wanted.square().mean(dim=-1, keepdim=True))).mean()
                policy.optimizer.zero_grad()
                loss.backward()  # type: ignore[no-untyped-call]
                policy.optimizer.step()
                losses.append(loss.item())
            self._n_updates += 1
        self.logger.record("train/lesson_loss", np.mean(losses))


class TaughtRecipe(Recipe):
    """A recipe for `TaughtPPO`."""

    algorithm_class = TaughtPPO


for kind in (TaughtPolicy, TruthfulScenarios, Memory):
    Recipe.classes[f"{HERE}.{kind.__name__}"] = kind


@dataclass
class TaughtTraining(Training):
    """The training of a `TaughtPolicy`; it keeps the student."""

    @override
    def export(self, model: BaseAlgorithm) -> tuple[PolicyNetwork, dict[str, Any]]:
        policy: Any = model.policy
        *hidden, mean = policy.student
        network = export_network(hidden, mean, policy.student_log_std, "gaussian")
        memory = unwrap_vec_wrapper(model.get_env(), Memory)  # type: ignore[arg-type]
        assert memory is not None
        return network, {"base_agent": "", "blocks": memory.blocks}


def taught_recipe(steps: int | None = None, **changes: Any) -> Recipe:
    """Return the recipe of `ppo-memory`, with changed hyperparameters if any are given."""
    recipe = read_recipe(str(HYPERPARAMETERS), steps=steps).with_changes(**changes)
    return TaughtRecipe(recipe.name, recipe.env_id, recipe.hyperparameters)


def main(
    seed: int = 0, steps: int | None = None, out: Path | None = None, resume: bool = False
) -> None:
    """Train `ppo-memory`.

    Args:
        seed: Seed of everything random.
        steps: Environment steps (default: 12 million, as in ppo-memory.yml).
        out: Folder for checkpoint and policy (default: runs/ppo-memory-SEED).
        resume: Continue from the checkpoint in the folder, if there is one.
    """
    folder = out or Path(f"runs/ppo-memory-{seed}")

    def report(progress: TrainingProgress) -> None:
        if scores := progress.evaluation:
            print(f"{progress.steps:>12,} steps  success {scores['success']:6.1%}", flush=True)

    card = TaughtTraining(taught_recipe(steps), seed, folder, report).run(resume)
    print(f"{folder / card.file_stem}.safetensors: success {card.scores['success']:.1%}")


if __name__ == "__main__":
    tyro.cli(main)
