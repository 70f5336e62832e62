"""Policies trained by reinforcement learning: saved as safetensors and JSON, run as agents.

A policy is two files.  NAME-SEED.safetensors holds the weights.  NAME-SEED.json, its card,
describes the network and its training, and has the SHA-256 of the weights and of itself, which are
checked when it is read.  Neither holds code: names on a card are looked up here, never imported or
evaluated.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple, Self

import gymnasium as gym
import numpy as np
import safetensors.numpy
from annotated_types import Ge, Gt, Lt
from numpy.typing import NDArray
from pydantic import ConfigDict, Field, TypeAdapter, ValidationError, model_validator
from pydantic.dataclasses import dataclass
from pydantic_core import from_json
from safetensors import SafetensorError
from typing_extensions import override

from mmc_gym._errors import UserError, explain
from mmc_gym._files import digest_of, write_atomically
from mmc_gym.agents.base import (
    Agent,
    Layouts,
    Started,
    check_no_state,
    require_plain,
    resumed,
    warn_of_another_arm,
)
from mmc_gym.agents.mmc import dynamic_mmc
from mmc_gym.agents.policy_network import Activation, Distribution, Float32, History, PolicyNetwork
from mmc_gym.body import ArmParameters
from mmc_gym.interface import (
    CannotActError,
    Control,
    ControlError,
    Observation,
    ReachInterface,
    read_attribute,
)

EVALUATION_EPISODES = 200  # of every evaluation during a training
FINAL_EPISODES = 500  # of the evaluation after a training; its scores are on the card
PRETRAINED = Path(str(files("mmc_gym.agents") / "pretrained"))
SUFFIXES = (".json", ".safetensors")  # of a policy's two files
_DIGEST = "card_sha256"  # the entry of a card with the SHA-256 of all the others
CURVE_COLUMNS = ("steps", "seconds", "cpu_seconds", "success")
"""Entries of every row of a learning curve."""


class Algorithm(NamedTuple):
    """An algorithm of stable-baselines3 or sb3-contrib."""

    path: str  #: "module:class"
    distribution: Distribution  #: of its policies' actions, see `PolicyNetwork`


ALGORITHMS = {
    "ppo": Algorithm("stable_baselines3:PPO", "gaussian"),
    "ppo_lstm": Algorithm("sb3_contrib:RecurrentPPO", "gaussian"),
    "a2c": Algorithm("stable_baselines3:A2C", "gaussian"),
    "trpo": Algorithm("sb3_contrib:TRPO", "gaussian"),
    "sac": Algorithm("stable_baselines3:SAC", "squashed"),
    "tqc": Algorithm("sb3_contrib:TQC", "squashed"),
    "crossq": Algorithm("sb3_contrib:CrossQ", "squashed"),
    "td3": Algorithm("stable_baselines3:TD3", "squashed"),
}
"""The algorithms by the names that rl_zoo3 gives them."""

Count = Annotated[int, Ge(0)]
Seconds = Annotated[float, Ge(0), Lt(math.inf)]
if TYPE_CHECKING:
    Row = dict[str, float]
else:
    Row = dict[str, int | float | None]  # whole numbers stay whole; None where there is no value


def file_stem(name: str, seed: int) -> str:
    """Return the name of a policy's files, without suffix: NAME-SEED."""
    return f"{name}-{seed}"


def shipped_file(name: str, seed: int) -> Path:
    """Return the path of the card of a policy that ships with the package."""
    return PRETRAINED / f"{file_stem(name, seed)}.json"


