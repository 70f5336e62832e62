"""Run the paper's 420 movements, from each of 21 targets to each other, and its example movement.

The targets are at the radii 1, 2, 3 and the angles 0°, 30°, …, 180°.  Before each movement
the network is set to the starting posture and moves to the first target (the warm movement);
its state is kept, the second target is given, and the movement is recorded.  Distance and
velocity are divided by the distance between the two targets (paper, Sect. "Results").
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import NamedTuple, TypeAlias

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mmc_gym.geometry import Floats
from mmc_gym.measures import speed
from mmc_gym.measures.reaching import largest_retreat
from mmc_gym.network.model import MMCNetwork, MMCState
from mmc_gym.network.normalizers import EuclideanNormalizer, LearnedNormalizer, Normalizer
from studies.paper.experiment import ExperimentSettings, tracked
from studies.paper.networks import trained_architectures

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

EUCLIDEAN, ACCURATE = "Euclidean", "accurate [16, 16]"
"""Names of the normalizers that are not trained by the paper's recipe."""

OVERSHOOT = 0.01  # how far the distance rises above its smallest so far, for an overshoot
SECOND_PEAK = 0.05  # how far the speed rises again, as a share of its peak, for a second peak
FAR = 0.1  # movements that end at a larger distance are counted
INNER = (PAIRS < 14).all(axis=1)
"""Movements between targets at radius 1 and 2, which need no stretched arm, (420,)."""

ITERATIONS = (10, 20, 40, 100)  # after which distances are given


class Recording(NamedTuple):
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
        """Position of the hand after every iteration, (..., iterations, 2)."""
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


Move: TypeAlias = Callable[[MMCNetwork, MMCState, Floats, int], tuple[MMCState, Floats]]
"""Takes network, state, target and iterations; returns the last state and all segments."""


def clamp_and_run(
    network: MMCNetwork, state: MMCState, target: Floats, iterations: int
) -> tuple[MMCState, Floats]:
    """Move as the paper does: clamp the target, and iterate."""
    return network.trajectory(state, network.inverse(target), iterations)


def record_movements(
    network: MMCNetwork,
    iterations: int = 100,
    warm_iterations: int | None = None,
    move: Move = clamp_and_run,
) -> Recording:
    """Run the 420 movements, all in one batch.

    Args:
        network: a network of three segments; the paper's have length 1.
        iterations: recorded iterations; the paper's are 100 for kinematic and 40 for dynamic
            networks.
        warm_iterations: iterations of the warm movement; by default equal to `iterations`.
        move: runs the network in both movements.

    Raises:
        ValueError: if the network does not have three segments.

    >>> recording = record_movements(MMCNetwork(schedule="delayed"))
    >>> recording.distance.shape, float(recording.distance.mean(axis=0)[-1].round(5))
    ((420, 100), 0.02264)
    """
    start, target = TARGETS[PAIRS[:, 0]], TARGETS[PAIRS[:, 1]]
    # A movement's state depends on its first target alone: warm 21 networks, not 420.
    state = network.state_from_segments(STARTING_SEGMENTS)
    if warm_iterations is None:
        warm_iterations = iterations
    warm, _ = move(network, state, TARGETS, warm_iterations)
    state = MMCState(np.ascontiguousarray(warm.values[..., PAIRS[:, 0]]), warm.segment_count)
    _, segments = move(network, state, target, iterations)
    return Recording(state.segments, np.moveaxis(segments, 0, -3), start, target)


def record_runs(
    network: MMCNetwork,
    normalizers: Sequence[Normalizer],
    iterations: int,
    warm_iterations: int | None = None,
) -> Recording:
    """Run the 420 movements with each normalizer; return one recording, (420 · runs, ...)."""
    recordings = [
        record_movements(replace(network, normalizer=normalizer), iterations, warm_iterations)
        for normalizer in normalizers
    ]
    return Recording(*map(np.concatenate, zip(*recordings, strict=True)))


def record_example(network: MMCNetwork, iterations: int = 40) -> Recording:
    """Run the paper's example movement from the starting posture, without a warm movement."""
    state = network.state_from_segments(STARTING_SEGMENTS)
    _, segments = clamp_and_run(network, state, EXAMPLE_TARGET, iterations)
    segments = np.moveaxis(segments, 0, -3)
    return Recording(state.segments, segments, state.end_effector, EXAMPLE_TARGET)


