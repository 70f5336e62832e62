"""Segment lengths identified on line, from posture and hand as they are observed.

The hand is linear in the lengths, x = Σ ℓ_i u(θ_i) with the unit vectors u of the segment angles θ.
So recursive least squares, the Kalman filter of a constant, finds them::

    K = P Uᵀ (U P Uᵀ + σ² I)⁻¹,     ℓ ← ℓ + K (x − U ℓ),     P ← P − K U P

with U = (u_1 … u_N), the told lengths and their doubtfulness `PRIOR` to begin with.  What the
postures so far do not tell stays as it was told: so little movement does little harm.

An observation counts only if the arm has turned since the last one that did, for an arm at rest
would repeat the same error until it is believed.  And the lengths are used only where they foretell
the hand clearly better than those told: noise alone, or a cursor that is turned, does not look like
other lengths.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mmc_gym.agents.planners import where
from mmc_gym.network.chain import Floats, wrap_angle

PRIOR = 0.3
"""Standard deviation of the told lengths, as a fraction of them."""
NOISE = 0.02
"""σ: standard deviation with which hand and posture agree, segment lengths."""
TURN = 0.05
"""How far a joint must have turned for an observation to count, radians."""
MEMORY = 0.7
"""Share of the mean square errors that an observation leaves as it is."""
BETTER = 0.25
"""Identified lengths are used while their mean square error is less than this share of the told."""
SHORTEST, LONGEST = 0.3, 2.0
"""And while all of them are within these factors of those told."""


class Lengths(NamedTuple):
    """What is known of the lengths.

    Attributes:
        mean: ℓ, segment lengths, (..., N).
        covariance: P, (..., N, N).
        last: posture of the last observation that counted, radians, (..., N); NaN: none did yet.
        told_error: mean square error of hands foretold with the told lengths, (...).
        error: the same of the identified lengths, (...).
    """

    mean: Floats
    covariance: Floats
    last: Floats
    told_error: Floats
    error: Floats


def start(segment_lengths: tuple[float, ...], batch: tuple[int, ...]) -> Lengths:
    """The told lengths, for a batch of arms that have not been observed yet."""
    told = np.array(segment_lengths)
    return Lengths(
        np.broadcast_to(told, (*batch, told.size)).copy(),
        np.broadcast_to(np.diag((PRIOR * told) ** 2), (*batch, told.size, told.size)).copy(),
        np.full((*batch, told.size), np.nan),
        np.zeros(batch),
        np.zeros(batch),
    )


def observe(
    lengths: Lengths, joint_angles: Floats, hand: Floats, told: tuple[float, ...]
) -> Lengths:
    """What is known after an observation.

    Args:
        lengths: what was known.
        joint_angles: radians, (..., N).
        hand: where the hand is seen with this posture, segment lengths, (..., 2).
        told: the lengths that were told.
    """
    turn = np.abs(wrap_angle(joint_angles - lengths.last)).max(axis=-1)
    counts = ~(turn <= TURN)  # NaN: the first one does
    angles = np.cumsum(joint_angles, axis=-1)
    units = np.stack([np.cos(angles), np.sin(angles)], axis=-2)  # U, (..., 2, N)
    transposed = np.swapaxes(units, -1, -2)

    error = hand - _product(units, lengths.mean)
    shares = units @ lengths.covariance  # U P
    gain = np.swapaxes(np.linalg.solve(shares @ transposed + NOISE**2 * np.eye(2), shares), -1, -2)
    covariance = lengths.covariance - gain @ shares
    new = Lengths(
        lengths.mean + _product(gain, error),
        (covariance + np.swapaxes(covariance, -1, -2)) / 2,
        joint_angles,
        _average(lengths.told_error, hand - units @ np.array(told)),
        _average(lengths.error, error),
    )
    return where(counts, new, lengths)


def best(lengths: Lengths, told: tuple[float, ...]) -> Floats:
    """The lengths to go by, (..., N): those identified where they are better, else those told."""
    ratio = lengths.mean / np.array(told)
    is_plausible = ((ratio > SHORTEST) & (ratio < LONGEST)).all(axis=-1)
    is_better = lengths.error < BETTER * lengths.told_error
    return np.where((is_plausible & is_better)[..., None], lengths.mean, np.array(told))


def _average(mean: Floats, error: Floats) -> Floats:
    """A mean square with one more error (..., 2) in it."""
    average: Floats = MEMORY * mean + (1 - MEMORY) * (error * error).sum(axis=-1)
    return average


def _product(matrix: Floats, vector: Floats) -> Floats:
    product: Floats = (matrix @ vector[..., None])[..., 0]
    return product
