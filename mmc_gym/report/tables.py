"""The tables of the report: rows of cells that are text.  The template shows all of them alike."""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping, Sequence
from statistics import median
from typing import Any, NamedTuple

import pandas as pd

from mmc_gym._console import number
from mmc_gym.benchmark.ranking import BASELINE_AGENT, success_by_environment
from mmc_gym.benchmark.statistics import Bootstrap
from mmc_gym.measures import MEASURES, Measure, SetMeasure
from mmc_gym.report.results import Results, count

PRESENT = 0.5  # share of its episodes in which the best agent needs a value

SCORE_RESAMPLES = 500  # for each of the thousands of intervals in the tables of all measures

_BETTER = {"high": "more is better", "low": "less is better", "neither": ""}
_SHADES = 10


class Heading(NamedTuple):
    """The heading of a column: label, unit, and which way is better."""

    label: str
    unit: str = ""
    better: str = ""


class TableCell(NamedTuple):
    """A cell: its text, notes in small print, whether it is the best, and its CSS class."""

    text: str
    notes: tuple[str, ...] = ()
    best: bool = False
    look: str = ""


class TableRow(NamedTuple):
    """A row of a table: its name, its cells, a note below the name, and its CSS class."""

    name: str
    cells: tuple[TableCell, ...]
    note: str = ""
    look: str = ""


class Table(NamedTuple):
    """A table: its title for screen readers, its CSS class, its cells and its caption."""

    title: str
    look: str
    headings: tuple[Heading, ...]
    rows: tuple[TableRow, ...]
    caption: str = ""


def ranking_table(results: Results) -> Table | None:
    """Return the ranking; None if there is no environment that all agents have attempted."""
    ranking = results.ranking
    if ranking.empty:
        return None
    shares = {
        "success": Heading("success", "%", _BETTER["high"]),
        "settled": Heading("settled", "% of the episode", _BETTER["high"]),
    }
    explained = ""
    if ranking["improvement"].notna().any():
        shares["improvement"] = Heading(f"better than {BASELINE_AGENT}", "%", _BETTER["high"])
        explained = (
            f"Better than {BASELINE_AGENT}: the probability of being settled for longer in the "
            "same episode, 50 % if equal. "
        )
    environments = int(ranking["environments"].iloc[0])
    left_out = len(results.environments) - environments
    partly = f" ({left_out} more were not attempted by all)" if left_out else ""
    rows = [_ranked(results, row, list(shares)) for row in ranking.to_dict("records")]
    return Table(
        "Ranking",
        "scores ranking",
        (
            Heading("agent"),
            Heading("rank"),
            *shares.values(),
            Heading("time to target", "s", _BETTER["low"]),
            Heading("training seeds"),
        ),
        tuple(rows),
        f"Ranked by success over {count(environments, 'environment')}{partly}, each weighing the "
        "same; then by time to target, the mean of the medians of the environments where an agent "
        "arrives. Settled: interquartile mean of the part of an episode after which the hand stays "
        f"at the target. {explained}In brackets: 95 % intervals. Cells that could not be played "
        "count as without success. "
        f"{results.sample_sizes([row.name for row in rows], results.environments)}",
    )


def _ranked(results: Results, row: Mapping[Hashable, Any], shares: Sequence[str]) -> TableRow:
    share = MEASURES["success"]
    intervals = [share.interval(row[f"{name}_low"], row[f"{name}_high"]) for name in shares]
    cells = (
        TableCell(str(row["rank"])),
        *(TableCell(share.number(row[name]), _notes(of)) for name, of in zip(shares, intervals)),
        TableCell(MEASURES["time_to_target"].number(row["time_to_target"])),
        TableCell(str(row["training_seeds"] or "–")),
    )
    agent = str(row["agent"])
    return TableRow(agent, cells, results.kind(agent))