@dataclass(frozen=True, config=ConfigDict(extra="forbid", strict=True))
class PolicyCard:
    """The card of a trained policy: what it is, and how it was trained."""

    #: of the hyperparameters, such as "ppo"; part of the names of its files
    name: Annotated[str, Field(pattern=r"^[^./\\:\x00][^/\\:\x00]*$")]
    algorithm: str  #: a key of `ALGORITHMS`
    env_id: str  #: the environment that it was trained in
    control: Control  #: the control mode that its actions are of
    segment_count: Annotated[int, Gt(0)]
    view: Literal["arm"]  #: it sees observations as they are
    activation: Activation  #: see `PolicyNetwork`
    distribution: Distribution  #: see `PolicyNetwork`
    base_agent: str  #: a key of `BASE_AGENTS` whose actions the policy corrects; empty for none
    hyperparameters: dict[str, Any]  #: the entries of the YAML file
    seed: Count
    training_steps: Count  #: environment steps
    training_seconds: Seconds  #: wall time
    training_cpu_seconds: Seconds  #: time of all cores, of this process alone
    versions: dict[str, str]  #: of the libraries
    scores: Row  #: of the evaluation after training
    learning_curve: list[Row]  #: a row per evaluation during training, with `CURVE_COLUMNS`
    sha256: str = ""  #: of the weights file
    engine: str | None = None  #: the physics engine of its training; None if unknown
    body: ArmParameters | None = None  #: that of its training, without perturbations; or None
    #: steps in each block of its memory, see `History`; empty if it has none
    blocks: tuple[Annotated[int, Gt(0)], ...] = ()
    #: perturbations on the scale of whose ranges it observes the context; empty if it does not
    context: list[Any] = Field(default_factory=list)

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.base_agent not in ("", *BASE_AGENTS):
            raise ValueError(f"base_agent must be one of {list(BASE_AGENTS)} or empty")
        if self.algorithm not in ALGORITHMS:
            raise ValueError(f"algorithm must be one of {list(ALGORITHMS)}")
        if self.distribution != ALGORITHMS[self.algorithm].distribution:
            raise ValueError(f"distribution must be that of {self.algorithm!r}")
        if self.body is not None and len(self.body.segment_lengths) != self.segment_count:
            raise ValueError(f"body must have {self.segment_count} segments")
        for row in self.learning_curve:
            if any(row.get(name) is None for name in CURVE_COLUMNS):
                raise ValueError(f"learning_curve must have {CURVE_COLUMNS} in every row")
        return self

    @property
    def file_stem(self) -> str:
        """The name of its files, without suffix."""
        return file_stem(self.name, self.seed)


def save_policy(network: PolicyNetwork, card: PolicyCard, folder: Path) -> None:
    """Write the policy's two files, named after it and its seed, into `folder`."""
    weights = safetensors.numpy.save(network.tensors)
    entries = {**asdict(card), "sha256": hashlib.sha256(weights).hexdigest()}
    text = json.dumps({**entries, _DIGEST: digest_of(entries)}, indent=1) + "\n"
    write_atomically(folder / f"{card.file_stem}.safetensors", weights)
    write_atomically(folder / f"{card.file_stem}.json", text)


def load_policy(path: str | Path) -> tuple[PolicyNetwork, PolicyCard]:
    """Read a policy from the path of either of its files, which must be as they were written."""
    path = Path(path)
    text = path.with_suffix(".json").read_bytes()
    weights = path.with_suffix(".safetensors").read_bytes()
    try:
        entries = from_json(text)
        if not isinstance(entries, dict) or entries.pop(_DIGEST, "") != digest_of(entries):
            raise ValueError("its card is not as it was written, or is of an earlier version")
        card = TypeAdapter(PolicyCard).validate_json(json.dumps(entries))
        if hashlib.sha256(weights).hexdigest() != card.sha256:
            raise ValueError("its weights are not those of its card")
        tensors = safetensors.numpy.load(weights)
        network = PolicyNetwork(tensors, card.activation, card.distribution)
        if not all(np.isfinite(tensor).all() for tensor in tensors.values()):
            raise ValueError("its weights must be finite")
    except (ValueError, SafetensorError) as error:
        reason = f"its card: {explain(error)}" if isinstance(error, ValidationError) else error
        raise UserError(f"{path.with_suffix('')} does not hold a policy: {reason}") from error
    return network, card


