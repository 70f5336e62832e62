"""Policies trained by reinforcement learning: kept as safetensors and JSON, run as agents.

A policy is two files.  NAME.safetensors holds the weights; NAME.json, its card, says what they
are weights of, how they were trained, and which weights they are (SHA-256).  Neither holds
code: what a card may name is looked up here, never imported or evaluated.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields, replace
from importlib.resources import files
from pathlib import Path
from typing import Any, get_args

import numpy as np
import safetensors.numpy
from numpy.typing import NDArray
from safetensors import SafetensorError

from mmc_gym._files import write_atomically
from mmc_gym.agents.base import Agent
from mmc_gym.agents.mmc import dynamic_mmc
from mmc_gym.agents.policy_network import Activation, Distribution, Float32, PolicyNetwork
from mmc_gym.agents.views import View, feature_count, features, turned_actions
from mmc_gym.interface import CONTROLS, ControlError, Observation, ReachInterface
from mmc_gym.network import EuclideanNormalizer

EVALUATION_EPISODES = 200  # of every evaluation during a training
FINAL_EPISODES = 500  # of the one after it, whose scores stand on the card
PRETRAINED = Path(str(files("mmc_gym.agents") / "pretrained"))


@dataclass(frozen=True)
class PolicyCard:
    """What a trained policy is and how it came about.

    Attributes:
        name: of the hyperparameters, such as "ppo".
        algorithm: "ppo", "sac" or "tqc".
        env_id: the environment that it was trained in.
        control: the meaning of its actions.
        segment_count: joints of its arm.
        view: what it sees, see `views`.
        activation: of the network, see `PolicyNetwork`.
        distribution: of its actions, see `PolicyNetwork`.
        base_agent: a key of `BASE_AGENTS` whose actions the policy corrects; empty for none.
        hyperparameters: as in the YAML file.
        seed: of the training.
        training_steps: environment steps.
        training_seconds: wall time.
        training_cpu_seconds: time of all cores, of this process alone.
        versions: of the libraries.
        scores: of the evaluation after training.
        learning_curve: one row per evaluation during training.
        sha256: of the weights file.
    """

    name: str
    algorithm: str
    env_id: str
    control: str
    segment_count: int
    view: View
    activation: Activation
    distribution: Distribution
    base_agent: str
    hyperparameters: dict[str, Any]
    seed: int
    training_steps: int
    training_seconds: float
    training_cpu_seconds: float
    versions: dict[str, str]
    scores: dict[str, float]
    learning_curve: list[dict[str, float]]
    sha256: str = ""

    @property
    def file_stem(self) -> str:
        """The name of its files, without suffix."""
        return f"{self.name}-{self.seed}"


def policy_files(network: PolicyNetwork, card: PolicyCard) -> dict[str, bytes]:
    """The contents of a policy's two files by their names."""
    weights = safetensors.numpy.save(dict(network.tensors))
    description = {**asdict(card), "sha256": hashlib.sha256(weights).hexdigest()}
    return {
        f"{card.file_stem}.safetensors": weights,
        f"{card.file_stem}.json": (json.dumps(description, indent=1) + "\n").encode(),
    }


def save_policy(network: PolicyNetwork, card: PolicyCard, folder: Path) -> None:
    """Write the policy's two files, named after it and its seed, into `folder`."""
    for name, content in policy_files(network, card).items():
        write_atomically(folder / name, content)


def load_policy(path: str | Path) -> tuple[PolicyNetwork, PolicyCard]:
    """Read a policy.

    Args:
        path: of either of its two files.

    Raises:
        FileNotFoundError: if one of them is missing.
        ValueError: if one is damaged, or they do not belong together; for a folder, too.
    """
    path = Path(path)
    if path.suffix not in (".json", ".safetensors"):
        raise ValueError(
            "path must be that of a policy's file, NAME.json or NAME.safetensors, "
            f"got {str(path)!r}"
        )
    text = path.with_suffix(".json").read_bytes()
    weights = path.with_suffix(".safetensors").read_bytes()
    try:
        values = json.loads(text)
        known = {field.name for field in fields(PolicyCard)}
        if not isinstance(values, dict) or set(values) != known:
            raise ValueError("its card has other entries than a policy's")
        card = PolicyCard(**values)
        _check_card(card)
        if hashlib.sha256(weights).hexdigest() != card.sha256:
            raise ValueError("its weights are not those of its card")
        tensors = safetensors.numpy.load(weights)
        network = PolicyNetwork(tensors, card.activation, card.distribution)
        if not all(np.isfinite(tensor).all() for tensor in tensors.values()):
            raise ValueError("its weights must be finite")
        if network.action_size != card.segment_count:
            raise ValueError(
                f"its card says {card.segment_count} joints, its weights {network.action_size}"
            )
    except (ValueError, TypeError, RecursionError, SafetensorError) as error:
        raise ValueError(f"{path.with_suffix('')} does not hold a policy: {error}") from error
    return network, card


