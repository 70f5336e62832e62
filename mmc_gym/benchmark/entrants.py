"""Who takes part in a comparison: agents by name, by `module:function`, or as objects."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias, cast

import gymnasium as gym

from mmc_gym.agents import agent_names, find_agent, is_policy_path
from mmc_gym.agents.base import ControlError
from mmc_gym.measures.rollout import Predictor

Factory: TypeAlias = Callable[[gym.Env[Any, Any]], Predictor]
AgentLike: TypeAlias = str | Predictor | Factory


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
        labelled = [(_label(agent), agent) for agent in agents]
    if not labelled:
        raise ValueError(f"agents must name at least one of {agent_names()}, got none")
    labels = [label for label, _ in labelled]
    repeated = sorted({label for label in labels if labels.count(label) > 1})
    if repeated:
        raise ValueError(f"agents must have different names, got {', '.join(repeated)} repeatedly")
    return {label: _factory(agent) for label, agent in labelled}


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


def _label(agent: AgentLike) -> str:
    if isinstance(agent, str):
        return Path(agent).stem if is_policy_path(agent) else agent
    return cast(str, getattr(agent, "__name__", type(agent).__name__))


def _factory(agent: AgentLike) -> Factory:
    if not isinstance(agent, str):
        if hasattr(agent, "predict") and not isinstance(agent, type):
            predictor = cast(Predictor, agent)
            return lambda env: predictor
        if callable(agent):
            return agent
    elif (make := find_agent(agent)) is not None:
        return make
    elif ":" in agent:
        return _imported(agent)
    raise ValueError(
        f"agents must be among {agent_names()}, or be given as 'module:function' or by the path "
        f"of a policy's file, got {agent!r}"
    )


def _imported(path: str) -> Factory:
    module_name, _, function_name = path.partition(":")
    # A console script, other than `python -m`, does not look into the working directory.
    here = str(Path.cwd())
    if here not in sys.path:
        sys.path.append(here)
    try:
        function = getattr(importlib.import_module(module_name), function_name)
    except (ImportError, AttributeError, ValueError) as error:
        raise ValueError(f"agent {path!r} cannot be imported: {error}") from error
    if not callable(function):
        raise ValueError(f"agent {path!r} must be a function of the environment, got {function!r}")
    return cast(Factory, function)
