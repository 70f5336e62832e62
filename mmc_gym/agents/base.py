"""Base classes of all agents: the signature of `predict`, and how observations become actions.

An agent sees only observations, and is given a `ReachInterface`.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import fields
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Protocol, TypeVar

import gymnasium as gym
import numpy as np
from gymnasium.vector import VectorWrapper
from numpy.typing import NDArray
from typing_extensions import override

from mmc_gym._errors import UserError, require, warn_of_mismatch
from mmc_gym._errors import all_true as all_true
from mmc_gym._errors import any_true as any_true
from mmc_gym.geometry import Floats
from mmc_gym.interface import (
    CannotActError,
    Observation,
    ReachInterface,
    Seen,
    Sensed,
    read_attribute,
)
from mmc_gym.network import MMCState

if TYPE_CHECKING:  # `import mmc_gym` loads no physics
    from mmc_gym.body import ArmParameters

State = TypeVar("State")
Started = Sequence[bool] | NDArray[np.bool_] | None
Layouts = dict[tuple[int, ...], Any]  # the layout of an agent's states, by batch shape


class Predictor(Protocol):
    """Any object with the `predict` of stable-baselines3, for a single observation."""

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[Any, Any]:
        """Return the action for `observation`, and the state to hand back at the next step."""


class Agent(ABC, Generic[State]):
    """A controller with stable-baselines3's `predict`, for one observation or a batch."""

    training_steps: int = 0  #: environment steps that its training took

    def __repr__(self) -> str:
        """Return its class and, if it keeps an interface, joints and control mode."""
        interfaces = [value for value in vars(self).values() if isinstance(value, ReachInterface)]
        facts = [f"{len(each.segment_lengths)} joints, {each.control}" for each in interfaces]
        return f"{type(self).__name__}({', '.join(facts)})"

    @abstractmethod
    def predict(
        self,
        observation: Observation,
        state: State | None = None,
        episode_start: Started = None,
        deterministic: bool = False,
    ) -> tuple[NDArray[np.float32], State | None]:
        """Choose an action.

        Args:
            observation: of one environment, or of several with a leading batch axis.
            state: what the last call returned; None at the start.
            episode_start: for each environment, whether a new episode starts with this
                observation, so that its part of the state is made anew.
            deterministic: whether agents that explore act without exploration.

        Returns:
            The action, float32 within −1 and 1, and the state for the next call.
        """

    def begin(self, seeds: Sequence[int]) -> State | None:
        """Return the first state of episodes with these seeds; None if the agent draws nothing."""
        del seeds
        return None

    @property
    def learns(self) -> bool:
        """Whether the agent keeps anything between trials: it overrides `between_trials`."""
        return type(self).between_trials is not Agent.between_trials

    def between_trials(self, state: State | None, rest: float = 0.0) -> State | None:
        """Return the state that the agent keeps for the next trial; None by default.

        `state` is the last that `predict` returned; `rest` is the time before the next trial beyond
        the usual, in s.  The first `predict` of the next trial gets the kept state and no
        `episode_start`, so the kept state itself must say that another movement begins, in another
        posture.
        """
        del state, rest
        return None


class InternalModelAgent(Agent[State]):
    """An agent that has an internal model of the arm as its state, and acts by joint targets."""

    #: whether the agent moves an arm in space (`ReachInterface.arm`); if not, a planar arm
    is_in_space: ClassVar[bool] = False

    def __init__(self, interface: ReachInterface) -> None:
        """Make an agent for an environment; raise a `CannotActError` if it cannot act in it."""
        accepted = "a ReachInterface, such as ReachInterface.of(env)"
        require(isinstance(interface, ReachInterface), "interface", interface, accepted)
        interface.check_takes_joint_targets()
        if (interface.arm is not None) != self.is_in_space:
            accepted = "in space" if self.is_in_space else "in the plane"
            raise CannotActError(f"interface must be of an arm {accepted} for this agent")
        self.interface = interface
        self._layouts: Layouts = {}

    @abstractmethod
    def start(self, sensed: Sensed) -> State:
        """Return the first state of an episode: internal models in the sensed postures."""

    def _resumed(self, state: State | None, sensed: Sensed, episode_start: Started) -> State:
        batch = sensed.joint_angles.shape[:-1]
        return resumed(state, partial(self.start, sensed), batch, episode_start, self._layouts)


