"""PPO of stable-baselines3 as an entry of the YAML file describes it.

The network may see the observation times fixed numbers, `input_scales`.  An observation has the
distance to the target divided by the largest there is, so that the last few hundredths, in which
success is decided, are all but invisible to it.  In the trained policy the numbers are multiplied
into the weights of the first layers: what is kept and run is a plain policy.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import gymnasium as gym
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.vec_env import VecEnv, VecNormalize

from mmc_gym.agents.reinforcement import ACTIVATIONS

# Entries of the YAML file that are not arguments of stable-baselines3's PPO by that name.
_NOT_PPO = {
    "n_timesteps",
    "policy",
    "n_envs",
    "learning_rate",
    "ent_coef",
    "policy_kwargs",
    "env_kwargs",
    "normalize_reward",
    "input_scales",
    "rollouts_per_leg",
}
_FIRST_LAYERS = ("mlp_extractor.policy_net.0.weight", "mlp_extractor.value_net.0.weight")


class ScaledInputs(BaseFeaturesExtractor):
    """What the network sees: the observation times fixed numbers."""

    def __init__(self, observation_space: gym.Space[Any], scales: Sequence[float]) -> None:
        """Make the layer; it has a scale for each number of an observation.

        Raises:
            ValueError: if there are more or fewer.
        """
        if observation_space.shape != (len(scales),):
            raise ValueError(
                f"input_scales must be as many as an observation of shape "
                f"{observation_space.shape} has, got {len(scales)}"
            )
        super().__init__(observation_space, len(scales))
        self._scales = torch.tensor(scales)

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """The observations, scaled."""
        return observations * self._scales


def make_model(hyperparameters: dict[str, Any], env: VecEnv, seed: int) -> PPO:
    """An untrained model with the hyperparameters, on the CPU."""
    h = hyperparameters
    if h.get("normalize_reward", False):
        env = VecNormalize(env, norm_obs=False, gamma=h["gamma"])
    policy = dict(h["policy_kwargs"])
    policy["activation_fn"] = ACTIVATIONS[policy["activation_fn"]]
    if "input_scales" in h:
        policy["features_extractor_class"] = ScaledInputs
        policy["features_extractor_kwargs"] = {"scales": [float(s) for s in h["input_scales"]]}
    options = {name: value for name, value in h.items() if name not in _NOT_PPO}
    return PPO(
        h["policy"],
        env,
        learning_rate=schedule(h["learning_rate"]),
        policy_kwargs=policy,
        seed=seed,
        device="cpu",
        **options,
    )


def plain_weights(model: PPO) -> dict[str, torch.Tensor]:
    """The weights of a policy that does without the scales what the model's does with them."""
    weights: dict[str, torch.Tensor] = dict(model.policy.state_dict())
    scaling = model.policy.features_extractor
    if isinstance(scaling, ScaledInputs):
        for name in _FIRST_LAYERS:
            weights[name] = weights[name] * scaling._scales
    return weights


def schedule(value: float | str) -> Callable[[float], float]:
    """Of the part of the training that remains: a constant, or "lin_X", from X down to 0."""
    if isinstance(value, str) and value.startswith("lin_"):
        start = float(value.removeprefix("lin_"))
        return lambda progress_remaining: start * progress_remaining
    constant = float(value)
    return lambda progress_remaining: constant
