"""Resolve agents: the grammar of their names, and what is known of each.

    mmc                            an agent of this package
    ppo-3, ppo                     a trained one: its training of seed 3; all of them, or seed 0
    runs/ppo-1/ppo-1.json          the file of a policy, or of a model of stable-baselines3 (.zip)
    runs/ppo-1                     a folder with one of these
    'runs/mine-*', 'mine-*.zip'    several trainings of one recipe: everything that matches
    module:name                    your own function, class or object
    LABEL=...                      any of these under another name

In Python functions, classes, models of stable-baselines3 and other objects with `predict` are
agents, too.  No other module parses the name of an agent.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from glob import glob
from os.path import exists
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, cast
from zipfile import is_zipfile

import gymnasium as gym
from gymnasium.vector import VectorEnv

from mmc_gym._errors import UserError, require, require_choice, unknown
from mmc_gym.agents.base import Agent, Predictor
from mmc_gym.agents.registry import AGENTS, REFERENCE
from mmc_gym.agents.resolved import (
    Factory,
    ResolvedAgent,
    ideal_hand,
    import_wrapper,
    model_agent,
    policy_agent,
    untrained_agent,
    user_agent,
)
from mmc_gym.agents.sb3 import SUFFIX, ModelAgent, SavedModel, as_agent, models_in, read_statistics
from mmc_gym.interface import InterfacedEnv

if TYPE_CHECKING:
    from mmc_gym.agents.policy import PolicyCard

AgentLike: TypeAlias = "str | Path | Predictor | Factory | Callable[[Any], Any]"
Agents: TypeAlias = "str | Iterable[AgentLike] | Mapping[str, AgentLike | Sequence[AgentLike]]"
"""Agents, in order; a mapping gives them labels, and a list in it is several trainings of one."""

Statistics: TypeAlias = "Any | Sequence[str] | Mapping[str, Any]"
"""A `VecNormalize` or the path of its file, for all models of stable-baselines3; of a mapping, or
as "LABEL=path", for one agent."""

Wrapper: TypeAlias = "str | Callable[[gym.Env[Any, Any]], gym.Env[Any, Any]]"
Wrappers: TypeAlias = "Wrapper | Sequence[Wrapper] | Mapping[str, Wrapper]"
"""A function of an environment, or "module:function", for all models of stable-baselines3; of a
mapping, or as "LABEL=module:function", for one agent."""

_LONGEST_LABEL = 100  # labels are part of the names of files


def resolve(agent: AgentLike, *, allow_pickle: bool = False) -> ResolvedAgent:
    """Return the agent of a name, path, function or object; of several trainings, the first.

    Args:
        agent: a name or path as above, a model of stable-baselines3, or another object with
            `predict`.  Or a function or class: called with the environment it returns such an
            object, or else called with an observation it returns an action.  "ppo" is its training
            of seed 0.  Modules are found in the working directory, too.
        allow_pickle: whether files with pickles may be loaded, such as those of stable-baselines3.
            That runs whatever code they name.

    >>> resolve("ppo-3").name, resolve("ppo-3").training_seed, resolve("mmc").training_seed
    ('ppo', 3, None)
    >>> resolve("mine=mmc").label
    'mine'
    """
    return _trainings([agent], "", allow_pickle, every_training=False)[0]


def resolve_all(
    agents: Agents,
    *,
    allow_pickle: bool = False,
    every_training: bool = True,
    wrapper: Wrappers = (),
    statistics: Statistics = (),
) -> list[ResolvedAgent]:
    """Return each training of each agent, in the order given, and check all of them.

    Args:
        agents: one or several, see `resolve`; see `Agents` for a mapping.
        allow_pickle: see `resolve`.
        every_training: whether the name of an agent that ships trained, such as "ppo", stands for
            all its trainings; or else for that of seed 0.
        wrapper: puts the environment of a model into the wrappers of its training; see `Wrappers`.
        statistics: those that a model's observations are normalized by; see `Statistics`.

    Raises:
        UserError: also for none, or two of the same label and training seed.
        FileNotFoundError: if a file is missing.

    >>> [(agent.label, agent.training_seed) for agent in resolve_all(["mmc", "mine=ppo-3"])]
    [('mmc', None), ('mine', 3)]
    """
    accepted = "a list of agents, such as ['mmc', 'ppo'], or a mapping"
    require(isinstance(agents, Iterable), "agents", agents, accepted)
    if isinstance(agents, Mapping):
        labelled: list[Any] = list(agents.items())
    else:
        labelled = [("", agent) for agent in ([agents] if isinstance(agents, str) else agents)]
    resolved: list[ResolvedAgent] = []
    for label, trainings in labelled:
        _check_label(label)
        sources = trainings if isinstance(trainings, (list, tuple)) else [trainings]
        resolved += _trainings(sources, label, allow_pickle, every_training)
    if not resolved:
        raise UserError("agents must be one or more, such as mmc and ppo, got none")
    wrappers = _by_agent("wrapper", wrapper, resolved)
    normalizers = _by_agent("statistics", statistics, resolved)
    resolved = [
        _as_trained(agent, wrap, normalizer, allow_pickle)
        for agent, wrap, normalizer in zip(resolved, wrappers, normalizers, strict=True)
    ]
    counts = Counter((agent.label, agent.training_seed) for agent in resolved)
    (label, _), count = counts.most_common(1)[0]
    if count > 1:
        raise UserError(
            f"agents must have different names, got {label} repeatedly; LABEL=... gives another"
        )
    return resolved


def _as_trained(
    agent: ResolvedAgent, wrapper: Any, statistics: Any, allow_pickle: bool
) -> ResolvedAgent:
    """Return the agent with a wrapper and statistics, if any; check those that it has."""
    model, seed = agent.model, agent.training_seed
    if statistics is not None:
        accepted = "for a model of stable-baselines3"
        require(model is not None, f"statistics of {agent.label}", statistics, accepted)
    if model is not None:
        normalizer = None if statistics is None else read_statistics(statistics, allow_pickle)
        loaded = model.load(normalizer)
        if normalizer is not None:
            agent = replace(model_agent(loaded, agent.label, agent.source), training_seed=seed)
    agent = replace(agent, wrapper=wrapper or agent.wrapper)
    import_wrapper(agent.wrapper)
    return agent


def _by_agent(name: str, value: Any, agents: Sequence[ResolvedAgent]) -> list[Any]:
    """Return what an argument has for each agent, see `Wrappers`; None where it has nothing."""
    if isinstance(value, Mapping):
        labelled = dict(value)
    else:
        values = value if isinstance(value, (list, tuple)) else [value]
        labelled = dict(_labelled(text) if isinstance(text, str) else ("", text) for text in values)
    everyone = labelled.pop("", None)
    for label in labelled:
        labels = dict.fromkeys(agent.label for agent in agents)
        require_choice(f"the agent of {name}", label, labels)
    is_used = everyone is None or any(agent.model for agent in agents)
    accepted = "for a model of stable-baselines3 among agents; or LABEL=..., for that agent"
    require(is_used, name, everyone, accepted)
    return [labelled.get(agent.label, everyone if agent.model else None) for agent in agents]


def _trainings(
    sources: Sequence[AgentLike], label: str, allow_pickle: bool, every_training: bool
) -> list[ResolvedAgent]:
    """Return the trainings of one agent, counted unless their own seeds all differ."""
    if not sources:
        raise UserError(f"agents must be given with at least one training, got none of {label!r}")
    unlabelled: list[Any] = []
    for source in sources:
        if isinstance(source, (str, Path)):
            source_label, name = _labelled(str(source))
            common_label, names = _expanded(name, every_training)
            label = label or source_label or common_label
            unlabelled += names
        else:
            unlabelled.append(source)
    agents = [_resolve(source, label, allow_pickle) for source in unlabelled]
    seeds = {agent.training_seed for agent in agents}
    if len(agents) > 1 and (None in seeds or len(seeds) < len(agents)):
        return [replace(agent, training_seed=seed) for seed, agent in enumerate(agents)]
    return agents


def _labelled(text: str) -> tuple[str, str]:
    """Split `LABEL=SOURCE`; without a label it is ""."""
    label, sign, source = text.partition("=")
    # An = may also be part of a path.
    if not sign or "/" in label or "\\" in label or exists(text) or glob(text):
        return "", text
    if not label:
        raise UserError(f"agents must have names, got {text!r}")
    _check_label(label)
    return label, source


def _check_label(label: object) -> None:
    accepted = f"a text of at most {_LONGEST_LABEL} characters"
    is_label = isinstance(label, str) and len(label.encode(errors="replace")) <= _LONGEST_LABEL
    require(is_label, "the label of an agent", label, accepted)


def _expanded(name: str, every_training: bool) -> tuple[str, list[str]]:
    """Return the trainings that a name or pattern stands for, and before them a label for all."""
    kind = name.removesuffix("-*")
    seeds = range(AGENTS[kind].training_seeds if kind in AGENTS else 0)
    if seeds and (every_training or kind != name):
        return kind, [f"{kind}-{seed}" for seed in seeds]
    if "*" in name and not Path(name).exists():
        return _common_label(name), _matching(name)
    return "", [name]


def _matching(pattern: str) -> list[str]:
    """Return the files and folders of agents that a pattern matches, mine-9 before mine-10."""
    # Of a policy's two files one is enough.
    suffixes = (".safetensors",) if pattern.endswith(".safetensors") else (".json", SUFFIX)
    paths = [path for path in glob(pattern) if path.endswith(suffixes) or Path(path).is_dir()]
    if not paths:
        raise UserError(f"agents must match a file or a folder, got {pattern!r}")
    # With numbers equally long, texts are in the order of their numbers.
    return sorted(paths, key=lambda path: re.sub(r"\d+", lambda digits: digits[0].zfill(20), path))


def _common_label(pattern: str) -> str:
    """Return a label for the trainings of a pattern: "mine" of "runs/mine-*.zip"."""
    parts = [part for part in Path(pattern).parts if part.strip("*")]
    name = next((part for part in reversed(parts) if "*" in part), parts[-1] if parts else pattern)
    return _without_suffix(name).replace("*", "").strip("-_.") or pattern


def _without_suffix(name: str) -> str:
    return re.sub(r"\.(zip|json|safetensors)$", "", name)


def _resolve(source: Any, label: str, allow_pickle: bool) -> ResolvedAgent:
    """Return the agent of a name or an object, under a label or else its own name."""
    if not isinstance(source, str):
        thing = as_agent(source)
        if isinstance(thing, ModelAgent):
            return model_agent(thing, label or thing.label)
        if hasattr(thing, "predict") or callable(thing):
            return user_agent(thing, label or getattr(thing, "__name__", type(thing).__name__))
        raise _unknown(source)
    if source == REFERENCE:
        return ideal_hand(label or source)
    if source in AGENTS and not AGENTS[source].training_seeds:
        return untrained_agent(source, label or source)
    from mmc_gym.agents.policy import SUFFIXES

    path, path_label, kind = _file_of(source)
    label = label or path_label
    if path.suffix in SUFFIXES:
        return policy_agent(path, label, path.stem if kind else source, kind)
    if not path.exists() and Path(f"{source}{SUFFIX}").is_file():  # as stable-baselines3 names it
        path = Path(f"{source}{SUFFIX}")
    if path.suffix == SUFFIX or (path.is_file() and is_zipfile(path)):
        return model_agent(SavedModel(path, allow_pickle), label, source)
    if ":" in source and not source.startswith("."):  # relative imports are not accepted
        return user_agent(source, label)
    raise _unknown(source)


def _file_of(name: str) -> tuple[Path, str, str]:
    """Return the file of a name or path, a label, and its key in `AGENTS` if the file ships."""
    from mmc_gym.agents.policy import shipped_file

    kind, _, seed = (name, "", "0") if name in AGENTS else name.rpartition("-")
    if kind in AGENTS and seed in map(str, range(AGENTS[kind].training_seeds)):
        return shipped_file(kind, int(seed)), name, kind
    path = Path(name)
    if name and path.is_dir() and name not in AGENTS:
        return _agent_in(path), path.resolve().name, ""
    return path, _without_suffix(path.name), ""


def read_card(name: str) -> PolicyCard | None:
    """Return the card of the policy that a name or path stands for; None if it is no policy.

    No module is imported.
    """
    from mmc_gym.agents.policy import SUFFIXES, load_policy

    path, *_ = _file_of(name)
    return load_policy(path)[1] if path.suffix in SUFFIXES else None


def _agent_in(folder: Path) -> Path:
    """Return the file of the only policy in a folder, or else of the only model."""
    cards = sorted(folder.glob("*.json"))
    policies = [card for card in cards if card.with_suffix(".safetensors").is_file()]
    files = policies or models_in(folder)
    if len(files) != 1:
        raise UserError(
            f"agent '{folder}' must be a folder with one policy, with best_model.zip, or with one "
            f"zip file of stable-baselines3, got {', '.join(file.name for file in files) or 'none'}"
        )
    return files[0]


def _unknown(agent: object) -> UserError:
    is_path = isinstance(agent, str) and ("/" in agent or "\\" in agent)
    if is_path and not Path(str(agent)).exists():
        return UserError(f"agent {agent!r} must be a name or a path, and there is no such file")
    if isinstance(agent, (gym.Env, VectorEnv)):
        accepted = "a name, a model or an object with predict; environments come after it"
        return UserError(f"agent must be {accepted}, got the environment {agent}")
    kind, _, seed = str(agent).rpartition("-")
    if kind in AGENTS and seed.isdigit():
        reason = f"{kind} is not trained, so it has no number"
        if count := AGENTS[kind].training_seeds:
            reason = f"{count} are shipped, {kind}-0 to {kind}-{count - 1}"
        return UserError(f"agent {agent!r} is not accepted: {reason}")
    names = [name for name in re.split(r"[,;\s]+", str(agent)) if name]
    if len(names) > 1 and not AGENTS.keys().isdisjoint(names):
        apart = f"separate names, {' '.join(names)} (in Python a list, {names})"
        return UserError(f"agents must be {apart}, got {agent!r}")
    return unknown(
        "agent",
        agent,
        AGENTS,
        "NAME-SEED of a trained one (ppo-3), 'module:name', an object with predict",
        "the path of a policy's file or folder or of a model's .zip",
    )


def make_agent(
    name: AgentLike,
    env: gym.Env[Any, Any],
    *,
    interface: Any = None,
    allow_pickle: bool = False,
    statistics: Statistics = (),
) -> Agent[Any]:
    """Make an agent for an environment, wrapped or not.

    Args:
        name: a key of `AGENTS`, "NAME-SEED" such as "ppo-3", the path of your own policy such as
            "runs/ppo-1/ppo-1.json", or "module:function"; see `resolve` for all.
        env: a reaching environment; the agent is given its segment lengths and control mode.
        interface: for an environment that is not of this package, the `ReachInterface` that you
            wrote for it, "module:name" of one, or a function of the environment that returns one.
        allow_pickle: whether files that hold pickles may be loaded, see `resolve`.
        statistics: of a model of stable-baselines3, see `resolve_all`.

    Raises:
        CannotActError: for an environment that the agent cannot act in.
        FileNotFoundError: if a file of the policy is missing.

    >>> import gymnasium as gym, mmc_gym
    >>> env = gym.make("MMCReach-v0")
    >>> agent, state = make_agent("mmc", env), None
    >>> observation, info = env.reset(seed=0)
    >>> for _ in range(100):
    ...     action, state = agent.predict(observation, state)
    ...     observation, reward, terminated, truncated, info = env.step(action)
    >>> bool(info["is_success"])
    True
    """
    if interface is not None:
        env = InterfacedEnv(env, interface)
    (agent,) = resolve_all(
        [name], allow_pickle=allow_pickle, every_training=False, statistics=statistics
    )
    return cast("Agent[Any]", agent.factory(env))
