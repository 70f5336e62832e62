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

import hashlib
import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cache, cached_property, partial
from glob import glob
from importlib.resources import files
from importlib.util import find_spec
from os.path import exists
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, cast

import cloudpickle
import gymnasium as gym
from gymnasium.vector import VectorEnv

from mmc_gym._errors import UserError, is_whole, require, unknown
from mmc_gym._files import import_object, look_here
from mmc_gym.agents.base import (
    Agent,
    Predictor,
    function_agent,
    raised,
    refusal,
    require_plain,
    warn_of_another_arm,
    why_no_action,
    with_whole_signature,
)
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
from mmc_gym.agents.sb3 import SUFFIX, ModelAgent, SavedModel, as_agent, models_in
from mmc_gym.interface import CONTROLS, CannotActError, Control, InterfacedEnv, ReachInterface

if TYPE_CHECKING:
    from mmc_gym.agents.policy import PolicyCard

Factory: TypeAlias = Callable[[gym.Env[Any, Any]], Predictor]
AgentLike: TypeAlias = "str | Path | Predictor | Factory | Callable[[Any], Any]"
Agents: TypeAlias = "str | Iterable[AgentLike] | Mapping[str, AgentLike | Sequence[AgentLike]]"
"""Agents, in order; a mapping gives them labels, and a list in it is several trainings of one."""

_LONGEST_LABEL = 100  # labels are part of the names of files


@dataclass(frozen=True, eq=False)
class ResolvedAgent:
    """An agent, or one of its trainings.

    Its files are read and its module is imported when they are first needed, again in each process
    that it is sent to.
    """

    label: str  #: the agent's name in tables and data
    #: the name from which `resolve` finds it again: "mmc", "ppo-3", "runs/ppo-1.json" or
    #: "module:function"; empty for functions and objects
    source: str
    name: str = ""  #: its key in `AGENTS`, or `REFERENCE`; empty if it does not ship
    policy: Path | None = None  #: the path of its policy; None if it has none
    #: its model of stable-baselines3, or the file of one; None if it has none
    model: SavedModel | ModelAgent | None = None
    given: Any = None  #: the function or object itself; None for a name or a model
    #: the place of this training among several whose files do not tell their seeds
    number: int | None = None

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
        """The model, function or object that was given, is loaded, or is imported by its name."""
        if self.given is not None:
            return self.given
        if self.model is not None:
            return self.model.load() if isinstance(self.model, SavedModel) else self.model
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
        """The seed of its training, from its files or counted; None if untrained or unknown."""
        if self.number is not None:
            return self.number
        if self.card is not None:
            return self.card.seed
        return None if self.model is None else self.model.training_seed

    @property
    def training_steps(self) -> int | None:
        """Environment steps of its training; 0 without one, None if they are not known."""
        if self.card is not None:
            return self.card.training_steps
        if self.model is not None:
            return self.model.training_steps
        steps = 0 if self.name else getattr(self._thing, "training_steps", None)
        return int(steps) if is_whole(steps) else None

    @property
    def source_name(self) -> str:
        """Its source; or for functions and objects a name that stands for it."""
        return self.source or f"given:{self.label}"

    @property
    def is_reference(self) -> bool:
        """Whether it is the ideal hand, which needs no arm."""
        return self.name == REFERENCE

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
        """The only control mode that it acts by; None if it acts by several, or it is not known.

        An object may have an attribute `control` that says so.
        """
        if self.name and self.card is None:
            return None
        known = getattr(self.card or self.model or self._thing, "control", None)
        return known if isinstance(known, str) and known in CONTROLS else None

    @property
    def knowledge(self) -> Knowledge:
        """Its kind, what it is given, and what it senses; of a policy, as its card says."""
        if self.card is not None:
            kind: Kind = "learned" if self.name else "yours"
            card, memory = self.card, sum(self.card.blocks)
            return learned_knowledge(card.view, card.base_agent, kind, memory=memory)
        if self.model is not None:
            return learned_knowledge("arm", kind="yours")
        if self.is_reference:
            return IDEAL
        return self.entry.knowledge if self.entry else UNKNOWN

    @cached_property
    def fingerprint(self) -> str:
        """A digest (SHA-256) of what it is made of; another one is another agent.

        A policy is made of its weights, and of the code if it corrects another agent; a model of
        its weights and statistics; an agent without a policy of the code of all agents and of the
        network; "module:function" of the module's file, and an object of its pickle.  A change of
        what these import or read goes unnoticed.  Empty where nothing is known.
        """
        if self.card is not None:
            if not self.card.base_agent:
                return self.card.sha256
            return hashlib.sha256((self.card.sha256 + code_digest()).encode()).hexdigest()
        if self.model is not None:
            return self.model.digest
        if self.name:
            return "" if self.is_reference else code_digest()
        return _digest_of_module(self.source) if self.source else _digest_of_pickle(self.given)

    def check(self) -> None:
        """Import its module or read its files; raise what `factory` and `card` raise."""
        _ = self.factory, self.card

    def __getstate__(self) -> dict[str, Any]:
        # The fingerprint travels along: pickles of one object may differ between processes.
        kept = {"fingerprint", *(field.name for field in fields(self))}
        return {name: value for name, value in vars(self).items() if name in kept}


