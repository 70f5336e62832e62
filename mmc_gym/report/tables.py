"""The tables of the report, see `mmc_gym._tables`."""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping, Sequence
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from mmc_gym._tables import NONE, Cell, Heading, Row, Table, count, interval, number
from mmc_gym.agents.registry import REFERENCE
from mmc_gym.benchmark.statistics import Bootstrap, Estimate, Scores, arrange
from mmc_gym.benchmark.suite import control_note
from mmc_gym.measures import MEASURES, Measure
from mmc_gym.measures.catalogue import PEOPLE, people, span
from mmc_gym.report.results import Results

if TYPE_CHECKING:
    from mmc_gym.experiments.results import ExperimentResult

_LOST = 3  # scenarios in which an agent loses most
PRESENT = 0.5  # share of its episodes in which the best agent needs a value

_BETTER = {"high": "more is better", "low": "less is better", "neither": ""}
_SUCCESS = MEASURES["success"]


def ranking_table(results: Results) -> Table | None:
    """Return the ranking; None if there is no scenario that all agents have attempted."""
    ranking = results.ranking
    if ranking.empty:
        return None
    longer = f"settled for longer than {results.focus[0]}"
    shares = {
        "success": Heading("success", "%", _BETTER["high"]),
        "settled": Heading("settled", "% of the episode", _BETTER["high"]),
    }
    explained = ""
    if len(ranking) > 1 and ranking["improvement"].notna().any():
        shares["improvement"] = Heading(longer, "%", _BETTER["high"])
        explained = f" S{longer[1:]}: in what part of the same episodes, 50 % if equal."
    has_blocks = ranking["control"].nunique() > 1
    environments = int(ranking["environments"].iloc[0])
    left_out = len(results.environments) - environments
    partly = f" ({left_out} more were not attempted by all)" if left_out else ""
    rows = []
    for row in ranking.to_dict("records"):
        cells = (
            *[Cell(str(row["control"]))] * has_blocks,
            Cell(str(row["rank"])),
            *(_share(row[name], row[f"{name}_low"], row[f"{name}_high"]) for name in shares),
            Cell(MEASURES["time_to_target"].number(row["time_to_target"])),
        )
        rows.append(_row(results, str(row["agent"]), cells))
    time = Heading("time to target", "s", _BETTER["low"])
    acts_by = [Heading("acts by")] * has_blocks
    return Table(
        headings=(Heading("agent"), *acts_by, Heading("rank"), *shares.values(), time),
        rows=tuple(rows),
        caption=f"Ranked by success over {count(environments, 'scenario')}{partly}, each weighing "
        "the same, then by time to target (mean of medians). Settled: mean of the "
        f"part of an episode after which the hand stays at the target.{explained} In brackets: "
        f"95 % intervals. {control_note(results.controls)} {results.sample_sizes}",
        title="How good the agents are",
        look="scores ranking",
    )


def _share(estimate: float, low: float, high: float, look: str = "") -> Cell:
    return Cell(_SUCCESS.number(estimate), _notes(_SUCCESS.interval(low, high)), look=look)


def _row(results: Results, agent: str, cells: Sequence[Cell], note: str = "") -> Row:
    return Row(agent, tuple(cells), note, "focus" if agent in results.focus else "")


def scenario_table(results: Results, agent: str) -> Table:
    """Return the success of an agent in each scenario, and of the others with the difference."""
    others = [one for one in results.agents if one not in (agent, REFERENCE)]
    rows, family = [], ""
    for name, found in results.successes.items():
        if agent not in found.scores.values:
            continue
        look = "all"
        if name in results.environments:
            before, family = family, results.environments[name].family
            look = "begins" if family != before else ""
        own = _share(*found.estimate(agent), look="mine")
        rows.append(Row(name, (own, *(_compared(found, agent, one) for one in others)), look=look))
    against = (
        f" Below the success of each other agent: how much more or less {agent} has in the same "
        f"episodes. + and blue: {agent} is clearly better; − and orange: clearly worse (the "
        "interval leaves out 0)."
    )
    return Table(
        headings=tuple(map(Heading, ("scenario", agent, *others))),
        rows=tuple(rows),
        caption="Success at the end of the episode, %, with 95 % intervals. "
        f"{control_note(results.controls)}"
        f"{against if others else ''}",
        title=f"Success of {agent} in each scenario",
        look="scores scenarios",
    )


