"""What all agents share: the signature of `predict`, and the way from observation to action.

An agent sees observations only.  What it is told about the body stands in `ReachInterface`:
the segment lengths, and how actions are meant.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeAlias, TypeVar

import gymnasium as gym
import numpy as np
from gymnasium.vector import VectorEnv
from numpy.typing import NDArray

from mmc_gym.network.chain import Floats, wrap_angle

Observation: TypeAlias = "NDArray[Any] | Mapping[str, NDArray[Any]]"
State = TypeVar("State")


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
    """

    segment_lengths: tuple[float, ...]
    control: str
    speed_limit: float
    servo_gain: float
    control_step: float

    @classmethod
    def of(cls, env: gym.Env[Any, Any] | VectorEnv[Any, Any, Any]) -> ReachInterface:
        """Read it off an environment or a native vector environment, wrapped or not.

        Raises:
            ValueError: if it is none of this package's reaching environments.
        """
        body = getattr(env.unwrapped, "parameters", None)
        control = getattr(env.unwrapped, "control", None)
        if body is None or control is None:
            raise ValueError(f"env must be a reaching environment of mmc_gym, got {env}")
        return cls.told(body, control)

    @classmethod
    def told(cls, body: Any, control: str) -> ReachInterface:
        """That of an arm's parameters and a control mode."""
        return cls(
            body.segment_lengths, control, body.speed_limit, body.servo_gain, body.control_step
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
        return Sensed(joint_angles, target)

    def act(self, joint_targets: Floats, sensed: Sensed) -> NDArray[np.float32]:
        """The action, float32 within −1 and 1, that sends the joints to their targets (..., N).

        Position control is handed the targets.  Delta and velocity control are asked for the
        speed that a position servo would ask for.

        Raises:
            ValueError: under torque control, which has no servo to hand targets to.
        """
        if self.control == "joint_position":
            action = wrap_angle(joint_targets) / math.pi
        elif self.control in ("joint_delta", "joint_velocity"):
            ahead = wrap_angle(joint_targets - sensed.joint_angles)
            action = ahead / self.max_joint_delta
        else:
            raise ValueError(
                "control must be 'joint_position', 'joint_delta' or 'joint_velocity' for an agent "
                f"that gives joint targets, got {self.control!r}"
            )
        clipped: NDArray[np.float32] = np.clip(action, -1.0, 1.0).astype(np.float32)
        return clipped


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
        self.interface = interface
        rest = np.zeros(len(interface.segment_lengths))
        interface.act(rest, Sensed(rest, np.zeros(2)))  # refuses a control mode it can't serve

    @abstractmethod
    def start(self, sensed: Sensed) -> State:
        """The state of internal models in the sensed postures."""

    @abstractmethod
    def restart(self, state: State, fresh: State, started: NDArray[np.bool_]) -> State:
        """`state`, with those of `fresh` where an episode `started` (batch axes)."""

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
        if state is None:
            state = self.start(sensed)
        elif episode_start is not None and np.any(episode_start):
            started = np.broadcast_to(
                np.asarray(episode_start, dtype=bool), sensed.joint_angles.shape[:-1]
            )
            state = self.restart(state, self.start(sensed), started)
        joint_targets, state = self.advance(state, sensed)
        return self.interface.act(joint_targets, sensed), state
