"""Finding out which agent is meant: by a name, the path of a file, a function or an object.

Nothing else in the package takes an agent's name apart.
"""

from __future__ import annotations

import hashlib
import inspect
from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, cast

import cloudpickle
import gymnasium as gym
import numpy as np

from mmc_gym._errors import UserError, nearest, unknown
from mmc_gym._modules import import_object, look_here
from mmc_gym.agents.base import Agent, Predictor
from mmc_gym.agents.registry import (
    AGENTS,
    UNKNOWN,
    AgentEntry,
    Kind,
    Knowledge,
    learned_knowledge,
)
from mmc_gym.agents.sb3 import (
    SUFFIX,
    ModelAgent,
    SavedModel,
    agent_of_model,
    find_model,
    is_model,
)
from mmc_gym.interface import CONTROLS, CannotActError, Control

if TYPE_CHECKING:
    from mmc_gym.agents.policy import PolicyCard

Factory: TypeAlias = Callable[[gym.Env[Any, Any]], Predictor]
AgentLike: TypeAlias = "str | Path | Predictor | Factory | Callable[[Any], Any]"


@dataclass(frozen=True, eq=False)
class ResolvedAgent:
    """The agent that a name, a path, a function or an object stands for.

    Files are read and modules imported when they are asked for; `check` asks for all.

    Attributes:
        label: its name; the name of its file without suffix, or of its folder, function or class.
        source: by which `resolve` finds it again, in another process too: "mmc", "ppo-3",
            "runs/ppo-1.json" or "module:function"; empty for functions and objects.
        name: its key in `AGENTS`; empty if it does not ship with the package.
        policy: the path of its policy; None if it has none.
        model: its file of stable-baselines3; None if it has none.
        given: what was handed in, if it was no name.
        asked: the control mode that the user says it acts by; None if nothing is said.
        allow_pickle: whether its pickles may be loaded.
    """

    label: str
    source: str
    name: str = ""
    policy: Path | None = None
    model: SavedModel | None = None
    given: Any = None
    asked: Control | None = None
    allow_pickle: bool = False

    @cached_property
    def factory(self) -> Factory:
        """The function that makes it for an environment.

        Raises:
            FileNotFoundError: if a file is missing.
            UserError: if it cannot be imported, or is pickled and that is not allowed.
        """
        if self.policy is not None:
            from mmc_gym.agents.policy import load_agent

            return partial(load_agent, self.policy)
        if self.model is not None:
            return self._loaded.acting_in
        if self.name:
            return AGENTS[self.name].make
        return partial(_made, self._thing, self.label)

    @cached_property
    def _thing(self) -> Any:
        """What was handed in, or is imported by its name."""
        return _imported(self.source) if self.given is None else self.given

    @cached_property
    def _loaded(self) -> ModelAgent:
        assert self.model is not None
        if not self.allow_pickle:
            raise UserError(
                f"agent {self.source!r} holds pickles, and to load them runs whatever code they "
                "name: if you trust the file, say --allow-pickle (in Python: allow_pickle=True)"
            )
        loaded = self.model.load()
        if self.asked is not None:
            loaded.trained_in = loaded.trained_in._replace(control=self.asked)
        return loaded

    @cached_property
    def card(self) -> PolicyCard | None:
        """The card of its policy; None if it has none.

        Raises:
            FileNotFoundError: if a file of the policy is missing.
            UserError: if it is damaged.
        """
        if self.policy is None:
            return None
        from mmc_gym.agents.policy import load_policy

        return load_policy(self.policy)[1]

    @property
    def training_seed(self) -> int | None:
        """The seed of its training, as its files have it; None if it is not trained, or unknown."""
        if self.model is not None:
            return self.model.training_seed
        return None if self.card is None else self.card.seed

    @property
    def entry(self) -> AgentEntry | None:
        """Its entry in `AGENTS`; None if it does not ship with the package."""
        return AGENTS.get(self.name)

    @property
    def control(self) -> Control | None:
        """The control mode in which it is compared; None for that of the environment."""
        return self.own_control or (self.entry.control if self.entry else None)

    @property
    def own_control(self) -> Control | None:
        """The only control mode that it acts by, as far as is known; None if it acts by several."""
        if self.asked is not None:
            return self.asked
        if self.card is not None:
            return self.card.control
        if self.model is not None:
            return self.model.trained_in.control
        if self.name:
            return None
        said = getattr(self._thing, "control", None)
        if isinstance(said, str) and said in CONTROLS:
            return said
        return self._thing.trained_in.control if isinstance(self._thing, ModelAgent) else None

    @property
    def is_model(self) -> bool:
        """Tells whether it is a model of stable-baselines3, which acts by one control mode only."""
        return self.model is not None or isinstance(self.given, ModelAgent)

    @property
    def knowledge(self) -> Knowledge:
        """Its kind, what it is told, and what it senses; of a policy, as its card has it."""
        if self.card is not None:
            kind: Kind = "learned" if self.name else "yours"
            card, memory = self.card, sum(self.card.blocks)
            return learned_knowledge(card.view, card.base_agent, kind, memory=memory)
        if self.is_model:
            return learned_knowledge("arm", kind="yours")
        return self.entry.knowledge if self.entry else UNKNOWN

    @property
    def acts_on_batches(self) -> bool:
        """Tells whether it is known to act on batches: agents of this package and policies do."""
        return bool(self.name) or self.policy is not None or self.is_model

    @cached_property
    def fingerprint(self) -> str:
        """A digest (SHA-256) of what it is made of; another one is another agent.

        Of a policy these are its weights, together with the code if it corrects another agent; of
        a model its weights and statistics; of an agent without a policy the code of all agents and
        of the network; of "module:function" the module's file, and of what was handed in its
        pickle.  What that imports or reads may change unnoticed.  Empty where nothing is known.
        """
        if self.card is not None:
            if not self.card.base_agent:
                return self.card.sha256
            return hashlib.sha256((self.card.sha256 + code_digest()).encode()).hexdigest()
        if self.model is not None:
            return self.model.digest
        if self.name:
            return code_digest()
        if isinstance(self.given, ModelAgent):
            return self.given.digest
        if self.given is not None:
            return _digest_of_pickle(self.given)
        look_here()
        try:
            spec = find_spec(self.source.partition(":")[0]) if self.source else None
        except (ImportError, ValueError):  # no such package, or __main__, which has no spec
            spec = None
        file = Path(spec.origin) if spec is not None and spec.origin else Path()
        return hashlib.sha256(file.read_bytes()).hexdigest() if file.is_file() else ""

    def check(self) -> None:
        """Import its module, or read its policy or model.

        Raises:
            FileNotFoundError: if a file is missing.
            UserError: if it cannot be imported, is damaged, or is pickled and that is not allowed.
        """
        if self.model is not None:
            _ = self.model.facts  # a file that is missing, or no model, is told first
        _ = self.factory, self.card


