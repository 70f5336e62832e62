"""`ResolvedAgent`: what is known about an agent, and how to make it for an environment.

It is filled in once, by one function for each kind of source; `mmc_gym.agents.resolver` parses
names and calls them.  Nothing asks for the kind afterwards.
"""

from __future__ import annotations

import inspect
import traceback
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from copy import deepcopy
from dataclasses import dataclass, field
from functools import cache, cached_property, partial
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, cast

import gymnasium as gym
import numpy as np

from mmc_gym._errors import UserError, is_whole, require
from mmc_gym._files import digest_files, import_object
from mmc_gym._identity import identity
from mmc_gym.agents.base import Predictor
from mmc_gym.agents.registry import (
    AGENTS,
    IDEAL,
    REFERENCE,
    UNKNOWN,
    AgentEntry,
    Knowledge,
    learned_knowledge,
)
from mmc_gym.agents.sb3 import AsTrained, ModelAgent, SavedModel, as_agent
from mmc_gym.interface import CONTROLS, CannotActError, Control

if TYPE_CHECKING:
    from mmc_gym.agents.policy import PolicyCard

Factory: TypeAlias = Callable[[gym.Env[Any, Any]], Predictor]


@dataclass(frozen=True, eq=False)
class ResolvedAgent:
    """An agent, or one of its trainings: its facts, and the function that makes it."""

    label: str  #: the agent's name in tables and data
    #: the name from which `resolve` finds it again: "mmc", "ppo-3", "runs/ppo-1.json" or
    #: "module:function"; empty for functions and objects
    source: str
    #: makes the agent for an environment; files are read anew in each process
    factory: Factory
    #: returns what its actions depend on: digests, and things that have an `identity`
    parts: Callable[[], Sequence[Any]]
    knowledge: Knowledge = UNKNOWN  #: its kind, what it is given and what it senses
    name: str = ""  #: its key in `AGENTS`, or `REFERENCE`; empty if it does not ship
    #: the only control mode that it can act in; None if several, or not known
    own_control: Control | None = None
    #: the only control mode in which it is compared; None: the mode of the environment
    control: Control | None = None
    #: arguments that its environment must be made with: to show the context it learnt with
    arguments: Mapping[str, Any] = field(default_factory=dict)
    training_seed: int | None = None  #: the seed of its training; None if untrained or unknown
    training_steps: int | None = 0  #: environment steps of its training; None if not known
    card: PolicyCard | None = None  #: of its policy; None if it has none
    model: SavedModel | ModelAgent | None = None  #: of stable-baselines3; None if it has none
    #: a function, or "module:function", that puts an environment into the wrappers of its training
    wrapper: Any = None

    def wrapped(self, env: gym.Env[Any, Any]) -> gym.Env[Any, Any]:
        """Return `env` inside the wrappers that the agent was trained in; `env` if it has none."""
        wrap = import_wrapper(self.wrapper)
        if wrap is None:
            return env
        try:
            wrapped = wrap(env)
        except Exception as error:  # whatever the user's code raises
            message = f"wrapper {self.wrapper!r} must take a single environment, it {raised(error)}"
            raise UserError(message) from error
        accepted = "a function that returns an environment in its wrappers"
        require(isinstance(wrapped, gym.Env), "wrapper", self.wrapper, accepted)
        return AsTrained(wrapped)

    @property
    def source_name(self) -> str:
        """The agent's `source`; for functions and objects, "given:" and the label."""
        return self.source or f"given:{self.label}"

    @property
    def is_reference(self) -> bool:
        """Whether the agent is the ideal hand, which needs no arm."""
        return self.name == REFERENCE

    @property
    def entry(self) -> AgentEntry | None:
        """Its entry in `AGENTS`; None if it does not ship with the package."""
        return AGENTS.get(self.name)

    @cached_property  # it travels along: pickles of one object may differ between processes
    def fingerprint(self) -> str:
        """SHA-256 digest of the agent and its wrapper; a new digest means a new agent.

        Empty for the ideal hand.
        """
        parts = [*self.parts(), *([] if self.wrapper is None else [self.wrapper])]
        return identity(*parts) if len(parts) > 1 else "".join(parts)