def _check_card(card: PolicyCard) -> None:
    """Raise a `ValueError` if an entry of a card is of another type or range than it must be."""

    def is_number(value: object) -> bool:
        return isinstance(value, (int, float)) and not isinstance(value, bool)

    def is_whole(value: object) -> bool:
        return isinstance(value, int) and not isinstance(value, bool)

    def is_row(value: object) -> bool:
        """Of measures; one without a value may be None."""
        return isinstance(value, dict) and all(
            one is None or is_number(one) for one in value.values()
        )

    squashed = card.algorithm != "ppo"
    rules: dict[str, tuple[bool, str]] = {
        **{
            name: (isinstance(getattr(card, name), str), "a text")
            for name in ("name", "env_id", "sha256")
        },
        **{
            name: (isinstance(value, str) and value in accepted, f"one of {accepted}")
            for name, value, accepted in (
                ("algorithm", card.algorithm, ("ppo", "sac", "tqc")),
                ("control", card.control, CONTROLS),
                ("view", card.view, get_args(View)),
                ("activation", card.activation, get_args(Activation)),
                ("base_agent", card.base_agent, ("", *BASE_AGENTS)),
            )
        },
        "segment_count": (is_whole(card.segment_count) and card.segment_count > 0, "a number > 0"),
        "hyperparameters": (isinstance(card.hyperparameters, dict), "a table"),
        "seed": (is_whole(card.seed) and card.seed >= 0, "a whole number >= 0"),
        "versions": (isinstance(card.versions, dict), "a table"),
        "scores": (is_row(card.scores), "a table of numbers"),
        "learning_curve": (
            isinstance(card.learning_curve, list) and all(map(is_row, card.learning_curve)),
            "tables of numbers",
        ),
        "distribution": (
            card.distribution == ("squashed" if squashed else "gaussian"),
            f"that of {card.algorithm!r}",
        ),
        "training_steps": (
            is_whole(card.training_steps) and card.training_steps >= 0,
            "a whole number >= 0",
        ),
        **{
            name: (is_number(value) and 0 <= value < math.inf, "a number >= 0")
            for name, value in (
                ("training_seconds", card.training_seconds),
                ("training_cpu_seconds", card.training_cpu_seconds),
            )
        },
    }
    for name, (fine, accepted) in rules.items():
        if not fine:
            raise ValueError(f"{name} must be {accepted}, got {getattr(card, name)!r}")


class PolicyAgent(Agent[Any]):
    """A trained policy, alone or as the correction of another agent; the state is the other's."""

    def __init__(
        self, network: PolicyNetwork, card: PolicyCard, interface: ReachInterface, seed: int = 0
    ) -> None:
        """Make an agent.

        A policy that gives joint deltas also acts in an environment with position control,
        where the same servo is handed the same joint target.

        Args:
            network: the policy.
            card: what it is.
            interface: of the environment to act in.
            seed: of its exploration, when it is asked for actions that are not deterministic.

        Raises:
            ValueError: if the arm has another number of joints than the policy's, or the
                policy's actions have no meaning in the environment.
        """
        count = len(interface.segment_lengths)
        if card.segment_count != count:
            raise ValueError(
                f"env must have {card.segment_count} segments for this policy, got {count}"
            )
        same = card.control == interface.control
        if not same and (card.control, interface.control) != ("joint_delta", "joint_position"):
            raise ControlError(
                f"control must be {card.control!r} for this policy, got {interface.control!r}",
                card.control,
            )
        if card.base_agent and card.base_agent not in BASE_AGENTS:
            raise ValueError(
                f"base_agent must be one of {list(BASE_AGENTS)}, got {card.base_agent!r}"
            )
        if card.view == "target" and (card.control != "joint_position" or card.base_agent):
            raise ValueError(
                "view 'target' is for policies that act alone, by joint positions, got control "
                f"{card.control!r} and base_agent {card.base_agent!r}"
            )
        inputs = feature_count(card.view, interface.layout) + (count if card.base_agent else 0)
        if network.input_size != inputs:
            raise ValueError(f"network must take {inputs} features, got {network.input_size}")
        self.card = card
        self.training_steps = card.training_steps
        self._network = network
        self._interface = interface
        self._convert = not same
        self._random = np.random.default_rng(seed)
        self._layout, self._shape = interface.layout, (interface.layout.size,)
        self._base = None
        if card.base_agent:
            self._base = BASE_AGENTS[card.base_agent](replace(interface, control=card.control))

    @classmethod
    def shipped(cls, name: str, seed: int, interface: ReachInterface) -> PolicyAgent:
        """The trained policy of that name and training seed that ships with the package."""
        return cls(*load_policy(PRETRAINED / f"{name}-{seed}.json"), interface)

    def predict(
        self,
        observation: Observation,
        state: Any = None,
        episode_start: Sequence[bool] | NDArray[np.bool_] | None = None,
        deterministic: bool = False,
    ) -> tuple[NDArray[np.float32], Any]:
        """See `Agent.predict`."""
        if not isinstance(observation, np.ndarray) or observation.shape[-1:] != self._shape:
            observation = self._interface.checked(observation)
        seen = features(np, self.card.view, observation, self._layout)
        seen = seen.astype(np.float32, copy=False)
        random = None if deterministic else self._random
        if self._base is None:
            action = self._network.act(seen, random)
            if self.card.view == "target":
                action = turned_actions(np, action, observation, self._layout)
                action = action.astype(np.float32, copy=False)  # goals are float64
        else:
            proposal, state = self._base.predict(observation, state, episode_start)
            seen = np.concatenate((seen, proposal), axis=-1)
            action = corrected(proposal, self._network.act(seen, random))
        if self._convert:
            sensed = self._interface.sense(observation)
            ahead = self._interface.max_joint_delta * action
            joint_targets = self._interface.within_limits_from(
                sensed.joint_angles, sensed.joint_angles + ahead
            )
            action = self._interface.act(joint_targets, sensed)
        return action, state


BASE_AGENTS: dict[str, Callable[[ReachInterface], Agent[Any]]] = {
    "mmc": lambda interface: dynamic_mmc(interface, EuclideanNormalizer()),
}


def corrected(proposal: Float32, correction: Float32) -> Float32:
    """A base agent's action, and a policy's correction of it, both within −1 and 1, added.

    Source: residual policy learning, Silver et al. (2018), https://arxiv.org/abs/1812.06298.
    """
    action: Float32 = np.clip(proposal + correction, -1.0, 1.0, dtype=np.float32)
    return action
