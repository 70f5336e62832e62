"""Bootstrap intervals over training seeds, and over the instances that all agents play.

    agent A               instance 1   2   3  …  of environment E
    training seed 1                ·   ·   ·         w_1         w_s: how often seed s is drawn
    training seed 2                ·   ·   ·         w_2
                                  u_1 u_2 u_3                    u_i: how often instance i is drawn

Each resample draws training seeds of every agent and instances, with replacement, as many as there
are.  The score of seed s at instance i then counts w_s u_i times.  So the interval covers that
another training gives another policy, and that other starts and targets are easier or harder.

    paired        The u_i are the same for all agents.  What makes an instance hard for all of them
                  cancels in their differences.
    stratified    Each environment counts equally, whatever its number of instances.
    shared        The u_i are the same for all environments with the same number of instances: the
                  benchmark draws the i-th start and target from the same seed everywhere.  With
                  separate draws 95 % intervals would cover only 50 to 70 %.
    seeds         A seed is one policy: it is drawn in all environments or in none.
    no training   An untrained agent has one policy, so only instances are drawn.  A single trained
                  policy is treated alike: its interval does not cover other trainings.
    one value     A single policy with values at a single instance has no interval.
    shares        The share of episodes that a single policy succeeds in, in one environment, has
                  Wilson's interval instead: after 0 of 20 a bootstrap gives [0, 0], Wilson's is
                  [0, 0.16].  In several environments it has the mean of these if no resample
                  differs.  Two shares whose episodes differ alike in all n pairs may differ
                  otherwise in as many as Wilson's interval of 0 of n says: after 20 equal pairs
                  [−0.16, 0.16].

Source: Agarwal, Schwarzer, Castro, Courville & Bellemare (2021), Deep reinforcement learning at the
edge of the statistical precipice, NeurIPS 34, https://arxiv.org/abs/2108.13264.  Unlike there,
instances are resampled too, and agents are paired by them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import pairwise
from statistics import NormalDist
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr, stdtrit

from mmc_gym.measures.catalogue import Measure, Statistic
from mmc_gym.measures.episode import Floats

CONFIDENCE = 0.95
TAILS = ((1 - CONFIDENCE) / 2, 1 - (1 - CONFIDENCE) / 2)  # the ends of an interval
RESAMPLES = 2_000  # by default

COLUMNS = ["agent", "training_seed", "environment", "instance"]
_INSTANCES, _POLICIES, _EPISODES = 0, 1, 2  # streams of random numbers
_COLUMNS = 1_000  # at once: bounds the memory
_linspace = lru_cache(maxsize=32)(np.linspace)  # of each number of resamples


@dataclass(frozen=True, eq=False)
class Scores:
    """Scores of agents in E environments; NaN where an episode has none."""

    instances: tuple[int, ...]  #: number of instances in each environment
    #: by agent, E arrays (policies, instances), the instances in the order of their names
    values: Mapping[str, tuple[Floats, ...]]
    #: by agent, the number of training seeds; 0 without training
    seeds: Mapping[str, int] = field(default_factory=dict)


def arrange(frame: pd.DataFrame, names: Sequence[str]) -> dict[str, Scores]:
    """Return the scores in several columns of a tidy frame as arrays.

    Args:
        frame: a row per episode, with the columns agent, training_seed (missing for an agent
            without training), environment, instance, and those of the scores.
        names: the columns of the scores, NaN where an episode has none.

    Raises:
        ValueError: if a column is missing, an episode occurs twice, or a policy lacks instances.
    """
    missing = [column for column in (*COLUMNS, *names) if column not in frame.columns]
    if missing or frame.empty:
        raise ValueError(f"frame must have rows with {[*COLUMNS, *names]}, it lacks {missing}")
    is_twice = frame.duplicated(COLUMNS).to_numpy()
    if is_twice.any():
        first = frame.loc[is_twice, COLUMNS].iloc[0].to_dict()
        raise ValueError(f"frame must have each episode once, got {first} repeatedly")
    agent, agents = pd.factorize(frame["agent"])
    environment = pd.factorize(frame["environment"])[0]
    seed = pd.factorize(frame["training_seed"])[0]  # -1 without training
    instance = pd.factorize(frame["instance"], sort=True)[0]
    most = instance.max() + 1
    sizes = tuple(np.bincount(np.unique(environment * most + instance) // most).tolist())
    places, count = {}, {}
    for number, name in enumerate(map(str, agents)):
        mine = np.flatnonzero(agent == number)
        policy, policies = pd.factorize(seed[mine])
        if len(mine) != len(policies) * sum(sizes):
            raise ValueError(
                f"frame must have all instances of all environments for each of the training seeds "
                f"of {name!r}, {len(policies)} × {sum(sizes)} episodes, got {len(mine)}"
            )
        order = np.lexsort((instance[mine], policy, environment[mine]))
        tables = np.split(mine[order], len(policies) * np.cumsum(sizes)[:-1])
        places[name] = [table.reshape(len(policies), -1) for table in tables]
        count[name] = 0 if policies.tolist() == [-1] else len(policies)

    columns = {name: frame[name].to_numpy(dtype=np.float64) for name in names}
    return {
        name: Scores(
            instances=sizes,
            values={agent: tuple(map(column.take, places[agent])) for agent in places},
            seeds=count,
        )
        for name, column in columns.items()
    }


@lru_cache(maxsize=32)
def _counts(seed: tuple[int, ...], count: int, resamples: int) -> Floats:
    """Return how often each of `count` is drawn in R resamples, after a row of ones."""
    drawn = np.random.default_rng(seed).integers(count, size=(resamples, count))
    cells: NDArray[np.intp] = drawn + np.arange(resamples)[:, None] * count
    times = np.bincount(cells.ravel(), minlength=resamples * count).reshape(resamples, count)
    counts = np.concatenate([np.ones((1, count)), times])
    counts.flags.writeable = False  # the cache shares it
    return counts


@lru_cache(maxsize=32)
def _episode_counts(
    seed: int, agent: int, shape: tuple[int, int], resamples: int
) -> NDArray[np.unsignedinteger]:
    """Return how often each of (policies · instances) episodes is drawn, (…, R + 1)."""
    policies = _counts((seed, _POLICIES, agent), shape[0], resamples)
    instances = _counts((seed, _INSTANCES, shape[1]), shape[1], resamples)
    counts = (policies.T[:, None] * instances.T).reshape(math.prod(shape), -1)
    return counts.astype(np.min_scalar_type(math.prod(shape) + 2), order="C")  # small: quick to add


class Estimate(NamedTuple):
    """A statistic over training seeds and instances, with its 95 % interval."""

    estimate: float
    low: float
    high: float

    @classmethod
    def of(cls, distribution: Floats) -> Estimate:
        """Return the estimate of a statistic in the data, then in each resample, (R + 1,)."""
        return cls(float(distribution[0]), *percentile_interval(distribution[1:]))


class Bootstrap:
    """Scores of agents and R resamples of them, the same for all estimates."""

    def __init__(self, scores: Scores, resamples: int = RESAMPLES, seed: int = 0) -> None:
        self.scores, self._seed = scores, seed
        #: by agent, how often each policy is drawn, (R + 1, policies).  Row 0 counts each once, and
        #: so gives the data themselves.
        self.policies = {
            agent: _counts((seed, _POLICIES, number), len(values[0]), resamples)
            for number, (agent, values) in enumerate(scores.values.items())
        }
        #: by environment, how often each instance is drawn, (R + 1, instances).  Environments with
        #: the same number of instances share their draw, which only depends on seed and number.
        self.instances = tuple(
            _counts((seed, _INSTANCES, count), count, resamples) for count in scores.instances
        )
        self._drawn = {draws.shape[1]: draws for draws in self.instances}
        self._shares = {count: draws / count for count, draws in self._drawn.items()}

    @classmethod
    def of(
        cls, frame: pd.DataFrame, value: str = "value", resamples: int = RESAMPLES, seed: int = 0
    ) -> Bootstrap:
        """Resample a column of a tidy frame; arguments and errors are those of `arrange`.

        >>> of = {"agent": "network", "training_seed": None, "environment": "random"}
        >>> frame = pd.DataFrame({**of, "instance": range(4), "value": [0.0, 1.0, 2.0, 3.0]})
        >>> Bootstrap.of(frame).estimate("network").estimate
        1.5
        """
        return cls(arrange(frame, [value])[value], resamples, seed)

    def estimate(self, agent: str, statistic: Statistic = "mean") -> Estimate:
        """Estimate a statistic of an agent over its training seeds and all instances.

        A median is one of the episodes of a single environment.
        """
        estimate = Estimate.of(self.distribution(agent, statistic))
        tables = self.scores.values[agent]
        has_width = len(tables) > 1 and estimate.low != estimate.high
        if has_width or not self._is_share(agent, statistic):
            return estimate
        known = [table[~np.isnan(table)] for table in tables]
        ends = [wilson_interval(float(np.mean(row)), len(row)) for row in known if len(row)]
        return Estimate(estimate.estimate, *np.mean(ends, axis=0).tolist())

    def difference(self, agent: str, other: str, statistic: Statistic = "mean") -> Estimate:
        """Estimate the statistic of one agent less that of another, on the same instances."""
        mine, theirs = (self.distribution(name, statistic) for name in (agent, other))
        # Rounded, so that the order of sums makes no difference.
        estimate, low, high = Estimate.of((mine - theirs).round(12))
        if low == high and all(self._is_share(name, statistic) for name in (agent, other)):
            hidden = float(np.mean([wilson_interval(0.0, n)[1] for n in self.scores.instances]))
            low, high = max(-1.0, low - hidden), min(1.0, low + hidden)
        return Estimate(estimate, low, high)

    def _is_share(self, agent: str, statistic: Statistic) -> bool:
        """Return whether a statistic is the share of the successes of a single policy."""
        tables = self.scores.values[agent]
        values = np.concatenate([table.ravel() for table in tables])
        return bool(
            statistic == "mean"
            and len(tables[0]) == 1
            and self._varies(agent)
            and np.isin(values[~np.isnan(values)], (0.0, 1.0)).all()
        )

    def improvement(self, agent: str, other: str) -> Estimate:
        """Estimate the probability that a policy of `agent` scores higher than one of `other`.

        Mean over environments of P(X > Y) + ½ P(X = Y), over all pairs of a training seed of each,
        at the same instance.  Pairs in which a score is NaN are left out.
        """
        weights = self.policies[agent][:, :, None] * self.policies[other][:, None]
        pairs = weights.reshape(len(weights), -1)
        at_once = max(1, _COLUMNS // pairs.shape[1])
        total, counted = np.zeros((2, len(pairs)))
        for draws, ours, others in self._sharing(agent, other):
            for begin in range(0, len(ours), at_once):
                part = slice(begin, begin + at_once)
                shares = _shares_of_wins(ours[part], others[part], draws, pairs)
                total += np.nansum(shares, axis=1)
                counted += (~np.isnan(shares)).sum(axis=1)
        with np.errstate(invalid="ignore"):
            return Estimate.of(self._where_it_varies(total / counted, agent, other))

    def _where_it_varies(self, distribution: Floats, *agents: str) -> Floats:
        if not all(map(self._varies, agents)):
            distribution[1:] = np.nan
        return distribution

    def _varies(self, agent: str) -> bool:
        """Return False if all values of an agent are of one policy at one instance."""
        known = [~np.isnan(table) for table in self.scores.values[agent]]
        policies = np.any([table.any(axis=1) for table in known], axis=0)
        # Environments with as many instances share their draw.
        instances = {
            (table.shape[1], instance)
            for table in known
            for instance in np.flatnonzero(table.any(axis=0))[:2]
        }
        return bool(policies.sum() > 1 or len(instances) > 1)

    def _sharing(self, *agents: str) -> Iterator[Sequence[Floats]]:
        """Yield each draw of instances, and each agent's tables of environments that share it.

        Shapes are (R + 1, instances) and (environments, policies, instances).
        """
        for count, draws in self._drawn.items():
            tables = (self.scores.values[agent] for agent in agents)
            alike = ([table for table in group if table.shape[1] == count] for group in tables)
            yield draws, *map(np.stack, alike)

    def distribution(self, agent: str, statistic: Statistic) -> Floats:
        """Return an agent's statistic in the data, then in each resample, (R + 1,)."""
        if statistic == "mean":
            return self._where_it_varies(self._means(agent), agent)
        (table,) = self.scores.values[agent]
        number = list(self.scores.values).index(agent)
        resamples = len(self.policies[agent]) - 1
        counts = _episode_counts(self._seed, number, table.shape, resamples)
        return self._where_it_varies(_weighted_medians(table, counts), agent)

    def _means(self, agent: str) -> Floats:
        policies = self.policies[agent]
        total, weight = np.zeros((2, len(policies)))
        for draws, scores in self._sharing(agent):
            known, shares = ~np.isnan(scores), self._shares[draws.shape[1]]
            values = np.where(known, scores, 0.0).sum(axis=0)
            total += _weighted_sums(shares, policies, values)[:, 0]
            weight += _weighted_sums(shares, policies, known.sum(axis=0))[:, 0]
        values = np.concatenate([table.ravel() for table in self.scores.values[agent]])
        ends = np.fmin.reduce(values), np.fmax.reduce(values)
        with np.errstate(invalid="ignore"):
            return np.clip(total / weight, *ends)  # rounding may leave the range


