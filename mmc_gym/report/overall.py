"""The battery as a whole: the ranking of its agents, and their success in each environment.

The ranking is that of `ranking.summarize_battery`, which `mmc-gym benchmark` prints, with intervals
of the times beside it.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from mmc_gym.benchmark.ranking import (
    BASELINE_AGENT,
    battery_scores,
    success_by_environment,
    summarize_battery,
)
from mmc_gym.benchmark.reference import REFERENCE
from mmc_gym.benchmark.statistics_part import CONFIDENCE
from mmc_gym.measures.catalogue import MEASURES
from mmc_gym.report.numbers import count, instances_of, listed, seeds_of
from mmc_gym.report.results import Results
from mmc_gym.report.scores import Estimates

_TIME = next(measure for measure in MEASURES if measure.name == "time_to_target")
_SHADES = 10


@dataclass(frozen=True)
class RankingTable:
    """The ranking.

    Attributes:
        headings: of the columns after the agent, with unit and which way is better.
        rows: rank, agent, kind, and (value, interval) of each column; training seeds or "–".
        caption: over how many environments, instances and training seeds.
        lead: the same in a sentence, the best of each kind; empty if nothing can be ranked.
    """

    headings: tuple[tuple[str, str, str], ...]
    rows: tuple[tuple[str, str, str, tuple[tuple[str, str], ...], str], ...]
    caption: str
    lead: str


@dataclass(frozen=True)
class HeatTable:
    """Success by environment and agent.

    Attributes:
        agents: its columns.
        rows: environment, whether a family begins there, and (text, shade from 0 to 10 or "",
            whether no agent has more) of each agent.
        caption: over how many instances and training seeds.
    """

    agents: tuple[str, ...]
    rows: tuple[tuple[str, bool, tuple[tuple[str, str, bool], ...]], ...]
    caption: str


def ranking_table(estimates: Estimates) -> RankingTable | None:
    """The ranking; None if there is no environment that all agents have attempted."""
    results = estimates.results
    baseline = results.labelled(BASELINE_AGENT)
    try:
        common = list(dict.fromkeys(_scores(results)["environment"]))
    except ValueError:
        return None
    ranking = results.ranking if baseline in (None, BASELINE_AGENT) else pd.DataFrame()
    if ranking.empty:
        ranking = summarize_battery(
            _numbered(results),
            [cell for cell, _ in results.not_played],
            [agent for agent in results.agents if results.seeds(agent) == (0, 0)],
            baseline or "",
            estimates.resamples,
        )
    rows = ranking.to_dict("records")
    compared = [] if baseline is None else [(f"better than {baseline}", "%", "more is better")]
    headings = [
        ("success", "%", "more is better"),
        ("settled", "% of the episode", "more is better"),
        *compared,
        ("time to target", "s", "less is better"),
    ]
    agents = [str(row["agent"]) for row in rows]
    left_out = len(results.environments) - len(common)
    partly = f" ({left_out} more have not been attempted by all)" if left_out else ""
    return RankingTable(
        tuple(headings),
        tuple(_row(estimates, row, baseline, common) for row in rows),
        f"Over {count(len(common), 'environment')}{partly}, each weighing the same. Success: the "
        "fraction of episodes that end at the target, by which agents are ranked; then by time to "
        "target, the mean over the environments where an agent arrives at all of its median. "
        "Settled: interquartile mean of the part of an episode after which the hand stays at the "
        "target. "
        f"{_explained(baseline)}Intervals: 95 % bootstrap over instances and training seeds. Cells "
        "that could not be played count as without success. "
        f"{instances_of(results, common)} {seeds_of(results, agents, common)}",
        _lead(results, rows, len(common)),
    )


def _explained(baseline: str | None) -> str:
    if baseline is None:
        return ""
    return (
        f"Better than {baseline}: probability of being settled for longer in the same episode, "
        "50 % if equal. "
    )


def _row(
    estimates: Estimates, row: Mapping[Hashable, Any], baseline: str | None, common: Sequence[str]
) -> tuple[str, str, str, tuple[tuple[str, str], ...], str]:
    agent = str(row["agent"])
    shares = ["success", "settled", *(["improvement"] if baseline is not None else [])]
    cells = [
        (_percent(row[name]), _interval(row[f"{name}_low"], row[f"{name}_high"], _percent))
        for name in shares
    ]
    low, high = time_interval(estimates, agent, common)
    cells.append((_seconds(row["time_to_target"]), _interval(low, high, _seconds)))
    seeds = str(row["training_seeds"] or "–")
    return str(row["rank"]), agent, estimates.results.kind(agent), tuple(cells), seeds


def time_interval(
    estimates: Estimates, agent: str, environments: Sequence[str]
) -> tuple[float, float]:
    """Of the mean over environments of the median time to target, 95 %; NaN without any.

    Where no success was drawn in an environment, its median stays what it is in the data: to leave
    it out would make the mean one over other environments.
    """
    found = []
    for key in environments:
        scores = estimates.scores(key)
        if agent in scores.agents:
            distribution = scores.distribution(agent, _TIME)
            if not math.isnan(distribution[0]):
                found.append(np.where(np.isnan(distribution), distribution[0], distribution)[1:])
    if not found:
        return math.nan, math.nan
    tail = (1 - CONFIDENCE) / 2
    low, high = np.quantile(np.mean(found, axis=0), (tail, 1 - tail)).tolist()
    return low, high


def _lead(results: Results, rows: Sequence[Mapping[Hashable, Any]], environments: int) -> str:
    """The best of each kind in a sentence."""
    best: dict[str, Mapping[Hashable, Any]] = {}
    for row in rows:
        best.setdefault(results.kind(str(row["agent"])), row)
    parts = [
        f"{row['agent']} ({kind}, {_trained(row)}) {_percent(row['success'])} % "
        f"{_interval(row['success_low'], row['success_high'], _percent)}"
        for kind, row in best.items()
        if kind not in ("baseline", "ideal")
    ]
    if not parts:
        return ""
    where = (
        "in the one environment" if environments == 1 else f"over all {environments} environments"
    )
    return (
        f"Success {where} that all have attempted, the best of each kind of agent: "
        f"{listed(parts)} (95 % intervals)."
    )


def _trained(row: Mapping[Hashable, Any]) -> str:
    seeds = int(row["training_seeds"])
    return count(seeds, "training seed") if seeds else "not trained"


def heat_table(results: Results, agents: Sequence[str]) -> HeatTable:
    """Success by environment.

    Args:
        results: of the benchmark.
        agents: in the order of the columns; the ideal hand is left out.
    """
    table = success_by_environment(_numbered(results), [cell for cell, _ in results.not_played])
    agents = [agent for agent in agents if agent != REFERENCE]
    rows, families = [], [""]
    for key, environment in results.environments.items():
        shares = {agent: float(table[key].get(agent, math.nan)) for agent in agents}
        texts = {agent: _whole(share) for agent, share in shares.items()}
        known = [share for share in shares.values() if not math.isnan(share)]
        most = _whole(max(known)) if known and max(known) > 0 else ""
        cells = tuple(
            (texts[agent], _shade(shares[agent]), texts[agent] == most) for agent in agents
        )
        rows.append((key, environment.family != families[-1], cells))
        families.append(environment.family)
    return HeatTable(
        tuple(agents),
        tuple(rows),
        "Success at the end of the episode in each environment, %; the darker the more, underlined "
        "the most of all, “·” not attempted, 0 where an agent could not act. Means over instances "
        f"and training seeds. {instances_of(results, results.environments)} "
        f"{seeds_of(results, agents)}",
    )


def _scores(results: Results) -> pd.DataFrame:
    return battery_scores(_numbered(results), _cells(results))


def _cells(results: Results) -> list[Any]:
    return [cell for cell, _ in results.not_played if cell.agent != REFERENCE]


def _numbered(results: Results) -> pd.DataFrame:
    """Episodes as they are stored: of training seed 0 without training."""
    seeds = results.episodes["training_seed"].fillna(0).astype(int)
    return results.episodes.assign(training_seed=seeds)


def _percent(share: float) -> str:
    return "–" if math.isnan(share) else f"{100 * share:.1f}"


def _seconds(seconds: float) -> str:
    return "–" if math.isnan(seconds) else f"{seconds:.2f}"


def _interval(low: float, high: float, written: Any) -> str:
    return "" if math.isnan(low) else f"[{written(low)}, {written(high)}]"


def _whole(share: float) -> str:
    """A share in whole percents, 0 and 100 only where they are exact."""
    if math.isnan(share):
        return "·"
    if 0 < share < 0.005:
        return "<1"
    return ">99" if 0.995 <= share < 1 else f"{100 * share:.0f}"


def _shade(share: float) -> str:
    return "" if math.isnan(share) else f"{round(_SHADES * share):d}"
