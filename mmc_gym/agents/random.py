"""Uniformly random actions: the floor of every comparison."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from mmc_gym.agents.base import Agent, Observation


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