def _weighted_sums(instances: Floats, policies: Floats, tables: NDArray[Any]) -> Floats:
    """Return Σ_s w_s Σ_i u_i x_si in each resample and environment, (R, environments).

    Weights u are (R, instances) and w (R, policies).  Tables x are (environments, policies,
    instances), or of a single environment without the first axis.
    """
    columns = tables.reshape(-1, tables.shape[-1]).T.astype(np.float64)
    by_policy = (instances @ columns).reshape(len(instances), -1, policies.shape[1])
    return np.asarray(np.einsum("rep,rp->re", by_policy, policies))


def _shares_of_wins(ours: Floats, others: Floats, instances: Floats, pairs: Floats) -> Floats:
    """Return P(X > Y) + ½ P(X = Y) in each resample and environment, (R, environments).

    Scores X and Y are (environments, policies, instances); weights (R, instances) and (R, pairs of
    policies).  NaN without pairs in which both have a score.
    """
    mine, theirs = ours[:, :, None], others[:, None]
    compared = ~np.isnan(mine) & ~np.isnan(theirs)
    wins = np.where(mine == theirs, 0.5, mine > theirs) * compared
    with np.errstate(invalid="ignore"):
        return _weighted_sums(instances, pairs, wins) / _weighted_sums(instances, pairs, compared)


