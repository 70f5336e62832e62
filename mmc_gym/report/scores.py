"""Estimates: every agent's value of every measure, and which of two agents is clearly better.

An agent takes part in a measure if at least half of its episodes have a value.  Measures of time,
path, shape and cost have one only where the episode ended at the target: an agent that hardly ever
arrives beats nobody by how little it moved.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import Any, Literal, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mmc_gym.benchmark.ranking import BASELINE_AGENT, rank_agents, ranked_scores
from mmc_gym.benchmark.statistics import RESAMPLES, TAILS, Scores, draw, percentile_interval
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


class Value(NamedTuple):
    """A statistic of an agent, or the difference of two, with its 95 % interval."""

    estimate: float
    low: float
    high: float

    @classmethod
    def of(cls, distribution: Floats) -> Value:
        """Return the value in the data, and the interval of that in all resamples."""
        return cls(float(distribution[0]), *percentile_interval(distribution[1:]))

    @classmethod
    def of_rows(cls, distributions: Floats) -> list[Value]:
        """Return `of` each row, in a tenth of the time."""
        ends = np.quantile(distributions[:, 1:], TAILS, axis=-1).T.tolist()
        return [
            # A row with a NaN has ends of the rest of it.
            cls.of(row) if math.isnan(low) else cls(float(row[0]), low, high)
            for row, (low, high) in zip(distributions, ends)
        ]


class EnvironmentScores:
    """The scores of all agents in an environment.

    Attributes:
        values: of all measures by agent, (measures, policies, instances); NaN where there is none.
        distributions: their statistics in the data, then in all resamples, (measures, R + 1).
        estimates: of every agent, by name of the measure.
    """

    def __init__(self, episodes: pd.DataFrame, measures: Sequence[Measure], resamples: int) -> None:
        """Arrange the scores of episodes; raise a `ValueError` if an agent has not met them all."""
        instances = int(episodes["instance"].nunique())
        names, agents = pd.factorize(episodes["agent"])
        trainings = episodes["training_seed"].to_numpy(np.float64)
        # By agent, training seed, and instance; the policy of an untrained agent is NaN.
        order = np.lexsort((episodes["instance"].to_numpy(), trainings, names))
        table = episodes[[measure.name for measure in measures]].to_numpy(np.float64)[order]
        ends = np.cumsum(np.bincount(names))
        self.values: dict[str, Floats] = {}
        seeds = {}
        for agent, rows, own in zip(
            map(str, agents), np.split(table, ends[:-1]), np.split(trainings[order], ends[:-1])
        ):
            seeds[agent] = len(np.unique(own[~np.isnan(own)]))
            policies = max(1, seeds[agent])
            if len(rows) != policies * instances:
                raise ValueError(
                    f"episodes of {agent!r} in {episodes['environment'].iloc[0]!r} must be of all "
                    f"{instances} instances for each of {policies} policies, got {len(rows)}"
                )
            self.values[agent] = rows.T.reshape(len(measures), policies, instances)
        first = {agent: (values[0],) for agent, values in self.values.items()}
        self._draws = draw(Scores((instances,), first, seeds), resamples, seed=0)
        self._numbers = {measure.name: number for number, measure in enumerate(measures)}
        self.distributions = {
            agent: self._resampled(agent, values, measures) for agent, values in self.values.items()
        }
        found = {agent: Value.of_rows(rows) for agent, rows in self.distributions.items()}
        self.estimates = {
            name: {agent: values[number] for agent, values in found.items()}
            for name, number in self._numbers.items()
        }

    def distribution(self, agent: str, measure: Measure) -> Floats:
        """Return a measure's statistic in the data, then in all resamples, (R + 1,)."""
        found: Floats = self.distributions[agent][self._numbers[measure.name]]
        return found

    def present(self, measure: Measure) -> dict[str, float]:
        """Return the part of its episodes in which each agent has a value, by name.

        Only instances count where any agent has one: few episodes record the time per action.
        """
        number = self._numbers[measure.name]
        known = {agent: ~np.isnan(values[number]) for agent, values in self.values.items()}
        anyone = np.any([rows.any(axis=0) for rows in known.values()], axis=0)
        return {
            agent: float(rows[:, anyone].mean()) if anyone.any() else 0.0
            for agent, rows in known.items()
        }

    def difference(self, agent: str, other: str, measure: Measure) -> Value | None:
        """Return one agent less the other where both have a value; None on too few instances."""
        number = self._numbers[measure.name]
        values = {name: self.values[name][number] for name in (agent, other)}
        common = np.all([(~np.isnan(rows)).any(axis=0) for rows in values.values()], axis=0)
        if common.sum() < COMMON:
            return None
        if common.all():
            one, less = (self.distribution(name, measure) for name in values)
        else:
            one, less = (
                self._resampled(name, np.where(common, rows, np.nan)[None], [measure])[0]
                for name, rows in values.items()
            )
        return Value.of(one - less)

    def _resampled(self, agent: str, values: Floats, measures: Sequence[Measure]) -> Floats:
        """Return the distributions of measures, from all their values."""
        policies, instances = self._draws.policies[agent], self._draws.instances[0]
        # Small numbers, row by row, are quick to add up.
        small = np.min_scalar_type(policies.shape[1] * instances.shape[1])
        of_policies, of_instances = (
            np.ascontiguousarray(counts.T, dtype=small) for counts in (policies, instances)
        )
        drawn = (of_policies[:, None] * of_instances).reshape(-1, len(policies))
        found = np.empty((len(measures), len(policies)))
        is_mean = np.array([measure.statistic == "mean" for measure in measures])
        found[is_mean] = _means(values[is_mean], policies, instances)
        for row in np.flatnonzero(~is_mean):
            found[row] = _medians(values[row].ravel(), drawn)
        return found


