"""Estimates of the report: every agent's figure in every environment, and who is clearly better.

An agent takes part in a measure where at least half of its episodes have a value; measures of time,
path, shape and cost have one only where the episode ended at the target.  So an agent that hardly
ever arrives, by what little it then moved, beats nobody.  It is compared with the strongest of its
rivals, the one with the best figure, on the instances where both have a value, by the paired
bootstrap of `resampling`: clearly better or worse where the 95 % interval of the difference
excludes 0, and is not of a size that no table would show.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
import pandas as pd

from mmc_gym.benchmark.statistics import (
    Bootstrap,
    Estimate,
    Scores,
    draw,
)
from mmc_gym.measures import Measure
from mmc_gym.measures.episode import Floats
from mmc_gym.report.numbers import resolution
from mmc_gym.report.results import Results

COMMON = 5
"""Instances at least, on which two agents are compared."""


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
            bootstrap = self._bootstrap({agent: self.values(agent, measure)})
            self._known[key] = bootstrap.distribution(agent, measure.statistic)
        return self._known[key]

    def estimate(self, agent: str, measure: Measure) -> Estimate:
        """A measure's statistic, with its interval."""
        bootstrap = self._bootstrap({agent: self.values(agent, measure)})
        return bootstrap.summarize(self.distribution(agent, measure), agent)

    def difference(self, agent: str, other: str, measure: Measure) -> Estimate | None:
        """One agent less the other, on the instances where both have a value; None if few."""
        tables = {name: self.values(name, measure) for name in (agent, other)}
        common = np.all([(~np.isnan(table)).any(axis=0) for table in tables.values()], axis=0)
        if common.sum() < COMMON:
            return None
        bootstrap = self._bootstrap(
            {name: np.where(common, table, np.nan) for name, table in tables.items()}
        )
        if common.all():
            one, less = (self.distribution(name, measure) for name in (agent, other))
        else:
            one, less = (bootstrap.distribution(name, measure.statistic) for name in (agent, other))
        found = bootstrap.summarize(one - less, agent, other)
        return replace(found, instances=int(common.sum()))

    def _bootstrap(self, tables: Mapping[str, Floats]) -> Bootstrap:
        return Bootstrap(self._scores(tables), self._draws)

    def _scores(self, tables: Mapping[str, Floats]) -> Scores:
        """Scores of a measure, (policies, instances) by agent."""
        values = {agent: (table,) for agent, table in tables.items()}
        return Scores(("",), (self._instances,), values, self._seeds)


Outcome = Literal["better", "worse", "unclear", "equal"]

RESAMPLES = 1_000
PRESENT = 0.5  # part of its episodes in which an agent must have a value


@dataclass(frozen=True)
class Comparison:
    """An agent beside another in one measure of one environment.

    Attributes:
        environment: key.
        measure: what is compared.
        mine: figure of the agent.
        theirs: of the other.
        rival: name of the other.
        outcome: for the agent.
    """

    environment: str
    measure: Measure
    mine: Estimate
    theirs: Estimate
    rival: str
    outcome: Outcome


@dataclass(eq=False)
class Estimates:
    """Figures of a benchmark, made when they are first asked for.

    Attributes:
        results: what they are of.
        resamples: of each bootstrap.
    """

    results: Results
    resamples: int = RESAMPLES
    _scores: dict[str, EnvironmentScores] = field(default_factory=dict)
    _known: dict[tuple[str, str], dict[str, Estimate]] = field(default_factory=dict)

    def scores(self, environment: str) -> EnvironmentScores:
        """All scores of an environment."""
        if environment not in self._scores:
            rows = self.results.episodes["environment"] == environment
            names = [measure.name for measure in self.results.measures]
            self._scores[environment] = EnvironmentScores(
                self.results.episodes[rows], names, self.resamples
            )
        return self._scores[environment]

    def of(self, environment: str, measure: Measure) -> dict[str, Estimate]:
        """The figure of every agent that was there, by name."""
        key = (environment, measure.name)
        if key not in self._known:
            scores = self.scores(environment)
            self._known[key] = {
                agent: scores.estimate(agent, measure)
                for agent in self.results.agents
                if agent in scores.agents
            }
        return self._known[key]

    def present(self, environment: str, measure: Measure) -> dict[str, float]:
        """Part of its episodes in which each agent has a value, by name.

        Of the instances where any agent has one: the time of an action is taken in a few only.
        """
        scores = self.scores(environment)
        known = {agent: ~np.isnan(scores.values(agent, measure)) for agent in scores.agents}
        anyone = np.any([rows.any(axis=0) for rows in known.values()], axis=0)
        return {
            agent: float(rows[:, anyone].mean()) if anyone.any() else 0.0
            for agent, rows in known.items()
        }

    def taking_part(
        self, environment: str, measure: Measure, agents: Iterable[str]
    ) -> dict[str, Estimate]:
        """The figures of those among `agents` that have a value often enough."""
        present = self.present(environment, measure)
        figures = self.of(environment, measure)
        return {
            agent: figures[agent]
            for agent in agents
            if present.get(agent, 0.0) >= PRESENT and math.isfinite(figures[agent].estimate)
        }

    def against(
        self, environment: str, measure: Measure, agent: str, rivals: Sequence[str]
    ) -> Comparison | None:
        """An agent beside the strongest of its rivals; None where there is nothing to compare."""
        mine = self.taking_part(environment, measure, [agent])
        theirs = self.taking_part(environment, measure, rivals)
        if not mine or not theirs or measure.best == "neither":
            return None
        pick = max if measure.best == "high" else min
        rival = pick(theirs, key=lambda name: theirs[name].estimate)
        difference = self.scores(environment).difference(agent, rival, measure)
        if difference is None:
            return None
        outcome = judge(difference, measure)
        return Comparison(environment, measure, mine[agent], theirs[rival], rival, outcome)


def judge(difference: Estimate, measure: Measure) -> Outcome:
    """What a difference says.

    "equal" if its interval does not reach half a unit of the last decimal that tables show, to
    either side; else "better" or "worse" if the interval excludes 0, and "unclear" if it does not.
    """
    low, high = (difference.low, difference.high)
    if max(-low, high) <= resolution(measure) / 2:
        return "equal"
    if measure.best == "low":
        low, high = -high, -low
    return "better" if low > 0 else "worse" if high < 0 else "unclear"


def rivals_of(results: Results, agent: str) -> tuple[str, ...]:
    """Agents of other kinds; neither the random one nor the ideal hand without an arm."""
    apart = {results.kind(agent), "baseline", "ideal"}
    return tuple(other for other in results.agents if results.kind(other) not in apart)


def scoreboard(estimates: Estimates, agent: str) -> list[Comparison]:
    """An agent beside the strongest of its rivals: all environments, all measures."""
    results = estimates.results
    rivals = rivals_of(results, agent)
    compared = (
        estimates.against(environment, measure, agent, rivals)
        for environment in results.environments
        for measure in results.measures
        if measure.best != "neither"
    )
    return [comparison for comparison in compared if comparison is not None]
