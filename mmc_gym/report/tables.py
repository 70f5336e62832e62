"""The tables of the report, see `mmc_gym._tables`."""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping, Sequence
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from mmc_gym._tables import NONE, Cell, Heading, Row, Table, count, interval, number
from mmc_gym.agents.registry import REFERENCE
from mmc_gym.benchmark.kinds import lacks_group, trained_without
from mmc_gym.benchmark.statistics import Bootstrap, Estimate, Scores, arrange
from mmc_gym.measures import MEASURES, Measure, words
from mmc_gym.measures.catalogue import PEOPLE, people, span
from mmc_gym.report.results import Results

if TYPE_CHECKING:
    from mmc_gym.experiments.results import ExperimentResult

_LOST = 3  # scenarios in which an agent loses most
PRESENT = 0.5  # share of its episodes in which the best agent needs a value

_SUCCESS = MEASURES["success"]


def ranking_table(results: Results) -> Table | None:
    """Return the ranking; None if there is no scenario that all agents have attempted."""
    ranking, better = results.ranking, words.BETTER["high"]
    if ranking.empty:
        return None
    shares = {
        "success": Heading("success", "%", better),
        "settled": Heading("settled", "% of the episode", better),
    }
    improvement = ""
    if len(ranking) > 1 and ranking["improvement"].notna().any():
        longer = f"settled for longer than {results.focus[0]}"
        shares["improvement"] = Heading(longer, "%", better)
        improvement = words.REPORTED_IMPROVEMENT.format(focus=results.focus[0])
    acts_by = [Heading("acts by")] * (ranking["control"].nunique() > 1)
    rows = []
    for row in ranking.to_dict("records"):
        cells = [Cell(str(row["control"])) for _ in acts_by] + [Cell(str(row["rank"]))]
        cells += (_share(row[name], row[f"{name}_low"], row[f"{name}_high"]) for name in shares)
        cells.append(Cell(MEASURES["time_to_target"].number(row["time_to_target"])))
        rows.append(_row(results, str(row["agent"]), cells))
    time = Heading("time to target", "s", words.BETTER["low"])
    ranked = int(ranking["environments"].iloc[0])
    return Table(
        headings=(Heading("agent"), *acts_by, Heading("rank"), *shares.values(), time),
        rows=tuple(rows),
        caption=words.REPORTED_RANKING.format(
            scenarios=words.scenarios(ranked, len(results.environments), "were not"),
            improvement=improvement,
            controls=words.control_note(results.controls),
            sample_sizes=results.sample_sizes,
        ),
        title="How good the agents are",
        look="scores ranking",
    )


def _share(estimate: float, low: float, high: float, look: str = "") -> Cell:
    return Cell.of(_SUCCESS.number(estimate), _SUCCESS.interval(low, high), look=look)


def _row(results: Results, agent: str, cells: Sequence[Cell], note: str = "") -> Row:
    return Row(agent, tuple(cells), note, "focus" if agent in results.focus else "")


def scenario_table(results: Results, agent: str) -> Table:
    """Return the success of an agent in each scenario, and of the others with the difference."""
    others = [label for label in results.agents if label not in (agent, REFERENCE)]
    rows, family = [], ""
    for name, successes in results.successes.items():
        if agent not in successes.scores.values:
            continue
        look = "all"
        if name in results.environments:
            before, family = family, results.environments[name].family
            look = "begins" if family != before else ""
        cells = [_compared(successes, agent, other) for other in others]
        rows.append(Row(name, (_share(*successes.estimate(agent), "mine"), *cells), look=look))
    return Table(
        headings=tuple(map(Heading, ("scenario", agent, *others))),
        rows=tuple(rows),
        caption=words.SCENARIO.format(
            controls=words.control_note(results.controls),
            against=words.AGAINST.format(agent=agent) if others else "",
        ),
        title=f"Success of {agent} in each scenario",
        look="scores scenarios",
    )


def _compared(successes: Bootstrap, agent: str, other: str) -> Cell:
    """Return the cell of another agent: its success, and by how much that of `agent` differs."""
    if other not in successes.scores.values:
        return Cell("·")
    gain = successes.difference(agent, other)
    look = "better" if gain.low > 0 else "worse" if gain.high < 0 else ""
    return Cell.of(_SUCCESS.number(successes.estimate(other).estimate), _signed(*gain), look=look)


