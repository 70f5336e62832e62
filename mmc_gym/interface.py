"""From the state of arms to what is observed of them: arrays in, arrays out, batch axes in front.

`MMCReachEnv` has its own, quicker way where nothing disturbs the senses; it comes to the same
bits (a test holds them together).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mmc_gym.envs.perturbations import Readings
from mmc_gym.envs.spec import ReachSetup

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
    # np.clip would take twice as long for few arms.
    speeds: Floats = np.maximum(joint_velocities / setup.told.speed_limit, -1.0)
    return np.minimum(speeds, 1.0, out=speeds)


def encode_posture(setup: ReachSetup, readings: Readings, more: int = 0) -> NDArray[np.float32]:
    """Cosines and sines of the joint angles, and relative speeds, (..., 3 N + more).

    The last `more` numbers are left for the caller to fill in.
    """
    angles, count = readings.joint_angles, setup.joint_count
    seen = np.empty((*angles.shape[:-1], 3 * count + more), np.float32)
    seen[..., :count] = np.cos(angles)
    seen[..., count : 2 * count] = np.sin(angles)
    seen[..., 2 * count : 3 * count] = relative_speeds(setup, readings.joint_velocities)
    return seen


def encode(setup: ReachSetup, readings: Readings) -> NDArray[np.float32]:
    """The observation of `MMCReach-v0`, (..., 3 N + 4)."""
    seen = encode_posture(setup, readings, more=4)
    seen[..., -4:-2] = readings.target / setup.reach
    seen[..., -2:] = (readings.target - readings.hand) / (2 * setup.reach)
    if setup.may_exceed_reach or setup.noises:
        np.clip(seen, -1.0, 1.0, out=seen)
    return seen
