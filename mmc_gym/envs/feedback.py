"""The sight of the hand, where perturbations hide it for a time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mmc_gym.envs.perturbations import Feedback
from mmc_gym.envs.workspace import distances

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]

_MOVING = 0.05  # of the peak speed; a slower hand has ended its movement, as in `mmc_gym.measures`
_FASTEST_REST = 0.1  # segment lengths / s; a slower peak is no movement


class HandSight:
    """Where the hands of n arms were last seen, and how far their movements are."""

    def __init__(self, count: int, control_step: float) -> None:
        """Begin without arms: each is reset by the look at its step 0."""
        self._seen, self._hands = np.zeros((2, count, 2))
        self._peaks, self._fastest_rest = np.zeros(count), _FASTEST_REST * control_step
        self._has_ended = np.zeros(count, dtype=bool)
        self.is_seen = np.ones(count, dtype=bool)  #: in the last look, (n,)

    def look(
        self,
        arms: Indices,
        steps: Indices,
        hands: Floats,
        seen: Floats,
        feedback: Sequence[Feedback],
    ) -> Floats:
        """Return where the hands of k arms are seen, (k, 2).

        Args:
            arms: their indices, (k,).
            steps: control steps since the start, (k,).
            hands: true positions of the hands, (k, 2).
            seen: positions as they would be seen, late and with noise, (k, 2).
            feedback: when they are.
        """
        starts = steps == 0
        self._peaks[arms[starts]], self._has_ended[arms[starts]] = 0.0, False
        moved = np.where(starts, 0.0, distances(hands, self._hands[arms]))
        peaks = np.maximum(self._peaks[arms], moved)
        is_slow = (moved < _MOVING * peaks) & (peaks > self._fastest_rest)
        ends = is_slow & ~self._has_ended[arms]
        is_seen = np.ones(len(arms), dtype=bool)
        for one in feedback:
            is_seen &= starts | (np.asarray(one.hidden) == 0.0) | one.shows(ends)
        self._hands[arms], self._peaks[arms], self.is_seen[arms] = hands, peaks, is_seen
        self._has_ended[arms] |= ends
        self._seen[arms] = np.where(is_seen[:, None], seen, self._seen[arms])
        return self._seen[arms]