class PolicyAgent(Agent[Any]):
    """A trained policy, alone or as the correction of another agent.

    The state is that of the other agent, or the policy's memory, (..., steps, 2 N + 4), or that of
    its LSTM, (..., 2, units); or None.
    """

    def __init__(
        self, network: PolicyNetwork, card: PolicyCard, interface: ReachInterface, seed: int = 0
    ) -> None:
        """Make an agent; `seed` is for its exploration, where it is not deterministic.

        A policy that gives joint deltas also acts under position control, where it hands the same
        joint targets to the same servo.

        Raises:
            CannotActError: if the arm has another number of joints than the policy's, or the
                policy's actions have no meaning in the environment.
        """
        layout, count = interface.layout, len(interface.segment_lengths)
        if card.segment_count != count:
            accepted = f"{card.segment_count} segments for this policy"
            raise CannotActError(f"env must have {accepted}, got {count}")
        if card.context and not layout.context_size:
            raise _needs_context(card)
        controls = (card.control, interface.control)
        self._gives_positions = controls == ("joint_delta", "joint_position")
        if card.control != interface.control and not self._gives_positions:
            raise ControlError(
                f"control must be {card.control!r} for this policy, got {interface.control!r}",
                card.control,
            )
        self._history = History(layout, card.blocks) if card.blocks else None
        inputs = layout.size + (count if card.base_agent else 0)
        inputs += self._history.size if self._history else 0
        inputs += layout.context_size if card.context else 0
        if network.input_size != inputs:
            raise UserError(f"network must take {inputs} features, got {network.input_size}")
        if network.memory_units and (card.base_agent or self._history):
            raise UserError("network must have no LSTM if it corrects an agent or has a history")
        self.card = card
        self.training_steps = card.training_steps
        self._network = network
        self._layouts: Layouts = {}
        self._interface = interface
        self._random = np.random.default_rng(seed)
        self._base = None
        if card.base_agent:
            self._base = BASE_AGENTS[card.base_agent](replace(interface, control=card.control))

    @override
    def __repr__(self) -> str:
        return f"{self.card.file_stem}: {super().__repr__()}"

    def save(self, folder: Path | str) -> Path:
        """Write the policy's two files, NAME-SEED, into `folder`; return the path of its card."""
        save_policy(self._network, self.card, Path(folder))
        return Path(folder) / f"{self.card.file_stem}.json"

    @override
    def predict(
        self,
        observation: Observation,
        state: Any = None,
        episode_start: Started = None,
        deterministic: bool = False,
    ) -> tuple[NDArray[np.float32], Any]:
        layout = self._interface.layout
        observation = layout.check(observation)
        seen = layout.flatten(observation).astype(np.float32, copy=False)
        if layout.context_size and not self.card.context:
            seen = seen[..., : layout.size]
        random = None if deterministic else self._random
        if self._history is not None:
            start = partial(self._history.start, observation)
            memory = resumed(state, start, seen.shape[:-1], episode_start, self._layouts)
            now = self._history.observed(observation, memory)
            recalled = self._history.recall(now, memory)
            action = self._network.act(np.concatenate((seen, recalled), axis=-1), random)
            state = self._history.extended(now, action, memory)
        elif self._base is not None:
            proposal, state = self._base.predict(observation, state, episode_start)
            seen = np.concatenate((seen, proposal), axis=-1)
            action = corrected(proposal, self._network.act(seen, random))
        elif units := self._network.memory_units:
            start = partial(np.zeros, (*seen.shape[:-1], 2, units), np.float32)
            memory = resumed(state, start, seen.shape[:-1], episode_start, self._layouts)
            action, state = self._network.act_from(memory, seen, random)
        else:
            check_no_state(state)
            action = self._network.act(seen, random)
        if self._gives_positions:
            action = self._as_positions(action, observation)
        return action, state

    def _as_positions(self, action: Float32, observation: Observation) -> Float32:
        sensed = self._interface.sense(observation)
        now = sensed.joint_angles
        ahead = now + self._interface.max_joint_delta * action
        return self._interface.act(self._interface.within_limits_from(now, ahead), sensed)


def make_policy(path: Path, env: gym.Env[Any, Any]) -> PolicyAgent:
    """Make the agent of a policy's file for an environment; warn of another arm than in training.

    Raises:
        CannotActError: as `PolicyAgent`, and if a wrapper changes observations or actions.
    """
    require_plain(env)
    network, card = load_policy(path)
    if card.context and read_attribute(env, "context_scale") != card.context:
        raise _needs_context(card)
    agent = PolicyAgent(network, card, ReachInterface.of(env))
    warn_of_another_arm(card.file_stem, card.body, env)
    return agent


def _needs_context(card: PolicyCard) -> CannotActError:
    return CannotActError(
        f"env must show the context as in the training of {card.file_stem}: make it with "
        f"observe_context={card.context}"
    )


def shipped_agent(interface: ReachInterface, name: str) -> PolicyAgent:
    """Make the agent of the training of seed 0 of a policy that ships."""
    return PolicyAgent(*load_policy(shipped_file(name, 0)), interface)


BASE_AGENTS: dict[str, Callable[[ReachInterface], Agent[Any]]] = {"mmc": dynamic_mmc}


def corrected(proposal: Float32, correction: Float32) -> Float32:
    """Return a base agent's action plus a policy's correction of it, within −1 and 1.

    Source: residual policy learning, Silver et al. (2018), https://arxiv.org/abs/1812.06298.
    """
    action: Float32 = np.clip(proposal + correction, -1.0, 1.0, dtype=np.float32)
    return action
