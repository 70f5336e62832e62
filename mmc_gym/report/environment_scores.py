"""The scores of one environment as arrays, and the bootstrap of all its measures by the same draws.

There are hundreds of figures in a report, and what takes time is to arrange the scores and to draw,
which is done once here; all else is as in `replication`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from mmc_gym.benchmark.replication import Estimate, distribution, estimate
from mmc_gym.benchmark.statistics import Scores, draw
from mmc_gym.benchmark.weighted import WeightedStatistic, weighted_mean, weighted_median
from mmc_gym.measures.catalogue import Measure
from mmc_gym.measures.reaching import Floats

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
        self._instances = instances
        shapes = {agent: table[0] for agent, table in self._tables.items()}
        self._draws = draw(self._scores(shapes), resamples, seed=0)
        self._known: dict[tuple[str, str, str], Floats] = {}

    def values(self, agent: str, measure: Measure) -> Floats:
        """Scores (policies, instances); NaN where there is none."""
        found: Floats = self._tables[agent][self._columns[measure.name]]
        return found

    def distribution(self, agent: str, measure: Measure) -> Floats:
        """A measure's statistic in the data themselves, and in all resamples, (R + 1,)."""
        key = (agent, measure.name, measure.statistic)
        if key not in self._known:
            scores = self._scores({agent: self.values(agent, measure)})
            statistic = _STATISTICS[measure.statistic]
            self._known[key] = distribution(scores, self._draws, agent, statistic)
        return self._known[key]

    def estimate(self, agent: str, measure: Measure) -> Estimate:
        """A measure's statistic, with its interval."""
        scores = self._scores({agent: self.values(agent, measure)})
        return estimate(self.distribution(agent, measure), scores, agent)

    def difference(self, agent: str, other: str, measure: Measure) -> Estimate | None:
        """One agent less the other, on the instances where both have a value; None if few."""
        tables = {name: self.values(name, measure) for name in (agent, other)}
        common = np.all([(~np.isnan(table)).any(axis=0) for table in tables.values()], axis=0)
        if common.sum() < COMMON:
            return None
        scores = self._scores(
            {name: np.where(common, table, np.nan) for name, table in tables.items()}
        )
        if common.all():
            one, less = (self.distribution(name, measure) for name in (agent, other))
        else:
            statistic = _STATISTICS[measure.statistic]
            one, less = (
                distribution(scores, self._draws, name, statistic) for name in (agent, other)
            )
        found = estimate(one - less, scores, agent, other)
        return replace(found, instances=int(common.sum()))

    def _scores(self, tables: Mapping[str, Floats]) -> Scores:
        """Scores of a measure, (policies, instances) by agent."""
        values = {agent: (table,) for agent, table in tables.items()}
        return Scores(("",), (self._instances,), values, self._seeds)
