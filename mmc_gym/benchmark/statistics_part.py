"""Bootstrap intervals: how much a statistic would vary over other episodes of the same kind.

They replicate over episodes, that is over starts and targets.  They say nothing about what
training the agent anew, with another seed, would change: for that there is `replication`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from mmc_gym.measures.catalogue import Measure, Statistic

CONFIDENCE = 0.95
RESAMPLES = 9_999
_RANKS_AT_ONCE = 1_000_000  # bounds the memory


@dataclass(frozen=True)
class Interval:
    """A statistic of a sample with its confidence interval.

    Attributes:
        estimate: the statistic; NaN for an empty sample.
        low: lower end; NaN for fewer than two values.
        high: upper end; NaN for fewer than two values.
        count: number of values it is about.
        missing: number of values that were NaN, and left out.
    """

    estimate: float
    low: float
    high: float
    count: int
    missing: int


def bootstrap_interval(values: ArrayLike, statistic: Statistic, seed: int = 0) -> Interval:
    """95 % percentile bootstrap interval of the mean or median of `values` (n,).

    Percentile, not BCa: the jackknife in BCa fails for the median.  Where all values are equal,
    so are all resamples, and the interval has no width: it cannot know what did not occur (with
    n successes in n episodes, a failure rate of up to 3/n is still plausible).

    Args:
        values: one per episode; NaNs are left out and counted.
        statistic: "mean" or "median".
        seed: of the resampling; the same seed gives the same interval.

    Source:
        Efron and Tibshirani (1993), An Introduction to the Bootstrap, chapter 13.

    Example:
        >>> bootstrap_interval([2.0, 2.0, float("nan")], "mean")
        Interval(estimate=2.0, low=2.0, high=2.0, count=2, missing=1)
    """
    sample = np.asarray(values, dtype=np.float64)
    present = sample[~np.isnan(sample)]
    count, missing = len(present), len(sample) - len(present)
    if count == 0:
        return Interval(math.nan, math.nan, math.nan, count, missing)
    estimate = float(np.mean(present) if statistic == "mean" else np.median(present))
    if count == 1:
        return Interval(estimate, math.nan, math.nan, count, missing)
    if np.all(present == present[0]):
        estimate = float(present[0])  # a mean may be a rounding error away
        return Interval(estimate, estimate, estimate, count, missing)
    ordered = np.sort(present)
    if statistic == "mean":
        found = _resampled(count, RESAMPLES, seed, lambda ranks: ordered[ranks].mean(axis=-1))
    else:
        found = ordered[_middle(count, RESAMPLES, seed)].mean(axis=-1)
    tail = (1 - CONFIDENCE) / 2
    low, high = np.quantile(found, (tail, 1 - tail)).tolist()
    return Interval(estimate, low, high, count, missing)


def _resampled(
    count: int, resamples: int, seed: int, of: Callable[[NDArray[np.intp]], NDArray[np.generic]]
) -> NDArray[Any]:
    """What `of` makes of resamples (some, count) of ranks, for all of them."""
    random = np.random.default_rng(seed)
    batch = max(1, _RANKS_AT_ONCE // count)
    sizes = [min(batch, resamples - first) for first in range(0, resamples, batch)]
    return np.concatenate([of(random.integers(count, size=(size, count))) for size in sizes])


@lru_cache(maxsize=8)
def _middle(count: int, resamples: int, seed: int) -> NDArray[np.intp]:
    """Ranks of the two values in the middle of each resample, (resamples, 2).

    Samples of one size share them: to sort anew for each measure would take as long as to play.
    """
    middle = [(count - 1) // 2, count // 2]
    return _resampled(count, resamples, seed, lambda ranks: np.sort(ranks, axis=-1)[:, middle])


def summarize(episodes: pd.DataFrame, measures: Sequence[Measure], seed: int = 0) -> pd.DataFrame:
    """Each agent's statistic and interval of each measure, one row for each pair.

    Args:
        episodes: one row per agent and episode, with a column "agent" and one per measure.
        measures: which of them to summarize.
        seed: of the resampling.

    Returns:
        Columns agent, measure, unit, statistic, and the fields of `Interval`.
    """
    rows = []
    for agent, group in episodes.groupby("agent", sort=False):
        for measure in measures:
            interval = bootstrap_interval(
                group[measure.name].to_numpy(np.float64), measure.statistic, seed
            )
            rows.append(
                {
                    "agent": agent,
                    "measure": measure.name,
                    "unit": measure.unit,
                    "statistic": measure.statistic,
                    **vars(interval),
                }
            )
    return pd.DataFrame(rows)
