"""The paper's movements: from each of 21 targets to each other, 420 in all, and one example.

The targets stand at the radii 1, 2, 3 and the angles 0°, 30°, …, 180°.  Before each movement
the network is set to the starting posture and moves to the first target (the warm movement);
its state is kept, the second target is given, and the movement is recorded.  Distance and
velocity are divided by the distance between the two targets (paper, Sect. "Results").
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from mmc_gym.measures import speed as profiles
from mmc_gym.measures.episode import moving_part
from mmc_gym.measures.reaching import largest_retreat
from mmc_gym.network.chain import Floats
from mmc_gym.network.model import MMCNetwork, MMCState
from mmc_gym.network.normalizers import EuclideanNormalizer, LearnedNormalizer, Normalizer
from mmc_gym.paper.experiment import Progress, Settings
from mmc_gym.paper.networks import architecture_name, trained_architectures

WARM_ITERATIONS_KINEMATIC = 100
WARM_ITERATIONS_DYNAMIC = 40

_ANGLES = np.arange(7) * (np.pi / 6)
_DIRECTIONS = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=-1)

TARGETS: NDArray[np.float64] = np.concatenate([radius * _DIRECTIONS for radius in (1, 2, 3)])
"""Targets, (21, 2): radius by radius, counter-clockwise."""

PAIRS: NDArray[np.intp] = np.argwhere(~np.eye(len(TARGETS), dtype=bool))
"""Indices of first and second target of the movements, (420, 2), ordered by the first."""

STARTING_SEGMENTS: NDArray[np.float64] = np.array([[0.99, 0.15], [0.707, 0.7071], [0.15, 0.99]])
"""Segment vectors of the starting posture, (3, 2)."""

EXAMPLE_TARGET: NDArray[np.float64] = np.array([-1.8, 1.8])
"""Target of the example movement, which begins in the starting posture."""

for _constant in (TARGETS, PAIRS, STARTING_SEGMENTS, EXAMPLE_TARGET):
    _constant.setflags(write=False)


@dataclass(frozen=True, eq=False)
class Recording:
    """Movements of an MMC network, with any batch axes in front.

    Attributes:
        start_segments: posture before the first iteration, (..., 3, 2).
        segments: posture after every iteration, (..., iterations, 3, 2).
        start: where the movement starts, (..., 2); the distance from it to the target is 1.
        target: where it should end, (..., 2).
    """

    start_segments: Floats
    segments: Floats
    start: Floats
    target: Floats

    @property
    def end_effector(self) -> Floats:
        """Where the hand is after every iteration, (..., iterations, 2)."""
        hand: Floats = self.segments.sum(axis=-2)
        return hand

    @property
    def distance(self) -> Floats:
        """Normalized distance of hand and target after every iteration, (..., iterations)."""
        return self._normalized(self.end_effector - self.target[..., None, :])

    @property
    def velocity(self) -> Floats:
        """Normalized path of the hand during every iteration, (..., iterations)."""
        start = self.start_segments.sum(axis=-2)[..., None, :]
        return self._normalized(np.diff(self.end_effector, axis=-2, prepend=start))

    def _normalized(self, vectors: Floats) -> Floats:
        path = np.linalg.norm(self.target - self.start, axis=-1, keepdims=True)
        lengths: Floats = np.linalg.norm(vectors, axis=-1) / path
        return lengths


def record_movements(
    network: MMCNetwork, iterations: int = 100, warm_iterations: int | None = None
) -> Recording:
    """Run the 420 movements, all in one batch.

    Args:
        network: a network of three segments; the paper's have length 1.
        iterations: recorded iterations.
        warm_iterations: iterations of the warm movement; by default the paper's 100 for
            kinematic and 40 for dynamic networks.

    Raises:
        ValueError: if the network has not three segments.

    >>> recording = record_movements(MMCNetwork(schedule="delayed"), iterations=40)
    >>> recording.distance.shape, float(recording.distance.mean(axis=0)[-1].round(5))
    ((420, 40), 0.09712)
    """
    if warm_iterations is None:
        kinematic = network.dynamics == "kinematic"
        warm_iterations = WARM_ITERATIONS_KINEMATIC if kinematic else WARM_ITERATIONS_DYNAMIC
    start, target = TARGETS[PAIRS[:, 0]], TARGETS[PAIRS[:, 1]]
    # A movement's state depends on its first target alone: warm 21 networks, not 420.
    warm = network.run(
        network.state_from_segments(STARTING_SEGMENTS), network.inverse(TARGETS), warm_iterations
    )
    state = MMCState(np.ascontiguousarray(warm.values[..., PAIRS[:, 0]]), warm.segment_count)
    return _record(network, state, start, target, iterations)


def record_example(network: MMCNetwork, iterations: int = 40) -> Recording:
    """Run the paper's example movement, from the starting posture, without a warm movement."""
    state = network.state_from_segments(STARTING_SEGMENTS)
    return _record(network, state, state.end_effector, EXAMPLE_TARGET, iterations)


def _record(
    network: MMCNetwork, state: MMCState, start: Floats, target: Floats, iterations: int
) -> Recording:
    start_segments = state.segments
    _, segments = network.trajectory(state, network.inverse(target), iterations)
    return Recording(start_segments, np.moveaxis(segments, 0, -3), start, target)


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
        "overshoots": float((each(largest_retreat, distance) > OVERSHOOT).sum()),
        "second_peaks": float((rises > SECOND_PEAK).sum()),
    }


def shapes(recording: Recording) -> dict[str, NDArray[np.float64]]:
    """How bell-shaped each movement is, columns of (movements,): see `profiles` for each."""
    velocity = recording.velocity
    return {
        "correlation": each(profiles.correlation_with_minimum_jerk, velocity),
        "peak_to_mean": each(profiles.peakedness, velocity),
        "time_to_peak": each(profiles.phase_of_peak, velocity),
        "velocity_peaks": each(profiles.count_peaks, velocity),
        "overshoot": each(largest_retreat, recording.distance),
        "final": np.asarray(recording.distance[:, -1], dtype=np.float64),
    }


def bulk(velocity: ArrayLike) -> NDArray[np.float64]:
    """The part of a profile from the first to the last velocity of 5 % of the highest or more.

    >>> bulk([0.01, 0.2, 1.0, 0.02, 0.1, 0.04]).tolist()
    [0.2, 1.0, 0.02, 0.1]
    """
    profile = np.asarray(velocity, dtype=np.float64)
    return profile[moving_part(profile)]


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
