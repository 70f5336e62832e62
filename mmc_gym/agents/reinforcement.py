"""Policies trained by reinforcement learning: kept as safetensors and JSON, run as agents.

A policy is two files.  NAME.safetensors holds the weights; NAME.json, its card, says what they
are weights of, how they were trained, and which weights they are (SHA-256).  Neither holds
code: what a card may name is looked up here, never imported or evaluated.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import safetensors.torch
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from safetensors import SafetensorError
from stable_baselines3.common.policies import ActorCriticPolicy

from mmc_gym._files import write_atomically
from mmc_gym.agents.base import Agent, Observation, ReachInterface

ACTIVATIONS: dict[str, type[torch.nn.Module]] = {"tanh": torch.nn.Tanh, "relu": torch.nn.ReLU}


@dataclass(frozen=True)
class PolicyCard:
    """What a trained policy is and how it came about.

    Attributes:
        algorithm: such as "ppo".
        env_id: the environment that it was trained in.
        control: the meaning of its actions.
        segment_count: joints of its arm.
        hidden_units: sizes of the hidden layers of policy and value function.
        activation: a key of `ACTIVATIONS`.
        hyperparameters: as in the YAML file.
        seed: of the training.
        training_steps: environment steps.
        training_seconds: wall time.
        versions: of the libraries.
        scores: of the evaluation after training.
        learning_curve: one row per evaluation during training.
        sha256: of the weights file.
    """

    algorithm: str
    env_id: str
    control: str
    segment_count: int
    hidden_units: list[int]
    activation: str
    hyperparameters: dict[str, Any]
    seed: int
    training_steps: int
    training_seconds: float
    versions: dict[str, str]
    scores: dict[str, float]
    learning_curve: list[dict[str, float]]
    sha256: str = ""


def make_policy(card: PolicyCard) -> ActorCriticPolicy:
    """An untrained policy of the card's shape, on the CPU.

    Raises:
        ValueError: if the card names an unknown activation.
    """
    if card.activation not in ACTIVATIONS:
        raise ValueError(f"activation must be one of {list(ACTIVATIONS)}, got {card.activation!r}")
    size = card.segment_count
    with torch.random.fork_rng():  # its first weights are drawn, and overwritten by a loaded one's
        return ActorCriticPolicy(
            spaces.Box(-1.0, 1.0, (3 * size + 4,), np.float32),
            spaces.Box(-1.0, 1.0, (size,), np.float32),
            lambda _: 0.0,
            net_arch=list(card.hidden_units),
            activation_fn=ACTIVATIONS[card.activation],
            use_sde=bool(card.hyperparameters.get("use_sde", False)),
        )


def save_policy(policy: ActorCriticPolicy, card: PolicyCard, folder: Path) -> None:
    """Write the policy's two files, named after its algorithm, into `folder`."""
    tensors = {name: tensor.contiguous() for name, tensor in policy.state_dict().items()}
    weights = safetensors.torch.save(tensors)
    description = {**asdict(card), "sha256": hashlib.sha256(weights).hexdigest()}
    write_atomically(folder / f"{card.algorithm}.safetensors", weights)
    write_atomically(folder / f"{card.algorithm}.json", json.dumps(description, indent=1) + "\n")


def load_policy(path: Path) -> tuple[ActorCriticPolicy, PolicyCard]:
    """Read a policy.

    Args:
        path: of either of its two files.

    Raises:
        FileNotFoundError: if one of them is missing.
        ValueError: if one is damaged, or they do not belong together.
    """
    text = path.with_suffix(".json").read_text()
    weights = path.with_suffix(".safetensors").read_bytes()
    try:
        values = json.loads(text)
        known = {field.name for field in fields(PolicyCard)}
        if not isinstance(values, dict) or set(values) != known:
            raise ValueError("its card has other entries than a policy's")
        card = PolicyCard(**values)
        if hashlib.sha256(weights).hexdigest() != card.sha256:
            raise ValueError("its weights are not those of its card")
        policy = make_policy(card)
        policy.load_state_dict(safetensors.torch.load(weights))
    except (ValueError, TypeError, RuntimeError, SafetensorError) as error:
        raise ValueError(f"{path.with_suffix('')} does not hold a policy: {error}") from error
    policy.set_training_mode(False)
    return policy, card


class PolicyAgent(Agent[None]):
    """A trained stable-baselines3 policy; it has no state."""

    def __init__(
        self, policy: ActorCriticPolicy, card: PolicyCard, interface: ReachInterface
    ) -> None:
        """Make an agent.

        A policy that gives joint deltas also acts in an environment with position control,
        where the same servo is handed the same joint target.

        Raises:
            ValueError: if the arm has another number of joints than the policy's, or the
                policy's actions have no meaning in the environment.
        """
        if card.segment_count != len(interface.segment_lengths):
            raise ValueError(
                f"env must have {card.segment_count} segments for this policy, "
                f"got {len(interface.segment_lengths)}"
            )
        same = card.control == interface.control
        if not same and (card.control, interface.control) != ("joint_delta", "joint_position"):
            raise ValueError(
                f"control must be {card.control!r} for this policy, got {interface.control!r}"
            )
        self.card = card
        self.training_steps = card.training_steps
        self._policy = policy
        self._interface = interface
        self._convert = not same

    @classmethod
    def shipped(cls, name: str, interface: ReachInterface) -> PolicyAgent:
        """The trained policy of that name that ships with the package."""
        folder = Path(str(files("mmc_gym.agents") / "pretrained"))
        return cls(*load_policy(folder / f"{name}.json"), interface)

    def predict(
        self,
        observation: Observation,
        state: None = None,
        episode_start: Sequence[bool] | NDArray[np.bool_] | None = None,
        deterministic: bool = False,
    ) -> tuple[NDArray[np.float32], None]:
        """See `Agent.predict`."""
        action, _ = self._policy.predict(observation, None, None, deterministic)  # type: ignore[arg-type]
        if self._convert:
            sensed = self._interface.sense(observation)
            ahead = self._interface.max_joint_delta * action
            action = self._interface.act(sensed.joint_angles + ahead, sensed)
        return action, None