def _compared(found: Bootstrap, agent: str, other: str) -> Cell:
    """Return the cell of another agent: its success, and by how much that of `agent` differs."""
    if other not in found.scores.values:
        return Cell("·")
    gain = found.difference(agent, other)
    ends = f" [{_signed(gain.low)}, {_signed(gain.high)}]" if math.isfinite(gain.low) else ""
    look = "better" if gain.low > 0 else "worse" if gain.high < 0 else ""
    notes = (f"{_signed(gain.estimate)}{ends}",)
    return Cell(_SUCCESS.number(found.estimate(other).estimate), notes, look=look)


def _signed(share: float) -> str:
    """Return a difference of fractions in percent, with its sign."""
    text = f"{100 * share:+.1f}"
    return text.replace("-", "−") if float(text) else "0.0"


def generalisation_table(results: Results) -> Table | None:
    """Return success and regret by where strengths are; None if no agent was trained on ranges."""
    places, best = results.places, results.yardstick
    if not places or not best:
        return None
    rows = []
    for agent in (one for one in results.agents if one != REFERENCE):
        cells = []
        for found in places.values():
            lost, own = found.difference(best, agent), found.estimate(agent)
            ends = (
                f" [{_signed(lost.low)}, {_signed(lost.high)}]" if math.isfinite(lost.low) else ""
            )
            note = "" if agent == best else f"{_signed(lost.estimate)}{ends}"
            cells.append(Cell(_SUCCESS.number(own.estimate), _notes(note)))
        lost_in = {
            name: results.successes[name].difference(best, agent).estimate
            for name in results.judged
            if {agent, best} <= results.successes[name].scores.values.keys()
        }
        worst = sorted(lost_in, key=lambda name: -lost_in[name])[:_LOST]
        most = [f"{name} {_signed(lost_in[name])}" for name in worst if lost_in[name] > 0]
        rows.append(_row(results, agent, (*cells, Cell(", ".join(most) or "nowhere"))))
    headings = [
        Heading(place, count(len(found.scores.instances), "scenario"))
        for place, found in places.items()
    ]
    return Table(
        headings=(Heading("agent"), *headings, Heading("loses most in", is_text=True)),
        rows=tuple(rows),
        caption="Success, %, inside the ranges of a training, between them, beyond them, and in "
        f"combinations of what it only met one at a time. Below: regret to {best}, how much more "
        "often that ends at the target, with its 95 % interval; below 0 where learning beats it.",
        title="Strengths that a training never had",
        look="scores",
    )


