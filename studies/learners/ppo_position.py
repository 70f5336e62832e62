"""Define `ppo-position`, a policy whose actions are joint angles.

    python -m studies.learners.train_all --names ppo-position --seeds 1

Joint angles mean a direction, so the policy sees the world as if the target lay straight ahead, and
its actions are turned back (`mmc_gym.agents.policy_network`).  The three policies that ship were
trained in this way, with the seeds 0 to 2.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch
from gymnasium import spaces
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.type_aliases import PyTorchObs, Schedule
from typing_extensions import override

from mmc_gym.agents.policy_network import turned_actions
from mmc_gym.training.hyperparameters import Recipe
from mmc_gym.training.policies import ViewLayer

HYPERPARAMETERS = Path(__file__).with_name("ppo-position.yml")


class PPOTargetPolicy(ActorCriticPolicy):
    """`ActorCriticPolicy` with the target's view, for joint positions.

    Its distribution is over actions in this view.  They leave the policy turned into the world's
    frame, and are turned back to compute their probability.
    """

    def __init__(
        self,
        observation_space: spaces.Space[Any],
        action_space: spaces.Box,
        lr_schedule: Schedule,
        **options: Any,
    ) -> None:
        seen = {"view": "target", "joint_count": action_space.shape[0]}
        options |= {"features_extractor_class": ViewLayer, "features_extractor_kwargs": seen}
        super().__init__(observation_space, action_space, lr_schedule, **options)

    @override
    def forward(
        self, obs: torch.Tensor, deterministic: bool = False
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        actions, values, log_probabilities = super().forward(obs, deterministic)
        return self._turned(actions, obs), values, log_probabilities

    @override
    def _predict(self, observation: PyTorchObs, deterministic: bool = False) -> Any:
        return self._turned(super()._predict(observation, deterministic), observation)

    @override
    def evaluate_actions(
        self, obs: PyTorchObs, actions: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor | None]:
        return super().evaluate_actions(obs, self._turned(actions, obs, back=True))

    def _turned(self, actions: torch.Tensor, observation: PyTorchObs, back: bool = False) -> Any:
        layer: Any = self.features_extractor
        return turned_actions(torch, actions, observation, layer.layout, back=back)


Recipe.classes["studies.learners.ppo_position.PPOTargetPolicy"] = PPOTargetPolicy
