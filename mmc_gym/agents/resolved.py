"""`ResolvedAgent`: what is known about an agent, and how to make it for an environment.

`mmc_gym.agents.resolver` parses the names of agents, and returns these objects.
"""

from __future__ import annotations

import inspect
import traceback
from collections.abc import Callable
from contextlib import suppress
from copy import deepcopy
from dataclasses import dataclass, fields
from functools import cache, cached_property, partial
from importlib.resources import files
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, TypeAlias, cast

import gymnasium as gym
import numpy as np

from mmc_gym._errors import UserError, is_whole, require
from mmc_gym._files import digest_files, import_object
from mmc_gym._identity import identity
from mmc_gym.agents.base import Predictor, require_plain, warn_of_another_arm
from mmc_gym.agents.registry import (
    AGENTS,
    IDEAL,
    REFERENCE,
    UNKNOWN,
    AgentEntry,
    Kind,
    Knowledge,
    learned_knowledge,
)
from mmc_gym.agents.sb3 import AsTrained, ModelAgent, SavedModel, as_agent
from mmc_gym.interface import CONTROLS, CannotActError, Control, ReachInterface, read_attribute

if TYPE_CHECKING:
    from mmc_gym.agents.policy import PolicyCard

Factory: TypeAlias = Callable[[gym.Env[Any, Any]], Predictor]


@dataclass(frozen=True, eq=False)
class ResolvedAgent:
    """An agent, or one of its trainings.

    Files are read and modules are imported when they are first needed, and again in each process
    that this object is sent to.
    """

    label: str  #: the agent's name in tables and data
    #: the name from which `resolve` finds it again: "mmc", "ppo-3", "runs/ppo-1.json" or
    #: "module:function"; empty for functions and objects
    source: str
    name: str = ""  #: its key in `AGENTS`, or `REFERENCE`; empty if it does not ship
    policy: Path | None = None  #: the path of its policy; None if it has none
    #: its stable-baselines3 model, or the file of the model; None if it has none
    model: SavedModel | ModelAgent | None = None
    given: Any = None  #: the function or object itself; None for a name or a model
    #: which of several trainings this is, if their files do not say their seeds
    number: int | None = None
    #: a function, or "module:function", that puts an environment into the wrappers of its training
    wrapper: Any = None

    @property
    def arguments(self) -> dict[str, Any]:
        """Arguments that its environment must be made with: to show the context it learnt with."""
        source = self.model if self.card is None else self.card
        context = getattr(source, "context", [])  # the file of a model does not know it
        return {"observe_context": context} if context else {}

    def wrapped(self, env: gym.Env[Any, Any]) -> gym.Env[Any, Any]:
        """Return `env` inside the wrappers that the agent was trained in; `env` if it has none."""
        if self.wrapper is None:
            return env
        try:
            made = self._wrap(env)
        except Exception as error:  # whatever the user's code raises
            message = f"wrapper {self.wrapper!r} must take a single environment, it {raised(error)}"
            raise UserError(message) from error
        accepted = "a function that returns an environment in its wrappers"
        require(isinstance(made, gym.Env), "wrapper", self.wrapper, accepted)
        return AsTrained(made)

    @cached_property
    def _wrap(self) -> Any:
        given = self.wrapper
        found = import_object(given, "wrapper") if isinstance(given, str) else given
        require(callable(found) or given is None, "wrapper", given, "a function")
        return found

    @cached_property
    def factory(self) -> Factory:
        """The function that makes the agent for an environment; a missing file raises an error."""
        if self.policy is not None:
            return partial(_make_policy, self.policy)
        if self.name:
            return _no_arm if self.entry is None else self.entry.make
        return partial(_made, self._thing, self.label)

    @cached_property
    def _thing(self) -> Any:
        """The model, function or object: as given, loaded from its file, or imported by name."""
        if self.given is not None:
            return self.given
        if self.model is not None:
            return self.model.load()
        found = import_object(self.source, "agent")
        fine = callable(found) or hasattr(found, "predict")
        require(fine, f"agent {self.source!r}", found, "a function of the environment")
        return as_agent(found)

    @cached_property
    def card(self) -> PolicyCard | None:
        """The card of its policy; None if it has none.  A missing file raises an error."""
        if self.policy is None:
            return None
        from mmc_gym.agents.policy import load_policy

        return load_policy(self.policy)[1]

    @property
    def training_seed(self) -> int | None:
        """The seed of its training: `number`, or from its files; None if untrained or unknown."""
        if self.number is not None:
            return self.number
        if self.card is not None:
            return self.card.seed
        return None if self.model is None else self.model.training_seed

    @property
    def training_steps(self) -> int | None:
        """Number of environment steps of its training; 0 if untrained, None if not known."""
        if self.card is not None:
            return self.card.training_steps
        if self.model is not None:
            return self.model.training_steps
        steps = 0 if self.name else getattr(self._thing, "training_steps", None)
        return int(steps) if is_whole(steps) else None

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

    @property
    def control(self) -> Control | None:
        """The only control mode in which it is compared; None: the mode of the environment."""
        return self.own_control or (self.entry.control if self.entry else None)

    @property
    def own_control(self) -> Control | None:
        """The only control mode that the agent can act in; None if several, or not known.

        An object may name the mode in an attribute `control`.
        """
        if self.name and self.card is None:
            return None
        control = getattr(self.card or self.model or self._thing, "control", None)
        return control if isinstance(control, str) and control in CONTROLS else None

    @property
    def knowledge(self) -> Knowledge:
        """The agent's kind, what it is given and what it senses; for a policy, from its card."""
        if self.card is not None:
            kind: Kind = "learned" if self.name else "yours"
            card, memory = self.card, sum(self.card.blocks)
            context = bool(card.context)
            return learned_knowledge(card.base_agent, kind, memory=memory, context=context)
        if self.model is not None:
            return learned_knowledge(kind="yours")
        if self.is_reference:
            return IDEAL
        return self.entry.knowledge if self.entry else UNKNOWN

    @cached_property
    def fingerprint(self) -> str:
        """SHA-256 digest of the agent and its wrapper; a new digest means a new agent.

        Empty for the ideal hand.
        """
        parts = [*self._parts, *([] if self.wrapper is None else [self.wrapper])]
        return identity(*parts) if len(parts) > 1 else "".join(parts)

    @property
    def _parts(self) -> list[Any]:
        """What the agent depends on: digests, and things that have an `identity`.

        They are a policy's weights, and the code of this package's agents if it corrects one of
        them; a model's weights, statistics and classes; that code, for an agent of this package
        without a policy; or your own agent.
        """
        if self.card is not None:
            return [self.card.sha256, *([code_digest()] if self.card.base_agent else [])]
        if self.model is not None:
            is_loaded = getattr(self.model, "allow_pickle", True)
            return [self.model.digest, *(self._thing.classes if is_loaded else [])]
        if self.name:
            return [] if self.is_reference else [code_digest()]
        return [self.source, self.given]

    def check(self) -> None:
        """Import its module or read its files; raise what `factory` and `card` raise."""
        _ = self.factory, self.card, self._wrap

    def __getstate__(self) -> dict[str, Any]:
        # The fingerprint travels along: pickles of one object may differ between processes.
        kept = {"fingerprint", *(field.name for field in fields(self))}
        return {name: value for name, value in vars(self).items() if name in kept}


