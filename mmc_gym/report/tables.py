"""The tables of the report, as the template takes them: rows of cells that are text."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median

from mmc_gym.measures.catalogue import Measure
from mmc_gym.report.numbers import (
    count,
    decimals_apart,
    instances_of,
    interval,
    number,
    seeds_of,
    unit,
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
