from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import mmc_gym  # noqa: F401  registers the environments
from mmc_gym.evaluation.rollout import Episode


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


def episode_of(hands, targets, control_step=0.02, joint_angles=None, **changes):
    """An episode in which the hand and the target were there; the servos did nothing."""
    hands = np.array(hands, dtype=np.float64)
    targets = np.broadcast_to(np.array(targets, dtype=np.float64), hands.shape)
    joint_angles = np.zeros((len(hands), 3)) if joint_angles is None else np.array(joint_angles)
    nothing = np.zeros_like(joint_angles[1:])
    values = {
        "seed": 0,
        "hands": hands,
        "distances": np.linalg.norm(hands - targets, axis=-1),
        "targets": targets,
        "joint_angles": joint_angles,
        "servo_impulses": nothing,
        "servo_work": nothing,
        "rewards": np.zeros(len(nothing)),
        "action_times": np.full(len(nothing), 1e-5),
        "control_step": control_step,
        "tolerance": 0.05,
        "reach": 3.0,
    }
    return Episode(**{**values, **changes})


@pytest.fixture
def make_episode():
    return episode_of
