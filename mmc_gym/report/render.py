"""`mmc-gym report`: a benchmark's store becomes one HTML file that needs nothing beside it.

No result is written here: every sentence with a number is computed from the estimates, and wins
and losses follow from the same rule.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

from jinja2 import Environment, PackageLoader, StrictUndefined

from mmc_gym._errors import UserError, require
from mmc_gym._files import write_atomically
from mmc_gym.benchmark.statistics import RESAMPLES
from mmc_gym.benchmark.store import reasons
from mmc_gym.report import figures, tables
from mmc_gym.report.panels import looks
from mmc_gym.report.replay import replay, replayed
from mmc_gym.report.results import Results, count, listed, read_results
from mmc_gym.report.scores import COMMON, MARGINS, SUCCESS, TIME, Comparison, Estimates, Outcome

FOCUS = ("mmc-body", "mmc")
"""The agents whose wins and losses are told: the network as model of its body, and alone."""

SMOOTH = "ppo-smooth"
"""The agent that learned with a reward for smoothness: is it as human-like as `NETWORKS`?"""

NETWORKS = ("mmc", "mmc-bell")

RANKED = (SUCCESS, TIME)
"""The measures in which `FOCUS` is compared with each rival: those that agents are ranked by."""

EXAMPLES = 3
"""Environments that a sentence names, those of the largest differences."""


def write_report(store: Path | str, out: Path | str, resamples: int = RESAMPLES) -> Path:
    """Write the report of a benchmark, and return its file.

    Args:
        store: folder of the benchmark.
        out: the HTML file.
        resamples: of each bootstrap.

    Raises:
        UserError: if there is no store, it is damaged or has no episodes, or `out` is a folder.
    """
    for name, path in (("store", store), ("out", out)):
        require(isinstance(path, str | Path), name, path, "a path")
    out = Path(out)
    if out.is_dir():
        raise UserError(f"out must be a file, got the folder {str(out)!r}")
    results = read_results(Path(store))
    return write_atomically(out, render(Estimates(results, resamples)))


def render(estimates: Estimates) -> str:
    """Return the report as HTML."""
    pages = Environment(
        loader=PackageLoader("mmc_gym.report"),
        autoescape=True,  # names of agents are what users call them
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    pages.policies["json.dumps_kwargs"] = {"separators": (",", ":")}
    return pages.get_template("report.html.j2").render(context(estimates))


def context(estimates: Estimates) -> dict[str, Any]:
    """Return what the template shows."""
    results = estimates.results
    main, look = results.main_agents, looks(results.main_agents)
    focus = [agent for name in FOCUS if (agent := results.label_of(name)) is not None]
    boards = {agent: board for agent in focus if (board := estimates.scoreboard(agent))}
    smooth, likeness = results.label_of(SMOOTH), _likeness(estimates)
    human = [measure for measure in results.measures if measure.name in MARGINS]
    others = [measure for measure in results.measures if measure.name not in MARGINS]
    return {
        "results": results,
        "manifest": results.manifest,
        "scope": scope(results),
        "lead": lead(estimates),
        "ranking": tables.ranking_table(estimates),
        "standings": [standing(board, agent) for agent, board in boards.items()],
        "against": {
            agent: tables.rivals_table(
                results, agent, estimates.against_each(agent, RANKED), RANKED
            )
            for agent in boards
        },
        "verdicts": [verdict(board, smooth or "", name) for name, board in likeness.items()],
        "heat": tables.heat_table(estimates),
        "told": tables.told_table(results),
        "replay": replay(results, replayed(results), main),
        "signs": tables.SIGNS,
        "boards": [tables.board_table(results, board, agent) for agent, board in boards.items()],
        "no_boards": nothing_compared(results, focus),
        "movements": figures.movements(results, look),
        "likeness": tables.likeness_table(results, smooth or "", likeness) if likeness else None,
        "margins": "; ".join(f"{one.full_label} {MARGINS[one.name]:g}" for one in human),
        "laws": tables.law_table(results),
        "human": figures.dots(estimates, human, look),
        "at_a_glance": figures.dots(estimates, others, look),
        "learning": figures.learning(estimates, look),
        "cost": tables.cost_table(results),
        "frontier": figures.frontier(estimates, look),
        "profiles": figures.profiles(estimates, look),
        "degradation": figures.degradation(estimates, look),
        "tables": {key: tables.score_table(estimates, key) for key in results.environments},
        "not_played": reasons(results.manifest.not_played),
        "main": main,
        "resamples": estimates.resamples,
        "profile_resamples": figures.PROFILE_RESAMPLES,
        "version": version("mmc-gym"),
    }


def scope(results: Results) -> str:
    """Return how much was played."""
    policies = results.episodes[["agent", "training_seed"]].drop_duplicates()
    return (
        f"{count(len(results.agents), 'agent')}, {len(policies):,} policies "
        f"with all training seeds, {count(len(results.environments), 'environment')}, "
        f"{count(len(results.episodes), 'episode')}."
    )


def lead(estimates: Estimates) -> str:
    """Return the success of the best agent of each kind; empty if nothing can be ranked."""
    results = estimates.results
    best: dict[str, Mapping[Hashable, Any]] = {}
    for row in estimates.ranking.to_dict("records"):
        best.setdefault(results.kind(str(row["agent"])), row)
    parts = [
        f"{row['agent']} ({kind}, {_trained(row)}) {SUCCESS.quantity(row['success'])} "
        f"{SUCCESS.interval(row['success_low'], row['success_high'])}"
        for kind, row in best.items()
        if kind not in ("baseline", "ideal")
    ]
    environments = count(len(estimates.common), "environment")
    return f"Success over {environments}, the best of each kind: {listed(parts)}." if parts else ""


def _trained(row: Mapping[Hashable, Any]) -> str:
    seeds = int(row["training_seeds"])
    return count(seeds, "training seed") if seeds else "not trained"


class Standing(NamedTuple):
    """How often each outcome was, and a line for each measure that has such a clear one."""

    agent: str
    counts: Counter[Outcome]
    better: list[str]
    worse: list[str]


def standing(board: Sequence[Comparison], agent: str) -> Standing:
    """Return where an agent stands among its rivals, from `Estimates.scoreboard`."""
    counts = Counter(entry.outcome for entry in board)
    return Standing(agent, counts, _lines(board, "better"), _lines(board, "worse"))


def _lines(board: Sequence[Comparison], outcome: Outcome) -> list[str]:
    lines = []
    for measure in dict.fromkeys(entry.measure for entry in board):
        compared = [entry for entry in board if entry.measure == measure]
        found = sorted((e for e in compared if e.outcome == outcome), key=_gap, reverse=True)
        examples = []
        for entry in found[:EXAMPLES]:
            mine = measure.number(entry.mine.estimate, entry.more_decimals)
            theirs = measure.quantity(entry.theirs.estimate, entry.more_decimals)
            examples.append(f"{entry.environment} ({mine} against {theirs} of {entry.rival})")
        if len(found) > EXAMPLES:
            examples.append(f"{len(found) - EXAMPLES} more")
        if found:
            among = count(len(compared), "environment")
            lines.append(f"{measure.full_label}: in {len(found)} of {among}: {listed(examples)}")
    return lines


def _gap(entry: Comparison) -> float:
    mine, theirs = entry.mine.estimate, entry.theirs.estimate
    return abs(mine - theirs) / max(abs(mine), abs(theirs), 1e-12)


def nothing_compared(results: Results, networks: Sequence[str]) -> str:
    """Return why there are no comparisons, if there are none."""
    if not networks:
        return "The network did not take part in this benchmark."
    if not any(results.rivals(agent) for agent in networks):
        return "The network has no rival in this benchmark."
    return f"There are fewer than {COMMON} instances in common to compare agents on."


def _likeness(estimates: Estimates) -> dict[str, list[Comparison]]:
    """Compare the agent that learned to be smooth with each network, where both have values."""
    smooth = estimates.results.label_of(SMOOTH)
    networks = [found for name in NETWORKS if (found := estimates.results.label_of(name))]
    if smooth is None:
        return {}
    return {name: board for name in networks if (board := estimates.likeness(smooth, name))}


def verdict(board: Sequence[Comparison], learned: str, network: str) -> str:
    """Return whether an agent that learned to be smooth is as human-like as a network."""
    counts = Counter(entry.outcome for entry in board)
    said: dict[Outcome, str] = {
        "better": "more human-like",
        "worse": "less human-like",
        "equal": "the same",
        "unclear": "not to be told apart",
    }
    parts = [f"{words} in {counts[one]}" for one, words in said.items() if counts[one]]
    who = f"{learned}, rewarded for smoothness, beside {network}"
    return f"{who}: {listed(parts)} of {count(len(board), 'measure')}"
