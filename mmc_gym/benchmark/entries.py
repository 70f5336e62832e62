"""Who takes part: agents by name, with all their training seeds, and your own agents.

An agent is named as

mmc                              an agent of this package
ppo, ppo-3                       a trained one: all its training seeds, or one of them
runs/ppo-1/ppo-1.json            the file of a policy
module:function                  your own, called with the environment
LABEL=...                        any of these under another name
LABEL@3=...                      one of them as training seed 3 of LABEL
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym

from mmc_gym._errors import UserError
from mmc_gym.agents import AGENTS, agent_names, resolve
from mmc_gym.agents.base import Predictor
from mmc_gym.agents.policy import is_policy_path
from mmc_gym.agents.resolver import AgentLike, Factory, ResolvedAgent, shipped_seeds
from mmc_gym.benchmark.reference import REFERENCE
from mmc_gym.interface import ControlError

LEFT_OUT = ("ik-transpose", "ik-pinv", "ik-nullspace", "ik-ccd", "ik-fabrik")
"""Agents that do not take part by default: other solvers of what `ik-dls` stands for."""

HIGHEST_SEED = 2**32 - 1


@dataclass(frozen=True)
class Entry:
    """An agent that takes part, or one of its trainings.

    Attributes:
        label: the agent's name in tables and data.
        training_seed: None if it was not trained, as far as is known.
        source: what `mmc_gym.agents.resolve` takes, or `REFERENCE`.
    """

    label: str
    training_seed: int | None
    source: AgentLike

    @property
    def is_reference(self) -> bool:
        """Tell whether it is the ideal hand, which needs no arm."""
        return bool(self.source == REFERENCE)

    @cached_property
    def agent(self) -> ResolvedAgent:
        """The agent itself; a worker process finds it anew, but knows its fingerprint."""
        return resolve(self.source)

    @cached_property
    def fingerprint(self) -> str:
        """Digest that tells it from another agent of the same name, see `ResolvedAgent`."""
        return "" if self.is_reference else self.agent.fingerprint

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "agent"}


def find_entries(names: Iterable[str]) -> list[Entry]:
    """Return the entries that names stand for, in the order given.

    Raises:
        UserError: if there is none, an unknown one, or one twice; or a file holds no policy.
        FileNotFoundError: if a policy's file is missing.

    Example:
        >>> find_entries(["mmc", "twin=mmc"])[1]
        Entry(label='twin', training_seed=None, source='mmc')
    """
    entries = [entry for name in names for entry in _entries(name)]
    return _different(entries, [(one.label, one.training_seed) for one in entries])


def single_entries(agents: Sequence[AgentLike] | Mapping[str, AgentLike]) -> list[Entry]:
    """Return an entry for each agent: of a trained one, that of training seed 0.

    Args:
        agents: names as in `find_entries`, functions of the environment, or objects with
            stable-baselines3's `predict`, called by their class; a mapping gives the labels.

    Raises:
        UserError: if there is none, an unknown one, or two with the same label.
    """
    if isinstance(agents, Mapping):
        named = [_Named(label, None, agent) for label, agent in agents.items()]
    else:
        given = [agents] if isinstance(agents, str) else agents
        named = [_read(one) if isinstance(one, str) else _Named("", None, one) for one in given]
    entries = []
    for label, _, source in named:
        agent = resolve(source)
        agent.check()
        entries.append(Entry(label or agent.label, agent.training_seed, source))
    return _different(entries, [one.label for one in entries])


def default_agents() -> tuple[str, ...]:
    """Return the names of the agents that take part by default; of trained ones, if they ship."""
    taking_part = (name for name in AGENTS if name not in LEFT_OUT)
    there = (name for name in taking_part if not AGENTS[name].training_seeds or shipped_seeds(name))
    return (*there, REFERENCE)


def make_for(
    agent: ResolvedAgent, make_env: Callable[[str | None], gym.Env[Any, Any]]
) -> tuple[gym.Env[Any, Any], Predictor]:
    """Make an environment, and an agent for it, under the agent's control.

    Args:
        agent: makes the agent, and tells its control mode, or finds out.
        make_env: makes the environment of a control mode; of its own one for None.
    """
    try:
        return _made(agent.factory, make_env(agent.control))
    except ControlError as refusal:
        control = refusal.control
    return _made(agent.factory, make_env(control))


def _made(factory: Factory, env: gym.Env[Any, Any]) -> tuple[gym.Env[Any, Any], Predictor]:
    try:
        return env, factory(env)
    except BaseException:
        env.close()
        raise


def training_steps(agent: object) -> int | None:
    """Return the environment steps spent in training an agent; None if it does not tell.

    `training_steps` of this package's agents, `num_timesteps` of stable-baselines3's models.
    """
    steps = getattr(agent, "training_steps", getattr(agent, "num_timesteps", None))
    return None if steps is None else int(steps)


class _Named(NamedTuple):
    label: str
    training_seed: int | None
    source: AgentLike


def _read(text: str) -> _Named:
    """Take `LABEL@SEED=SOURCE` apart; "" and None for what is not there."""
    label, has_label, source = text.rpartition("=")
    if is_policy_path(text):  # its folders may have an = in their names
        label, has_label, source = text.partition("=")
        if Path(text).exists() or "/" in label or "\\" in label:
            has_label = ""
    if not has_label:
        return _Named("", None, text)
    name, at, number = label.rpartition("@") if "@" in label else (label, "", "")
    if not name:
        raise UserError(f"agents must have names, got {text!r}")
    if not at:
        return _Named(name, None, source)
    if not number.isdecimal():
        raise UserError(f"agents must be named as LABEL or LABEL@SEED, got {label!r}")
    if int(number) > HIGHEST_SEED:
        raise UserError(f"training seeds must be at most {HIGHEST_SEED}, got {text!r}")
    return _Named(name, int(number), source)


def _entries(text: str) -> list[Entry]:
    label, training_seed, source = _read(text)
    if source == REFERENCE:
        return [Entry(label or REFERENCE, None, REFERENCE)]
    if source in AGENTS and AGENTS[source].training_seeds:
        if training_seed is not None:
            raise UserError(f"{text!r} must name one training, such as {source}-0")
        seeds = shipped_seeds(source)
        if not seeds:
            raise UserError(f"agents must be there, but {source} has not been trained")
        return [Entry(label or source, seed, f"{source}-{seed}") for seed in seeds]
    agent = resolve(source)
    agent.check()
    if training_seed is None:
        training_seed = agent.training_seed
    return [Entry(label or agent.name or agent.label, training_seed, source)]


def _different(entries: list[Entry], keys: Sequence[Hashable]) -> list[Entry]:
    """Return entries; raise a `UserError` if there is none, or two have the same key."""
    if not entries:
        raise UserError(f"agents must name at least one of {agent_names()}, got none")
    for one, key in zip(entries, keys):
        if keys.count(key) > 1:
            raise UserError(
                f"agents must have different names, got {one.label} repeatedly; LABEL={one.label} "
                "is another name for it"
            )
    return entries