def summarize(recording: Recording) -> dict[str, float]:
    """Summarize a recording of (movements, iterations).

    Returns:
        Means over the movements: distance_k after each recorded k of `ITERATIONS`, final distance
        and its deviation, peak_velocity and peak_iteration of the mean profile.  Numbers of
        movements: far (ending farther than `FAR`), overshoots and second_peaks.
    """
    distance, velocity = recording.distance, recording.velocity
    mean_distance, mean_velocity = distance.mean(axis=0), velocity.mean(axis=0)
    recorded = [k for k in ITERATIONS if k <= len(mean_distance)]
    return {
        **{f"distance_{k}": float(mean_distance[k - 1]) for k in recorded},
        "final": float(mean_distance[-1]),
        "deviation": float(distance[:, -1].std()),
        "far": float((distance[:, -1] > FAR).sum()),
        "peak_velocity": float(mean_velocity.max()),
        "peak_iteration": float(mean_velocity.argmax() + 1),
        "overshoots": float((each(largest_retreat, distance) > OVERSHOOT).sum()),
        "second_peaks": float((each(second_rise, velocity) > SECOND_PEAK).sum()),
    }


def shapes(recording: Recording) -> dict[str, Floats]:
    """Return measures of each movement's shape, (movements,) each: see `measures.speed`."""
    distance, velocity = recording.distance, recording.velocity
    return {
        "correlation": each(speed.correlation_with_minimum_jerk, velocity),
        "peak_to_mean": each(speed.peakedness, velocity),
        "time_to_peak": each(speed.phase_of_peak, velocity),
        "velocity_peaks": each(speed.count_peaks, velocity),
        "overshoot": each(largest_retreat, distance),
        "final": distance[:, -1],
    }


def each(measure: Callable[[Floats], float], profiles: Floats) -> Floats:
    """Measure every profile of (profiles, iterations)."""
    return np.array([measure(profile) for profile in profiles])


def all_normalizers(settings: ExperimentSettings) -> dict[str, tuple[Normalizer, ...]]:
    """Return normalizers by name: Euclidean, accurate, and all runs of each architecture."""
    return {
        EUCLIDEAN: (EuclideanNormalizer(),),
        ACCURATE: (LearnedNormalizer.shipped("accurate"),),
        **{
            name: architecture.normalizers
            for name, architecture in trained_architectures(settings).items()
        },
    }


def summarize_networks(
    networks: Sequence[MMCNetwork],
    normalizers: Mapping[str, Sequence[Normalizer]],
    iterations: int,
) -> pd.DataFrame:
    """Run the 420 movements with every run of every normalizer in every network.

    Returns:
        A row per network, normalizer and run: dynamics, decay (NaN for kinematic networks),
        schedule, normalizer, run, and the columns of `summarize`.
    """
    runs = [(name, *run) for name, group in normalizers.items() for run in enumerate(group)]
    rows = []
    for network, (name, number, normalizer) in tracked(list(product(networks, runs)), "networks"):
        recording = record_movements(replace(network, normalizer=normalizer), iterations)
        rows.append(
            {
                "dynamics": network.dynamics,
                "decay": np.nan if network.dynamics == "kinematic" else network.velocity_decay,
                "schedule": network.schedule,
                "normalizer": name,
                "run": number,
                **summarize(recording),
            }
        )
    return pd.DataFrame(rows)


def second_rise(speeds: Floats) -> float:
    """Return how far the speed rises again after its peak, as a share of the peak.

    max_{k>j≥p} (s_k − s_j) / s_p, where p is the step of the peak s_p; 0 for a hand at rest.
    Unlike `count_peaks` it ignores what comes before the peak.

    Args:
        speeds: of the hand in each step, (steps,).

    Example:
        >>> second_rise(np.array([0.2, 0.1, 1.0, 0.3, 0.5]))
        0.2
    """
    highest = speed.highest_speed(speeds)
    if highest == 0.0:
        return 0.0
    after = speeds[speeds.argmax() :]
    return float((after - np.minimum.accumulate(after)).max()) / highest
