"""The paper's movements: from each of 21 targets to each other, 420 in all, and one example.

The targets stand at the radii 1, 2, 3 and the angles 0°, 30°, …, 180°.  Before each movement
the network is set to the starting posture and moves to the first target (the warm movement);
its state is kept, the second target is given, and the movement is recorded.  Distance and
velocity are divided by the distance between the two targets (paper, Sect. "Results").
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mmc_gym.network.chain import Floats
from mmc_gym.network.model import MMCNetwork, MMCState

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
