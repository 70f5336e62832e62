"""Mean, median and interquartile mean of weighted values, for many sets of weights at once."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from mmc_gym.measures.reaching import Floats

WeightedStatistic: TypeAlias = Callable[[Floats, Floats], Floats]
"""Of values (k,), in order, and how much each counts in R resamples, (R, k): (R,)."""


def weighted_mean(values: Floats, weights: Floats) -> Floats:
    """A `WeightedStatistic`: Σ w x / Σ w."""
    with np.errstate(invalid="ignore"):
        mean: Floats = weights @ values / weights.sum(axis=-1)
    return mean


def weighted_iqm(values: Floats, weights: Floats) -> Floats:
    """A `WeightedStatistic`: the interquartile mean, of the middle half of the weight.

    Values at the quartiles count in part.  Nearly as robust as the median, and nearly as precise as
    the mean.

    Example:
        >>> weighted_iqm(np.array([0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 1000.0]), np.ones((1, 8)))
        array([3.5])
        >>> weighted_iqm(np.array([1.0, 2.0, 9.0]), np.ones((1, 3)))  # (¼ · 1 + 2 + ¼ · 9) / 1½
        array([3.])
    """
    return _between(values, weights, 0.25, 0.75)


def weighted_median(values: Floats, weights: Floats) -> Floats:
    """A `WeightedStatistic`: the median; the middle of two where the weights part there."""
    if values.size == 0:
        return np.full(len(weights), np.nan)
    total = np.cumsum(weights, axis=-1)
    half = total[:, -1:] / 2
    slack = 1e-9 * half  # weights are multiples of one over numbers of instances
    last = values.size - 1
    low = np.minimum((total < half - slack).sum(axis=-1), last)
    high = np.minimum((total <= half + slack).sum(axis=-1), last)
    middle: Floats = (values[low] + values[high]) / 2
    return np.where(half[:, 0] > 0, middle, np.nan)


def _between(values: Floats, weights: Floats, low: float, high: float) -> Floats:
    """Mean of values, in order, between two shares of the weight."""
    if values.size == 0:
        return np.full(len(weights), np.nan)
    total = np.cumsum(weights, axis=-1)
    whole = total[:, -1:].copy()
    inside = np.clip(total, low * whole, high * whole, out=total)
    # Σ x_k (c_k − c_{k−1}) by parts, without another array of this size.
    steps = np.diff(values, append=0.0)
    summed = -(inside @ steps) - values[0] * low * whole[:, 0]
    with np.errstate(invalid="ignore"):
        mean = summed / ((high - low) * whole[:, 0])
    clipped: Floats = np.clip(mean, values[0], values[-1])  # rounding leads a hair beyond
    return clipped
