"""What all agents share: the signature of `predict`, and the way from observation to action.

An agent sees observations only.  What it is told about the body stands in `ReachInterface`:
the segment lengths, and how actions are meant.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Generic, TypeAlias, TypeVar

import gymnasium as gym
import numpy as np
from gymnasium.vector import VectorEnv
from numpy.typing import NDArray

from mmc_gym.network.chain import Floats, wrap_angle

Observation: TypeAlias = "NDArray[Any] | Mapping[str, NDArray[Any]]"
State = TypeVar("State")
JointLimits: TypeAlias = "tuple[tuple[float, float], ...]"


@dataclass(frozen=True)
class Sensed:
    """An observation in physical units; all arrays lead with the batch.

    Attributes:
        joint_angles: radians, (..., N).
        target: segment lengths, (..., 2).
    """

    joint_angles: Floats
    target: Floats


@dataclass(frozen=True)
class ReachInterface:
    """What an agent is told about a reaching environment.

    Attributes:
        segment_lengths: N lengths.
        control: the environment's control mode.
        speed_limit: largest joint speed, rad/s.
        servo_gain: speed that a position servo asks for per angle to its target, 1/s.
        control_step: duration of a control step, s.
        joint_limits: lowest and highest angle of each joint, radians; None: joints turn freely.
    """

    segment_lengths: tuple[float, ...]
    control: str
    speed_limit: float
    servo_gain: float
    control_step: float
    joint_limits: JointLimits | None = None

    @classmethod
    def of(cls, env: gym.Env[Any, Any] | VectorEnv[Any, Any, Any]) -> ReachInterface:
        """Read it off an environment, wrapped or not, or a vector of equal ones of any kind.

        Raises:
            ValueError: if it is none of this package's reaching environments, or they differ.
        """
        body, control = told_by(env, "parameters"), told_by(env, "control")
        if body is None or control is None:
            raise ValueError(f"env must be a reaching environment of mmc_gym, got {env!r}")
        return cls.told(body, control)

    @classmethod
    def told(cls, body: Any, control: str) -> ReachInterface:
        """That of an arm's parameters and a control mode."""
        return cls(
            *(body.segment_lengths, control, body.speed_limit, body.servo_gain, body.control_step),
            body.joint_limits,
        )

    @property
    def max_joint_delta(self) -> float:
        """What an action of 1 means under `joint_delta`, radians."""
        return self.speed_limit / self.servo_gain

    def sense(self, observation: Observation) -> Sensed:
        """Decode an observation of MMCReach-v0 (13 values at N = 3) or MMCReachGoal-v0 (a dict).

        Raises:
            ValueError: if its last axis has another length.
        """
        count, reach = len(self.segment_lengths), sum(self.segment_lengths)
        if isinstance(observation, Mapping):
            posture = np.asarray(observation["observation"], dtype=np.float64)
            target = np.asarray(observation["desired_goal"], dtype=np.float64)
            expected = 3 * count
        else:
            posture = np.asarray(observation, dtype=np.float64)
            target = posture[..., 3 * count : 3 * count + 2] * reach
            expected = 3 * count + 4
        if posture.shape[-1:] != (expected,):
            raise ValueError(f"observation must have shape (..., {expected}), got {posture.shape}")
        joint_angles = np.arctan2(posture[..., count : 2 * count], posture[..., :count])
        return Sensed(self.within_limits(joint_angles), target)

    def checked(self, observation: Observation) -> Observation:
        """The observation as arrays.

        Raises:
            ValueError: if its last axis has another length than that of this environment.
        """
        if isinstance(observation, Mapping):
            arrays = {name: np.asarray(value) for name, value in observation.items()}
            self.sense(arrays)
            return arrays
        array = np.asarray(observation, dtype=np.float32)
        self.sense(array)
        return array

    def within_limits(self, joint_angles: Floats) -> Floats:
        """The angles within the joint limits that are nearest to these, (..., N); all if none."""
        if self.joint_limits is None:
            return joint_angles
        low, high = self._low_and_high
        middle, half = (low + high) / 2, (high - low) / 2
        near: Floats = middle + np.clip(wrap_angle(joint_angles - middle), -half, half)
        return near

    def within_limits_from(self, before: Floats, joint_angles: Floats) -> Floats:
        """Angles that joints come to on the short way, (..., N), from `before`, up to the limits.

        An internal posture that is taken on by this never jumps from one limit to the other.
        """
        if self.joint_limits is None:
            return joint_angles
        low, high = self._low_and_high
        stopped: Floats = np.clip(before + wrap_angle(joint_angles - before), low, high)
        return stopped

    def turn(self, joint_angles: Floats, joint_targets: Floats) -> Floats:
        """By how much joints turn to targets, radians, (..., N): the short way, or that allowed."""
        if self.joint_limits is None:
            return wrap_angle(joint_targets - joint_angles)
        return self.within_limits(joint_targets) - self.within_limits(joint_angles)

    @cached_property
    def _low_and_high(self) -> tuple[Floats, Floats]:
        low, high = np.transpose(self.joint_limits or ())
        return low, high

    def act(self, joint_targets: Floats, sensed: Sensed) -> NDArray[np.float32]:
        """The action, float32 within −1 and 1, that sends the joints to their targets (..., N).

        Position control is handed the targets.  Delta and velocity control are asked for the
        speed that a position servo would ask for.  Targets beyond a joint limit are at the limit,
        and no joint is sent through the range that it must not enter.

        Raises:
            ValueError: under torque control, which has no servo to hand targets to.
        """
        if self.control == "joint_position":
            action = wrap_angle(self.within_limits(joint_targets)) / math.pi
        elif self.control in ("joint_delta", "joint_velocity"):
            action = self.turn(sensed.joint_angles, joint_targets) / self.max_joint_delta
        else:
            raise ValueError(
                "control must be 'joint_position', 'joint_delta' or 'joint_velocity' for an agent "
                f"that gives joint targets, got {self.control!r}"
            )
        clipped: NDArray[np.float32] = np.clip(action, -1.0, 1.0).astype(np.float32)
        return clipped

    def check_takes_joint_targets(self) -> None:
        """Raise a `ValueError` under torque control, which has no servo to hand targets to."""
        rest = np.zeros(len(self.segment_lengths))
        self.act(rest, Sensed(rest, np.zeros(2)))


