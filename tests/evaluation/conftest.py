from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import mmc_gym  # noqa: F401  registers the environments


class Oracle:
    """Knows a posture for every target: three unit segments along an arc, q = (β − φ, φ, φ).

    Its hand is at the distance |1 + e^{iφ} + e^{2iφ}| = 1 + 2 cos φ from the base.
    """

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[Any, Any]:
        x, y = 3.0 * observation[9:11].astype(np.float64)
        bend = math.acos(np.clip((math.hypot(x, y) - 1) / 2, -1, 1))
        posture = (math.atan2(y, x) - bend, bend, bend)
        action = [math.remainder(angle, math.tau) / math.pi for angle in posture]
        return np.array(action, np.float32).clip(-1, 1), None


class Frozen:
    """Asks for the posture it is in, and so never gets anywhere."""

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[Any, Any]:
        return np.arctan2(observation[3:6], observation[:3]) / np.float32(math.pi), None


@pytest.fixture
def oracle() -> Oracle:
    return Oracle()


@pytest.fixture
def frozen() -> Frozen:
    return Frozen()


@pytest.fixture
def env() -> Iterator[gym.Env[Any, Any]]:
    env = gym.make("MMCReach-v0")
    yield env
    env.close()
