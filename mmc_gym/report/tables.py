"""The tables of the report: rows of cells that are text.  The template shows all of them alike."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Hashable, Iterable, Mapping, Sequence
from statistics import median
from typing import Any, NamedTuple

import pandas as pd

from mmc_gym._console import number
from mmc_gym.benchmark.ranking import BASELINE_AGENT, success_by_environment
from mmc_gym.benchmark.reference import REFERENCE
from mmc_gym.measures import Measure, SetMeasure
from mmc_gym.report.results import Results, count
from mmc_gym.report.scores import PRESENT, SUCCESS, TIME, Comparison, Estimates, Outcome
from mmc_gym.training.curves import LEVELS, first_reached

SIGNS: dict[Outcome, tuple[str, str]] = {
    "better": ("▲", "clearly better"),
    "worse": ("▼", "clearly worse"),
    "unclear": ("○", "no clear difference"),
    "equal": ("=", "the same"),
}
"""Sign and words of each outcome: they differ without colour."""

BETTER = {"high": "more is better", "low": "less is better", "neither": ""}

_SHADES = 10


class Heading(NamedTuple):
    """The heading of a column: label, unit, and which way is better."""

    label: str
    unit: str = ""
    better: str = ""


class Cell(NamedTuple):
    """A cell of a table: a text, and smaller notes below it.

    Attributes:
        best: whether it is the best of its column, or row.
        look: its CSS class; empty for none.
        sign: before the text, and its meaning, see `SIGNS`.
    """

    text: str
    notes: tuple[str, ...] = ()
    best: bool = False
    look: str = ""
    sign: tuple[str, str] | None = None


_NOTHING = Cell("·")


class Row(NamedTuple):
    """A row of a table: its name, its cells, a note below the name, and its CSS class."""

    name: str
    cells: tuple[Cell, ...]
    note: str = ""
    look: str = ""


class Table(NamedTuple):
    """A table: its title for those who do not see it, its CSS class, its cells and its caption."""

    title: str
    look: str
    headings: tuple[Heading, ...]
    rows: tuple[Row, ...]
    caption: str = ""


def told_table(results: Results) -> Table:
    """Return what each agent is, is told, senses, and has learned from."""
    rows = []
    for agent in results.agents:
        one = results.identities[agent]
        known = one.knowledge
        name = f"{one.name}: " if one.description and one.name != agent else ""
        texts = (known.kind, known.lengths, known.actions, known.senses, _learned(results, agent))
        rows.append(Row(agent, tuple(map(Cell, texts)), f"{name}{one.description}"))
    labels = ("agent", "kind", "segment lengths", "what actions do", "senses", "learned from")
    return Table("What each agent is told", "told", tuple(map(Heading, labels)), tuple(rows))


def _learned(results: Results, agent: str) -> str:
    if agent in results.cards:
        cards = results.cards[agent]
        steps = median(card.training_steps for card in cards)
        minutes = median(card.training_cpu_seconds for card in cards) / 60
        seeds = count(len(cards), "training seed")
        return f"{steps:,.0f} environment steps ({minutes:.1f} min on one core) in each of {seeds}"
    unknown = results.kind(agent) in ("learned", "yours")
    return "unknown" if unknown else "nothing: not trained"


def cost_table(results: Results) -> Table | None:
    """Return when each training first had so much success; None without learning curves."""
    rows = []
    for agent, cards in results.curves.items():
        cells = [Cell(str(len(cards)))]
        for level in LEVELS:
            steps = median(first_reached(card, level, "steps") for card in cards)
            minutes = median(first_reached(card, level, "cpu_seconds") for card in cards) / 60
            never = math.isinf(steps)
            cells.append(Cell("never") if never else Cell(f"{steps:,.0f}", (f"{minutes:.1f} min",)))
        rows.append(Row(agent, tuple(cells)))
    if not rows:
        return None
    levels = (Heading(f"{level:.0%} success".replace("%", " %"), "steps") for level in LEVELS)
    return Table(
        "What learning costs",
        "scores",
        (Heading("agent"), Heading("training seeds"), *levels),
        tuple(rows),
        "Environment steps, and minutes on one core, to the first evaluation with so much success; "
        "medians over the training seeds. The same evaluation instances for all.",
    )


def score_table(estimates: Estimates, environment: str) -> Table:
    """Return all measures of all agents in an environment."""
    results = estimates.results
    columns = [_column(estimates, environment, measure) for measure in results.measures]
    present = [agent for agent in results.agents if any(agent in column for column in columns)]
    return Table(
        f"Measures in {environment}",
        "scores",
        (Heading("agent"), *_headings(results.measures)),
        tuple(
            Row(agent, tuple(column[agent] for column in columns), results.kind(agent))
            for agent in present
        ),
        results.sample_sizes(present, [environment]),
    )


def _column(estimates: Estimates, environment: str, measure: Measure) -> dict[str, Cell]:
    figures = estimates.of(environment, measure)
    present = estimates.scores(environment).present(measure)
    values = {agent: measure.number(found.estimate) for agent, found in figures.items()}
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
            _notes(
                measure.interval(found.low, found.high),
                f"{100 * present[agent]:.0f} %" if 0 < present[agent] < 1 else "",
            ),
            best=agent in racing and values[agent] == best,
        )
        for agent, found in figures.items()
    }


def _notes(*notes: str) -> tuple[str, ...]:
    return tuple(note for note in notes if note)


def _headings(measures: Sequence[Measure]) -> tuple[Heading, ...]:
    return tuple(
        Heading(measure.label, measure.shown_unit, BETTER[measure.best]) for measure in measures
    )


def board_table(results: Results, board: Sequence[Comparison], agent: str) -> Table:
    """Return an agent beside the best of its rivals, from `Estimates.scoreboard`."""
    measures = tuple(m for m in results.measures if any(entry.measure == m for entry in board))
    cells = {(entry.environment, entry.measure.name): _compared(entry) for entry in board}
    environments = [key for key in results.environments if any(e.environment == key for e in board)]
    rivals = sorted({entry.rival for entry in board}, key=results.agents.index)
    return Table(
        f"Wins and losses of {agent}",
        "board",
        (Heading("environment"), *_headings(measures)),
        tuple(
            Row(key, tuple(cells.get((key, measure.name), _NOTHING) for measure in measures))
            for key in environments
        ),
        f"Above: {agent}; below: the rival with the best value. "
        f"{results.sample_sizes([agent, *rivals], environments)}",
    )


def rivals_table(
    results: Results,
    agent: str,
    counts: Mapping[str, Mapping[str, Counter[Outcome]]],
    measures: Sequence[Measure],
) -> Table:
    """Return an agent beside each of its rivals, from `Estimates.against_each`."""
    rows = []
    for rival, by_measure in counts.items():
        cells = []
        for measure in measures:
            found = by_measure[measure.name]
            alike = found["unclear"] + found["equal"]
            text = f"▲{found['better']} ○{alike} ▼{found['worse']}"
            cells.append(Cell(text) if found else _NOTHING)
        rows.append(Row(rival, tuple(cells), results.kind(rival)))
    return Table(
        f"{agent} beside each of its rivals",
        "board",
        (Heading("rival"), *(Heading(one.label, "environments") for one in measures)),
        tuple(rows),
        f"In how many environments {agent} is clearly better (▲) or worse (▼) than this rival, and "
        "in how many there is no clear difference (○). Only those count in which both have a value "
        "in half of their episodes. "
        f"{results.sample_sizes([agent, *counts], results.environments)}",
    )


def likeness_table(results: Results, agent: str, boards: Mapping[str, list[Comparison]]) -> Table:
    """Return an agent beside others in human-likeness, from `Estimates.likeness` of each."""
    measures = tuple(dict.fromkeys(entry.measure for board in boards.values() for entry in board))
    rows = []
    for rival, board in boards.items():
        found = {entry.measure.name: entry for entry in board}
        cells = (
            _compared(found[one.name], with_difference=True) if one.name in found else _NOTHING
            for one in measures
        )
        rows.append(Row(f"{agent} and {rival}", tuple(cells)))
    return Table(
        f"Human-likeness of {agent}",
        "board",
        (Heading("agents"), *_headings(measures)),
        tuple(rows),
        f"Above: {agent}; below: the other; then the difference and its 95 % interval. "
        f"Environment: {results.base}. {results.sample_sizes([agent, *boards], [results.base])}",
    )


def _compared(entry: Comparison, with_difference: bool = False) -> Cell:
    more = entry.more_decimals if entry.outcome in ("better", "worse") else 0
    mine, theirs = (entry.measure.number(one.estimate, more) for one in (entry.mine, entry.theirs))
    notes = [f"{theirs} {entry.rival}"]
    if with_difference:
        difference = entry.difference
        ends = entry.measure.interval(difference.low, difference.high)
        notes.append(f"{entry.measure.number(difference.estimate)} {ends}")
    return Cell(mine, tuple(notes), look=entry.outcome, sign=SIGNS[entry.outcome])


def ranking_table(estimates: Estimates) -> Table | None:
    """Return the ranking; None if there is no environment that all agents have attempted."""
    results, ranking, common = estimates.results, estimates.ranking, estimates.common
    if ranking.empty:
        return None
    baseline = results.label_of(BASELINE_AGENT)
    shares = {
        "success": Heading("success", "%", BETTER["high"]),
        "settled": Heading("settled", "% of the episode", BETTER["high"]),
    }
    explained = ""
    if baseline is not None:
        shares["improvement"] = Heading(f"better than {baseline}", "%", BETTER["high"])
        explained = (
            f"Better than {baseline}: how probable it is to be settled for longer in the same "
            "episode, 50 % if equal. "
        )
    left_out = len(results.environments) - len(common)
    partly = f" ({left_out} more were not attempted by all)" if left_out else ""
    rows = ranking.to_dict("records")
    return Table(
        "Ranking",
        "scores ranking",
        (
            Heading("agent"),
            Heading("rank"),
            *shares.values(),
            Heading("time to target", "s", BETTER["low"]),
            Heading("training seeds"),
        ),
        tuple(_ranked(estimates, row, shares) for row in rows),
        f"Ranked by success over {count(len(common), 'environment')}{partly}, each weighing the "
        "same; then by time to target, the mean of the medians of the environments where an agent "
        "arrives. Settled: interquartile mean of the part of an episode after which the hand stays "
        f"at the target. {explained}In brackets: 95 % intervals. Cells that could not be played "
        "count as without success. "
        f"{results.sample_sizes([str(row['agent']) for row in rows], common)}",
    )


def _ranked(estimates: Estimates, row: Mapping[Hashable, Any], shares: Iterable[str]) -> Row:
    agent = str(row["agent"])
    cells = [
        _with_interval(SUCCESS, row[name], row[f"{name}_low"], row[f"{name}_high"])
        for name in shares
    ]
    time = _with_interval(TIME, row["time_to_target"], *estimates.time_interval(agent))
    seeds = Cell(str(row["training_seeds"] or "–"))
    return Row(agent, (Cell(str(row["rank"])), *cells, time, seeds), estimates.results.kind(agent))


def _with_interval(measure: Measure, value: float, low: float, high: float) -> Cell:
    return Cell(measure.number(value), _notes(measure.interval(low, high)))


def heat_table(estimates: Estimates) -> Table:
    """Return success by environment and agent, the agents in the order of the ranking."""
    results = estimates.results
    table = success_by_environment(results.episodes, results.cells_not_played)
    ranked = [] if estimates.ranking.empty else map(str, estimates.ranking["agent"])
    agents = [a for a in dict.fromkeys([*ranked, *results.agents]) if a != REFERENCE]
    rows, family = [], ""
    for key, environment in results.environments.items():
        shares = {agent: float(table[key].get(agent, math.nan)) for agent in agents}
        known = [share for share in shares.values() if share > 0]
        most = _whole(max(known)) if known else ""
        cells = tuple(
            Cell(_whole(share), best=_whole(share) == most, look=_shade(share))
            for share in shares.values()
        )
        rows.append(Row(key, cells, look="begins" if environment.family != family else ""))
        family = environment.family
    return Table(
        "Success in each environment",
        "heat",
        tuple(map(Heading, ("environment", *agents))),
        tuple(rows),
        "Success at the end of the episode, %: the darker the more; underlined: the most; ·: not "
        "attempted; 0 also where an agent could not act. "
        f"{results.sample_sizes(agents, results.environments)}",
    )


def _whole(share: float) -> str:
    """Return a share in whole percents, 0 and 100 only where they are exact."""
    if math.isnan(share):
        return "·"
    if 0 < share < 0.005:
        return "<1"
    return ">99" if 0.995 <= share < 1 else f"{100 * share:.0f}"


def _shade(share: float) -> str:
    return "" if math.isnan(share) else f"s{round(_SHADES * share):d}"


class Law(NamedTuple):
    """A law of human movement, or another measure of sets of movements."""

    measure: str
    explained: str = ""  # name of the measure that tells how well the law holds
    people: str = ""  # what people do, and who found that
    source: str = ""


LAWS = (
    Law("posture_variability", "", "above 0", "Soechting et al. 1995"),
    Law("fitts_slope", "fitts_r_squared", "about 0.1", "Fitts 1954"),
    Law("speed_curvature_exponent", "speed_curvature_r_squared", "0.333", "Lacquaniti et al. 1983"),
)


def law_table(results: Results) -> Table | None:
    """Return how agents keep the laws, and other measures of sets; None if none was taken."""
    known = results.sets[results.sets["value"].notna()] if len(results.sets) else results.sets
    told = {name for law in LAWS for name in (law.measure, law.explained)}
    others = [Law(name) for name in results.set_measures if name not in told]
    laws = [law for law in (*LAWS, *others) if (known["measure"] == law.measure).any()]
    if not laws:
        return None
    measures = [results.set_measures[law.measure] for law in laws]
    present = set(known.loc[known["measure"].isin([one.name for one in measures]), "agent"])
    agents = [agent for agent in results.agents if agent in present]
    environments = list(dict.fromkeys(one.environment for one in measures))
    people = [Cell(law.people or "–", _notes(law.source)) for law in laws]
    rows = []
    for agent in agents:
        mine = known[known["agent"] == agent]
        cells = tuple(_kept(mine, law, one) for law, one in zip(laws, measures))
        rows.append(Row(agent, cells, results.kind(agent)))
    return Table(
        "Laws of human movement",
        "scores",
        (Heading("agent"), *(Heading(one.label, one.shown_unit) for one in measures)),
        (Row("people", tuple(people), look="people"), *rows),
        "Posture variability: how much the postures differ at the same target, reached from "
        "different starts; 0 is Donders' law. Fitts' slope: time for each bit of difficulty; no "
        "agent is told the width of a target. Speed-curvature exponent: how much slower the hand "
        "is where its path bends. Means over training seeds, and their range; R²: the part of the "
        "variance that the law explains; –: too few movements arrived. Environments: "
        f"{', '.join(environments)}. {results.sample_sizes(agents, environments)}",
    )


def _kept(mine: pd.DataFrame, law: Law, measure: SetMeasure) -> Cell:
    values = mine.loc[mine["measure"] == law.measure, "value"]
    if values.empty:
        return Cell("–")
    notes = []
    if len(values) > 1:
        notes.append(f"{measure.number(values.min())} to {measure.number(values.max())}")
    explained = mine.loc[mine["measure"] == law.explained, "value"]
    if len(explained):
        notes.append(f"R² {number(explained.mean(), 2)}")
    return Cell(measure.number(values.mean()), tuple(notes))