def told_by(env: Any, name: str) -> Any:
    """An attribute of a reaching environment; None if it has none of that name.

    Args:
        env: an environment, wrapped or not, or a vector of them: Gymnasium's, native or not, or
            stable-baselines3's.
        name: of the attribute.

    Raises:
        ValueError: if it is not the same for all environments of a vector.
    """
    value = getattr(getattr(env, "unwrapped", None), name, None)
    if value is not None or not hasattr(env, "get_attr"):
        return value
    try:
        values = list(env.get_attr(name))
    except AttributeError:
        return None
    if any(other != values[0] for other in values):
        raise ValueError(f"env must be of environments with the same {name}, got {values}")
    return values[0] if values else None


class ControlError(ValueError):
    """An agent cannot act by the actions of an environment.

    Attributes:
        control: the control mode that it acts by.
    """

    def __init__(self, message: str, control: str) -> None:
        """Say what is wrong, and what would be right."""
        super().__init__(message, control)
        self.control = control

    def __str__(self) -> str:
        return str(self.args[0])


class Agent(ABC, Generic[State]):
    """A controller with stable-baselines3's `predict`, for one observation or a batch.

    Attributes:
        training_steps: environment steps that its training took.
    """

    training_steps: int = 0

    @abstractmethod
    def predict(
        self,
        observation: Observation,
        state: State | None = None,
        episode_start: Sequence[bool] | NDArray[np.bool_] | None = None,
        deterministic: bool = False,
    ) -> tuple[NDArray[np.float32], State | None]:
        """Choose an action.

        Args:
            observation: of one environment, or of several with a leading batch axis.
            state: what the last call returned; None at the start.
            episode_start: for each environment, whether a new episode starts with this
                observation, so that its part of the state is made anew.
            deterministic: without exploration, for agents that explore.

        Returns:
            The action, float32 within −1 and 1, and the state for the next call.
        """


