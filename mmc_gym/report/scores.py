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
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from mmc_gym.benchmark.replication import Estimate
from mmc_gym.measures.catalogue import Measure
from mmc_gym.report.environment_scores import EnvironmentScores
from mmc_gym.report.numbers import resolution
from mmc_gym.report.results import Results

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
