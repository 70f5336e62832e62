"""Who takes part in the benchmark: agents by name, with all their training seeds, and others.

Names are "mmc" for an agent of this package; "ppo" for a trained one in all its training seeds, and
"ppo-3" in one of them; "module:function" for an agent from outside, called with the environment;
the path of a policy's file; "LABEL=NAME" for any of these under another name; and
"LABEL@3=module:function", or "LABEL@3=PATH", for one of the training seeds of an agent.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium as gym

from mmc_gym.agents import AGENTS, agent_names, resolve
from mmc_gym.agents.base import Predictor
from mmc_gym.agents.policy import PRETRAINED, PolicyCard, is_policy_path, load_policy
from mmc_gym.agents.resolver import AgentLike, Factory
from mmc_gym.benchmark.reference import REFERENCE
from mmc_gym.interface import ControlError


def entrants(agents: Sequence[AgentLike] | Mapping[str, AgentLike]) -> dict[str, Factory]:
    """Label and factory of each agent, in the order given.

    An agent is a name that `mmc_gym.make_agent` accepts, or the path of a policy, which is called
    by the file's name without suffix; `"module:function"`, where the
    function is called with the environment and returns an object with stable-baselines3's
    `predict` (modules in the working directory are found); such a function; or such an object,
    for instance a stable-baselines3 model.  A mapping gives the labels; otherwise strings stand
    for themselves, and objects are called by their class.

    Raises:
        ValueError: if there is no agent, an unknown one, or two with the same label.
    """
    if isinstance(agents, str):
        agents = [agents]
    if isinstance(agents, Mapping):
        labelled = list(agents.items())
    else:
        labelled = [(resolve(agent).label, agent) for agent in agents]
    if not labelled:
        raise ValueError(f"agents must name at least one of {agent_names()}, got none")
    labels = [label for label, _ in labelled]
    repeated = sorted({label for label in labels if labels.count(label) > 1})
    if repeated:
        raise ValueError(f"agents must have different names, got {', '.join(repeated)} repeatedly")
    return {label: resolve(agent).factory for label, agent in labelled}


def make_for(
    factory: Factory, make_env: Callable[[str | None], gym.Env[Any, Any]]
) -> tuple[gym.Env[Any, Any], Predictor]:
    """An environment, and an agent made for it; under the agent's control if it knows no other.

    Args:
        factory: makes the agent.
        make_env: makes the environment, with its own control mode for None.
    """
    env = make_env(None)
    try:
        return env, factory(env)
    except ControlError as refusal:
        env.close()
        env = make_env(refusal.control)
    except BaseException:
        env.close()
        raise
    try:
        return env, factory(env)
    except BaseException:
        env.close()
        raise


def training_steps(agent: object) -> int | None:
    """Environment steps spent in training an agent; None if it does not tell.

    `training_steps` of this package's agents, `num_timesteps` of stable-baselines3's models.
    """
    for name in ("training_steps", "num_timesteps"):
        steps = getattr(agent, name, None)
        if steps is not None:
            return int(steps)
    return None


LEFT_OUT = ("ik-transpose", "ik-pinv", "ik-nullspace", "ik-ccd", "ik-fabrik")
"""Agents that do not take part by default: other solvers of what `ik-dls` stands for."""


@dataclass(frozen=True)
class Contestant:
    """An agent, or one of the trainings of an agent.

    Attributes:
        agent: what it is called.
        training_seed: 0 if it is not trained.
        source: what `entrants` makes it of, or `REFERENCE`.
        is_trained: whether it was trained, as far as known.
    """

    agent: str
    training_seed: int
    source: str
    is_trained: bool

    @property
    def is_reference(self) -> bool:
        """Whether it is the ideal hand, which needs no arm."""
        return self.source == REFERENCE

    @property
    def is_own(self) -> bool:
        """Whether it is of this package: its agents are known to act on batches."""
        return is_policy_path(self.source) or ":" not in self.source

    @property
    def factory(self) -> Factory:
        """What makes it for an environment.

        Raises:
            ValueError: if it cannot be found.
        """
        (factory,) = entrants([self.source]).values()
        return factory

    @property
    def card(self) -> PolicyCard | None:
        """Of a policy, one's own or one that ships; None for all others, or if it is missing."""
        if not (self.is_own and self.is_trained):
            return None
        is_path = is_policy_path(self.source)
        try:
            return load_policy(self.source if is_path else PRETRAINED / f"{self.source}.json")[1]
        except (FileNotFoundError, ValueError):
            return None

    @property
    def fingerprint(self) -> str:
        """SHA-256 of a policy's weights, or of the file that an agent's module is written in.

        Another one is another agent, whatever its name.  Of a module it is that file alone: what it
        imports, or reads, may change unnoticed.  Empty if there is none.
        """
        return "" if self.is_reference else resolve(self.source).fingerprint


