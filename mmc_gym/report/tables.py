"""The tables of the report: rows of cells that are text.  The template shows all of them alike."""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping, Sequence
from itertools import product
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mmc_gym._console import interval, number
from mmc_gym.agents.registry import REFERENCE
from mmc_gym.benchmark.statistics import Bootstrap, Estimate, Scores, arrange
from mmc_gym.measures import MEASURES, Measure
from mmc_gym.measures.catalogue import PEOPLE, people, span
from mmc_gym.measures.episode import Floats
from mmc_gym.report.results import Results, count

if TYPE_CHECKING:
    from mmc_gym.experiments.results import ExperimentResult

PRESENT = 0.5  # share of its episodes in which the best agent needs a value

_BETTER = {"high": "more is better", "low": "less is better", "neither": ""}
_SUCCESS = MEASURES["success"]


class Heading(NamedTuple):
    """The heading of a column: label, unit, and which way is better."""

    label: str
    unit: str = ""
    better: str = ""


class TableCell(NamedTuple):
    """A cell: its text, notes in small print, whether it is the best, its CSS class, and links.

    A link is a scenario and the number of an episode that the replay shows.
    """

    text: str
    notes: tuple[str, ...] = ()
    best: bool = False
    look: str = ""
    links: tuple[tuple[str, int], ...] = ()


NONE = TableCell("–")


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
    """Return the ranking; None if there is no scenario that all agents have attempted."""
    ranking = results.ranking
    if ranking.empty:
        return None
    first = results.focus[0]
    shares = {
        "success": Heading("success", "%", _BETTER["high"]),
        "settled": Heading("settled", "% of the episode", _BETTER["high"]),
    }
    explained = ""
    if len(ranking) > 1 and ranking["improvement"].notna().any():
        shares["improvement"] = Heading(f"settled for longer than {first}", "%", _BETTER["high"])
        explained = (
            f" Settled for longer than {first}: in what part of the same episodes, 50 % if equal."
        )
    environments = int(ranking["environments"].iloc[0])
    left_out = len(results.environments) - environments
    partly = f" ({left_out} more were not attempted by all)" if left_out else ""
    return Table(
        "How good the agents are",
        "scores ranking",
        (
            Heading("agent"),
            Heading("rank"),
            *shares.values(),
            Heading("time to target", "s", _BETTER["low"]),
        ),
        tuple(_ranked(results, row, list(shares)) for row in ranking.to_dict("records")),
        f"Ranked by success over {count(environments, 'scenario')}{partly}, each weighing the "
        "same, then by time to target (mean of medians). Settled: interquartile mean of the part "
        f"of an episode after which the hand stays at the target.{explained} In brackets: 95 % "
        f"intervals. {results.sample_sizes}",
    )


def _ranked(results: Results, row: Mapping[Hashable, Any], shares: Sequence[str]) -> TableRow:
    cells = (
        TableCell(str(row["rank"])),
        *(
            TableCell(
                _SUCCESS.number(row[name]),
                _notes(_SUCCESS.interval(row[f"{name}_low"], row[f"{name}_high"])),
            )
            for name in shares
        ),
        TableCell(MEASURES["time_to_target"].number(row["time_to_target"])),
    )
    return _row(results, str(row["agent"]), cells)


def _row(results: Results, agent: str, cells: Sequence[TableCell], note: str = "") -> TableRow:
    """Return the row of an agent, marked if it is in focus."""
    return TableRow(agent, tuple(cells), note, "focus" if agent in results.focus else "")


def scenario_table(results: Results, agent: str) -> Table:
    """Return the success of an agent in each scenario, and of the others with the difference."""
    others = [one for one in results.agents if one not in (agent, REFERENCE)]
    rows, family = [], ""
    for name, found in results.successes.items():
        if agent in found:
            environment = results.environments.get(name)
            begins = environment is not None and environment.family != family
            family = environment.family if environment else family
            mine = Estimate.of(found[agent])
            text = _SUCCESS.number(mine.estimate)
            own = TableCell(text, _notes(_SUCCESS.interval(mine.low, mine.high)), look="mine")
            cells = [own, *(_compared(found, agent, other) for other in others)]
            look = "all" if environment is None else "begins" if begins else ""
            rows.append(TableRow(name, tuple(cells), look=look))
    against = (
        f" Below the success of each other agent: how much more or less {agent} has in the same "
        f"episodes. + and blue: {agent} is clearly better; − and orange: clearly worse (the "
        "interval leaves out 0)."
        if others
        else ""
    )
    return Table(
        f"Success of {agent} in each scenario",
        "scores scenarios",
        tuple(map(Heading, ("scenario", agent, *others))),
        tuple(rows),
        f"Success at the end of the episode, %, with 95 % intervals.{against}",
    )


def _compared(found: Mapping[str, Floats], agent: str, other: str) -> TableCell:
    if other not in found:
        return TableCell("·")
    less = Estimate.of(found[agent] - found[other])
    ends = f" [{_signed(less.low)}, {_signed(less.high)}]" if math.isfinite(less.low) else ""
    look = "better" if less.low > 0 else "worse" if less.high < 0 else ""
    notes = (f"{_signed(less.estimate)}{ends}",)
    return TableCell(_SUCCESS.number(found[other][0]), notes, look=look)


def _signed(share: float) -> str:
    """Return a difference of fractions in percent, with its sign."""
    text = f"{100 * share:+.1f}"
    return text.replace("-", "−") if float(text) else "0.0"