class JointTargetAgent(Agent[State]):
    """An agent whose state is an internal model of the arm, and which gives joint targets."""

    def __init__(self, interface: ReachInterface) -> None:
        """Make an agent for the environment that `interface` was read off.

        Raises:
            ValueError: under torque control.
        """
        interface.check_takes_joint_targets()
        self.interface = interface

    @abstractmethod
    def start(self, sensed: Sensed) -> State:
        """The state of internal models in the sensed postures."""

    @abstractmethod
    def restart(self, state: State, fresh: State, started: NDArray[np.bool_]) -> State:
        """`state`, with those of `fresh` where an episode `started` (batch axes)."""

    @abstractmethod
    def batch_shape(self, state: State) -> tuple[int, ...]:
        """Batch axes of a state."""

    @abstractmethod
    def advance(self, state: State, sensed: Sensed) -> tuple[Floats, State]:
        """Joint targets (..., N) in radians, and the state after one control step."""

    def predict(
        self,
        observation: Observation,
        state: State | None = None,
        episode_start: Sequence[bool] | NDArray[np.bool_] | None = None,
        deterministic: bool = False,
    ) -> tuple[NDArray[np.float32], State | None]:
        """See `Agent.predict`; it is deterministic always."""
        sensed = self.interface.sense(observation)
        batch = sensed.joint_angles.shape[:-1]
        if state is None:
            state = self.start(sensed)
        else:
            check_batch(self.batch_shape(state), batch)
            started = episodes_started(episode_start, batch)
            if started is not None:
                state = self.restart(state, self.start(sensed), started)
        joint_targets, state = self.advance(state, sensed)
        return self.interface.act(joint_targets, sensed), state


def check_batch(state_batch: tuple[int, ...], batch: tuple[int, ...]) -> None:
    """Raise a `ValueError` if a state has other batch axes than the observation."""
    if state_batch != batch:
        raise ValueError(
            f"state must be that of as many arms as are observed, batch {batch}, got {state_batch}"
        )


def episodes_started(
    episode_start: Sequence[bool] | NDArray[np.bool_] | None, batch: tuple[int, ...]
) -> NDArray[np.bool_] | None:
    """Where episodes start, as a mask of the batch axes; None where none does.

    Raises:
        ValueError: if `episode_start` does not fit the batch.
    """
    if episode_start is None or not np.any(episode_start):
        return None
    given = np.asarray(episode_start, dtype=bool)
    try:
        return np.broadcast_to(given if batch or given.size != 1 else given.reshape(()), batch)
    except ValueError as error:
        raise ValueError(
            f"episode_start must be of shape {batch}, as the observations are, got {given.shape}"
        ) from error


class RandomAgent(Agent[None]):
    """Draws every action uniformly from −1 to 1."""

    def __init__(self, action_size: int, seed: int = 0) -> None:
        """Make the agent; the same seed gives the same actions."""
        self._action_size = action_size
        self._random = np.random.default_rng(seed)

    def predict(
        self,
        observation: Observation,
        state: None = None,
        episode_start: Sequence[bool] | NDArray[np.bool_] | None = None,
        deterministic: bool = False,
    ) -> tuple[NDArray[np.float32], None]:
        """See `Agent.predict`; the observation gives no more than the batch."""
        if isinstance(observation, Mapping):
            observation = observation["observation"]
        shape = (*np.shape(observation)[:-1], self._action_size)
        return self._random.uniform(-1.0, 1.0, shape).astype(np.float32), None
