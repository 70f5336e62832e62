"""`mmc-gym report`: a benchmark's store becomes one HTML file that needs nothing beside it."""

from __future__ import annotations

from importlib.metadata import version
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from mmc_gym._files import write_atomically
from mmc_gym.agents.policy import PRETRAINED
from mmc_gym.envs.render import shapes as drawing
from mmc_gym.report import sentences as human
from mmc_gym.report import sentences as words
from mmc_gym.report.figures import (
    PROFILE_RESAMPLES,
    degradation,
    dots,
    frontier,
    learning,
    movements,
    profiles,
)
from mmc_gym.report.numbers import count
from mmc_gym.report.panels import looks
from mmc_gym.report.replay import replay
from mmc_gym.report.results import Results, main_agents, read_results
from mmc_gym.report.scores import RESAMPLES, Estimates, scoreboard
from mmc_gym.report.tables import (
    SIGNS,
    board_table,
    heat_table,
    law_table,
    ranking_table,
    score_table,
    told_rows,
)

FOCUS = ("mmc", "mmc-closed")
"""The agents whose wins and losses are told: the network alone, and with all loops closed."""

_SIDE_BY_SIDE = 4  # agents that the replay begins with


def write_report(
    store: Path | str,
    out: Path | str,
    cards: Path | str = PRETRAINED,
    resamples: int = RESAMPLES,
) -> Path:
    """Write the report of a benchmark.

    Args:
        store: folder of the benchmark, see `data`.
        out: the HTML file.
        cards: folder of this package's policies, for what they learned from.
        resamples: of each bootstrap.

    Returns:
        The file.

    Raises:
        ValueError: if there is no store, or it is damaged, or `out` is a folder.
    """
    out = Path(out)
    if out.is_dir():
        raise ValueError(f"out must be a file, got the folder {str(out)!r}")
    results = read_results(Path(store), Path(cards))
    return write_atomically(out, render(Estimates(results, resamples)))


def render(estimates: Estimates) -> str:
    """The report as HTML."""
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
    """What the template shows."""
    results = estimates.results
    main = main_agents(results.identities)
    look = looks(main)
    base = words.base_of(results)
    focus = [agent for name in FOCUS if (agent := results.labelled(name)) is not None]
    boards = {agent: scoreboard(estimates, agent) for agent in focus}
    boards = {agent: board for agent, board in boards.items() if board}
    ranking = ranking_table(estimates)
    ranked = [row[1] for row in ranking.rows] if ranking else []
    human_measures = tuple(measure for measure in human.HUMAN if measure in results.measures)
    others = tuple(measure for measure in results.measures if measure not in human_measures)
    return {
        "results": results,
        "base": base,
        "scope": words.scope(results),
        "overview": words.overview(estimates),
        "ranking": ranking,
        "heat": heat_table(results, list(dict.fromkeys([*ranked, *results.agents]))),
        "standings": [words.standing(board, agent) for agent, board in boards.items()],
        "human_likeness": human.human_likeness(estimates),
        "margins": human.margins(),
        "sample_cost": words.sample_cost(results),
        "robustness": [s for agent in focus[:1] for s in words.robustness(estimates, agent)],
        "told": told_rows(results),
        "signs": SIGNS,
        "no_boards": words.nothing_compared(results, focus),
        "boards": [board_table(results, board, agent) for agent, board in boards.items()],
        "replay": {
            **replay(results, _replayed(results, base), main),
            "chosen": _one_of_each_kind(results, main),
            "colours": _colours(),
        },
        "movements": movements(results, base, look),
        "laws": law_table(results),
        "human": dots(estimates, human_measures, look),
        "at_a_glance": dots(estimates, others, look),
        "learning": learning(estimates, look),
        "frontier": frontier(estimates, look),
        "profiles": profiles(estimates, look),
        "degradation": degradation(estimates, look),
        "tables": [score_table(estimates, key) for key in results.environments],
        "main": main,
        "resamples": estimates.resamples,
        "profile_resamples": PROFILE_RESAMPLES,
        "not_played": words.not_played(results),
        "instances": {
            key: count(results.instances(key), "instance") for key in results.environments
        },
        "version": version("mmc-gym"),
    }


def _replayed(results: Results, base: str) -> list[str]:
    """The unperturbed environment, another without perturbation, the strongest of each family."""
    if results.paths.empty:
        return []
    recorded = set(results.paths["environment"])
    plain = [key for key, one in results.environments.items() if not one.family and key != base]
    strongest = [keys[-1] for keys in words.families(results).values()]
    return [key for key in (base, *plain[:1], *strongest, *plain[1:]) if key in recorded]


def _one_of_each_kind(results: Results, agents: tuple[str, ...]) -> list[str]:
    first = list({results.kind(agent): agent for agent in reversed(agents)}.values())
    chosen = list(dict.fromkeys([*reversed(first), *agents]))[:_SIDE_BY_SIDE]
    return [agent for agent in agents if agent in chosen]


def _colours() -> dict[str, str]:
    """Those of the environments' pictures."""
    names = ("BACKGROUND", "REACHABLE", "BORDER", "OUTLINE", "ROD", "BASE", "TRACE", "TARGET")
    return {name.lower(): "#{:02x}{:02x}{:02x}".format(*getattr(drawing, name)) for name in names}