def resolve(agent: AgentLike, *, allow_pickle: bool = False) -> ResolvedAgent:
    """Return the agent of a name, path, function or object; of several trainings, the first.

    Args:
        agent: a name or path as above, a model of stable-baselines3, or another object with
            `predict`.  Or a function or class: called with the environment it returns such an
            object, or else called with an observation it returns an action.  "ppo" is its training
            of seed 0.  Folders are those that `mmc-gym train` and rl_zoo3 write.  Modules are found
            in the working directory, too.
        allow_pickle: whether files with pickles may be loaded, such as those of stable-baselines3.
            That runs whatever code they name.

    >>> resolve("ppo-3").name, resolve("ppo-3").training_seed, resolve("mmc").training_seed
    ('ppo', 3, None)
    >>> resolve("mine=mmc").label
    'mine'
    """
    return _trainings([agent], "", allow_pickle, every_training=False)[0]


def resolve_all(
    agents: Agents, *, allow_pickle: bool = False, every_training: bool = True
) -> list[ResolvedAgent]:
    """Return each training of each agent, in the order given, and check all of them.

    Args:
        agents: one or several, see `resolve`; see `Agents` for a mapping.
        allow_pickle: see `resolve`.
        every_training: whether the name of an agent that ships trained, such as "ppo", stands for
            all its trainings; or else for that of seed 0.

    Raises:
        UserError: also for none, or two of the same label and training seed.
        FileNotFoundError: if a file is missing.

    >>> [(one.label, one.training_seed) for one in resolve_all(["mmc", "mine=ppo-3"])]
    [('mmc', None), ('mine', 3)]
    """
    accepted = "a list of agents, such as ['mmc', 'ppo'], or a mapping"
    require(isinstance(agents, Iterable), "agents", agents, accepted)
    found = []
    listed = [agents] if isinstance(agents, str) else agents
    pairs: Any = agents.items() if isinstance(agents, Mapping) else (("", one) for one in listed)
    for label, given in pairs:
        _check_label(label)
        several = given if isinstance(given, (list, tuple)) else [given]
        found += _trainings(several, label, allow_pickle, every_training)
    if not found:
        raise UserError("agents must be one or more, such as mmc and ppo, got none")
    for one in found:
        one.check()
    counts = Counter((one.label, one.training_seed) for one in found)
    (label, _), count = counts.most_common(1)[0]
    if count > 1:
        raise UserError(
            f"agents must have different names, got {label} repeatedly; LABEL=... gives another"
        )
    return found