class JointTargetAgent(InternalModelAgent[State]):
    """An agent whose internal model needs no more than the sensed posture and target."""

    @abstractmethod
    def advance(self, state: State, sensed: Sensed) -> tuple[Floats, State]:
        """Return joint targets (..., N) in radians, and the state after one control step."""

    @override
    def predict(
        self,
        observation: Observation,
        state: State | None = None,
        episode_start: Started = None,
        deterministic: bool = False,
    ) -> tuple[NDArray[np.float32], State | None]:
        sensed = self.interface.sense(observation)
        state = self._resumed(state, sensed, episode_start)
        joint_targets, state = self.advance(state, sensed)
        action = self.interface.act(joint_targets, sensed)
        return self.interface.checked_action(action, joint_targets.shape[:-1]), state


class FeedbackAgent(InternalModelAgent[State]):
    """An agent that corrects its internal model by everything that observations show (`Seen`)."""

    @abstractmethod
    def respond(self, state: State, seen: Seen) -> tuple[NDArray[np.float32], State]:
        """Return actions, a row for each of n arms, and the state after one control step."""

    @override
    def predict(
        self,
        observation: Observation,
        state: State | None = None,
        episode_start: Started = None,
        deterministic: bool = False,
    ) -> tuple[NDArray[np.float32], State | None]:
        seen = self.interface.look(observation)
        batch, rows = seen.joint_angles.shape[:-1], seen.in_rows()
        state = self._resumed(state, rows, episode_start)
        action, state = self.respond(state, rows)
        action = self.interface.checked_action(action, rows.joint_angles.shape[:-1])
        return action.reshape(*batch, action.shape[-1]), state


def resumed(
    state: State | None,
    start: Callable[[], State],
    batch: tuple[int, ...],
    episode_start: Started,
    layouts: Layouts,
) -> State:
    """Return `state`, made anew by `start` for each arm whose episode starts, or if it is None.

    Raise a `UserError` if `state` or `episode_start` does not have the layout of this batch.
    """
    if state is None:
        return start()
    if batch not in layouts:
        layouts[batch] = _layout_of(start())
    if _layout_of(state) != layouts[batch]:
        raise UserError(
            "state must be what predict returned for this agent and as many arms, "
            f"here {_described(start())}, got {_described(state)}"
        )
    if episode_start is None or not np.any(episode_start):
        return state
    starts = np.asarray(episode_start, dtype=bool)
    if not batch and starts.size == 1:
        starts = starts.reshape(())
    if starts.shape not in ((), batch):
        raise UserError(
            f"episode_start must be of shape {batch}, as the observations are, got {starts.shape}"
        )
    return where(np.broadcast_to(starts, batch), start(), state)


def check_no_state(state: object) -> None:
    """Raise a `UserError` if an agent without memory is handed a state."""
    accepted = "None, which is what predict returned for this agent"
    require(state is None, "state", state, accepted)


# A state is an array with leading batch axes, a network's state, or a named tuple of states.  Its
# layout is its type, and the shape of the first array in each of its fields.


def _layout_of(state: Any) -> list[Any]:
    return [type(state), *map(_first_shape, state if isinstance(state, tuple) else (state,))]


def _first_shape(state: Any) -> tuple[int, ...] | None:
    while isinstance(state, tuple) and state:
        state = state[0]
    array = state.values if isinstance(state, MMCState) else state
    return getattr(array, "shape", None)


def _described(state: Any) -> str:
    shape = _first_shape(state)
    return repr(state) if shape is None else f"{type(state).__name__} of shape {shape}"


def where(condition: NDArray[np.bool_], yes: State, no: State) -> State:
    """Return a state that is `yes` where `condition`, on the batch axes, holds; `no` elsewhere."""
    return _where(condition, yes, no)


def _where(condition: NDArray[np.bool_], yes: Any, no: Any) -> Any:
    if isinstance(yes, MMCState):  # its batch is last
        return MMCState(np.where(condition, yes.values, no.values), yes.segment_count)
    if isinstance(yes, tuple):
        return type(yes)(*(_where(condition, *pair) for pair in zip(yes, no, strict=True)))
    trailing = (1,) * (np.ndim(yes) - np.ndim(condition))
    return np.where(np.reshape(condition, (*np.shape(condition), *trailing)), yes, no)


def of_arms(state: State, arms: NDArray[np.intp]) -> State:
    """Return the state of some of the arms alone."""
    return _of_arms(state, arms)


def _of_arms(state: Any, arms: NDArray[np.intp]) -> Any:
    if isinstance(state, tuple):
        return type(state)(*(_of_arms(field, arms) for field in state))
    return state[arms]