def import_wrapper(wrapper: Any) -> Any:
    """Return the function of a `ResolvedAgent.wrapper`; None if there is none."""
    wrap = import_object(wrapper, "wrapper") if isinstance(wrapper, str) else wrapper
    require(callable(wrap) or wrapper is None, "wrapper", wrapper, "a function")
    return wrap


def ideal_hand(label: str) -> ResolvedAgent:
    """Return the ideal hand, which acts in no environment."""
    return ResolvedAgent(label, REFERENCE, _no_arm, tuple, IDEAL, name=REFERENCE)


def _no_arm(env: object) -> Predictor:
    raise CannotActError(f"{REFERENCE!r} is a hand without an arm, which acts in no environment")


def untrained_agent(name: str, label: str) -> ResolvedAgent:
    """Return an agent of this package that needs no training."""
    entry = AGENTS[name]
    knowledge, control = entry.knowledge, entry.control
    return ResolvedAgent(label, name, entry.make, _with_code, knowledge, name, control=control)


def policy_agent(path: Path, label: str, source: str, name: str = "") -> ResolvedAgent:
    """Return the agent of a policy, from its card; with a `name` it ships with the package.

    A policy depends on its weights, and on the code of this package's agents if it corrects one of
    them.
    """
    from mmc_gym.agents.policy import load_policy, make_policy

    _, card = load_policy(path)
    return ResolvedAgent(
        label,
        source,
        partial(make_policy, path),
        partial(_with_code, card.sha256) if card.base_agent else partial(tuple, [card.sha256]),
        learned_knowledge(
            card.base_agent,
            "learned" if name else "yours",
            memory=sum(card.blocks),
            context=bool(card.context),
        ),
        name,
        own_control=card.control,
        control=card.control,
        arguments={"observe_context": card.context} if card.context else {},
        training_seed=card.seed,
        training_steps=card.training_steps,
        card=card,
    )


def model_agent(model: SavedModel | ModelAgent, label: str, source: str = "") -> ResolvedAgent:
    """Return the agent of a stable-baselines3 model, loaded or in a file."""
    context, control = model.trained_in.context, _control_of(model)
    return ResolvedAgent(
        label,
        source,
        model.acting_in,
        model.parts,
        learned_knowledge(kind="yours"),
        own_control=control,
        control=control,
        arguments={"observe_context": [*context]} if context else {},
        training_seed=model.training_seed,
        training_steps=model.training_steps,
        model=model,
        wrapper=model.trained_in.wrap,
    )


def user_agent(thing: Any, label: str) -> ResolvedAgent:
    """Return the agent of your own function, class or object, or of "module:name" of one."""
    source, imported = (thing, _imported(thing)) if isinstance(thing, str) else ("", thing)
    steps, control = getattr(imported, "training_steps", None), _control_of(imported)
    return ResolvedAgent(
        label,
        source,
        partial(_make_user_agent, thing, label),
        partial(tuple, [source, None if source else thing]),
        own_control=control,
        control=control,
        training_steps=int(steps) if is_whole(steps) else None,
    )


def _control_of(thing: Any) -> Control | None:
    """Return the control mode that an object names in an attribute `control`, if any."""
    control = getattr(thing, "control", None)
    return control if isinstance(control, str) and control in CONTROLS else None


def _imported(source: str) -> Any:
    thing = import_object(source, "agent")
    is_agent = callable(thing) or hasattr(thing, "predict")
    require(is_agent, f"agent {source!r}", thing, "a function of the environment")
    return as_agent(thing)


