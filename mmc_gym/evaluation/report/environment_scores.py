"""The scores of one environment as arrays, and the bootstrap of all its measures by the same draws.

As `replication` does it for one measure of a frame: there are hundreds of figures in a report, and
what takes time is to arrange the scores and to draw, which is done once here.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pandas as pd

from mmc_gym.evaluation.measures import Measure
from mmc_gym.evaluation.metrics import Floats
from mmc_gym.evaluation.replication import Estimate
from mmc_gym.evaluation.resampling import Scores, draw
from mmc_gym.evaluation.statistics import CONFIDENCE
from mmc_gym.evaluation.weighted import WeightedStatistic, weighted_mean, weighted_median

COMMON = 5
"""Instances at least, on which two agents are compared."""

_STATISTICS: dict[str, WeightedStatistic] = {"mean": weighted_mean, "median": weighted_median}


class EnvironmentScores:
    """The scores of all agents in an environment.

    Attributes:
        agents: names.
    """

    def __init__(self, episodes: pd.DataFrame, measures: Sequence[str], resamples: int) -> None:
        """Arrange scores and draw resamples.

        Args:
            episodes: of the environment; columns agent, training_seed, instance, and measures.
            measures: names of the columns.
            resamples: of the bootstrap.

        Raises:
            ValueError: if an agent has not met all instances.
        """
        instances = episodes["instance"].nunique()
        self._columns = {name: number for number, name in enumerate(measures)}
        self._tables: dict[str, Floats] = {}  # (measures, policies, instances)
        self._seeds: dict[str, int] = {}
        for agent, rows in episodes.groupby("agent", sort=False):
            ordered = rows.sort_values(["training_seed", "instance"], kind="stable")
            policies = max(1, int(rows["training_seed"].nunique()))
            if len(rows) != policies * instances:
                raise ValueError(
                    f"episodes of {agent!r} in {rows['environment'].iloc[0]!r} must be of all "
                    f"{instances} instances for each of {policies} policies, got {len(rows)}"
                )
            values = ordered[list(measures)].to_numpy(np.float64)
            self._tables[str(agent)] = values.T.reshape(len(measures), policies, instances)
            self._seeds[str(agent)] = int(rows["training_seed"].nunique())
        self.agents = tuple(self._tables)
        shapes = {agent: (table[0],) for agent, table in self._tables.items()}
        self._draws = draw(Scores(("",), (instances,), shapes, self._seeds), resamples, seed=0)
        self._known: dict[tuple[str, str, str], Floats] = {}

    def values(self, agent: str, measure: Measure) -> Floats:
        """Scores (policies, instances); NaN where there is none."""
        found: Floats = self._tables[agent][self._columns[measure.name]]
        return found

    def distribution(self, agent: str, measure: Measure) -> Floats:
        """A measure's statistic in the data themselves, and in all resamples, (R + 1,)."""
        key = (agent, measure.name, measure.statistic)
        if key not in self._known:
            self._known[key] = self._resampled(agent, measure, self.values(agent, measure))
        return self._known[key]

    def estimate(self, distribution: Floats, *agents: str) -> Estimate:
        """The statistic of the data, with its interval."""
        resampled = distribution[1:][~np.isnan(distribution[1:])]
        low, high = math.nan, math.nan
        if resampled.size:
            tail = (1 - CONFIDENCE) / 2
            low, high = np.quantile(resampled, (tail, 1 - tail)).tolist()
        seeds = tuple(self._seeds[agent] for agent in agents)
        instances = next(iter(self._tables.values())).shape[-1]
        return Estimate(float(distribution[0]), low, high, seeds, instances, 1)

    def difference(self, agent: str, other: str, measure: Measure) -> Estimate | None:
        """One agent less the other, on the instances where both have a value; None if few."""
        tables = [self.values(name, measure) for name in (agent, other)]
        common = np.all([(~np.isnan(table)).any(axis=0) for table in tables], axis=0)
        if common.sum() < COMMON:
            return None
        if common.all():
            one, less = (self.distribution(name, measure) for name in (agent, other))
        else:
            one, less = (
                self._resampled(name, measure, np.where(common, table, np.nan))
                for name, table in zip((agent, other), tables, strict=True)
            )
        return self.estimate(one - less, agent, other)

    def _resampled(self, agent: str, measure: Measure, table: Floats) -> Floats:
        values = table.ravel()
        order = np.argsort(values, kind="stable")
        order = order[: values.size - int(np.isnan(values).sum())]  # NaNs are the last
        policy, instance = np.divmod(order, table.shape[1])
        weights = self._draws.policies[agent][:, policy] * self._draws.instances[0][:, instance]
        return _STATISTICS[measure.statistic](values[order], weights)
