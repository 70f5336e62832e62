"""Teach a policy with a memory what one that is told the truth does.

A policy that must find out about noise, delays and its body from a memory learns slowly by its
rewards.  One that is told the truth does not, and can say at any moment what it would do.  So first
a teacher, actor and critic, learns by PPO what the truth is good for.  Then its student acts, and
learns to do, by its memory, what the teacher would do in its place: weighted least squares, on what
the student itself runs into (dataset aggregation; here only the latest of it is kept).

Literature: Ross, Gordon & Bagnell (2011), A reduction of imitation learning and structured
prediction to no-regret online learning, AISTATS, https://arxiv.org/abs/1011.0686.  Lee, Hwangbo,
Wellhausen, Koltun & Hutter (2020), Learning quadrupedal locomotion over challenging terrain,
Science Robotics 5:eabc5986 (a teacher that is told, a student with a memory).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3 import PPO
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor, create_mlp
from stable_baselines3.common.type_aliases import PyTorchObs, Schedule
from typing_extensions import override

from mmc_gym.training.randomised import truth_size

NOISE = 0.05
"""Standard deviation of a student's noise, so that it meets a little more than what it does."""
CALM = 0.004
"""Mean square of actions at which an error counts half as much as at rest: success is decided at
the target, where little is to be done."""


class TruthLayer(BaseFeaturesExtractor):
    """The truth, which an observation ends with."""

    def __init__(self, observation_space: spaces.Box, size: int) -> None:
        """Make the layer for the last `size` values."""
        super().__init__(observation_space, size)

    @override
    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        return observations[..., -self.features_dim :]


class TaughtPolicy(ActorCriticPolicy):
    """A teacher, actor and critic, that sees the truth, and a student that sees all else.

    Attributes:
        student: the student's network; its last layer gives actions.
        inputs: how many values the student sees, the first ones.
        student_acts: who acts when actions are collected; `predict` always asks the student.
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
        """Make a policy; further options are those of its base class.

        Args:
            observation_space: of observations that end with the truth.
            action_space: of joint actions.
            lr_schedule: learning rate.
            net_arch: the student's hidden layers.
            teacher: those of the teacher's actor, and of its critic.
            options: of the base class.
        """
        told = truth_size(action_space.shape[0])
        self.inputs = observation_space.shape[0] - told
        self._student_layers = list(net_arch)
        self.student_acts = False
        options["features_extractor_class"] = TruthLayer
        options["features_extractor_kwargs"] = {"size": told}
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

    def studied(self, obs: torch.Tensor) -> torch.Tensor:
        """Return the student's actions, not yet clipped."""
        actions: torch.Tensor = self.student(obs[..., : self.inputs])
        return actions

    def taught(self, obs: torch.Tensor) -> torch.Tensor:
        """Return the actions that the teacher means, clipped."""
        truth = self.features_extractor(obs)
        means: torch.Tensor = self.action_net(self.mlp_extractor.forward_actor(truth))
        return means.clamp(-1.0, 1.0)

    @override
    def forward(
        self, obs: torch.Tensor, deterministic: bool = False
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        if not self.student_acts:
            return super().forward(obs, deterministic)
        actions = self.studied(obs)
        if not deterministic:
            actions = actions + NOISE * torch.randn_like(actions)
        unused = actions[:, :1]  # values and probabilities, which only PPO asks for
        return actions, unused, unused[:, 0]

    @override
    def _predict(self, observation: PyTorchObs, deterministic: bool = False) -> torch.Tensor:
        assert isinstance(observation, torch.Tensor)
        actions = self.studied(observation)
        return actions if deterministic else actions + NOISE * torch.randn_like(actions)


class TaughtPPO(PPO):
    """PPO of the teacher of a `TaughtPolicy`, and then lessons of its student."""

    policy: TaughtPolicy

    def __init__(
        self, *arguments: Any, lessons: float = 0.5, lesson_epochs: int = 2, **options: Any
    ) -> None:
        """Make a model; further arguments are those of PPO.

        Args:
            arguments: policy and environment.
            lessons: share of the steps in which the student acts and learns; they come last.
            lesson_epochs: passes through what has been collected, as `n_epochs` is for PPO.
            options: of PPO.  The learning rate takes its course twice, for each of both.
        """
        super().__init__(*arguments, **options)
        self.lessons, self.lesson_epochs = lessons, lesson_epochs

    @override
    def collect_rollouts(self, *arguments: Any, **options: Any) -> bool:
        taught = self.num_timesteps / self._total_timesteps
        self.policy.student_acts = taught >= 1.0 - self.lessons
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
        """Let the student do what the teacher would have done where the student was."""
        policy = self.policy
        self._update_learning_rate(policy.optimizer)
        buffer = self.rollout_buffer
        seen = buffer.observations.reshape(-1, buffer.obs_shape[0])
        observations = torch.as_tensor(seen, device=self.device)
        with torch.no_grad():
            right = policy.taught(observations)
        losses = []
        for _ in range(self.lesson_epochs):
            for batch in torch.split(torch.randperm(len(seen)), self.batch_size):
                wanted, actions = right[batch], policy.studied(observations[batch])
                # What is asked for beyond the bounds is clipped to them, and right.
                beyond = (wanted * actions >= 1.0) & (wanted.abs() >= 1.0)
                errors = torch.where(beyond, 0.0, actions - wanted).square()
                loss = (errors / (CALM + wanted.square().mean(dim=-1, keepdim=True))).mean()
                policy.optimizer.zero_grad()
                loss.backward()  # type: ignore[no-untyped-call]
                policy.optimizer.step()
                losses.append(loss.item())
            self._n_updates += 1
        self.logger.record("train/lesson_loss", np.mean(losses))
