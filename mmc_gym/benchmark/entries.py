"""Who takes part: agents by name, with all their training seeds, and your own agents.

An agent is named as

mmc                              an agent of this package
ppo, ppo-3                       a trained one: all its training seeds, or one of them
runs/ppo-1/ppo-1.json            the file of a policy, or of a model of stable-baselines3 (.zip)
runs/ppo-1                       a folder with one of these
module:name                      your own function, class or object
'runs/mine-*', 'mine-*.zip'      several trainings of one agent: all that match
LABEL=...                        any of these under another name
LABEL@3=...                      one of them as training seed 3 of LABEL
...@joint_velocity               what acts by this control mode
"""

from __future__ import annotations

import re
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from glob import glob
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias, cast

import gymnasium as gym

from mmc_gym._errors import UserError, require
from mmc_gym.agents import AGENTS, resolve
from mmc_gym.agents.base import Predictor
from mmc_gym.agents.policy import is_policy_path
from mmc_gym.agents.resolver import AgentLike, Factory, ResolvedAgent, shipped_seeds
from mmc_gym.agents.sb3 import SUFFIX, ModelAgent
from mmc_gym.benchmark.reference import REFERENCE
from mmc_gym.envs.scenarios import EnvLike, is_own, make_environment
from mmc_gym.interface import CONTROLS, ControlError

Agents: TypeAlias = "str | Iterable[AgentLike] | Mapping[str, AgentLike | Sequence[AgentLike]]"
"""Agents, in order; a mapping gives them labels, and a list in it is several trainings of one."""

LEFT_OUT = ("ik-nullspace",)
"""Agents that do not take part by default: other solvers of what `ik-dls` solves."""

HIGHEST_SEED = 2**32 - 1


@dataclass(frozen=True)
class Entry:
    """An agent that takes part, or one of its trainings.

    Attributes:
        label: the agent's name in tables and data.
        training_seed: None if it was not trained, as far as is known.
        source: what `mmc_gym.agents.resolve` takes, or `REFERENCE`.
        allow_pickle: whether its pickles may be loaded.
    """

    label: str
    training_seed: int | None
    source: AgentLike
    allow_pickle: bool = False

    @property
    def is_reference(self) -> bool:
        """Tell whether it is the ideal hand, which needs no arm."""
        return isinstance(self.source, str) and self.source == REFERENCE

    @cached_property
    def agent(self) -> ResolvedAgent:
        """The agent itself; a worker process finds it anew, but knows its fingerprint."""
        return resolve(self.source, allow_pickle=self.allow_pickle)

    @property
    def source_name(self) -> str:
        """The source, if it is a name or a path; or else one that stands for what was given."""
        return str(self.source) if isinstance(self.source, str) else f"given:{self.label}"

    @cached_property
    def fingerprint(self) -> str:
        """Digest that tells it from another agent of the same name, see `ResolvedAgent`."""
        return "" if self.is_reference else self.agent.fingerprint

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "agent"}


def find_entries(
    agents: Agents, *, allow_pickle: bool = False, every_training: bool = True
) -> list[Entry]:
    """Return an entry for each training of each agent, in the order given.

    Args:
        agents: names as above, functions, classes or objects, see `resolve`.
        allow_pickle: whether files that hold pickles may be loaded, see `resolve`.
        every_training: whether the name of an agent that ships trained, such as "ppo", stands for
            all its trainings; or else for that of seed 0.

    Raises:
        UserError: if there is none, an unknown one, or one twice; or a file holds no policy, or
            pickles that may not be loaded.
        FileNotFoundError: if a file is missing.

    Example:
        >>> find_entries(["mmc", "twin=mmc"])[1]
        Entry(label='twin', training_seed=None, source='mmc', allow_pickle=False)
    """
    fine = isinstance(agents, Iterable)
    require(fine, "agents", agents, "a list of agents, such as ['mmc', 'ppo'], or a mapping")
    entries = []
    for named in _all_named(agents):
        if isinstance(named.source, str) and named.source in AGENTS and every_training:
            entries += _shipped(named) or [_entry(named, allow_pickle)]
        else:
            entries.append(_entry(named, allow_pickle))
    return _different(entries, [(one.label, one.training_seed) for one in entries])