def resolve(agent: AgentLike, *, allow_pickle: bool = False) -> ResolvedAgent:
    """Find out which agent is meant.

    Args:
        agent: one of

            - a key of `AGENTS`, which for trained agents is the training of seed 0,
            - "NAME-SEED", such as "ppo-3", for another of its trainings,
            - the path of a policy, of either of its two files; it may have any character in it,
            - the path of a zip file that a model of stable-baselines3 was saved to,
            - the path of a folder with one of these, such as those that `mmc-gym train` and
              rl_zoo3 write,
            - "module:name": a function or class in a module; modules in the working directory are
              found,
            - such a function or class itself: it is called with the environment and returns an
              object with `predict`; or, if it does not, it is called with observations and returns
              actions,
            - a model of stable-baselines3, or any other object with `predict`.

            "@" and a control mode may follow a name or path, "model.zip@joint_velocity"; an object
            may say it by an attribute `control`.
        allow_pickle: whether files that hold pickles may be loaded, which runs whatever code they
            name: those of stable-baselines3 do.

    Raises:
        UserError: if it is none of these.

    >>> resolve("ppo-3").name, resolve("ppo-3").training_seed, resolve("mmc").training_seed
    ('ppo', 3, None)
    >>> resolve("mmc@joint_velocity").control
    'joint_velocity'
    """
    if isinstance(agent, (str, Path)):
        return _resolve_name(str(agent), allow_pickle)
    if is_model(agent):
        made = agent_of_model(agent)
        return ResolvedAgent(made.label, "", given=made)
    if isinstance(agent, ModelAgent):
        return ResolvedAgent(agent.label, "", given=agent)
    if hasattr(agent, "predict") or callable(agent):
        label = cast(str, getattr(agent, "__name__", type(agent).__name__))
        return ResolvedAgent(label, "", given=agent)
    raise _unknown(agent)


