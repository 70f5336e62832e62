"""Estimates: every agent's value of every measure, and which of two agents is clearly better.

An agent takes part in a measure if at least half of its episodes have a value.  Measures of time,
path, shape and cost have one only where the episode ended at the target: an agent that hardly ever
arrives beats nobody by how little it moved.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import numpy as np
import pandas as pd

from mmc_gym.benchmark.ranking import BASELINE_AGENT, rank_agents, ranked_scores
from mmc_gym.benchmark.statistics import CONFIDENCE, RESAMPLES, Bootstrap, Estimate, Scores, draw
from mmc_gym.measures import MEASURES, Measure
from mmc_gym.measures.episode import Floats
from mmc_gym.report.results import Results

COMMON = 5
"""Fewest instances on which two agents are compared."""

PRESENT = 0.5
"""Part of its episodes in which an agent must have a value."""

SUCCESS, TIME = MEASURES["success"], MEASURES["time_to_target"]

MARGINS: Mapping[str, float] = {
    "minimum_jerk_correlation": 0.01,
    "velocity_peaks": 0.5,
    "sparc": 0.18,
}
"""Measures of human-likeness, and by how much two agents may differ and still be alike.

The first and the last are the difference between minimum jerk and minimum acceleration, two models
of human reaching; that of velocity peaks is half a peak.
"""

Outcome = Literal["better", "worse", "unclear", "equal"]

_MOST_DECIMALS = 3  # more than usual


class EnvironmentScores:
    """The scores of all agents in an environment.

    Attributes:
        agents: their names.
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
        self._instances = episodes["instance"].nunique()
        self._columns = {name: number for number, name in enumerate(measures)}
        self._tables: dict[str, Floats] = {}  # (measures, policies, instances)
        self._seeds: dict[str, int] = {}
        for agent, rows in episodes.groupby("agent", sort=False):
            ordered = rows.sort_values(["training_seed", "instance"], kind="stable")
            seeds = int(rows["training_seed"].nunique())
            policies = max(1, seeds)
            if len(rows) != policies * self._instances:
                raise ValueError(
                    f"episodes of {agent!r} in {rows['environment'].iloc[0]!r} must be of all "
                    f"{self._instances} instances for each of {policies} policies, got {len(rows)}"
                )
            values = ordered[list(measures)].to_numpy(np.float64)
            self._tables[str(agent)] = values.T.reshape(len(measures), policies, self._instances)
            self._seeds[str(agent)] = seeds
        self.agents = tuple(self._tables)
        first = {agent: table[0] for agent, table in self._tables.items()}
        self._draws = draw(self._scores(first), resamples, seed=0)
        self._known: dict[tuple[str, str, str], Floats] = {}

    def values(self, agent: str, measure: Measure) -> Floats:
        """Return scores (policies, instances); NaN where there is none."""
        found: Floats = self._tables[agent][self._columns[measure.name]]
        return found

    def distribution(self, agent: str, measure: Measure) -> Floats:
        """Return a measure's statistic in the data, then in all resamples, (R + 1,)."""
        key = (agent, measure.name, measure.statistic)
        if key not in self._known:
            bootstrap = self._bootstrap({agent: self.values(agent, measure)})
            self._known[key] = bootstrap.distribution(agent, measure.statistic)
        return self._known[key]

    def estimate(self, agent: str, measure: Measure) -> Estimate:
        """Return a measure's statistic with its interval."""
        bootstrap = self._bootstrap({agent: self.values(agent, measure)})
        return bootstrap.summarize(self.distribution(agent, measure), agent)

    def difference(self, agent: str, other: str, measure: Measure) -> Estimate | None:
        """Return one agent less the other where both have a value; None on too few instances."""
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
        """Return the scores of a measure, from (policies, instances) by agent."""
        values = {agent: (table,) for agent, table in tables.items()}
        return Scores((self._instances,), values, self._seeds)


@dataclass(frozen=True)
class Comparison:
    """An agent beside another in one measure of one environment.

    Attributes:
        environment: its key.
        measure: the measure.
        rival: name of the other.
        mine: estimate of the agent.
        theirs: estimate of the other.
        difference: the former less the latter, paired by instance.
        outcome: for the agent.
    """

    environment: str
    measure: Measure
    rival: str
    mine: Estimate
    theirs: Estimate
    difference: Estimate
    outcome: Outcome

    @property
    def more_decimals(self) -> int:
        """Decimals more than usual that it takes to tell both estimates apart; 0 if too many."""
        for more in range(_MOST_DECIMALS):
            mine, theirs = (
                self.measure.number(one.estimate, more) for one in (self.mine, self.theirs)
            )
            if mine != theirs:
                return more
        return 0