_OF_STEPS = {"TimeLimit", "OrderEnforcing", "PassiveEnvChecker", "Autoreset", "ClipAction"}
_OF_REWARDS = {"NormalizeReward", "ClipReward", "TransformReward"}
_OF_RECORDS = {"RecordEpisodeStatistics", "Monitor", "VecMonitor", "VecCheckNan", "DictInfoToList"}
_OF_FILMS = {"RecordVideo", "VecVideoRecorder", "HumanRendering", "RenderCollection"}
_OF_PICTURES = {"AddWhiteNoise", "ObstructView"}
HARMLESS = frozenset(_OF_STEPS | _OF_REWARDS | _OF_RECORDS | _OF_FILMS | _OF_PICTURES)
"""Names of wrappers that change neither observations nor the effect of actions."""


def wrappers_of(env: Any) -> list[Any]:
    """Return the wrappers around an environment, the outermost first.

    For a vector, the wrappers of its first environment follow if it runs in this process.
    """
    wrappers = []
    while env is not None:
        if hasattr(env, "venv") or isinstance(env, (gym.Wrapper, VectorWrapper)):
            wrappers.append(env)
            env = env.venv if hasattr(env, "venv") else env.env
        else:  # a vector with its environments, or the innermost environment
            env = next(iter(getattr(env, "envs", ())), None)
    return wrappers


def changes_contract(wrapper: Any) -> bool:
    """Return whether a wrapper changes what agents see, or what their actions do.

    A wrapper of Gymnasium or stable-baselines3 does, unless it is known to be harmless.  Any other
    wrapper does if it changes the observation space or the action space.
    """
    if type(wrapper).__module__.startswith(("gymnasium.", "stable_baselines3.", "sb3_contrib.")):
        is_off = getattr(wrapper, "norm_obs", True) is False  # VecNormalize, of rewards alone
        return not (is_off or type(wrapper).__name__ in HARMLESS)
    inner = getattr(wrapper, "venv", None) or wrapper.env
    names = ("observation_space", "action_space")
    return any(getattr(wrapper, name) != getattr(inner, name) for name in names)


def require_plain(env: Any) -> None:
    """Raise a `CannotActError` for a wrapper that changes observations or actions."""
    for wrapper in wrappers_of(env):
        if changes_contract(wrapper):
            raise CannotActError(
                "env must show its own observations and take its own actions, got it in "
                f"{type(wrapper).__name__}: make the agent for the environment inside"
            )


def warn_of_another_arm(label: str, trained: ArmParameters | None, env: Any) -> None:
    """Warn with a `MismatchWarning` if an agent was trained with an arm unlike that of `env`.

    Engines do not matter, because they simulate the same arm.  Perturbations do not count, because
    they are intended.
    """
    here = read_attribute(env, "unperturbed")
    if trained is None or here is None:
        return
    # Equal control steps may be divided into different substeps.
    left_out = ("segment_masses", "substep", "substeps")
    names = [field.name for field in fields(trained) if field.name not in left_out]
    differences = "; ".join(
        f"{name} {getattr(trained, name)} in training, {getattr(here, name)} here"
        for name in (*names, "masses", "control_step")
        if getattr(trained, name) != getattr(here, name)
    )
    if differences:
        warn_of_mismatch(f"{label} was trained with another arm than that of env: {differences}")


class RandomAgent(Agent[tuple[np.random.Generator, ...]]):
    """Draws every action uniformly from an action space, by default −1 to 1 for each joint.

    With a state from `begin` each arm draws from its own generator; without, all share one.
    """

    def __init__(self, interface: ReachInterface, space: Any = None) -> None:
        self._interface, ones = interface, np.ones(len(interface.segment_lengths))
        low, high = (-ones, ones) if space is None else (space.low, space.high)
        self._low, self._high = np.atleast_2d(low)[0], np.atleast_2d(high)[0]
        self._random = np.random.default_rng(0)

    @override
    def begin(self, seeds: Sequence[int]) -> tuple[np.random.Generator, ...]:
        return tuple(np.random.default_rng(seed) for seed in seeds)

    @override
    def predict(
        self,
        observation: Observation,
        state: tuple[np.random.Generator, ...] | None = None,
        episode_start: Started = None,
        deterministic: bool = False,
    ) -> tuple[NDArray[np.float32], tuple[np.random.Generator, ...] | None]:
        batch, size = self._interface.sense(observation).joint_angles.shape[:-1], len(self._low)
        if isinstance(state, tuple) and len(state) == math.prod(batch) > 0:
            shares = np.reshape([generator.random(size) for generator in state], (*batch, size))
            actions = self._low + (self._high - self._low) * shares
        else:
            check_no_state(state)
            actions = self._random.uniform(self._low, self._high, (*batch, size))
        return actions.astype(np.float32), state