def _weighted_medians(table: Floats, counts: NDArray[np.unsignedinteger]) -> Floats:
    """Return the median of (policies, instances) in each resample of `_episode_counts`, (R,)."""
    values = table.ravel()
    order = np.argsort(values)[: np.count_nonzero(~np.isnan(values))]  # NaN last
    if not len(order):
        return np.full(counts.shape[1], np.nan)
    ends = counts[order]
    for before, row in pairwise(ends):  # a third of the time of `cumsum` over rows
        row += before
    whole = ends[-1]
    halves = (whole + 1) // 2, (whole + 2) // 2
    lower, upper = ((ends < half).sum(axis=0, dtype=counts.dtype) for half in halves)
    places = np.minimum([lower, upper], len(order) - 1)  # without any weight they are beyond it
    return np.where(whole > 0, values[order[places]].sum(axis=0) / 2, np.nan)


@dataclass(frozen=True)
class Interval:
    """A statistic of `count` values with its 95 % interval; `missing` NaNs are left out."""

    estimate: float
    low: float
    high: float
    count: int
    missing: int


def wilson_interval(share: float, count: int) -> tuple[float, float]:
    """Return Wilson's 95 % interval of a probability, from the share of successes in `count`.

    Source: Wilson (1927), J. Am. Stat. Assoc. 22: 209-212.

    >>> [round(end, 2) for end in wilson_interval(0.0, 20)]
    [0.0, 0.16]
    """
    z2 = NormalDist().inv_cdf(TAILS[1]) ** 2
    middle = share + z2 / (2 * count)
    half = math.sqrt(z2 / count * (share * (1 - share) + z2 / (4 * count)))
    whole = 1 + z2 / count
    return max(0.0, (middle - half) / whole), min(1.0, (middle + half) / whole)