def _trainings(
    sources: Sequence[AgentLike], label: str, allow_pickle: bool, every_training: bool
) -> list[ResolvedAgent]:
    """Return the trainings of one agent, by their own seeds if all differ, or else counted."""
    if not sources:
        raise UserError(f"agents must be given with at least one training, got none of {label!r}")
    found = []
    for source in sources:
        if isinstance(source, (str, Path)):
            own_label, name = _labelled(str(source))
            common_label, names = _expanded(name, every_training)
            label = label or own_label or common_label
            found += [_resolve_name(one, allow_pickle) for one in names]
        else:
            found.append(_resolve_object(source))
    if len(found) > 1:
        seeds = [one.training_seed for one in found]
        if None in seeds or len(set(seeds)) < len(seeds):
            found = [replace(one, number=number) for number, one in enumerate(found)]
    return [replace(one, label=label) for one in found] if label else found


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
    """Raise a `UserError` unless it is a label that a file's name can hold."""
    accepted = f"a text of at most {_LONGEST_LABEL} characters"
    fine = isinstance(label, str) and len(label.encode(errors="replace")) <= _LONGEST_LABEL
    require(fine, "the label of an agent", label, accepted)


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
    found = [path for path in glob(pattern) if path.endswith(suffixes) or Path(path).is_dir()]
    if not found:
        raise UserError(f"agents must match a file or a folder, got {pattern!r}")
    # With numbers equally long, texts are in the order of their numbers.
    return sorted(found, key=lambda path: re.sub(r"\d+", lambda digits: digits[0].zfill(20), path))


def _common_label(pattern: str) -> str:
    """Return a label for the trainings of a pattern: "mine" of "runs/mine-*.zip"."""
    parts = [part for part in Path(pattern).parts if part.strip("*")]
    name = next((part for part in reversed(parts) if "*" in part), parts[-1] if parts else pattern)
    return re.sub(r"\.(zip|json|safetensors)$|\*", "", name).strip("-_.") or pattern


def _resolve_object(agent: Any) -> ResolvedAgent:
    agent = as_agent(agent)
    if isinstance(agent, ModelAgent):
        return ResolvedAgent(agent.label, "", model=agent)
    if hasattr(agent, "predict") or callable(agent):
        label = getattr(agent, "__name__", type(agent).__name__)
        return ResolvedAgent(label, "", given=agent)
    raise _unknown(agent)


def _resolve_name(name: str, allow_pickle: bool) -> ResolvedAgent:
    if name == REFERENCE or (name in AGENTS and not AGENTS[name].training_seeds):
        return ResolvedAgent(name, name, name)
    from mmc_gym.agents.policy import SUFFIXES, shipped_file

    kind, _, seed = (name, "", "0") if name in AGENTS else name.rpartition("-")
    if kind in AGENTS and seed in map(str, range(AGENTS[kind].training_seeds)):
        path = shipped_file(kind, int(seed))
        return ResolvedAgent(name, path.stem, kind, path)
    path, label = Path(name), Path(name).stem
    if name and path.is_dir():
        path, label = _agent_in(path), path.resolve().name
    if path.suffix in SUFFIXES:
        return ResolvedAgent(label, name, policy=path)
    if path.suffix == SUFFIX:
        return ResolvedAgent(label, name, model=SavedModel(path, allow_pickle))
    if ":" in name and not name.startswith("."):  # relative imports are not accepted
        return ResolvedAgent(name, name)
    raise _unknown(name)


def _agent_in(folder: Path) -> Path:
    """Return the file of the only policy in a folder, or else of the only model."""
    cards = sorted(folder.glob("*.json"))
    policies = [one for one in cards if one.with_suffix(".safetensors").is_file()]
    found = policies or models_in(folder)
    if len(found) != 1:
        raise UserError(
            f"agent '{folder}' must be a folder with one policy, with best_model.zip, or with one "
            f"zip file of stable-baselines3, got {', '.join(one.name for one in found) or 'none'}"
        )
    return found[0]


