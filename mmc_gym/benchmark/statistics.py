"""Bootstrap resamples of scores: of training seeds, and of the instances that all agents met.

    agent A               instance 1   2   3  …  of environment E
    training seed 1                ·   ·   ·         w_1         w_s: how often seed s is drawn
    training seed 2                ·   ·   ·         w_2
                                  u_1 u_2 u_3                    u_i: how often instance i is drawn

A resample draws as many training seeds of each agent as it has, and as many instances as there
are, both with replacement; the score of seed s at instance i then counts w_s u_i times.  So the
interval covers both that training again gives another policy, and that other starts and targets are
easier or harder.  Episodes of one policy are never drawn as if each came from its own training.

    paired        The u_i are the same for all agents: what makes an instance hard for all of them
                  drops out of their differences.
    stratified    Each environment counts equally, whatever its number of instances.
    shared        The u_i are the same for all environments with as many instances.  The battery
                  draws the i-th start and target from the same seed everywhere: what is hard
                  without perturbation is hard under all of them, and drawn for each on its own it
                  would seem to average out (95 % intervals would cover 50 to 70 %).  Sets that
                  have nothing in common but their size lose nothing: they vary independently.
    seeds         A seed is one policy: it is drawn in all environments or in none.
    no training   An agent that was not trained has one policy, and only instances are drawn.  A
                  single trained policy is treated alike: its interval cannot tell what training
                  again would change.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal, TypeAlias

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from mmc_gym.measures.catalogue import Measure, Statistic
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


COLUMNS = ("agent", "training_seed", "environment", "instance")
_UNTRAINED = "no training"
_INSTANCES, _POLICIES = 0, 1  # streams of random numbers


@dataclass(frozen=True, eq=False)
class Scores:
    """Scores of agents, (policies, instances) for each environment; NaN where there is none.

    Attributes:
        environments: their names, E of them.
        instances: the number of instances in each.
        values: by agent, E arrays (policies, instances), the instances in the order of their names.
        seeds: by agent, its number of training seeds; 0 for one policy without training.
    """

    environments: tuple[str, ...]
    instances: tuple[int, ...]
    values: Mapping[str, tuple[Floats, ...]]
    seeds: Mapping[str, int]

    def of(self, agent: str) -> tuple[Floats, ...]:
        """The scores of an agent.

        Raises:
            ValueError: if there is no such agent.
        """
        if agent not in self.values:
            raise ValueError(f"agent must be one of {list(self.values)}, got {agent!r}")
        return self.values[agent]


@dataclass(frozen=True, eq=False)
class Draws:
    """How often everything was drawn in R resamples; row 0 draws all once: the data themselves.

    Attributes:
        policies: by agent, (R + 1, policies).
        instances: by environment, (R + 1, instances).
    """

    policies: Mapping[str, Floats]
    instances: tuple[Floats, ...]


def arrange(frame: pd.DataFrame, value: str = "value") -> Scores:
    """The scores of a tidy frame as arrays.

    Args:
        frame: a row per episode, with the columns agent, training_seed (missing for an agent
            without training), environment, instance, and `value`.
        value: the column of the scores, NaN where an episode has none.

    Raises:
        ValueError: if a column is missing, an episode is there twice, or some agent's policy has
            not met all instances.
    """
    missing = [column for column in (*COLUMNS, value) if column not in frame.columns]
    if missing or frame.empty:
        raise ValueError(f"frame must have rows with {[*COLUMNS, value]}, it lacks {missing}")
    seeds = frame["training_seed"].astype(object).where(frame["training_seed"].notna(), _UNTRAINED)
    table = frame.assign(training_seed=seeds)
    if table.duplicated(list(COLUMNS)).any():
        twice = table.loc[table.duplicated(list(COLUMNS)), list(COLUMNS)].iloc[0].to_dict()
        raise ValueError(f"frame must have each episode once, got {twice} repeatedly")
    environments = tuple(dict.fromkeys(table["environment"]))
    instances = {
        environment: sorted(set(group["instance"]))
        for environment, group in table.groupby("environment", sort=False)
    }
    values, count = {}, {}
    for agent, group in table.groupby("agent", sort=False):
        policies = list(dict.fromkeys(group["training_seed"]))
        episodes = group.set_index(["environment", "training_seed", "instance"])[value]
        if len(episodes) != len(policies) * sum(map(len, instances.values())):
            raise ValueError(
                f"frame must have all instances of all environments for each of the training seeds "
                f"of {agent!r}, {len(policies)} × {sum(map(len, instances.values()))} episodes, "
                f"got {len(episodes)}"
            )
        values[str(agent)] = tuple(
            episodes.loc[environment]
            .unstack()
            .reindex(index=policies, columns=instances[environment])
            .to_numpy(dtype=np.float64)
            for environment in environments
        )
        count[str(agent)] = 0 if policies == [_UNTRAINED] else len(policies)
    sizes = tuple(len(instances[environment]) for environment in environments)
    return Scores(tuple(map(str, environments)), sizes, values, count)


def draw(scores: Scores, resamples: int, seed: int) -> Draws:
    """Draw policies, and instances: one draw for all environments with as many of them.

    Instances depend on the seed and their number alone, neither on agents nor on environments.
    """
    of_instances = {
        count: _counts((seed, _INSTANCES, count), count, resamples)
        for count in set(scores.instances)
    }
    of_policies = {
        agent: _counts((seed, _POLICIES, number), len(values[0]), resamples)
        for number, (agent, values) in enumerate(scores.values.items())
    }
    return Draws(of_policies, tuple(of_instances[count] for count in scores.instances))


def _counts(seed: tuple[int, ...], count: int, resamples: int) -> Floats:
    drawn = np.random.default_rng(seed).integers(count, size=(resamples, count))
    cells: NDArray[np.intp] = drawn + np.arange(resamples)[:, None] * count
    times = np.bincount(cells.ravel(), minlength=resamples * count).reshape(resamples, count)
    return np.concatenate([np.ones((1, count)), times])


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


NESTED_RESAMPLES = 2_000
_BATCH = 250  # resamples at once: bounds the memory

Better: TypeAlias = Literal["high", "low"]


@dataclass(frozen=True)
class Estimate:
    """A statistic over training seeds and instances, with its 95 % interval.

    Attributes:
        estimate: of the data themselves.
        low: lower end of the interval.
        high: upper end.
        seeds: number of training seeds of the agent, or of each of two; 0 without training.
        instances: number of instances, the same for all agents.
        environments: in how many environments they are.
        missing: number of episodes, of both of two agents, that have no score (NaN).
    """

    estimate: float
    low: float
    high: float
    seeds: tuple[int, ...]
    instances: int
    environments: int
    missing: int = 0


def stratified_bootstrap(
    frame: pd.DataFrame,
    statistic: WeightedStatistic = weighted_iqm,
    value: str = "value",
    resamples: int = NESTED_RESAMPLES,
    seed: int = 0,
) -> dict[str, Estimate]:
    """A statistic of each agent, over its training seeds and all instances, with its interval.

    Args:
        frame: tidy, a row per episode, see `resampling.arrange`.
        statistic: `weighted_iqm`, `weighted_mean` or `weighted_median`, or one like them.
        value: the column of the scores; episodes where it is NaN are left out.
        resamples: how many.
        seed: of the resampling.

    Raises:
        ValueError: if the agents have not met the same instances.

    Example:
        >>> frame = pd.DataFrame(
        ...     {
        ...         "agent": "network",
        ...         "training_seed": None,
        ...         "environment": "MMCReach-v0",
        ...         "instance": range(4),
        ...         "value": [0.0, 1.0, 2.0, 3.0],
        ...     }
        ... )
        >>> found = stratified_bootstrap(frame)["network"]
        >>> found.estimate, found.seeds, found.instances
        (1.5, (0,), 4)
    """
    scores = arrange(frame, value)
    draws = draw(scores, resamples, seed)
    return {
        agent: estimate(distribution(scores, draws, agent, statistic), scores, agent)
        for agent in scores.values
    }


def paired_difference(
    frame: pd.DataFrame,
    agent: str,
    other: str,
    statistic: WeightedStatistic = weighted_mean,
    value: str = "value",
    resamples: int = NESTED_RESAMPLES,
    seed: int = 0,
) -> Estimate:
    """The statistic of one agent less that of another, on the same instances.

    Both are resampled with the same instances, and each with its own training seeds.  For the
    mean it is the mean of the differences at each instance.

    Args:
        frame: as in `stratified_bootstrap`.
        agent: the one.
        other: the other.
        statistic: as in `stratified_bootstrap`.
        value: the column of the scores.
        resamples: how many.
        seed: of the resampling.

    Raises:
        ValueError: if there is no such agent, or they have not met the same instances.
    """
    scores = arrange(frame, value)
    draws = draw(scores, resamples, seed)
    one, less = (distribution(scores, draws, name, statistic) for name in (agent, other))
    return estimate(one - less, scores, agent, other)


def probability_of_improvement(
    frame: pd.DataFrame,
    agent: str,
    other: str,
    better: Better = "high",
    value: str = "value",
    resamples: int = NESTED_RESAMPLES,
    seed: int = 0,
) -> Estimate:
    """How probable it is that a policy of `agent` does better than one of `other`.

    Mean over environments of P(X > Y) + ½ P(X = Y), over all pairs of a training seed of the one
    and of the other, both at the same instance.  ½ for an agent and its copy.

    Args:
        frame: as in `stratified_bootstrap`; where either is NaN, the pair is left out.
        agent: the one.
        other: the other.
        better: whether "high" or "low" scores are better.
        value: the column of the scores.
        resamples: how many.
        seed: of the resampling.

    Raises:
        ValueError: if there is no such agent, or they have not met the same instances.
    """
    scores = arrange(frame, value)
    draws = draw(scores, resamples, seed)
    sign = 1.0 if better == "high" else -1.0
    chances = []
    for mine, theirs, instances in zip(scores.of(agent), scores.of(other), draws.instances):
        lead = sign * (mine[:, None] - theirs[None])  # (policies, policies, instances)
        compared = (~np.isnan(mine))[:, None] & (~np.isnan(theirs))[None]
        # Not the sign of the difference: of two infinite scores there is none.
        wins = np.where(mine[:, None] == theirs[None], 0.5, lead > 0) * compared
        weights = draws.policies[agent][:, :, None] * draws.policies[other][:, None]
        sums = [
            (np.tensordot(instances, table.astype(np.float64), (1, 2)) * weights).sum((1, 2))
            for table in (wins, compared)
        ]
        with np.errstate(invalid="ignore"):
            chances.append(sums[0] / sums[1])
    return estimate(np.mean(chances, axis=0), scores, agent, other)


def performance_profile(
    frame: pd.DataFrame,
    thresholds: ArrayLike,
    better: Better = "high",
    value: str = "value",
    resamples: int = NESTED_RESAMPLES,
    seed: int = 0,
) -> pd.DataFrame:
    """The share of each agent's episodes that are better than τ, for all τ, with 95 % bands.

    The bands are pointwise.  An episode without a score (NaN) is better than no τ.  Environments
    count equally.

    Args:
        frame: as in `stratified_bootstrap`.
        thresholds: τ, (m,).
        better: "high": the share above τ, "low": below.
        value: the column of the scores.
        resamples: how many.
        seed: of the resampling.

    Returns:
        A row per agent and τ: agent, threshold, and the fields of `Estimate`, seeds a number.
    """
    scores = arrange(frame, value)
    draws = draw(scores, resamples, seed)
    levels = np.asarray(thresholds, dtype=np.float64)
    rows = []
    for agent, values in scores.values.items():
        shares = np.zeros((resamples + 1, levels.size))
        for table, instances in zip(values, draws.instances):
            for policy, weight in zip(table, draws.policies[agent].T):
                beyond = policy > levels[:, None] if better == "high" else policy < levels[:, None]
                above = instances @ beyond.T.astype(np.float64)
                shares += weight[:, None] * above / (policy.size * len(table) * len(values))
        for level, column in zip(levels.tolist(), shares.T):
            found = vars(estimate(column, scores, agent))
            rows.append({"agent": agent, "threshold": level, **found, "seeds": found["seeds"][0]})
    return pd.DataFrame(rows)


def distribution(scores: Scores, draws: Draws, agent: str, statistic: WeightedStatistic) -> Floats:
    """The statistic of an agent in the data themselves and in all resamples, (R + 1,).

    What the functions of frames are made of, for whoever has many statistics of the same draws.
    """
    tables, policies = scores.of(agent), draws.policies[agent]
    values = np.concatenate([table.ravel() for table in tables])
    order = np.argsort(values, kind="stable")
    order = order[: values.size - int(np.isnan(values).sum())]  # NaNs are the last
    policy = np.concatenate([np.repeat(np.arange(len(t)), t.shape[1]) for t in tables])[order]
    starts = np.cumsum([0, *scores.instances])
    instance = np.concatenate(
        [np.tile(np.arange(t.shape[1]) + start, len(t)) for t, start in zip(tables, starts)]
    )[order]
    equal = np.concatenate([table / table.shape[1] for table in draws.instances], axis=1)
    found = []
    for first in range(0, len(policies), _BATCH):
        rows = slice(first, first + _BATCH)
        weights = np.take(equal[rows], instance, axis=1)
        weights *= np.take(policies[rows], policy, axis=1)
        found.append(statistic(values[order], weights))
    return np.concatenate(found)


def estimate(distribution: Floats, scores: Scores, *agents: str) -> Estimate:
    """What a `distribution`, or a difference of two, says of one agent, or of two."""
    resampled = distribution[1:][~np.isnan(distribution[1:])]
    low, high = math.nan, math.nan
    if resampled.size:
        tail = (1 - CONFIDENCE) / 2
        low, high = np.quantile(resampled, (tail, 1 - tail)).tolist()
    return Estimate(
        estimate=float(distribution[0]),
        low=low,
        high=high,
        seeds=tuple(scores.seeds[agent] for agent in agents),
        instances=sum(scores.instances),
        environments=len(scores.environments),
        missing=sum(
            int(np.isnan(table).sum())
            for agent in dict.fromkeys(agents)
            for table in scores.values[agent]
        ),
    )
