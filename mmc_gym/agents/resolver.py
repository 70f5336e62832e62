"""Finding out which agent is meant: by a name, a policy's path, a function or an object.

Nothing else in the package takes an agent's name apart.
"""

from __future__ import annotations

import hashlib
import importlib
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property, partial
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, cast

import gymnasium as gym

from mmc_gym._errors import UserError
from mmc_gym.agents.base import Agent, Predictor
from mmc_gym.agents.registry import (
    AGENTS,
    UNKNOWN,
    AgentEntry,
    Kind,
    Knowledge,
    learned_knowledge,
)
from mmc_gym.interface import Control

if TYPE_CHECKING:
    from mmc_gym.agents.policy import PolicyCard

Factory: TypeAlias = Callable[[gym.Env[Any, Any]], Predictor]
AgentLike: TypeAlias = "str | Predictor | Factory"


@dataclass(frozen=True, eq=False)
class ResolvedAgent:
    """The agent that a name, a path, a function or an object stands for.

    Files are read and modules imported when they are asked for; `check` asks for all.

    Attributes:
        label: its name; a policy's file name without suffix; the name of a function or class.
        source: by which `resolve` finds it again, in another process too: "mmc", "ppo-3",
            "runs/ppo-1.json" or "module:function"; empty for functions and objects.
        name: its key in `AGENTS`; empty if it does not ship with the package.
        policy: the path of its policy; None if it has none.
        given: the function that makes it, if it was handed in; or one that returns the object.
    """

    label: str
    source: str
    name: str = ""
    policy: Path | None = None
    given: Factory | None = None

    @cached_property
    def factory(self) -> Factory:
        """The function that makes it for an environment.

        Raises:
            UserError: if it cannot be imported.
        """
        if self.given is not None:
            return self.given
        if self.policy is not None:
            from mmc_gym.agents.policy import load_agent

            return partial(load_agent, self.policy)
        return AGENTS[self.name].make if self.name else _imported(self.source)

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
        """The seed of its training, as its card has it; None if it is not trained, or unknown."""
        return None if self.card is None else self.card.seed

    @property
    def entry(self) -> AgentEntry | None:
        """Its entry in `AGENTS`; None if it does not ship with the package."""
        return AGENTS.get(self.name)

    @property
    def control(self) -> Control | None:
        """The control mode in which it is compared; None for that of the environment."""
        if self.card is not None:
            return self.card.control
        return self.entry.control if self.entry else None

    @property
    def knowledge(self) -> Knowledge:
        """Its kind, what it is told, and what it senses; of a policy, as its card has it."""
        if self.card is not None:
            kind: Kind = "learned" if self.name else "yours"
            return learned_knowledge(self.card.view, self.card.base_agent, kind)
        return self.entry.knowledge if self.entry else UNKNOWN

    @property
    def acts_on_batches(self) -> bool:
        """Tells whether it is known to act on batches: agents of this package and policies do."""
        return bool(self.name) or self.policy is not None

    @cached_property
    def fingerprint(self) -> str:
        """A digest (SHA-256) of what it is made of; another one is another agent.

        Of a policy these are its weights, together with the code if it corrects another agent; of
        an agent without a policy the code of all agents and of the network; of "module:function"
        the module's file.  What that file imports or reads may change unnoticed.  Empty where no
        file is known.
        """
        if self.card is not None:
            if not self.card.base_agent:
                return self.card.sha256
            return hashlib.sha256((self.card.sha256 + code_digest()).encode()).hexdigest()
        if self.name:
            return code_digest()
        look_here()
        try:
            spec = find_spec(self.source.partition(":")[0]) if self.source else None
        except (ImportError, ValueError):  # no such package, or __main__, which has no spec
            spec = None
        file = Path(spec.origin) if spec is not None and spec.origin else Path()
        return hashlib.sha256(file.read_bytes()).hexdigest() if file.is_file() else ""

    def check(self) -> None:
        """Import its module, or read its policy.

        Raises:
            FileNotFoundError: if a file of the policy is missing.
            UserError: if it cannot be imported, or the policy is damaged.
        """
        _ = self.factory, self.card