@dataclass(eq=False)
class Estimates:
    """Estimates of a benchmark, made when they are first asked for.

    Attributes:
        results: the results of the benchmark.
        resamples: of each bootstrap.
    """

    results: Results
    resamples: int = RESAMPLES
    _scores: dict[str, EnvironmentScores] = field(default_factory=dict)
    _known: dict[tuple[str, str], dict[str, Estimate]] = field(default_factory=dict)

    def scores(self, environment: str) -> EnvironmentScores:
        """Return all scores of an environment."""
        if environment not in self._scores:
            rows = self.results.episodes["environment"] == environment
            names = [measure.name for measure in self.results.measures]
            self._scores[environment] = EnvironmentScores(
                self.results.episodes[rows], names, self.resamples
            )
        return self._scores[environment]

    def of(self, environment: str, measure: Measure) -> dict[str, Estimate]:
        """Return the estimate of every agent that was there, by name."""
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
        """Return the part of its episodes in which each agent has a value, by name.

        Only instances count where any agent has one: few episodes record the time per action.
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
        """Return the estimates of those among `agents` that have a value often enough."""
        present = self.present(environment, measure)
        found = self.of(environment, measure)
        return {
            agent: found[agent]
            for agent in agents
            if present.get(agent, 0.0) >= PRESENT and math.isfinite(found[agent].estimate)
        }

    def compare(
        self,
        environment: str,
        measure: Measure,
        agent: str,
        rivals: Sequence[str],
        margin: float | None = None,
    ) -> Comparison | None:
        """Compare an agent with the rival that has the best value; None if that is impossible.

        Args:
            environment: its key.
            measure: the measure.
            agent: name.
            rivals: names.
            margin: see `judge`; half of the last digit shown by default.
        """
        mine = self.taking_part(environment, measure, [agent])
        theirs = self.taking_part(environment, measure, rivals)
        if not mine or not theirs or measure.best == "neither":
            return None
        pick = max if measure.best == "high" else min
        rival = pick(theirs, key=lambda name: theirs[name].estimate)
        difference = self.scores(environment).difference(agent, rival, measure)
        if difference is None:
            return None
        outcome = judge(difference, measure, margin)
        return Comparison(
            environment, measure, rival, mine[agent], theirs[rival], difference, outcome
        )

    def scoreboard(self, agent: str) -> list[Comparison]:
        """Compare an agent with the best of its rivals in all measures of all environments."""
        rivals = self.results.rivals(agent)
        compared = (
            self.compare(environment, measure, agent, rivals)
            for environment in self.results.environments
            for measure in self.results.measures
        )
        return [comparison for comparison in compared if comparison is not None]

    def likeness(self, agent: str, rival: str) -> list[Comparison]:
        """Compare two agents in the measures of human-likeness, each with its margin."""
        compared = (
            self.compare(self.results.base, measure, agent, [rival], MARGINS[measure.name])
            for measure in self.results.measures
            if measure.name in MARGINS
        )
        return [comparison for comparison in compared if comparison is not None]

    @cached_property
    def common(self) -> list[str]:
        """The environments that all agents have attempted: those of the ranking."""
        results = self.results
        try:
            scores = ranked_scores(results.episodes, results.cells_not_played)
        except ValueError:
            return []
        return list(dict.fromkeys(scores["environment"]))

    @cached_property
    def ranking(self) -> pd.DataFrame:
        """The store's ranking, or else one made here; empty if `common` is."""
        results = self.results
        baseline = results.label_of(BASELINE_AGENT)
        if not self.common:
            return pd.DataFrame()
        if baseline in (None, BASELINE_AGENT) and not results.ranking.empty:
            return results.ranking
        return rank_agents(
            results.episodes,
            results.cells_not_played,
            baseline or "",
            self.resamples,
        )

    def time_interval(self, agent: str) -> tuple[float, float]:
        """Return the 95 % interval of the mean over `common` of the median time to target.

        In a resample without any success in an environment, the median there is that of the data:
        without it the mean would be over other environments.  NaN if the agent never arrives.
        """
        found = []
        for key in self.common:
            scores = self.scores(key)
            if agent in scores.agents:
                times = scores.distribution(agent, TIME)
                if not math.isnan(times[0]):
                    found.append(np.where(np.isnan(times), times[0], times)[1:])
        if not found:
            return math.nan, math.nan
        tail = (1 - CONFIDENCE) / 2
        low, high = np.quantile(np.mean(found, axis=0), (tail, 1 - tail)).tolist()
        return low, high


def judge(difference: Estimate, measure: Measure, margin: float | None = None) -> Outcome:
    """Return what the interval of a difference says.

    Args:
        difference: of two agents.
        measure: the measure.
        margin: the largest difference that counts as none; half of the last digit shown by
            default.

    Returns:
        "equal" if the interval lies within the margin to both sides; else "better" or "worse" if
        it excludes 0, and "unclear" if it does not.
    """
    low, high = difference.low, difference.high
    if max(-low, high) <= (measure.resolution / 2 if margin is None else margin):
        return "equal"
    if measure.best == "low":
        low, high = -high, -low
    return "better" if low > 0 else "worse" if high < 0 else "unclear"