def _unknown(agent: object) -> UserError:
    is_path = isinstance(agent, str) and ("/" in agent or "\\" in agent)
    if is_path and not Path(str(agent)).exists():
        return UserError(f"agent {agent!r} must be a name or a path, and there is no such file")
    if isinstance(agent, (gym.Env, VectorEnv)):
        accepted = "a name, a model or an object with predict; environments come after it"
        return UserError(f"agent must be {accepted}, got the environment {agent}")
    kind, _, seed = str(agent).rpartition("-")
    if kind in AGENTS and seed.isdigit():
        count = AGENTS[kind].training_seeds
        known = f"{count} are shipped, {kind}-0 to {kind}-{count - 1}"
        known = known if count else f"{kind} is not trained, so it has no number"
        return UserError(f"agent {agent!r} is not accepted: {known}")
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


def _no_arm(env: object) -> Predictor:
    raise CannotActError(f"{REFERENCE!r} is a hand without an arm, which acts in no environment")


def _make_policy(path: Path, env: gym.Env[Any, Any]) -> Predictor:
    """Make the agent of a policy; warn of an arm that differs from the one on its card."""
    from mmc_gym.agents.policy import PolicyAgent, load_policy

    require_plain(env)
    network, card = load_policy(path)
    agent = PolicyAgent(network, card, ReachInterface.of(env))
    warn_of_another_arm(card.file_stem, card.body, env)
    return agent


def _made(given: Any, label: str, env: gym.Env[Any, Any]) -> Predictor:
    """Make the agent of a function, a class or an object for an environment."""
    agent, failure = given, None
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
    """Raise a `UserError` for a function or class that cannot be called with an environment."""
    is_agent = not isinstance(given, type) or hasattr(given, "predict")
    require(is_agent, f"agent {label!r}", given, "a class with predict")
    if error := refusal(given, None):
        name = getattr(given, "__name__", "a function")
        accepted = f"{name}(env), called with the environment alone"
        raise UserError(f"agent {label!r} must be {accepted}, got {given}: {error}") from error


def _digest_of_module(source: str) -> str:
    look_here()
    try:
        spec = find_spec(source.partition(":")[0])
    except (ImportError, ValueError):  # no such package, or __main__, which has no spec
        spec = None
    file = Path(spec.origin) if spec is not None and spec.origin else Path()
    return hashlib.sha256(file.read_bytes()).hexdigest() if file.is_file() else ""


def _digest_of_pickle(thing: Any) -> str:
    try:
        return hashlib.sha256(cloudpickle.dumps(thing)).hexdigest()
    except Exception:  # it cannot be pickled; a worker raises the same error
        return ""


@cache
def code_digest() -> str:
    """Return the SHA-256 of the code and weights of all agents that have no policy."""
    package = Path(str(files("mmc_gym")))
    patterns = ("interface.py", "agents/**/*.py", "network/**/*.py", "*/weights/*")
    digest = hashlib.sha256()
    for part in sorted(part for pattern in patterns for part in package.glob(pattern)):
        digest.update(part.relative_to(package).as_posix().encode() + b"\0")
        digest.update(hashlib.sha256(part.read_bytes()).digest())
    return digest.hexdigest()


def make_agent(
    name: AgentLike, env: gym.Env[Any, Any], *, interface: Any = None, allow_pickle: bool = False
) -> Agent[Any]:
    """Make an agent for an environment, wrapped or not.

    Args:
        name: a key of `AGENTS`, "NAME-SEED" such as "ppo-3", the path of your own policy such as
            "runs/ppo-1/ppo-1.json", or "module:function"; see `resolve` for all.
        env: a reaching environment; the agent is given its segment lengths and control mode.
        interface: for an environment that is not of this package, the `ReachInterface` that you
            wrote for it, "module:name" of one, or a function of the environment that returns one.
        allow_pickle: whether files that hold pickles may be loaded, see `resolve`.

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
    >>> info["is_success"]
    True
    """
    if interface is not None:
        env = InterfacedEnv(env, interface)
    return cast("Agent[Any]", resolve(name, allow_pickle=allow_pickle).factory(env))
