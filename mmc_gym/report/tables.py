"""The tables of the report, as the template takes them: rows of cells that are text."""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from statistics import median
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
from mmc_gym.benchmark.statistics import CONFIDENCE
from mmc_gym.measures import MEASURES, SET_MEASURES, Measure, SetMeasure
from mmc_gym.report.numbers import (
    count,
    decimals_apart,
    instances_of,
    interval,
    listed,
    number,
    seeds_of,
    unit,
    written,
)
from mmc_gym.report.results import Environment, Results
from mmc_gym.report.scores import PRESENT, Comparison, Estimates, Outcome

SIGNS: dict[Outcome, tuple[str, str]] = {
    "better": ("▲", "clearly better"),
    "worse": ("▼", "clearly worse"),
    "unclear": ("○", "no clear difference"),
    "equal": ("=", "no difference in the digits shown"),
}
"""Sign and words of each outcome: they differ without colour."""


@dataclass(frozen=True)
class Cell:
    """A figure in a table.

    Attributes:
        value: as text.
        interval: below it.
        note: below that; empty if there is nothing to say.
        best: whether no agent has a better value.
    """

    value: str
    interval: str
    note: str
    best: bool


@dataclass(frozen=True)
class ScoreTable:
    """Measures of all agents in an environment.

    Attributes:
        environment: what it is.
        headings: label, unit, and which way is better, of each column.
        rows: name, kind and cells of each agent.
        caption: over how many instances and seeds.
    """

    environment: Environment
    headings: tuple[tuple[str, str, str], ...]
    rows: tuple[tuple[str, str, tuple[Cell, ...]], ...]
    caption: str


@dataclass(frozen=True)
class BoardCell:
    """A comparison in the scoreboard: the outcome's name, sign and words, and both figures."""

    outcome: Outcome
    sign: str
    words: str
    mine: str
    theirs: str
    rival: str


@dataclass(frozen=True)
class Board:
    """The scoreboard of an agent: a row an environment, a column a measure."""

    agent: str
    headings: tuple[tuple[str, str, str], ...]
    rows: tuple[tuple[str, tuple[BoardCell | None, ...]], ...]
    caption: str


def told_rows(results: Results) -> list[tuple[str, ...]]:
    """Agent, kind, description; what it is told of lengths and actions, sees, and learned from."""
    rows: list[tuple[str, ...]] = []
    for agent in results.agents:
        one = results.identities[agent]
        known = one.knowledge
        name = f"{one.own}: " if one.description and one.own != agent else ""
        about = f"{name}{one.description}"
        learned = _learned_from(results, agent)
        rows.append((agent, known.kind, about, known.lengths, known.actions, known.senses, learned))
    return rows


def _learned_from(results: Results, agent: str) -> str:
    if agent in results.cards:
        cards = results.cards[agent]
        steps = median(card.training_steps for card in cards)
        minutes = median(card.training_cpu_seconds for card in cards) / 60
        seeds = count(len(cards), "training seed")
        return f"{steps:,.0f} environment steps ({minutes:.1f} min on one core) in each of {seeds}"
    unknown = results.kind(agent) in ("learned", "yours")
    return "unknown" if unknown else "nothing: not trained"


def score_table(estimates: Estimates, environment: str) -> ScoreTable:
    """All measures of all agents in an environment."""
    results = estimates.results
    measures = results.measures
    columns = [_column(estimates, environment, measure) for measure in measures]
    present = [agent for agent in results.agents if any(agent in column for column in columns)]
    return ScoreTable(
        results.environments[environment],
        _headings(measures),
        tuple(
            (agent, results.kind(agent), tuple(column[agent] for column in columns))
            for agent in present
        ),
        "Means of shares, medians of the others, with 95 % bootstrap intervals over instances and "
        "training seeds; bold and underlined: the best value, among agents that have one in at "
        f"least {PRESENT:.0%} of their episodes; n %: so many of the episodes have a value. "
        "Time, path, shape and cost are told of the episodes that ended at the target. "
        f"{instances_of(results, [environment])} {seeds_of(results, present, [environment])}",
    )


def _column(estimates: Estimates, environment: str, measure: Measure) -> dict[str, Cell]:
    figures = estimates.of(environment, measure)
    present = estimates.present(environment, measure)
    values = {agent: number(measure, estimate.estimate) for agent, estimate in figures.items()}
    racing = [
        agent
        for agent in figures
        if present[agent] >= PRESENT and estimates.results.kind(agent) not in ("ideal", "baseline")
    ]
    best = ""
    if measure.best != "neither" and racing:
        pick = max if measure.best == "high" else min
        best = values[pick(racing, key=lambda agent: figures[agent].estimate)]
    return {
        agent: Cell(
            values[agent],
            interval(measure, estimate),
            f"{present[agent]:.0%}".replace("%", " %") if 0 < present[agent] < 1 else "",
            agent in racing and values[agent] == best,
        )
        for agent, estimate in figures.items()
    }