def given_table(results: Results) -> Table:
    """Return what each agent is, what it is given, what it senses, and how long it trained."""
    rows = []
    for agent in results.agents:
        who = results.identities[agent]
        known = who.knowledge
        cells = map(Cell, (who.training, known.lengths, known.actions, known.senses))
        rows.append(_row(results, agent, tuple(cells), note=who.about(agent)))
    labels = ("agent", "training", "segment lengths", "what actions do", "senses")
    return Table(
        headings=tuple(map(Heading, labels)),
        rows=tuple(rows),
        title="What each agent is given, and its training",
        look="given",
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
        shown = results.replayed_failures.get((agent, name), [])
        cells = (
            Cell(f"{len(failed)} of {len(mine)}"),
            Cell("" if shown else "–", links=tuple((name, number + 1) for number in shown)),
            Cell(f"{possible} of {len(instances)}"),
            Cell(MEASURES["final_distance"].number(failed["final_distance"].median())),
        )
        rows.append((len(failed) / len(mine), Row(f"{agent} in {name}", cells)))
    if not rows:
        return None
    labels = ("agent and scenario", "failed", "replay of episode", "where another agent arrives")
    return Table(
        headings=(*map(Heading, labels), Heading("median distance at the end", "lengths")),
        rows=tuple(row for _, row in sorted(rows, key=lambda pair: -pair[0])),
        caption="Failed: the hand is not at the target at the end of the episode. A number shows "
        "that episode in the replay below.",
        title="Where it fails",
        look="scores failures",
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
    columns = []
    for measure in results.measures:
        of_agents = {agent: found[agent, measure.name] for agent in played}
        columns.append(_measure_column(results, scores[measure.name], measure, of_agents))
    labels = (Heading(one.label, one.shown_unit, _BETTER[one.best]) for one in results.measures)
    shown = [agent for agent in results.agents if agent in played]
    return Table(
        headings=(Heading("agent"), *labels),
        rows=tuple(_row(results, one, tuple(column[one] for column in columns)) for one in shown),
        caption=control_note({one: results.controls[one] for one in shown if one != REFERENCE}),
        title=f"Measures in {environment}",
        look="scores",
    )


def _measure_column(
    results: Results, scores: Scores, measure: Measure, found: Mapping[str, Estimate]
) -> dict[str, Cell]:
    """Return the cell of each agent that has played a scenario, by name.

    An agent can be the best only if enough of its episodes have a value.  Otherwise one that hardly
    ever arrives could win with a few short movements.
    """
    present = {name: 1 - float(np.isnan(own).mean()) for name, (own,) in scores.values.items()}
    racing = {
        agent: one.estimate
        for agent, one in found.items()
        if present[agent] >= PRESENT
        and math.isfinite(one.estimate)
        and results.kind(agent) not in ("ideal", "baseline")
    }
    best = ""  # as it is written: agents whose numbers look the same are all the best
    if measure.best != "neither" and racing:
        best = measure.number((max if measure.best == "high" else min)(racing.values()))
    cells = {}
    for agent, one in found.items():
        text = measure.number(one.estimate)
        is_partly = 0 < present[agent] < 1
        part = f"{number(min(100 * present[agent], 99), 0)} %" if is_partly else ""
        notes = _notes(measure.interval(one.low, one.high), part)
        cells[agent] = Cell(text, notes, best=agent in racing and text == best)
    return cells


def _notes(*notes: str) -> tuple[str, ...]:
    return tuple(note for note in notes if note)


def experiment_table(result: ExperimentResult, focus: Sequence[str]) -> Table:
    """Return the measures of learning of agents in an experiment, below those of people."""
    from mmc_gym.experiments.results import settings_note  # takes long, as does matplotlib

    name, measures = result.experiment.name, result.measures
    facts = measures.drop_duplicates("measure").to_dict("records")
    rows = []
    for agent, own in measures.groupby("agent", sort=False):
        found = {row["measure"]: _learning_cell(row) for row in own.to_dict("records")}
        cells = tuple(found.get(one["measure"], NONE) for one in facts)
        look = "people" if agent == PEOPLE else "focus" if agent in focus else ""
        rows.append(Row(str(agent), cells, look=look))
    cited = people(result.experiment.family).values()
    tasks = "".join(f" {one.source}: {one.task}; what differs: {one.differs}." for one in cited)
    return Table(
        headings=(Heading("agent"), *(Heading(one["label"], one["unit"]) for one in facts)),
        rows=tuple(sorted(rows, key=lambda row: row.name != PEOPLE)),
        caption=f"Of the mean over {count(result.trials['subject'].nunique(), 'subject')}; below, "
        f"95 % bootstrap intervals over subjects; –: no value.{settings_note(result.settings)}"
        f"{tasks and ' People:' + tasks}",
        title=f"Learning in {name}",
        look="scores",
    )


def _learning_cell(row: Mapping[Hashable, Any]) -> Cell:
    if row["agent"] == PEOPLE:
        return Cell(span(row["low"], row["high"]), (row["source"],))
    ends = interval(row["low"], row["high"], row["decimals"])
    return Cell(number(row["estimate"], row["decimals"]), _notes(ends))