def sample_interval(
    values: ArrayLike, statistic: Statistic, seed: int = 0, resamples: int = RESAMPLES
) -> Interval:
    """Return the mean or median of `values` with its 95 % interval: percentile bootstrap.

    Percentile, not BCa: the jackknife in BCa fails for the median.  The mean of zeros and ones has
    Wilson's interval instead, if it is of one sample.  Values are (episodes,), or (trainings,
    episodes) of several trainings on the same episodes, and then both are resampled.

    Source: Efron and Tibshirani (1993), An Introduction to the Bootstrap, chapter 13.

    >>> sample_interval([2.0, 2.0, float("nan")], "mean")
    Interval(estimate=2.0, low=2.0, high=2.0, count=2, missing=1)
    >>> found = sample_interval([[1.0, 1.0, 1.0], [0.0, 0.0, 0.0]], "mean")
    >>> found.estimate, found.low, found.high, found.count
    (0.5, 0.0, 1.0, 6)
    """
    table = np.asarray(values, dtype=np.float64)
    present = table[~np.isnan(table)]
    estimate = Estimate(math.nan, math.nan, math.nan)
    if present.size:
        sample = present[None] if table.ndim == 1 else table
        bootstrap = Bootstrap(Scores((sample.shape[1],), {"": (sample,)}), resamples, seed)
        estimate = bootstrap.estimate("", statistic)
        if table.ndim == 1 and statistic == "mean":  # not from shares, so that 7 of 20 is 0.35
            mean = float(np.clip(np.mean(present), present.min(), present.max()))
            estimate = estimate._replace(estimate=mean)
    return Interval(*estimate, present.size, table.size - present.size)


