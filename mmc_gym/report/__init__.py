"""The report of a store: one file, HTML or Markdown, about the agents to compare.

A store holds a benchmark, experiments over trials (`mmc-gym adapt`), or both.  The file is complete
in itself, and every number in it is computed from the store.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from mmc_gym._errors import UserError, require, require_choice, unknown
from mmc_gym._files import write_atomically
from mmc_gym._tables import count, plain, to_html, to_markdown
from mmc_gym.benchmark.statistics import RESAMPLES
from mmc_gym.benchmark.store import MANIFEST, TRIALS, reasons
from mmc_gym.measures import MEASURES
from mmc_gym.report import tables
from mmc_gym.report.replay import replay
from mmc_gym.report.results import Results, listed, read_results

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from mmc_gym.experiments.results import ExperimentResult

__all__ = ["write_report"]

Format = Literal["html", "md"]


def write_report(
    store: Path | str,
    out: Path | str,
    resamples: int = RESAMPLES,
    *,
    focus: Sequence[str] = (),
    format: Format = "html",
    yardstick: str = "",
) -> Path:
    """Write the report of a store, and return its file.

    Args:
        store: folder of a benchmark, of experiments, or of both.
        out: the file.
        resamples: number for the ranking's intervals; the other tables use at most 500.
        focus: names of the agents that it is about; by default your own (files, models, modules
            and objects), or else the first that took part.
        format: "html", or "md" for its tables in Markdown.
        yardstick: name of the agent to whom the others have regret, if one was trained on ranges;
            by default the best.

    Raises:
        UserError: also if the store is damaged or has no episodes.
    """
    for name, path in (("store", store), ("out", out)):
        require(isinstance(path, str | Path), name, path, "a path")
    require_choice("format", format, get_args(Format))
    out = Path(out)
    if out.is_dir():
        raise UserError(f"out must be a file, got the folder {str(out)!r}")
    experiments: list[ExperimentResult] = []
    if (Path(store) / TRIALS).exists():
        from mmc_gym.experiments.trials import read_experiments  # takes long, as does matplotlib

        experiments = read_experiments(store)
    if experiments and not (Path(store) / MANIFEST).exists():
        shown = _titles(experiments, focus)
    else:
        results = read_results(Path(store), resamples, focus, yardstick)
        focus, shown = results.focus, _of_benchmark(results, format)
    shown["experiments"] = [_of_experiment(one, focus) for one in experiments]
    return write_atomically(out, _render(shown, format))


def _render(shown: Mapping[str, Any], format: Format) -> str:
    """Return the report as HTML or Markdown."""
    pages = Environment(
        loader=PackageLoader("mmc_gym.report"),
        autoescape=True,  # users choose the names of agents
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    pages.policies["json.dumps_kwargs"] = {"separators": (",", ":")}
    pages.filters |= {
        "html": lambda one: Markup(to_html(one)),
        "plain": plain,
        "markdown": to_markdown,
    }
    pages.globals |= {"count": count, "version": version("mmc-gym"), "results": None}
    return pages.get_template(f"report.{format}.j2").render(shown)


def _titles(experiments: Sequence[ExperimentResult], focus: Sequence[str]) -> dict[str, Any]:
    """Return title and headline of a report without a benchmark."""
    known = list(dict.fromkeys(name for one in experiments for name in one.trials["agent"]))
    for name in focus:
        if name not in known:
            raise unknown("focus", name, known)
    names = listed([one.experiment.name for one in experiments])
    return {
        "title": listed(list(focus) or known),
        "headline": f"Learning over trials in {names}.",
    }


def _of_experiment(result: ExperimentResult, focus: Sequence[str]) -> dict[str, Any]:
    """Return what the report shows of an experiment."""
    return {
        "experiment": result.experiment,
        "table": tables.experiment_table(result, focus),
        "source": _picture(result.plot()),
    }


def _of_benchmark(results: Results, format: Format) -> dict[str, Any]:
    """Return what the report shows of a benchmark."""
    shown: dict[str, Any] = {
        "results": results,
        "title": listed(results.focus),
        "headline": _headline(results),
        "ranking": tables.ranking_table(results),
        "scenarios": [tables.scenario_table(results, agent) for agent in results.focus],
        "generalisation": tables.generalisation_table(results),
        "given": tables.given_table(results),
        "failures": tables.failure_table(results),
        "tables": {key: tables.score_table(results, key) for key in results.environments},
        "not_played": reasons(results.manifest.not_played),
    }
    if format == "html":
        shown |= {"replay": replay(results), "learning": _learning_curves(results)}
        if shown["generalisation"]:
            from mmc_gym.report.curves import draw_generalisation  # takes long

            shown["strengths"] = _picture(draw_generalisation(results))
    return shown


def _headline(results: Results) -> str:
    """Return how good the agents in focus are, in a sentence for each."""
    success, said = MEASURES["success"], []
    for row in results.ranking.to_dict("records"):
        if row["agent"] in results.focus:
            interval = success.interval(row["success_low"], row["success_high"])
            share = f"{success.quantity(row['success'])} of its episodes {interval}".rstrip()
            rank = f"rank {row['rank']} of {len(results.ranking)}"
            said.append(f"{row['agent']} ends at the target in {share}, {rank}.")
    return " ".join(said)


def _learning_curves(results: Results) -> str | None:
    """Return a picture of the learning curves of all agents.

    There is none if no agent in focus has a curve, or if the seeds of no agent overlap.
    """
    if not any(results.identities[agent].cards for agent in results.focus):
        return None
    from mmc_gym.report.curves import curve_rows, draw_learning_curves, mean_curves

    cards = {agent: results.identities[agent].cards for agent in results.agents}
    curves = curve_rows({agent: found for agent, found in cards.items() if found})
    by_steps, by_time = mean_curves(curves, "steps"), mean_curves(curves, "cpu_seconds")
    if by_steps.empty or by_time.empty:
        return None
    return _picture(draw_learning_curves(by_steps, by_time))


def _picture(figure: Figure) -> str:
    """Return a figure as an address that holds its SVG."""
    from matplotlib import rc_context

    from mmc_gym._plotting import STYLE

    buffer = io.BytesIO()
    with rc_context({**STYLE, "text.parse_math": False}):  # users choose the names of agents
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    return f"data:image/svg+xml;base64,{base64.b64encode(buffer.getvalue()).decode()}"