def one_entry(agent: AgentLike, *, allow_pickle: bool = False) -> Entry:
    """Return the entry of one agent; of several trainings, that of the first."""
    return find_entries([agent], allow_pickle=allow_pickle, every_training=False)[0]


def default_agents() -> tuple[str, ...]:
    """Return the names of the agents that take part by default; of trained ones, if they ship."""
    taking_part = (name for name in AGENTS if name not in LEFT_OUT)
    there = (name for name in taking_part if not AGENTS[name].training_seeds or shipped_seeds(name))
    return (*there, REFERENCE)


def make_for(
    entry: Entry,
    make_env: Callable[[str | None], gym.Env[Any, Any]],
    control: str | None = None,
    *,
    is_own_env: bool = False,
) -> tuple[gym.Env[Any, Any], Predictor]:
    """Make an environment, and an agent for it, under the agent's control.

    Args:
        entry: whose agent tells its control mode, or finds out.
        make_env: makes the environment of a control mode; of its own one for None.
        control: that the user asks for, for agents that act by several, or whose own is unknown.
        is_own_env: whether the environment is the user's, whose control mode is meant.

    Raises:
        UserError: if nobody knows the control mode that a model was trained in.
    """
    agent = entry.agent
    own = agent.own_control
    try:
        made, player = _made(agent.factory, make_env(own or control or agent.control))
    except ControlError as refusal:
        if agent.asked is not None:
            raise
        made, player = _made(agent.factory, make_env(refusal.control))
    is_told = own or control or is_own_env
    if isinstance(player, ModelAgent) and player.trained_in.control is None and not is_told:
        made.close()
        raise UserError(
            f"agent {entry.label!r} must be given with the control mode that it was trained in, "
            "which a model of stable-baselines3 does not tell without its environment: "
            f"{_ways(entry)}"
        )
    return made, player


def _ways(entry: Entry) -> str:
    """Say how the control mode of an agent is given."""
    own = "by an attribute `control` of what is given"
    if isinstance(entry.source, str):
        own = f"as {entry.source}@joint_delta (the default of MMCReach-v0)"
    return f"{own}, or any other of {', '.join(CONTROLS)}; --env-kwargs control=... says it for all"


def make_together(
    entry: Entry,
    env: EnvLike,
    env_kwargs: Mapping[str, Any],
    check: Callable[[gym.Env[Any, Any]], None] = lambda env: None,
) -> tuple[gym.Env[Any, Any], Predictor]:
    """Make an environment of the user's choice, and an agent for it.

    Args:
        entry: the agent.
        env: see `EnvLike`.
        env_kwargs: arguments of the environment.  A `control` among them is for agents that act by
            several control modes, or do not tell theirs.
        check: raises a `UserError` for an environment that is not accepted.

    Raises:
        UserError: if either cannot be made, or they do not go together.
    """
    given = dict(env_kwargs)
    asked = given.pop("control", None)

    def make_env(control: str | None) -> gym.Env[Any, Any]:
        made = make_environment(env, control or asked, **given)
        check(made)
        return made

    return make_for(entry, make_env, asked, is_own_env=is_own(env))


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


def _all_named(agents: Agents) -> list[_Named]:
    """Return all trainings that are named, each with its label."""
    if isinstance(agents, Mapping):
        for label in agents:
            require(isinstance(label, str), "the label of an agent", label, "a text")
        groups = {
            label: list(of) if isinstance(of, (list, tuple)) else [cast(AgentLike, of)]
            for label, of in agents.items()
        }
        return [one for label, sources in groups.items() for one in _trainings(label, sources)]
    given = [agents] if isinstance(agents, str) else agents
    found = []
    for one in given:
        named = _read(one) if isinstance(one, str) else _Named("", None, one)
        paths = _matching(named.source)
        if paths is None:
            found.append(named)
            continue
        if named.training_seed is not None:
            raise UserError(f"{one!r} must name one training, as it is given a seed")
        found += _trainings(named.label or _common(str(named.source)), paths)
    return found


def _trainings(label: str, sources: Sequence[AgentLike]) -> list[_Named]:
    """Return the trainings of an agent, by their own seeds if all have one, or else numbered."""
    if not sources:
        raise UserError(f"agents must be given with at least one training, got none of {label!r}")
    if len(sources) == 1:
        (source,) = sources
        paths = _matching(source)
        return [_Named(label, None, source)] if paths is None else _trainings(label, paths)
    seeds = [None if _is_reference(one) else resolve(one).training_seed for one in sources]
    if None in seeds or len(set(seeds)) < len(seeds):
        seeds = list(range(len(seeds)))
    return [_Named(label, seed, source) for seed, source in zip(seeds, sources)]


