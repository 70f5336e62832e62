"""What all agents share: the signature of `predict`, and the way from observation to action.

An agent sees observations only.  What it is told about the body stands in `ReachInterface`:
the segment lengths, and how actions are meant.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from mmc_gym.interface import Observation, ReachInterface, Sensed
from mmc_gym.network.chain import Floats

State = TypeVar("State")


class Predictor(Protocol):
    """Whatever acts: it has the `predict` of stable-baselines3, for a single observation."""

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[Any, Any]:
        """Return the action for `observation`, and the state to hand back at the next step."""


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