def _resolve_name(name: str, allow_pickle: bool) -> ResolvedAgent:
    before, at, control = name.rpartition("@")
    if at and control in CONTROLS:
        found = _resolve_name(before, allow_pickle)
        return replace(found, source=name, asked=control)
    if name in AGENTS and not AGENTS[name].training_seeds:
        return ResolvedAgent(name, name, name)
    from mmc_gym.agents.policy import is_policy_path, shipped_file

    if is_policy_path(name):
        return ResolvedAgent(Path(name).stem, name, policy=Path(name))
    if name.endswith(SUFFIX):
        model = SavedModel(Path(name))
        return ResolvedAgent(Path(name).stem, name, model=model, allow_pickle=allow_pickle)
    kind, _, seed = (name, "", "0") if name in AGENTS else name.rpartition("-")
    if kind in AGENTS and seed in map(str, range(AGENTS[kind].training_seeds)):
        path = shipped_file(kind, int(seed))
        return ResolvedAgent(name, path.stem, kind, path)
    if name and Path(name).is_dir():
        return _resolve_folder(Path(name), name, allow_pickle)
    if ":" in name and not name.startswith("."):  # a relative import is none from here
        return ResolvedAgent(name, name)
    raise _unknown(name)


def _resolve_folder(folder: Path, name: str, allow_pickle: bool) -> ResolvedAgent:
    label = folder.resolve().name
    policies = [one for one in sorted(folder.glob("*.json")) if _has_weights(one)]
    if len(policies) == 1:
        return ResolvedAgent(label, name, policy=policies[0])
    path = None if policies else find_model(folder)
    if path is None:
        names = ", ".join(one.name for one in policies) or "none"
        raise UserError(
            f"agent {name!r} must be a folder with one policy, or with a zip file of "
            f"stable-baselines3, got {names}"
        )
    return ResolvedAgent(label, name, model=SavedModel(path), allow_pickle=allow_pickle)


def _has_weights(card: Path) -> bool:
    return card.with_suffix(".safetensors").is_file()


def _unknown(agent: object) -> UserError:
    is_path = isinstance(agent, str) and ("/" in agent or "\\" in agent)
    if is_path and not Path(str(agent)).exists():
        return UserError(f"agent {agent!r} must be a name or a path, and there is no such file")
    counts = {name: entry.training_seeds for name, entry in AGENTS.items()}
    trained = [f"{name}-{seed}" for name, count in counts.items() for seed in range(count)]
    return unknown(
        *("agent", agent, AGENTS),
        *("NAME-SEED of a trained one (ppo-3)", "'module:name'", "an object with predict"),
        "the path of a policy's file or folder or of a model's .zip",
        guess=nearest(agent, [*AGENTS, *trained]),
    )


def _imported(path: str) -> Any:
    found = import_object(path, "agent")
    if not callable(found) and not hasattr(found, "predict"):
        raise UserError(f"agent {path!r} must be a function of the environment, got {found!r}")
    return agent_of_model(found) if is_model(found) else found


