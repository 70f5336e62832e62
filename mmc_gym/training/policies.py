"""Policies of stable-baselines3 and sb3-contrib, and as plain arrays.

Most are "MlpPolicy", as everyone else's.  Those that see through one of our `views` have full names
in YAML files, so that rl_zoo3 finds them too.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from gymnasium import spaces
from sb3_contrib.tqc.policies import TQCPolicy
from stable_baselines3.common.policies import ActorCriticPolicy, BasePolicy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor, FlattenExtractor
from stable_baselines3.common.type_aliases import PyTorchObs, Schedule
from typing_extensions import override

from mmc_gym.agents.policy_network import Activation, Distribution, Float32, PolicyNetwork
from mmc_gym.agents.views import View, feature_count, features, turned_actions
from mmc_gym.interface import ObservationLayout
from mmc_gym.training.taught import TaughtPolicy

ACTIVATIONS: dict[Activation, type[torch.nn.Module]] = {
    "relu": torch.nn.ReLU,
    "tanh": torch.nn.Tanh,
}


class ViewLayer(BaseFeaturesExtractor):
    """`features` as a layer without parameters."""

    def __init__(self, observation_space: spaces.Space[Any], view: View, joint_count: int) -> None:
        """Make the layer for the observations of an arm with `joint_count` joints.

        Raises:
            ValueError: if the observations are those of no such arm.
        """
        layout = ObservationLayout(joint_count, reach=1.0)  # features have no need of it
        additions = layout.additions(observation_space)
        super().__init__(observation_space, feature_count(view, layout) + additions)
        self.view: View = view
        self.layout = layout

    def forward(self, observations: torch.Tensor | Mapping[str, torch.Tensor]) -> torch.Tensor:
        """Return the features of observations, (batch, features)."""
        seen: torch.Tensor = features(torch, self.view, observations, self.layout)
        return seen


class _HasView(BasePolicy):
    """A policy with `view` before its first layer."""

    view: View = "arm"

    def __init__(
        self,
        observation_space: spaces.Space[Any],
        action_space: spaces.Box,
        lr_schedule: Schedule,
        **options: Any,
    ) -> None:
        """Make a policy with the options of its base class."""
        options["features_extractor_class"] = ViewLayer
        seen = {"view": self.view, "joint_count": action_space.shape[0]}
        options["features_extractor_kwargs"] = seen
        super().__init__(observation_space, action_space, lr_schedule, **options)


class PPOTargetPolicy(_HasView, ActorCriticPolicy):
    """`ActorCriticPolicy` with the target's view, for joint positions.

    Its distribution is over actions in this view.  They are turned as they go out, and turned back
    where their probability is asked for.
    """

    view = "target"

    @override
    def forward(
        self, obs: torch.Tensor, deterministic: bool = False
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        actions, values, log_probabilities = super().forward(obs, deterministic)
        return self._turned(actions, obs), values, log_probabilities

    @override
    def _predict(self, observation: PyTorchObs, deterministic: bool = False) -> torch.Tensor:
        return self._turned(super()._predict(observation, deterministic), observation)

    @override
    def evaluate_actions(
        self, obs: PyTorchObs, actions: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor | None]:
        return super().evaluate_actions(obs, self._turned(actions, obs, back=True))

    def _turned(
        self, actions: torch.Tensor, observation: PyTorchObs, back: bool = False
    ) -> torch.Tensor:
        layer: Any = self.features_extractor
        turned: torch.Tensor = turned_actions(torch, actions, observation, layer.layout, back=back)
        return turned


class TQCGoalPolicy(_HasView, TQCPolicy):
    """`TQCPolicy` that sees a goal environment as `MMCReach-v0` shows itself."""


POLICIES: dict[str, type[BasePolicy]] = {
    f"{policy.__module__}.{policy.__name__}": policy
    for policy in (PPOTargetPolicy, TQCGoalPolicy, TaughtPolicy)
}


def export_policy(policy: BasePolicy) -> tuple[PolicyNetwork, View]:
    """Return the network of a policy that PPO, SAC or TQC trains, and what it sees.

    The weights are copies.

    Raises:
        ValueError: if the policy has another kind of layers, or none of our views.
    """
    parts: dict[str, Any]
    layer: Any
    hidden: Any
    distribution: Distribution = "gaussian"
    if isinstance(policy, TaughtPolicy):
        *layers, mean = policy.student
        layer, hidden = FlattenExtractor(policy.observation_space), layers
        parts = {"mean": mean, "log_std": policy.student_log_std}
    elif isinstance(policy, ActorCriticPolicy):
        layer, hidden = policy.features_extractor, policy.mlp_extractor.policy_net
        parts = {"mean": policy.action_net, "log_std": policy.log_std}
    else:
        actor: Any = policy.actor
        layer, hidden = actor.features_extractor, actor.latent_pi
        parts = {"mean": actor.mu, "log_std": actor.log_std}
        distribution = "squashed"
    if not isinstance(layer, (FlattenExtractor, ViewLayer)):
        raise ValueError(f"policy must see the observation or one of our views, got {layer}")
    linear = [part for part in hidden if isinstance(part, torch.nn.Linear)]
    parts |= {f"hidden.{index}": part for index, part in enumerate(linear)}
    kinds = {type(part) for part in hidden} - {torch.nn.Linear}
    activation = next((name for name, kind in ACTIVATIONS.items() if kinds == {kind}), None)
    if activation is None:
        raise ValueError(f"policy must have one of {list(ACTIVATIONS)} between layers, got {kinds}")
    tensors: dict[str, Float32] = {}
    for name, part in parts.items():
        if isinstance(part, torch.nn.Linear):
            tensors |= {f"{name}.weight": _array(part.weight), f"{name}.bias": _array(part.bias)}
        elif isinstance(part, torch.nn.Parameter):
            tensors[name] = _array(part)
        else:
            kind = type(part).__name__
            raise ValueError(f"policy must have linear layers, got {kind} for {name}")
    view = layer.view if isinstance(layer, ViewLayer) else "arm"
    return PolicyNetwork(tensors, activation, distribution), view


def _array(parameter: torch.Tensor) -> Float32:
    array: Float32 = parameter.detach().cpu().numpy().copy()
    return array