def _signed(share: float, low: float = math.nan, high: float = math.nan) -> str:
    """Return a difference of fractions in percent with its sign, and its interval if it has one."""
    if math.isfinite(low):
        return f"{_signed(share)} [{_signed(low)}, {_signed(high)}]"
    text = f"{100 * share:+.1f}"
    return text.replace("-", "−") if float(text) else "0.0"


def generalisation_table(results: Results) -> Table | None:
    """Return success and regret by where strengths are; None if no agent was trained on ranges."""
    places, best = results.places, results.yardstick
    if not places or not best:
        return None
    rows = []
    for agent in (label for label in results.agents if label != REFERENCE):
        cells = [_judged(successes, agent, best) for successes in places.values()]
        lost = {
            name: results.successes[name].difference(best, agent).estimate
            for name in results.judged
            if {agent, best} <= results.successes[name].scores.values.keys()
        }
        most = sorted(lost, key=lambda name: -lost[name])[:_LOST]
        texts = [f"{name} {_signed(lost[name])}" for name in most if lost[name] > 0]
        rows.append(_row(results, agent, (*cells, Cell(", ".join(texts) or "nowhere"))))
    return Table(
        headings=(*_sorts(places), Heading("loses most in", is_text=True)),
        rows=tuple(rows),
        caption=words.GENERALISATION.format(best=best),
        title="Strengths that a training never had",
        look="scores",
    )


def kinds_table(results: Results) -> Table | None:
    """Return success and regret by group of perturbations; None if no training lacks a group.

    Trainings without a group share a row, in which each is judged on the group that it lacks; –: no
    training lacks it.  Without the training on all groups, each has its own row.
    """
    best, agents = results.yardstick, [name for name in results.agents if name != REFERENCE]
    without = {agent: trained_without(agent, agents) for agent in agents}
    partial = {name for names in without.values() for name in names.values()}
    rows = []
    is_asked = any(lacks_group(name) for name in agents)
    for agent in (name for name in agents if is_asked and name not in partial):
        for label, names in ((agent, {}), (f"{agent}, never met", without[agent])):
            cells = [
                _judged(successes, names.get(group, agent), best)
                if label == agent or group in names
                else NONE
                for group, successes in results.groups.items()
            ]
            if {*cells} != {NONE}:
                rows.append(_row(results, label, cells))
    if not rows:
        return None
    return Table(
        headings=_sorts(results.groups),
        rows=tuple(rows),
        caption=words.KINDS.format(best=best),
        title="Kinds that a training never had",
        look="scores",
    )


def _sorts(successes: Mapping[Any, Bootstrap]) -> tuple[Heading, ...]:
    """Return the headings of a table by sorts of scenarios, with their numbers."""
    sizes = {
        sort: count(len(each.scores.instances), "scenario") for sort, each in successes.items()
    }
    return Heading("agent"), *(Heading(sort, size) for sort, size in sizes.items())


def _judged(successes: Bootstrap, agent: str, best: str) -> Cell:
    """Return an agent's success, and by how much that of the best exceeds it."""
    regret = "" if agent == best else _signed(*successes.difference(best, agent))
    return Cell.of(_SUCCESS.number(successes.estimate(agent).estimate), regret)


def given_table(results: Results) -> Table:
    """Return what each agent is, what it is given, what it senses, and how long it trained."""
    rows = []
    for agent in results.agents:
        identity = results.identities[agent]
        known = identity.knowledge
        cells = map(Cell, (identity.training, known.lengths, known.actions, known.senses))
        rows.append(_row(results, agent, tuple(cells), note=identity.about(agent)))
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
        episodes = results.by_scenario[name]
        mine = episodes[episodes["agent"] == agent]
        failed = mine[mine["success"] == 0]
        if failed.empty:
            continue
        arrived = episodes[(episodes["agent"] != REFERENCE) & (episodes["success"] == 1)]
        instances = set(failed["instance"])
        shown = results.replayed_failures.get((agent, name), [])
        cells = (
            Cell(f"{len(failed)} of {len(mine)}"),
            Cell("" if shown else "–", links=tuple((name, number + 1) for number in shown)),
            Cell(f"{len(instances & set(arrived['instance']))} of {len(instances)}"),
            Cell(MEASURES["final_distance"].number(failed["final_distance"].median())),
        )
        rows.append((len(failed) / len(mine), Row(f"{agent} in {name}", cells)))
    if not rows:
        return None
    labels = ("agent and scenario", "failed", "replay of episode", "where another agent arrives")
    return Table(
        headings=(*map(Heading, labels), Heading("median distance at the end", "lengths")),
        rows=tuple(row for _, row in sorted(rows, key=lambda pair: -pair[0])),
        caption=words.FAILURES,
        title="Where it fails",
        look="scores failures",
    )