def _made(given: Any, label: str, env: gym.Env[Any, Any]) -> Predictor:
    """Return the agent that a function, a class or an object stands for in an environment."""
    if isinstance(given, ModelAgent):
        return given.acting_in(env)
    if hasattr(given, "predict") and not isinstance(given, type):
        return _with_whole_signature(given)
    made, failure = None, None
    try:
        made = given(env)
    except CannotActError:
        raise
    except Exception as error:  # it may be a function of observations
        failure = error
    if is_model(made):
        return agent_of_model(made).acting_in(env)
    if hasattr(made, "predict"):
        return _with_whole_signature(made)
    if not isinstance(given, type) and _gives_actions(given, env):
        return FunctionAgent(given)
    if failure is not None:
        raise failure
    raise UserError(
        f"agent {label!r} must return an object with predict for an environment, or an action for "
        f"an observation, got {made!r}"
    )


def _gives_actions(function: Callable[[Any], Any], env: gym.Env[Any, Any]) -> bool:
    """Tell whether a function returns something of an action's shape for an observation."""
    space = deepcopy(env.observation_space)
    space.seed(0)
    try:
        action = np.asarray(function(space.sample()))
    except Exception:  # whatever it raises, it is no such function
        return False
    return action.shape == env.action_space.shape and action.dtype.kind in "fiub"


class FunctionAgent:
    """A function of observations that returns actions."""

    def __init__(self, function: Callable[[Any], Any]) -> None:
        """Make the agent of a function; it may return a pair as `predict` does."""
        self._function = function

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[Any, Any]:
        """Return the function's action."""
        given = self._function(observation)
        return given if isinstance(given, tuple) and len(given) == 2 else (given, None)


def _with_whole_signature(agent: Any) -> Predictor:
    """Return the agent itself, or one that spares it what its `predict` does not take."""
    try:
        inspect.signature(agent.predict).bind(None, None, None, deterministic=True)
    except TypeError:
        return FunctionAgent(agent.predict)
    except ValueError:  # it has no signature that Python knows
        pass
    return cast(Predictor, agent)


def _digest_of_pickle(thing: Any) -> str:
    try:
        return hashlib.sha256(cloudpickle.dumps(thing)).hexdigest()
    except Exception:  # whatever stands against it; a worker will say so
        return ""


@cache
def code_digest() -> str:
    """Return the SHA-256 of the code and the weights that agents without a policy are made of."""
    package = Path(str(files("mmc_gym")))
    parts = [package / "interface.py"]
    for folder in ("agents", "network"):
        parts += [*(package / folder).rglob("*.py"), *(package / folder / "weights").glob("*")]
    digest = hashlib.sha256()
    for part in sorted(parts):
        digest.update(part.relative_to(package).as_posix().encode() + b"\0")
        digest.update(hashlib.sha256(part.read_bytes()).digest())
    return digest.hexdigest()


def make_agent(
    name: AgentLike, env: gym.Env[Any, Any], *, allow_pickle: bool = False
) -> Agent[Any]:
    """Make an agent for an environment, wrapped or not.

    Args:
        name: a key of `AGENTS`, "NAME-SEED" such as "ppo-3", the path of your own policy such as
            "runs/ppo-1/ppo-1.json", or "module:function"; see `resolve` for all.
        env: a reaching environment; the agent is told its segment lengths and control mode.
        allow_pickle: whether files that hold pickles may be loaded, which runs whatever code they
            name: those of stable-baselines3 do.

    Raises:
        UserError: for an unknown name, a file that holds no policy, or what is no reaching
            environment; as `CannotActError`, for an environment that the agent cannot act in.
        FileNotFoundError: if a file of the policy is missing.

    >>> import gymnasium as gym, mmc_gym
    >>> env = gym.make("MMCReach-v0")
    >>> agent, state = make_agent("mmc", env), None
    >>> observation, info = env.reset(seed=0)
    >>> for _ in range(100):
    ...     action, state = agent.predict(observation, state)
    ...     observation, reward, terminated, truncated, info = env.step(action)
    >>> info["is_success"]
    True
    """
    return cast("Agent[Any]", resolve(name, allow_pickle=allow_pickle).factory(env))


def shipped_seeds(name: str) -> list[int]:
    """Return the training seeds of an agent whose policies are there; none if it is not trained."""
    from mmc_gym.agents.policy import shipped_file

    seeds = range(AGENTS[name].training_seeds)
    return [seed for seed in seeds if shipped_file(name, seed).is_file()]