def _no_arm(env: object) -> Predictor:
    raise CannotActError(f"{REFERENCE!r} is a hand without an arm, which acts in no environment")


def _make_policy(path: Path, env: gym.Env[Any, Any]) -> Predictor:
    from mmc_gym.agents.policy import PolicyAgent, load_policy

    require_plain(env)
    network, card = load_policy(path)
    if card.context and read_attribute(env, "context_scale") != card.context:
        raise CannotActError(
            f"env must show the context as in the training of {card.file_stem}: make it with "
            f"observe_context={card.context}"
        )
    agent = PolicyAgent(network, card, ReachInterface.of(env))
    warn_of_another_arm(card.file_stem, card.body, env)
    return agent


def _made(given: Any, label: str, env: gym.Env[Any, Any]) -> Predictor:
    """Make an agent from an object, a class, or a function of environments or observations."""
    agent, failure = given, cast("Exception | None", None)
    if isinstance(given, type) or not hasattr(given, "predict"):
        _check_takes_env(given, label)
        try:
            agent = as_agent(given(env))
        except CannotActError:
            raise
        except Exception as error:  # it may be a function of observations
            agent, failure = None, error
    if isinstance(agent, ModelAgent):
        return agent.acting_in(env)
    if hasattr(agent, "predict"):
        return with_whole_signature(agent)
    if isinstance(given, type):
        raise failure or UserError(f"agent {label!r} must be a class with predict, got {agent!r}")
    if not (why := why_no_action(given, env)):
        return function_agent(given)
    seen = f"returned {agent!r}" if failure is None else raised(failure)
    if failure is not None and why == seen:  # its own mistake, whatever it is called with
        raise failure
    raise UserError(
        f"agent {label!r} must return an object with predict for an environment, or an action for "
        f"an observation; for an observation it {why}; for the environment it {seen}"
    ) from failure


def _check_takes_env(given: Any, label: str) -> None:
    is_agent = not isinstance(given, type) or hasattr(given, "predict")
    require(is_agent, f"agent {label!r}", given, "a class with predict")
    if error := refusal(given, None):
        name = getattr(given, "__name__", "a function")
        accepted = f"{name}(env), called with the environment alone"
        raise UserError(f"agent {label!r} must be {accepted}, got {given}: {error}") from error


def refusal(function: Callable[..., Any], *arguments: Any, **more: Any) -> TypeError | None:
    """Return the error if a function does not take these arguments; None if it may take them."""
    with suppress(ValueError):  # Python does not know its signature
        try:
            inspect.signature(function).bind(*arguments, **more)
        except TypeError as error:
            return error
    return None


def why_no_action(function: Callable[[Any], Any], env: gym.Env[Any, Any]) -> str:
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


def function_agent(function: Callable[[Any], Any]) -> Predictor:
    """Return an agent whose `predict` calls `function` with the observation alone.

    The function returns an action, or an action and a state.
    """

    def predict(
        observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[Any, Any]:
        given = function(observation)
        return given if isinstance(given, tuple) and len(given) == 2 else (given, None)

    return SimpleNamespace(predict=predict)


def with_whole_signature(agent: Any) -> Predictor:
    """Return the agent; if its `predict` takes an observation alone, wrap it to take all four."""
    if refusal(agent.predict, None, None, None, deterministic=True):
        whole: Any = function_agent(agent.predict)
        if hasattr(agent, "between_trials"):
            whole.between_trials = agent.between_trials
        return cast(Predictor, whole)
    return cast(Predictor, agent)


@cache
def code_digest() -> str:
    """Return the SHA-256 of the code and weights of all agents that have no policy."""
    package = Path(str(files("mmc_gym")))
    rooms = ("agents/**/*.py", "network/**/*.py", "robots/**/*.py", "*/weights/*")
    return digest_files(package, "interface/*.py", "geometry.py", *rooms)
