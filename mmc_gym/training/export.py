"""Out of a policy of stable-baselines3 or sb3-contrib, the plain network that acts as it does."""

from __future__ import annotations

from typing import Any

import torch
from stable_baselines3.common.policies import ActorCriticPolicy, BasePolicy

from mmc_gym.agents.policy_network import Activation, Distribution, Float32, PolicyNetwork
from mmc_gym.agents.views import View
from mmc_gym.training.policies import ACTIVATIONS, ViewLayer


def export_policy(policy: BasePolicy) -> tuple[PolicyNetwork, View]:
    """The network of a policy that PPO, SAC or TQC trains, and what it sees.

    Its weights are copies.

    Raises:
        ValueError: if the policy has another kind of layers, or none of our views.
    """
    parts: dict[str, Any]
    distribution: Distribution
    if isinstance(policy, ActorCriticPolicy):
        layer, hidden = policy.features_extractor, policy.mlp_extractor.policy_net
        parts = {"mean": policy.action_net, "log_std": policy.log_std}
        distribution = "gaussian"
    else:
        actor: Any = policy.actor
        layer, hidden = actor.features_extractor, actor.latent_pi
        parts = {"mean": actor.mu, "log_std": actor.log_std}
        distribution = "squashed"
    if not isinstance(layer, ViewLayer):
        raise ValueError(f"policy must have one of the views here, got {layer}")
    linear = [part for part in hidden if isinstance(part, torch.nn.Linear)]
    kinds = {type(part) for part in hidden} - {torch.nn.Linear}
    parts |= {f"hidden.{index}": part for index, part in enumerate(linear)}
    tensors: dict[str, Float32] = {}
    for name, part in parts.items():
        if isinstance(part, torch.nn.Linear):
            tensors |= {f"{name}.weight": _array(part.weight), f"{name}.bias": _array(part.bias)}
        elif isinstance(part, torch.nn.Parameter):
            tensors[name] = _array(part)
        else:
            raise ValueError(f"policy must have linear layers, got {part} for {name}")
    return PolicyNetwork(tensors, _activation(kinds), distribution), layer.view


def _activation(kinds: set[type]) -> Activation:
    for name, kind in ACTIVATIONS.items():
        if kinds == {kind}:
            return name
    raise ValueError(f"policy must have one of {list(ACTIVATIONS)} between its layers, got {kinds}")


def _array(parameter: torch.Tensor) -> Float32:
    array: Float32 = parameter.detach().cpu().numpy().copy()
    return array