def default_agents() -> tuple[str, ...]:
    """Names of the agents that take part unless others are named; of trained ones, if they ship."""
    taking_part = (name for name in AGENTS if name not in LEFT_OUT)
    there = (
        name for name in taking_part if not AGENTS[name].training_seeds or _shipped_seeds(name)
    )
    return (*there, REFERENCE)


def _shipped_seeds(name: str) -> list[int]:
    """The training seeds of a policy whose files are there."""
    seeds = range(AGENTS[name].training_seeds)
    return [seed for seed in seeds if (PRETRAINED / f"{name}-{seed}.json").is_file()]


def contestants(names: Iterable[str]) -> list[Contestant]:
    """Those that the names stand for, in the order given.

    Raises:
        ValueError: if there is none, an unknown one, or one twice; or a file holds no policy.
        FileNotFoundError: if a policy's file is missing.

    Example:
        >>> contestants(["mmc", "twin=mmc"])[1]
        Contestant(agent='twin', training_seed=0, source='mmc', is_trained=False)
    """
    found = [one for name in names for one in _contestants(name)]
    if not found:
        raise ValueError(f"agents must name at least one of {', '.join(AGENTS)}, got none")
    keys = [(one.agent, one.training_seed) for one in found]
    for agent, seed in keys:
        if keys.count((agent, seed)) > 1:
            raise ValueError(
                f"agents must have different names, got {agent} repeatedly; LABEL={agent} is "
                "another name for it"
            )
    return found


def _contestants(name: str) -> list[Contestant]:
    label, has_label, source = name.rpartition("=")
    if not label and has_label:
        raise ValueError(f"agents must have names, got {name!r}")
    if source == REFERENCE:
        return [Contestant(label or REFERENCE, 0, REFERENCE, False)]
    if source in AGENTS and AGENTS[source].training_seeds:
        seeds = _shipped_seeds(source)
        if not seeds:
            raise ValueError(f"agents must be there, but {source} has not been trained")
        return [Contestant(label or source, seed, f"{source}-{seed}", True) for seed in seeds]
    (plain_label,) = entrants([source])  # refuses what is unknown
    if is_policy_path(source):
        load_policy(source)  # refuses what is none
        label, _, seed = _label_and_seed(label)
        return [Contestant(label or plain_label, seed, source, True)]
    kind, _, number = source.rpartition("-")
    if source not in AGENTS and ":" not in source:
        if int(number) not in _shipped_seeds(kind):
            raise ValueError(f"agents must be there, but {source} has not been trained")
        return [Contestant(label or kind, int(number), source, True)]
    label, is_training, seed = _label_and_seed(label)
    return [Contestant(label or source, seed, source, is_training)]


def _label_and_seed(label: str) -> tuple[str, bool, int]:
    """Name, whether a training seed is named, and which."""
    name, at, number = label.rpartition("@")
    if not at:
        return label, False, 0
    if not name or not number.isdecimal():
        raise ValueError(f"agents must be named as LABEL or LABEL@SEED, got {label!r}")
    return name, True, int(number)