def _is_reference(source: AgentLike) -> bool:
    return isinstance(source, str) and source == REFERENCE


def _matching(source: AgentLike) -> list[AgentLike] | None:
    """Return the files and folders that a pattern stands for; None if it is no pattern."""
    if not isinstance(source, (str, Path)) or "*" not in str(source) or Path(source).exists():
        return None
    pattern, at, control = str(source).rpartition("@")
    if not at or control not in CONTROLS:
        pattern, at, control = str(source), "", ""
    name, star, rest = pattern.partition("-*")
    if star and not rest and name in AGENTS and AGENTS[name].training_seeds:
        return [f"{name}-{seed}" for seed in shipped_seeds(name)]
    # Of a policy's two files one is enough.
    found = [one for one in sorted(glob(pattern), key=_numbers) if _may_be_agent(Path(one))]
    cards = {Path(one).with_suffix("") for one in found if one.endswith(".json")}
    found = [o for o in found if o.endswith(".json") or Path(o).with_suffix("") not in cards]
    if not found:
        raise UserError(f"agents must match a file or a folder, got {str(source)!r}")
    return [f"{one}{at}{control}" for one in found]


def _may_be_agent(path: Path) -> bool:
    return path.is_dir() or path.suffix == SUFFIX or is_policy_path(path.name)


def _numbers(path: str) -> list[Any]:
    """Return a key that sorts mine-2 before mine-10."""
    return [int(part) if part.isdecimal() else part for part in re.split(r"(\d+)", path)]


def _common(pattern: str) -> str:
    """Return a label for the trainings of a pattern: "mine" of "runs/mine-*.zip"."""
    named = [part for part in Path(pattern).parts if part.strip("*")]
    name = next((part for part in named[::-1] if "*" in part), named[-1] if named else pattern)
    name = re.sub(r"@.*|\.(zip|json|safetensors)$", "", name).replace("*", "").strip("-_.")
    return name or Path(pattern).parent.name or pattern


def _read(text: str) -> _Named:
    """Take `LABEL@SEED=SOURCE` apart; "" and None for what is not there."""
    label, has_label, source = text.rpartition("=")
    if is_policy_path(text) or SUFFIX in text or "/" in source:  # folders may have an = in them
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


def _shipped(named: _Named) -> list[Entry]:
    """Return an entry for each training of an agent that ships; none if it is not trained."""
    name = str(named.source)
    if not AGENTS[name].training_seeds:
        return []
    if named.training_seed is not None:
        raise UserError(
            f"{named.label}@{named.training_seed}={name} must name one training, such as {name}-0"
        )
    seeds = shipped_seeds(name)
    if not seeds:
        raise UserError(f"agents must be there, but {name} has not been trained")
    return [Entry(named.label or name, seed, f"{name}-{seed}") for seed in seeds]


def _entry(named: _Named, allow_pickle: bool) -> Entry:
    """Return the entry of one training, or of an agent without any."""
    if _is_reference(named.source):
        return Entry(named.label or REFERENCE, None, REFERENCE)
    agent = resolve(named.source, allow_pickle=allow_pickle)
    agent.check()
    seed = agent.training_seed if named.training_seed is None else named.training_seed
    source = str(named.source) if isinstance(named.source, (str, Path)) else named.source
    if not isinstance(source, str) and agent.is_model:
        source = agent.given  # a worker process is sent its policy, without its environment
    entry = Entry(named.label or agent.label, seed, source, allow_pickle)
    vars(entry)["agent"] = agent  # not to be read a second time
    return entry


def _different(entries: list[Entry], keys: Sequence[Hashable]) -> list[Entry]:
    """Return entries; raise a `UserError` if there is none, or two have the same key."""
    if not entries:
        raise UserError("agents must be one or more, such as mmc and ppo, got none")
    for one, key in zip(entries, keys):
        if keys.count(key) > 1:
            raise UserError(
                f"agents must have different names, got {one.label} repeatedly; LABEL={one.label} "
                "is another name for it, LABEL@SEED=... another training"
            )
    return entries