def resolve(agent: AgentLike) -> ResolvedAgent:
    """Find out which agent is meant.

    Args:
        agent: one of

            - a key of `AGENTS`, which for trained agents is the training of seed 0,
            - "NAME-SEED", such as "ppo-3", for another of its trainings,
            - the path of a policy, of either of its two files; it may have any character in it,
            - "module:function": a function or class that is called with the environment and
              returns an object with stable-baselines3's `predict`; modules in the working
              directory are found,
            - such a function or class itself,
            - an object with `predict`, such as a stable-baselines3 model.

    Raises:
        UserError: if it is none of these.

    >>> resolve("ppo-3").name, resolve("ppo-3").training_seed, resolve("mmc").training_seed
    ('ppo', 3, None)
    """
    if isinstance(agent, str):
        return _resolve_name(agent)
    label = cast(str, getattr(agent, "__name__", type(agent).__name__))
    if hasattr(agent, "predict") and not isinstance(agent, type):
        predictor = cast(Predictor, agent)
        return ResolvedAgent(label, "", given=lambda env: predictor)
    if callable(agent):
        return ResolvedAgent(label, "", given=agent)
    raise _unknown(agent)


def _resolve_name(name: str) -> ResolvedAgent:
    if name in AGENTS and not AGENTS[name].training_seeds:
        return ResolvedAgent(name, name, name)
    from mmc_gym.agents.policy import is_policy_path, shipped_file

    if is_policy_path(name):
        return ResolvedAgent(Path(name).stem, name, policy=Path(name))
    kind, _, seed = (name, "", "0") if name in AGENTS else name.rpartition("-")
    if kind in AGENTS and seed in map(str, range(AGENTS[kind].training_seeds)):
        path = shipped_file(kind, int(seed))
        return ResolvedAgent(name, path.stem, kind, path)
    if ":" in name and not name.startswith("."):  # a relative import is none from here
        return ResolvedAgent(name, name)
    raise _unknown(name)


def _unknown(agent: object) -> UserError:
    return UserError(
        f"agent must be one of {agent_names()}, or be given as 'module:function' or by the path "
        f"of a policy's file, got {agent!r}"
    )


def _imported(path: str) -> Factory:
    module_name, _, function_name = path.partition(":")
    look_here()
    try:
        function = getattr(importlib.import_module(module_name), function_name)
    except (ImportError, AttributeError, ValueError) as error:
        raise UserError(f"agent {path!r} cannot be imported: {error}") from error
    if not callable(function):
        raise UserError(f"agent {path!r} must be a function of the environment, got {function!r}")
    return cast(Factory, function)


def look_here() -> None:
    """Let modules in the working directory be found, as `python -m` does but no console script."""
    here = str(Path.cwd())
    if here not in sys.path:
        sys.path.append(here)


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


def make_agent(name: str, env: gym.Env[Any, Any]) -> Agent[Any]:
    """Make an agent for an environment, wrapped or not.

    Args:
        name: a key of `AGENTS`, "NAME-SEED" such as "ppo-3", the path of your own policy such as
            "runs/ppo-1/ppo-1.json", or "module:function"; see `resolve`.
        env: a reaching environment; the agent is told its segment lengths and control mode.

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
    return cast("Agent[Any]", resolve(name).factory(env))


def agent_names() -> str:
    """Return the names that `make_agent` accepts, for a message."""
    return ", ".join(
        f"{name} (or {name}-0 to {name}-{entry.training_seeds - 1})"
        if entry.training_seeds > 1
        else name
        for name, entry in AGENTS.items()
    )


def shipped_seeds(name: str) -> list[int]:
    """Return the training seeds of an agent whose policies are there; none if it is not trained."""
    from mmc_gym.agents.policy import shipped_file

    seeds = range(AGENTS[name].training_seeds)
    return [seed for seed in seeds if shipped_file(name, seed).is_file()]