def board_table(results: Results, board: Sequence[Comparison], agent: str) -> Board:
    """The scoreboard of an agent, from what `estimates.scoreboard` returned."""
    measures = tuple(m for m in results.measures if any(entry.measure == m for entry in board))
    cells = {(entry.environment, entry.measure.name): _board_cell(entry) for entry in board}
    environments = [key for key in results.environments if any(e.environment == key for e in board)]
    rivals = sorted({entry.rival for entry in board}, key=results.agents.index)
    return Board(
        agent,
        _headings(measures),
        tuple(
            (key, tuple(cells.get((key, measure.name)) for measure in measures))
            for key in environments
        ),
        f"{agent} against the strongest of its rivals in each cell. Above: {agent}; below: the "
        "rival with the best value and its name. The rival is picked by its value, which favours "
        "the rival; of comparisons without any true difference about 1 in 20 is called clear. "
        f"{instances_of(results, environments)} "
        f"{seeds_of(results, [agent, *rivals], environments)}",
    )


def _board_cell(entry: Comparison) -> BoardCell:
    figures = (entry.mine.estimate, entry.theirs.estimate)
    clear = entry.outcome in ("better", "worse")
    more = decimals_apart(entry.measure, *figures) if clear else 0
    mine, theirs = (number(entry.measure, value, more) for value in figures)
    return BoardCell(entry.outcome, *SIGNS[entry.outcome], mine, theirs, entry.rival)


def _headings(measures: Sequence[Measure]) -> tuple[tuple[str, str, str], ...]:
    better = {"high": "more is better", "low": "less is better", "neither": ""}
    return tuple((measure.label, unit(measure), better[measure.best]) for measure in measures)


_TIME = MEASURES["time_to_target"]
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


@dataclass(frozen=True)
class Law:
    """A law, and how it is shown.

    Attributes:
        measure: name of the set measure.
        explained: of the one that tells how well it holds; empty if none does.
        people: what people do, as text.
        source: of that.
    """

    measure: str
    explained: str
    people: str
    source: str

    @property
    def description(self) -> SetMeasure:
        """The set measure itself."""
        return SET_MEASURES[self.measure]


LAWS = (
    Law("posture_variability", "", "above 0", "Soechting et al. 1995"),
    Law("fitts_slope", "fitts_r_squared", "about 0.1", "Fitts 1954"),
    Law(
        *("speed_curvature_exponent", "speed_curvature_r_squared"),
        *("0.333", "Lacquaniti et al. 1983"),
    ),
)


@dataclass(frozen=True)
class LawTable:
    """How the agents keep the laws.

    Attributes:
        headings: label and unit of each column.
        people: what people do, and the source, of each column.
        rows: agent, kind, and (value, note) of each column.
        caption: over how many instances and training seeds.
    """

    headings: tuple[tuple[str, str], ...]
    people: tuple[tuple[str, str], ...]
    rows: tuple[tuple[str, str, tuple[tuple[str, str], ...]], ...]
    caption: str


def law_table(results: Results) -> LawTable | None:
    """The table; None if no agent was in an environment that suits any of the laws."""
    known = results.sets[results.sets["value"].notna()] if len(results.sets) else results.sets
    laws = [law for law in LAWS if (known["measure"] == law.measure).any()]
    if not laws:
        return None
    taken = known[known["measure"].isin([law.measure for law in laws])]
    present = set(taken["agent"])
    agents = [agent for agent in results.agents if agent in present]
    environments = [law.description.environment for law in laws]
    return LawTable(
        tuple((law.description.label, law.description.unit) for law in laws),
        tuple((law.people, law.source) for law in laws),
        tuple(
            (agent, results.kind(agent), tuple(_cell(known, agent, law) for law in laws))
            for agent in agents
        ),
        "Posture variability: how much the postures differ that put the hand to the same target "
        "from other starts; 0 is Donders' law. Fitts' slope: how much longer it takes for each bit "
        "of difficulty, over the distances and widths of targets; no agent is told the width. "
        "Speed-curvature exponent: how much slower the hand is where its path is more curved, in "
        "following a target. Means over training seeds, with their range; R²: how much of "
        "the variance the law explains (where that is little, its number says little); –: too "
        f"few movements arrived. Environments: {', '.join(environments)}. "
        f"{instances_of(results, environments)} {seeds_of(results, agents, environments)}",
    )


def _cell(known: pd.DataFrame, agent: str, law: Law) -> tuple[str, str]:
    mine = known[known["agent"] == agent]
    values = mine.loc[mine["measure"] == law.measure, "value"]
    if values.empty:
        return "–", ""
    decimals = law.description.decimals
    notes = []
    if len(values) > 1:
        notes.append(f"{written(values.min(), decimals)} to {written(values.max(), decimals)}")
    explained = mine.loc[mine["measure"] == law.explained, "value"]
    if len(explained):
        notes.append(f"R² {written(explained.mean(), 2)}")
    return written(values.mean(), decimals), "; ".join(notes)
