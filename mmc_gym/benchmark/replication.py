"""Statistics of agents over training seeds and over the instances that they all met.

Starts, targets and perturbations are the same for all agents, and they are compared on them.  The
intervals say what would change with other instances and, where there are several, with other
training seeds: see `resampling`.  Each result says over how many of both, so that captions can.

Source: Agarwal, Schwarzer, Castro, Courville & Bellemare (2021), Deep reinforcement learning at the
edge of the statistical precipice, NeurIPS 34, https://arxiv.org/abs/2108.13264: interquartile mean,
performance profiles, probability of improvement and stratified bootstrap.  Unlike there, instances
are resampled too, and agents are paired by them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from mmc_gym.benchmark.statistics import Draws, Scores, arrange, draw
from mmc_gym.benchmark.statistics_part import CONFIDENCE
from mmc_gym.benchmark.weighted import WeightedStatistic, weighted_iqm, weighted_mean
from mmc_gym.measures.reaching import Floats

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
