"""From the state of arms to what is observed of them: arrays in, arrays out, batch axes in front.

`MMCReachEnv` has its own, quicker way where nothing disturbs the senses; it comes to the same
bits (a test holds them together).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mmc_gym.envs.perturbations import Readings
from mmc_gym.envs.setup import ReachSetup

Floats = NDArray[np.float64]


def disturb(
    setup: ReachSetup, readings: Readings, randoms: Sequence[np.random.Generator]
) -> Readings:
    """The readings under the noises of a setup.

    Args:
        setup: of the environment.
        readings: of the arms, (n, …).
        randoms: the generator of each of the n arms.
    """
    for noise, draws in zip(setup.noises, setup.noise_draws, strict=True):
        normals = np.stack([random.standard_normal(draws) for random in randoms])
        readings = noise.disturb(readings, normals)
    return readings


def relative_speeds(setup: ReachSetup, joint_velocities: Floats) -> Floats:
    """Joint velocities (..., N) as fractions of their limit, clipped to ±1."""
    return np.clip(joint_velocities / setup.told.speed_limit, -1.0, 1.0)


def encode_posture(setup: ReachSetup, readings: Readings) -> Floats:
    """Cosines and sines of the joint angles, and relative speeds, (..., 3 N)."""
    angles = readings.joint_angles
    speeds = relative_speeds(setup, readings.joint_velocities)
    return np.concatenate([np.cos(angles), np.sin(angles), speeds], axis=-1)


def encode(setup: ReachSetup, readings: Readings) -> NDArray[np.float32]:
    """The observation of `MMCReach-v0`, (..., 3 N + 4)."""
    target = readings.target
    offset = (target - readings.hand) / (2 * setup.reach)
    parts = [encode_posture(setup, readings), target / setup.reach, offset]
    return np.clip(np.concatenate(parts, axis=-1), -1.0, 1.0).astype(np.float32)