def heat_table(results: Results) -> Table:
    """Return success by environment and agent, the agents in the order of the ranking."""
    table = success_by_environment(results.episodes, results.cells_not_played)
    rows, family = [], ""
    for key, environment in results.environments.items():
        shares = [float(table[key].get(agent, math.nan)) for agent in results.ranked]
        known = [share for share in shares if share > 0]
        most = _whole(max(known)) if known else ""
        cells = tuple(
            TableCell(_whole(share), best=_whole(share) == most, look=_shade(share))
            for share in shares
        )
        rows.append(TableRow(key, cells, look="begins" if environment.family != family else ""))
        family = environment.family
    return Table(
        "Success in each environment",
        "heat",
        tuple(map(Heading, ("environment", *results.ranked))),
        tuple(rows),
        "Success at the end of the episode, %: the darker the more; underlined: the most; ·: not "
        "attempted; 0 also where an agent could not act. "
        f"{results.sample_sizes(results.ranked, results.environments)}",
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


def given_table(results: Results) -> Table:
    """Return what each agent is, what it is given, what it senses, and how long it trained."""
    rows = []
    for agent in results.agents:
        one = results.identities[agent]
        known = one.knowledge
        name = f"{one.name}: " if one.description and one.name != agent else ""
        texts = (known.kind, known.lengths, known.actions, known.senses, _learned(results, agent))
        note = f"{name}{one.description}"
        rows.append(TableRow(agent, tuple(map(TableCell, texts)), note))
    labels = ("agent", "kind", "segment lengths", "what actions do", "senses", "learned from")
    return Table("What each agent is given", "given", tuple(map(Heading, labels)), tuple(rows))


def _learned(results: Results, agent: str) -> str:
    if agent in results.cards:
        cards = results.cards[agent]
        steps = median(card.training_steps for card in cards)
        minutes = median(card.training_cpu_seconds for card in cards) / 60
        seeds = count(len(cards), "training seed")
        return f"{steps:,.0f} environment steps ({minutes:.1f} min on one core) in each of {seeds}"
    unknown = results.kind(agent) in ("learned", "yours")
    return "unknown" if unknown else "nothing: not trained"


def score_table(results: Results, environment: str, resamples: int = SCORE_RESAMPLES) -> Table:
    """Return all measures of all agents in an environment, with `resamples` for each interval."""
    episodes = results.episodes[results.episodes["environment"] == environment]
    columns = [_column(results, episodes, measure, resamples) for measure in results.measures]
    played = set(episodes["agent"])
    agents = [agent for agent in results.agents if agent in played]
    return Table(
        f"Measures in {environment}",
        "scores",
        (
            Heading("agent"),
            *(Heading(one.label, one.shown_unit, _BETTER[one.best]) for one in results.measures),
        ),
        tuple(
            TableRow(agent, tuple(column[agent] for column in columns), results.kind(agent))
            for agent in agents
        ),
        results.sample_sizes(agents, [environment]),
    )


def _column(
    results: Results, episodes: pd.DataFrame, measure: Measure, resamples: int
) -> dict[str, TableCell]:
    """Return the cell of each agent that has played an environment, by name.

    An agent can be the best only if enough of its episodes have a value.  Otherwise one that hardly
    ever arrives could win with a few short movements.
    """
    bootstrap = Bootstrap.of(episodes, measure.name, resamples)
    found = {
        agent: bootstrap.estimate(agent, measure.statistic) for agent in bootstrap.scores.values
    }
    present = _present(episodes, measure.name)
    values = {agent: measure.number(one.estimate) for agent, one in found.items()}
    racing = [
        agent
        for agent in found
        if present.get(agent, 0.0) >= PRESENT and results.kind(agent) not in ("ideal", "baseline")
    ]
    best = ""
    if measure.best != "neither" and racing:
        pick = max if measure.best == "high" else min
        best = values[pick(racing, key=lambda agent: found[agent].estimate)]
    return {
        agent: TableCell(
            values[agent],
            _notes(
                measure.interval(one.low, one.high),
                f"{100 * present[agent]:.0f} %" if 0 < present.get(agent, 0.0) < 1 else "",
            ),
            best=agent in racing and values[agent] == best,
        )
        for agent, one in found.items()
    }


def _present(episodes: pd.DataFrame, measure: str) -> dict[str, float]:
    """Return the share of its episodes in which each agent has a value, by name.

    Count only instances where some agent has a value, because few record the time per action.
    """
    known = episodes[measure].notna()
    anyone = known.groupby(episodes["instance"]).transform("any")
    shares = known[anyone].groupby(episodes.loc[anyone, "agent"]).mean()
    return {str(agent): float(share) for agent, share in shares.items()}


def _notes(*notes: str) -> tuple[str, ...]:
    return tuple(note for note in notes if note)


class Law(NamedTuple):
    """A law of human movement, or another measure of sets of movements."""

    measure: str
    explained: str = ""  # name of the measure that says how well the law holds
    people: str = ""  # what people do, and who found that
    source: str = ""


LAWS = (
    Law("posture_variability", "", "above 0", "Soechting et al. 1995"),
    Law("fitts_slope", "fitts_r_squared", "about 0.1", "Fitts 1954"),
    Law("speed_curvature_exponent", "speed_curvature_r_squared", "0.333", "Lacquaniti et al. 1983"),
)


def law_table(results: Results) -> Table | None:
    """Return how well agents follow the laws, and other set measures; None without any values."""
    known = results.sets[results.sets["value"].notna()] if len(results.sets) else results.sets
    listed = {name for law in LAWS for name in (law.measure, law.explained)}
    others = [Law(name) for name in results.set_measures if name not in listed]
    laws = [law for law in (*LAWS, *others) if (known["measure"] == law.measure).any()]
    if not laws:
        return None
    measures = [results.set_measures[law.measure] for law in laws]
    present = set(known.loc[known["measure"].isin([one.name for one in measures]), "agent"])
    agents = [agent for agent in results.agents if agent in present]
    environments = list(dict.fromkeys(one.environment for one in measures))
    people = [TableCell(law.people or "–", _notes(law.source)) for law in laws]
    rows = []
    for agent in agents:
        mine = known[known["agent"] == agent]
        cells = tuple(_kept(mine, law, one) for law, one in zip(laws, measures))
        rows.append(TableRow(agent, cells, results.kind(agent)))
    return Table(
        "Laws of human movement",
        "scores",
        (Heading("agent"), *(Heading(one.label, one.shown_unit) for one in measures)),
        (TableRow("people", tuple(people), look="people"), *rows),
        "Posture variability: how much the postures differ at the same target, reached from "
        "different starts; 0 is Donders' law. Fitts' slope: time for each bit of difficulty; no "
        "agent is given the width of a target. Speed-curvature exponent: how much slower the hand "
        "is where its path bends. Means over training seeds, and their range; R²: the part of the "
        "variance that the law explains; –: too few movements arrived. Environments: "
        f"{', '.join(environments)}. {results.sample_sizes(agents, environments)}",
    )


def _kept(mine: pd.DataFrame, law: Law, measure: SetMeasure) -> TableCell:
    values = mine.loc[mine["measure"] == law.measure, "value"]
    if values.empty:
        return TableCell("–")
    notes = []
    if len(values) > 1:
        notes.append(f"{measure.number(values.min())} to {measure.number(values.max())}")
    explained = mine.loc[mine["measure"] == law.explained, "value"]
    if len(explained):
        notes.append(f"R² {number(explained.mean(), 2)}")
    return TableCell(measure.number(values.mean()), tuple(notes))