def score_table(results: Results, environment: str) -> Table:
    """Return all measures of all agents in a scenario."""
    episodes = results.by_scenario[environment]
    scores = arrange(episodes, [measure.name for measure in results.measures])
    bootstraps = {name: Bootstrap(scores[name], results.resamples) for name in scores}
    agents = [str(agent) for agent in episodes["agent"].unique()]
    estimates = {  # one agent after the other: its draws are large and the same for all measures
        (agent, measure.name): bootstraps[measure.name].estimate(agent, measure.statistic)
        for agent in agents
        for measure in results.measures
    }
    columns = []
    for measure in results.measures:
        of_agents = {agent: estimates[agent, measure.name] for agent in agents}
        columns.append(_measure_column(results, scores[measure.name], measure, of_agents))
    labels = [
        Heading(measure.label, measure.shown_unit, words.BETTER[measure.best])
        for measure in results.measures
    ]
    shown = [agent for agent in results.agents if agent in agents]
    controls = {agent: results.controls[agent] for agent in shown if agent != REFERENCE}
    return Table(
        headings=(Heading("agent"), *labels),
        rows=tuple(_row(results, agent, [cells[agent] for cells in columns]) for agent in shown),
        caption=words.control_note(controls),
        title=f"Measures in {environment}",
        look="scores",
    )


def _measure_column(
    results: Results, scores: Scores, measure: Measure, estimates: Mapping[str, Estimate]
) -> dict[str, Cell]:
    """Return the cell of each agent that has played a scenario, by name.

    An agent can be the best only if enough of its episodes have a value.  Otherwise one that hardly
    ever arrives could win with a few short movements.
    """
    present = {agent: 1 - np.isnan(table).mean() for agent, (table,) in scores.values.items()}
    racing = {
        agent: estimate
        for agent, (estimate, _, _) in estimates.items()
        if present[agent] >= PRESENT
        and math.isfinite(estimate)
        and results.kind(agent) not in ("ideal", "baseline")
    }
    best = ""  # as it is written: agents whose numbers look the same are all the best
    if measure.best != "neither" and racing:
        best = measure.number((max if measure.best == "high" else min)(racing.values()))
    cells = {}
    for agent, (estimate, low, high) in estimates.items():
        text, share = measure.number(estimate), present[agent]
        part = f"{number(min(100 * share, 99), 0)} %" if 0 < share < 1 else ""
        is_best = agent in racing and text == best
        cells[agent] = Cell.of(text, measure.interval(low, high), part, best=is_best)
    return cells


def experiment_table(result: ExperimentResult, focus: Sequence[str]) -> Table:
    """Return the measures of learning of agents in an experiment, below those of people."""
    from mmc_gym.experiments.results import settings_note  # takes long, as does matplotlib

    measures = result.measures
    facts = measures.drop_duplicates("measure").to_dict("records")
    rows = []
    for agent, of_agent in measures.groupby("agent", sort=False):
        cells = {row["measure"]: _learning_cell(row) for row in of_agent.to_dict("records")}
        look = "people" if agent == PEOPLE else "focus" if agent in focus else ""
        in_order = tuple(cells.get(row["measure"], NONE) for row in facts)
        rows.append(Row(str(agent), in_order, look=look))
    cited = "".join(map(words.CITED.format, people(result.experiment.family).values()))
    return Table(
        headings=(Heading("agent"), *(Heading(row["label"], row["unit"]) for row in facts)),
        rows=tuple(sorted(rows, key=lambda row: row.name != PEOPLE)),
        caption=words.LEARNING.format(
            subjects=count(result.trials["subject"].nunique(), "subject"),
            settings=settings_note(result.settings),
            people=cited and f" People:{cited}",
        ),
        title=f"Learning in {result.experiment.name}",
        look="scores",
    )


def _learning_cell(row: Mapping[Hashable, Any]) -> Cell:
    if row["agent"] == PEOPLE:
        return Cell(span(row["low"], row["high"]), (row["source"],))
    decimals = row["decimals"]
    return Cell.of(number(row["estimate"], decimals), interval(row["low"], row["high"], decimals))