def _make_user_agent(thing: Any, label: str, env: gym.Env[Any, Any]) -> Predictor:
    """Make an agent from an object, a class, or a function of environments or observations."""
    thing = _imported(thing) if isinstance(thing, str) else thing
    agent, failure = thing, cast("Exception | None", None)
    if isinstance(thing, type) or not hasattr(thing, "predict"):
        _check_takes_env(thing, label)
        try:
            agent = as_agent(thing(env))
        except CannotActError:
            raise
        except Exception as error:  # it may be a function of observations
            agent, failure = None, error
    if isinstance(agent, ModelAgent):
        return agent.acting_in(env)
    if hasattr(agent, "predict"):
        is_whole_signature = _refusal(agent.predict, None, None, None, deterministic=True) is None
        return cast(
            Predictor, agent if is_whole_signature else _FunctionAgent(agent.predict, agent)
        )
    if isinstance(thing, type):
        raise failure or UserError(f"agent {label!r} must be a class with predict, got {agent!r}")
    if not (why := _why_no_action(thing, env)):
        return _FunctionAgent(thing)
    seen = f"returned {agent!r}" if failure is None else raised(failure)
    if failure is not None and why == seen:  # its own mistake, whatever it is called with
        raise failure
    raise UserError(
        f"agent {label!r} must return an object with predict for an environment, or an action for "
        f"an observation; for an observation it {why}; for the environment it {seen}"
    ) from failure


def _check_takes_env(function: Any, label: str) -> None:
    is_agent = not isinstance(function, type) or hasattr(function, "predict")
    require(is_agent, f"agent {label!r}", function, "a class with predict")
    if error := _refusal(function, None):
        name = getattr(function, "__name__", "a function")
        accepted = f"{name}(env), called with the environment alone"
        if isinstance(function, type):
            accepted += f", or an object of the class, {name}(...)"
        raise UserError(f"agent {label!r} must be {accepted}, got {function}: {error}") from error


def _refusal(function: Callable[..., Any], *arguments: Any, **more: Any) -> TypeError | None:
    """Return the error if a function does not take these arguments; None if it may take them."""
    with suppress(ValueError):  # Python does not know its signature
        try:
            inspect.signature(function).bind(*arguments, **more)
        except TypeError as error:
            return error
    return None


def _why_no_action(function: Callable[[Any], Any], env: gym.Env[Any, Any]) -> str:
    """Return, in words, what a function does instead of giving an action; "" if it gives one."""
    space = deepcopy(env.observation_space)
    space.seed(0)
    try:
        action = np.asarray(function(space.sample()))
    except Exception as error:  # whatever the user's code raises
        return raised(error)
    shape = env.action_space.shape
    if action.shape == shape and action.dtype.kind in "fiub":
        return ""
    return f"returned {action.dtype} of shape {action.shape}, an action has {shape}"


def raised(error: Exception) -> str:
    """Return, in words, what a user's function raised, and its file and line."""
    frames = traceback.extract_tb(error.__traceback__)
    frame = frames[min(1, len(frames) - 1)]
    return f"raised {type(error).__name__}: {error} ({frame.filename}:{frame.lineno})"


class _FunctionAgent:
    """An agent that calls a function of the observation alone.

    The function returns an action, or an action and a state.  It may be the `predict` of `agent`,
    whose `between_trials` is kept.
    """

    def __init__(self, function: Callable[[Any], Any], agent: Any = None) -> None:
        self._function = function
        if hasattr(agent, "between_trials"):
            self.between_trials = agent.between_trials

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[Any, Any]:
        result = self._function(observation)
        return result if isinstance(result, tuple) and len(result) == 2 else (result, None)


def _with_code(*digests: str) -> tuple[str, ...]:
    """Return digests, and that of the code of this package's agents."""
    return (*digests, code_digest())


@cache
def code_digest() -> str:
    """Return the SHA-256 of the code and weights of all agents that have no policy."""
    package = Path(str(files("mmc_gym")))
    rooms = ("agents/**/*.py", "network/**/*.py", "robots/**/*.py", "*/weights/*")
    return digest_files(package, "interface/*.py", "geometry.py", *rooms)
