"""The learned rivals as their actors alone: safetensors in half precision, played by numpy."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import safetensors.numpy

from mmc_gym.agents.policy_network import PolicyNetwork

FOLDER = Path(__file__).parent / "actors"


def save_actor(model: Any, file: Path) -> None:
    """Write the actor of an SAC or TQC of stable-baselines3, with what it is from."""
    import torch

    from mmc_gym.training.policies import export_network

    actor = model.policy.actor
    spread = torch.zeros_like(actor.mu.bias)  # it acts deterministically
    network = export_network(actor.latent_pi, actor.mu, spread, "squashed")
    halves = {name: tensor.astype(np.float16) for name, tensor in network.tensors.items()}
    facts = {"algorithm": type(model).__name__, "steps": model.num_timesteps, "seed": model.seed}
    card = {name: str(fact) for name, fact in facts.items()}
    file.parent.mkdir(parents=True, exist_ok=True)
    safetensors.numpy.save_file(halves, file, metadata=card)


class Actor:
    """Acts as the model did, to the rounding of its weights."""

    def __init__(self, file: Path) -> None:
        tensors = safetensors.numpy.load_file(file)
        whole = {name: tensor.astype(np.float32) for name, tensor in tensors.items()}
        self.network = PolicyNetwork(whole, "relu", "squashed")

    def predict(self, observation: Any, state: Any = None, **_: Any) -> tuple[Any, None]:
        """Return the action."""
        if isinstance(observation, Mapping):  # of the Panda; it was trained without encoders
            names = ("achieved_goal", "desired_goal", "observation")
            observation = np.concatenate([observation[name] for name in names], axis=-1)
        return self.network.act(np.asarray(observation, np.float32)), None
