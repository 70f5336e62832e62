"""What is said about many movements: distances, velocity peaks, overshoot, and bell shape.

Iterations are counted from 1, as in the paper; distances and velocities are normalized.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from mmc_gym.measures import reaching as metrics
from mmc_gym.measures import speed as profiles
from mmc_gym.network.chain import Floats
from mmc_gym.network.model import MMCNetwork
from mmc_gym.network.normalizers import EuclideanNormalizer, LearnedNormalizer, Normalizer
from mmc_gym.paper.experiment import Progress, Settings
from mmc_gym.paper.networks import architecture_name, trained_architectures
from mmc_gym.paper.protocol import PAIRS, Recording, record_movements

EUCLIDEAN, ACCURATE = "Euclidean", "accurate [16, 16]"
"""Names of the normalizers that the paper's recipe has no part in."""

OVERSHOOT = 0.01
"""A movement overshoots if its distance rises by more than this above its smallest so far."""

SECOND_PEAK = 0.05
"""A second velocity peak is a rise, after the peak, by more than this share of it."""

FAR = 0.1
"""Movements that end at a larger distance are counted."""

INNER = (PAIRS < 14).all(axis=1)
"""Movements between targets at radius 1 and 2, which need no stretched arm, (420,)."""

ITERATIONS = (10, 20, 40, 100)
"""Iterations after which distances are given."""


def summarize(recording: Recording) -> dict[str, float]:
    """Distances and velocity peaks of movements, (movements, iterations), as columns.

    Returns:
        distance_k, mean over the movements, for every k of `ITERATIONS` that was recorded; final
        (distance), its deviation, and far, the number of movements that end above `FAR`;
        peak_velocity and peak_iteration of the mean velocity profile; overshoots and
        second_peaks, numbers of movements.
    """
    distance, velocity = recording.distance, recording.velocity
    mean_distance, mean_velocity = distance.mean(axis=0), velocity.mean(axis=0)
    rises = each(profiles.second_rise, velocity)
    return {
        **{
            f"distance_{k}": float(mean_distance[k - 1])
            for k in ITERATIONS
            if k <= len(mean_distance)
        },
        "final": float(mean_distance[-1]),
        "deviation": float(distance[:, -1].std()),
        "far": float((distance[:, -1] > FAR).sum()),
        "peak_velocity": float(mean_velocity.max()),
        "peak_iteration": float(mean_velocity.argmax() + 1),
        "overshoots": float((each(metrics.overshoot, distance) > OVERSHOOT).sum()),
        "second_peaks": float((rises > SECOND_PEAK).sum()),
    }


def shapes(recording: Recording) -> dict[str, NDArray[np.float64]]:
    """How bell-shaped each movement is, columns of (movements,): see `profiles` for each."""
    velocity = recording.velocity
    return {
        "correlation": each(profiles.minimum_jerk_correlation, velocity),
        "peak_to_mean": each(profiles.peak_to_mean, velocity),
        "time_to_peak": each(profiles.time_to_peak, velocity),
        "velocity_peaks": each(profiles.velocity_peaks, velocity),
        "overshoot": each(metrics.overshoot, recording.distance),
        "final": np.asarray(recording.distance[:, -1], dtype=np.float64),
    }


def bulk(velocity: ArrayLike) -> NDArray[np.float64]:
    """The part of a profile from the first to the last velocity of 5 % of the highest or more.

    >>> bulk([0.01, 0.2, 1.0, 0.02, 0.1, 0.04]).tolist()
    [0.2, 1.0, 0.02, 0.1]
    """
    profile = np.asarray(velocity, dtype=np.float64)
    return profile[profiles.moving_part(profile)]


def bulk_shape(velocity: Floats) -> tuple[float, float]:
    """Shape of the bulk of profiles, (profiles, iterations), as medians over them.

    Returns:
        Peak over mean velocity, and the share of the iterations that are over before the fastest.
    """
    parts = [bulk(profile) for profile in velocity]
    return (
        float(np.median([part.max() / part.mean() for part in parts])),
        float(np.median([part.argmax() / part.size for part in parts])),
    )


def each(measure: Callable[[Floats], float], profiles: Floats) -> NDArray[np.float64]:
    """The measure of every profile, from (profiles, iterations)."""
    return np.array([measure(profile) for profile in profiles])


def all_normalizers(settings: Settings, progress: Progress) -> dict[str, tuple[Normalizer, ...]]:
    """Euclidean, the shipped accurate one, and all runs of every architecture, by name."""
    trained = trained_architectures(settings, progress)
    return {
        EUCLIDEAN: (EuclideanNormalizer(),),
        ACCURATE: (LearnedNormalizer.shipped("accurate"),),
        **{architecture_name(units): trained[units].normalizers for units in trained},
    }


def summarize_networks(
    networks: Iterable[MMCNetwork],
    normalizers: Mapping[str, Sequence[Normalizer]],
    iterations: int,
    progress: Progress,
) -> pd.DataFrame:
    """Run the 420 movements with every normalizer in every network, and summarize each.

    Args:
        networks: descriptions whose normalizer is replaced.
        normalizers: all runs of each kind, by its name.
        iterations: recorded iterations, and as many of the warm movement.
        progress: called with (recordings done, their total number).

    Returns:
        A row per network, normalizer and run: dynamics, decay (not a number for kinematic
        networks), schedule, normalizer, run, and the columns of `summarize`.
    """
    networks = list(networks)
    total = len(networks) * sum(map(len, normalizers.values()))
    rows: list[dict[str, object]] = []
    progress(0, total)
    for network in networks:
        kinematic = network.dynamics == "kinematic"
        for name, runs in normalizers.items():
            for number, normalizer in enumerate(runs):
                recording = record_movements(
                    replace(network, normalizer=normalizer), iterations, iterations
                )
                rows.append(
                    {
                        "dynamics": network.dynamics,
                        "decay": np.nan if kinematic else network.velocity_decay,
                        "schedule": network.schedule,
                        "normalizer": name,
                        "run": number,
                        **summarize(recording),
                    }
                )
                progress(len(rows), total)
    return pd.DataFrame(rows)


def pooled(
    network: MMCNetwork, normalizers: Sequence[Normalizer], iterations: int, warm_iterations: int
) -> tuple[Floats, Floats]:
    """Distance and velocity of the movements with all normalizers, (movements, iterations)."""
    recordings = [
        record_movements(replace(network, normalizer=normalizer), iterations, warm_iterations)
        for normalizer in normalizers
    ]
    return (
        np.concatenate([recording.distance for recording in recordings]),
        np.concatenate([recording.velocity for recording in recordings]),
    )


def over_runs(values: ArrayLike, digits: str = ".4f") -> str:
    """Mean over the runs, and the least and the largest of them, if there are several.

    >>> over_runs([0.0625]), over_runs([0.05, 0.04, 0.09])
    ('0.0625', '0.0600 (0.0400 to 0.0900)')
    """
    values = np.asarray(values, dtype=np.float64)
    mean = f"{values.mean():{digits}}"
    if values.size == 1:
        return mean
    return f"{mean} ({values.min():{digits}} to {values.max():{digits}})"
