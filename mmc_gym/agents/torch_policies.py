"""Policies of stable-baselines3 and sb3-contrib that see the arm's frame (see `arm_frame`).

They are named by their full names in the YAML files, so that rl_zoo3 finds them too.  Their
layers are rectified linear, unless `policy_kwargs` says otherwise.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from gymnasium import spaces
from sb3_contrib.tqc import policies as tqc
from stable_baselines3.common.policies import ActorCriticPolicy, BasePolicy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.type_aliases import Schedule
from stable_baselines3.sac import policies as sac

from mmc_gym.agents.arm_frame import feature_count, in_arm_frame
from mmc_gym.agents.policy_network import Activation

ACTIVATIONS: dict[Activation, type[torch.nn.Module]] = {
    "relu": torch.nn.ReLU,
    "tanh": torch.nn.Tanh,
}


class ArmFrame(BaseFeaturesExtractor):
    """`in_arm_frame` as a layer without parameters."""

    def __init__(self, observation_space: spaces.Space[Any], joint_count: int) -> None:
        """Make the layer for the observations of an arm with `joint_count` joints.

        Raises:
            ValueError: if the observations are those of no such arm.
        """
        goals = getattr(observation_space, "spaces", None)  # of a goal environment
        posture: Any = goals["observation"] if goals else observation_space
        additions = posture.shape[0] - (3 * joint_count if goals else 3 * joint_count + 4)
        if additions < 0:
            raise ValueError(
                f"observation_space must be that of a reaching environment with {joint_count} "
                f"joints, got {observation_space}"
            )
        super().__init__(observation_space, feature_count(joint_count) + additions)
        self._joint_count = joint_count
        self._reach = float(goals["desired_goal"].high[0]) if goals else 1.0

    def forward(self, observations: torch.Tensor | Mapping[str, torch.Tensor]) -> torch.Tensor:
        """The features of observations, (batch, features)."""
        features: torch.Tensor = in_arm_frame(torch, observations, self._joint_count, self._reach)
        return features


class _SeesArmFrame(BasePolicy):
    """What the policies below have in common."""

    def __init__(
        self,
        observation_space: spaces.Space[Any],
        action_space: spaces.Box,
        lr_schedule: Schedule,
        **options: Any,
    ) -> None:
        """Make a policy; the options are those of the class that it extends.

        `activation_fn` may be a key of `ACTIVATIONS`, for YAML has no classes.
        """
        activation = options.get("activation_fn", "relu")
        options["activation_fn"] = ACTIVATIONS.get(activation, activation)
        options["features_extractor_class"] = ArmFrame
        options["features_extractor_kwargs"] = {"joint_count": action_space.shape[0]}
        super().__init__(observation_space, action_space, lr_schedule, **options)


class PPOPolicy(_SeesArmFrame, ActorCriticPolicy):
    """`ActorCriticPolicy` that sees the arm's frame."""


class SACPolicy(_SeesArmFrame, sac.SACPolicy):
    """`SACPolicy` that sees the arm's frame."""


class TQCPolicy(_SeesArmFrame, tqc.TQCPolicy):
    """`TQCPolicy` that sees the arm's frame."""


POLICIES: dict[str, type[BasePolicy]] = {
    f"{__name__}.{policy.__name__}": policy for policy in (PPOPolicy, SACPolicy, TQCPolicy)
}