def _means(values: Floats, policies: Floats, instances: Floats) -> Floats:
    """Return means of values (measures, policies, instances) in each resample, (measures, R + 1).

    The other arrays are those of `Draws`.
    """
    known = ~np.isnan(values)
    flat, by_policy = (-1, values.shape[-1]), (len(policies), *values.shape[:2])
    sums, counts = (
        ((instances @ table.reshape(flat).T).reshape(by_policy) * policies[:, None]).sum(axis=-1)
        for table in (np.where(known, values, 0.0), known.astype(np.float64))
    )
    with np.errstate(invalid="ignore"):
        means: Floats = (sums / counts).T
    return means


def _medians(values: Floats, drawn: NDArray[Any]) -> Floats:
    """Return the median in each resample of values (k,) that it draws so often, (k, R + 1)."""
    order = np.argsort(values)[: np.count_nonzero(~np.isnan(values))]
    if order.size == 0:
        return np.full(drawn.shape[1], np.nan)
    total = drawn[order]
    for before, row in pairwise(total):  # several times as quick as `cumsum`
        row += before
    whole, half = total[-1], total[-1] // 2
    low = (total < whole - half).sum(axis=0, dtype=total.dtype)
    high = (total <= half).sum(axis=0, dtype=total.dtype)
    ordered = np.append(values[order], np.nan)  # the last where nothing was drawn
    middle: Floats = (ordered[low] + ordered[high]) / 2
    return middle


@dataclass(frozen=True)
class Comparison:
    """An agent's value of a measure less that of a rival, paired by instance."""

    environment: str
    measure: Measure
    rival: str
    mine: Value
    theirs: Value
    difference: Value
    outcome: Outcome

    @property
    def more_decimals(self) -> int:
        """Decimals more than usual that it takes to tell both estimates apart; 0 if too many."""
        for more in range(_MOST_DECIMALS):
            texts = {self.measure.number(v.estimate, more) for v in (self.mine, self.theirs)}
            if len(texts) == 2:
                return more
        return 0