def given_table(results: Results) -> Table:
    """Return what each agent is, what it is given, what it senses, and how long it trained."""
    rows = []
    for agent in results.agents:
        one = results.identities[agent]
        known = one.knowledge
        name = f"{one.name}: " if one.description and one.name != agent else ""
        texts = (one.training, known.lengths, known.actions, known.senses)
        kind = one.description or ("your own" if known.kind == "yours" else known.kind)
        rows.append(_row(results, agent, [TableCell(text) for text in texts], f"{name}{kind}"))
    labels = ("agent", "training", "segment lengths", "what actions do", "senses")
    return Table(
        "What each agent is given, and its training",
        "given",
        tuple(map(Heading, labels)),
        tuple(rows),
    )


def failure_table(results: Results) -> Table | None:
    """Return where the agents in focus fail, with links to the replay; None if nowhere."""
    rows = []
    for agent, name in product(results.focus, results.environments):
        here = results.by_scenario[name]
        mine = here[here["agent"] == agent]
        failed = mine[mine["success"] == 0]
        if failed.empty:
            continue
        others = here[(here["agent"] != REFERENCE) & (here["success"] == 1)]
        instances = set(failed["instance"])
        possible = len(instances & set(others["instance"]))
        shown = results.replayed_failures(agent, name)
        cells = (
            TableCell(f"{len(failed)} of {len(mine)}"),
            TableCell("" if shown else "–", links=tuple((name, number + 1) for number in shown)),
            TableCell(f"{possible} of {len(instances)}"),
            TableCell(MEASURES["final_distance"].number(failed["final_distance"].median())),
        )
        share = len(failed) / len(mine)
        rows.append((share, _row(results, f"{agent} in {name}", cells)))
    if not rows:
        return None
    return Table(
        "Where it fails",
        "scores failures",
        (
            Heading("agent and scenario"),
            Heading("failed"),
            Heading("replay of episode"),
            Heading("where another agent arrives"),
            Heading("median distance at the end", "lengths"),
        ),
        tuple(row for _, row in sorted(rows, key=lambda pair: -pair[0])),
        "Failed: the hand is not at the target at the end of the episode. A number shows that "
        "episode in the replay below.",
    )


def score_table(results: Results, environment: str) -> Table:
    """Return all measures of all agents in a scenario."""
    episodes = results.by_scenario[environment]
    scores = arrange(episodes, [one.name for one in results.measures])
    bootstraps = {name: Bootstrap(one, results.resamples) for name, one in scores.items()}
    played = [str(agent) for agent in episodes["agent"].unique()]
    found = {  # one agent after the other, as its draws are large and the same for all measures
        (agent, measure.name): bootstraps[measure.name].estimate(agent, measure.statistic)
        for agent in played
        for measure in results.measures
    }
    columns = [
        _column(results, scores[one.name], one, {agent: found[agent, one.name] for agent in played})
        for one in results.measures
    ]
    return Table(
        f"Measures in {environment}",
        "scores",
        (
            Heading("agent"),
            *(Heading(one.label, one.shown_unit, _BETTER[one.best]) for one in results.measures),
        ),
        tuple(
            _row(results, agent, [column[agent] for column in columns])
            for agent in results.agents
            if agent in played
        ),
    )


def _column(
    results: Results, scores: Scores, measure: Measure, found: Mapping[str, Estimate]
) -> dict[str, TableCell]:
    """Return the cell of each agent that has played a scenario, by name.

    An agent can be the best only if enough of its episodes have a value.  Otherwise one that hardly
    ever arrives could win with a few short movements.  Any value is enough for a `sampled` measure.
    """
    shares = {name: 1 - float(np.isnan(own).mean()) for name, (own,) in scores.values.items()}
    present = {name: math.ceil(one) if measure.sampled else one for name, one in shares.items()}
    values = {agent: measure.number(one.estimate) for agent, one in found.items()}
    racing = [
        agent
        for agent in found
        if present[agent] >= PRESENT
        and math.isfinite(found[agent].estimate)
        and results.kind(agent) not in ("ideal", "baseline")
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
                f"{number(min(100 * present[agent], 99), 0)} %" if 0 < present[agent] < 1 else "",
            ),
            best=agent in racing and values[agent] == best,
        )
        for agent, one in found.items()
    }


def _notes(*notes: str) -> tuple[str, ...]:
    return tuple(note for note in notes if note)


def experiment_table(result: ExperimentResult, focus: Sequence[str]) -> Table:
    """Return the measures of learning of agents in an experiment, below those of people."""
    from mmc_gym.experiments.results import settings_note  # takes long, as does matplotlib

    name, measures = result.experiment.name, result.measures
    facts = measures.drop_duplicates("measure").to_dict("records")
    rows = []
    for agent, own in measures.groupby("agent", sort=False):
        found = {row["measure"]: row for row in own.to_dict("records")}
        cells = tuple(_learned(found.get(one["measure"])) for one in facts)
        look = "people" if agent == PEOPLE else "focus" if agent in focus else ""
        rows.append(TableRow(str(agent), cells, look=look))
    cited = people(result.experiment.family).values()
    tasks = "".join(f" {one.source}: {one.task}; what differs: {one.differs}." for one in cited)
    return Table(
        f"Learning in {name}",
        "scores",
        (Heading("agent"), *(Heading(one["label"], one["unit"]) for one in facts)),
        tuple(sorted(rows, key=lambda row: row.name != PEOPLE)),
        f"Of the mean over {count(result.trials['subject'].nunique(), 'subject')}; below, 95 % "
        f"bootstrap intervals over subjects; –: no value.{settings_note(result.settings)}"
        f"{tasks and ' People:' + tasks}",
    )


def _learned(row: Mapping[Hashable, Any] | None) -> TableCell:
    if row is None:
        return NONE
    if row["agent"] == PEOPLE:
        return TableCell(span(row["low"], row["high"]), (row["source"],))
    decimals = row["decimals"]
    text = number(row["estimate"], decimals)
    return TableCell(text, _notes(interval(row["low"], row["high"], decimals)))