def resampled_means(samples: ArrayLike, resamples: int = RESAMPLES, seed: int = 0) -> Floats:
    """Return the mean over a sample (n, ...), then that of each resample, (R + 1, ...).

    Whatever is computed from each row, such as a fit to a mean curve, has the `percentile_interval`
    of its rows but the first.  NaNs are left out, and a sample of one is not resampled: (1, ...).
    """
    table = np.asarray(samples, dtype=np.float64)
    resamples = resamples if len(table) > 1 else 0
    counts = _counts((seed, _INSTANCES, len(table)), len(table), resamples)
    present = ~np.isnan(table)
    with np.errstate(invalid="ignore"):
        return np.asarray(
            np.tensordot(counts, np.where(present, table, 0.0), 1)
            / np.tensordot(counts, present.astype(np.float64), 1)
        )


def success_interval(successes: ArrayLike, episodes: int) -> Interval:
    """Return the mean success of several trainings, with its 95 % interval over seeds and episodes.

    A resample draws training seeds, and for each of them a binomial number of successes in so many
    `episodes`.  Drawing seeds alone would give ten trainings with 499 successes in 500 episodes an
    interval without width.  A single training has none.  The `successes` are fractions of the
    episodes of each training, (seeds,).

    >>> found = success_interval([0.998, 0.998, 0.998], episodes=500)
    >>> found.estimate, found.low < 0.997, found.high
    (0.998, True, 1.0)
    """
    fractions = np.asarray(successes, dtype=np.float64)
    present = fractions[~np.isnan(fractions)]
    count, missing = present.size, fractions.size - present.size
    if count < 2:
        estimate = present.item() if count else math.nan
        return Interval(estimate, math.nan, math.nan, count, missing)
    seeds = _counts((0, _POLICIES, 0), count, RESAMPLES)[1:].astype(np.int64)
    succeeded = np.random.default_rng((0, _EPISODES)).binomial(seeds * episodes, present)
    low, high = percentile_interval(succeeded.sum(axis=-1) / (count * episodes))
    return Interval(float(np.mean(present)), low, high, count, missing)


def summarize(episodes: pd.DataFrame, measures: Sequence[Measure], seed: int = 0) -> pd.DataFrame:
    """Return a row per agent and measure: agent, measure, unit, statistic, and an `Interval`.

    The `episodes` have a row per agent and episode, with a column "agent" and one per measure;
    with several trainings of an agent also "training_seed", and the same episodes in each.
    """
    rows = []
    for agent, group in episodes.groupby("agent", sort=False):
        trainings = group["training_seed"].nunique() if "training_seed" in group else 1
        for measure in measures:
            values = group[measure.name].to_numpy(np.float64)
            table = values.reshape(trainings, -1) if trainings > 1 else values
            interval = sample_interval(table, measure.statistic, seed)
            facts = {"measure": measure.name, "unit": measure.unit, "statistic": measure.statistic}
            rows.append({"agent": agent, **facts, **vars(interval)})
    return pd.DataFrame(rows)


def expanded_tails(count: int) -> tuple[float, float]:
    """Return between which quantiles of resamples of few units 95 % intervals are.

    The plain `TAILS` are too narrow; these are as wide as Student's t asks for (Hesterberg 2015,
    Am. Stat. 69, 371).
    """
    if count < 2:
        return TAILS
    high = ndtr(math.sqrt(count / (count - 1)) * stdtrit(count - 1, TAILS[1]))
    return float(1 - high), float(high)


def percentile_interval(
    resampled: Floats, tails: tuple[float, float] = TAILS
) -> tuple[float, float]:
    """Return the ends of the 95 % percentile interval; resamples with NaN are left out."""
    present = np.sort(resampled[~np.isnan(resampled)])
    if not present.size:
        return math.nan, math.nan
    low, high = np.interp(tails, _linspace(0, 1, present.size), present).tolist()
    return low, high