@dataclass(eq=False)
class Estimates:
    """Estimates of a benchmark, made when they are first asked for, each of `resamples`."""

    results: Results
    resamples: int = RESAMPLES
    _scores: dict[str, EnvironmentScores] = field(default_factory=dict)

    def scores(self, environment: str) -> EnvironmentScores:
        """Return all scores of an environment."""
        if environment not in self._scores:
            self._scores[environment] = EnvironmentScores(
                self._episodes[environment], self.results.measures, self.resamples
            )
        return self._scores[environment]

    @cached_property
    def _episodes(self) -> dict[str, pd.DataFrame]:
        """The episodes of each environment."""
        groups = self.results.episodes.groupby("environment", sort=False)
        return {str(environment): rows for environment, rows in groups}

    def of(self, environment: str, measure: Measure) -> dict[str, Value]:
        """Return the value of every agent that was there, by name."""
        found = self.scores(environment).estimates[measure.name]
        return {agent: found[agent] for agent in self.results.agents if agent in found}

    def taking_part(
        self, environment: str, measure: Measure, agents: Iterable[str]
    ) -> dict[str, Value]:
        """Return the values of those among `agents` that have a value often enough."""
        present = self.scores(environment).present(measure)
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

        The margin is that of `judge`.
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
        found = (mine[agent], theirs[rival], difference)
        return Comparison(environment, measure, rival, *found, judge(difference, measure, margin))

    def scoreboard(self, agent: str) -> list[Comparison]:
        """Compare an agent with the best of its rivals in all measures of all environments."""
        rivals = self.results.rivals(agent)
        compared = (
            self.compare(environment, measure, agent, rivals)
            for environment in self.results.environments
            for measure in self.results.measures
        )
        return [comparison for comparison in compared if comparison is not None]

    def against_each(
        self, agent: str, measures: Sequence[Measure]
    ) -> dict[str, dict[str, Counter[Outcome]]]:
        """Count the outcomes over all environments, by rival and name of the measure.

        Every other agent is a rival, but for the random one, and the hand without an arm.
        """
        results = self.results
        rivals = [
            other
            for other in results.agents
            if other != agent and results.kind(other) not in ("baseline", "ideal")
        ]
        counts: dict[str, dict[str, Counter[Outcome]]] = {}
        for rival in rivals:
            counts[rival] = {}
            for measure in measures:
                compared = (
                    self.compare(environment, measure, agent, [rival])
                    for environment in results.environments
                )
                counts[rival][measure.name] = Counter(one.outcome for one in compared if one)
        return counts

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
        not_played = results.cells_not_played
        return rank_agents(results.episodes, not_played, baseline or "", self.resamples)

    def time_interval(self, agent: str) -> tuple[float, float]:
        """Return the 95 % interval of the mean over `common` of the median time to target.

        In a resample without any success in an environment, the median there is that of the data:
        without it the mean would be over other environments.  NaN if the agent never arrives.
        """
        found = []
        for key in self.common:
            scores = self.scores(key)
            if agent in scores.values:
                times = scores.distribution(agent, TIME)
                if not math.isnan(times[0]):
                    found.append(np.where(np.isnan(times), times[0], times)[1:])
        return percentile_interval(np.mean(found, axis=0)) if found else (math.nan, math.nan)


def judge(difference: Value, measure: Measure, margin: float | None = None) -> Outcome:
    """Judge the difference of two agents by its interval.

    It is "equal" if the interval lies within the margin to both sides, half of the last digit shown
    by default; else "better" or "worse" if it excludes 0, and "unclear" if it does not.
    """
    low, high = difference.low, difference.high
    if max(-low, high) <= (measure.resolution / 2 if margin is None else margin):
        return "equal"
    if measure.best == "low":
        low, high = -high, -low
    return "better" if low > 0 else "worse" if high < 0 else "unclear"
