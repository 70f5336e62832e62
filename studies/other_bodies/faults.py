"""Motors and sensors that fail, in an environment that is not this package's."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np

WEAK, PUSH = 0.4, 0.2  # share of a weak motor's action that arrives; what a pushed motor adds to it


@dataclass(frozen=True)
class Fault:
    """The joint, counted from 0, of which something fails."""

    weak: int | None = None  # its motor gets 40 % of its action
    pushed: int | None = None  # its motor gets an action that is larger by 0.2
    stuck: int | None = None  # it is felt where it was at first, and at rest


NO_FAULT = Fault()


class Faulty(gym.Wrapper[Any, Any, Any, Any]):
    """An environment in which a motor or a sensor fails.

    `angles` and `speeds` say where in an array of observed numbers those of the stuck joint are.
    It is the observation, or the part `key` of it.
    """

    def __init__(
        self, env: gym.Env[Any, Any], fault: Fault, angles: Any, speeds: Any, key: str = ""
    ) -> None:
        super().__init__(env)
        self.fault, self.angles, self.speeds, self.key = fault, angles, speeds, key
        self.felt: Any = None

    def reset(self, **arguments: Any) -> tuple[Any, dict[str, Any]]:
        """Begin an episode, with the sensor where the joint is."""
        self.felt = None
        observation, info = super().reset(**arguments)
        return self._sensed(observation), info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Act by the motors."""
        action = np.array(action)
        if self.fault.weak is not None:
            action[self.fault.weak] *= WEAK
        if self.fault.pushed is not None:
            action[self.fault.pushed] += PUSH
        observation, reward, terminated, truncated, info = super().step(np.clip(action, -1.0, 1.0))
        return self._sensed(observation), reward, terminated, truncated, info

    def _sensed(self, observation: Any) -> Any:
        if self.fault.stuck is None:
            return observation
        is_part = isinstance(observation, Mapping)
        numbers = np.array(observation[self.key] if is_part else observation)
        if self.felt is None:
            self.felt = numbers[self.angles]
        numbers[self.angles], numbers[self.speeds] = self.felt, 0.0
        return {**observation, self.key: numbers} if is_part else numbers
