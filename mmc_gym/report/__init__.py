"""The report of a benchmark: one HTML file with tables, figures and a replay.

The file needs nothing beside it.  No result is written here: every number is computed from the
benchmark's store.
"""

from __future__ import annotations

from importlib.metadata import version
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from mmc_gym._errors import UserError, require
from mmc_gym._files import write_atomically
from mmc_gym.benchmark.statistics import RESAMPLES
from mmc_gym.benchmark.store import reasons
from mmc_gym.report import figures, tables
from mmc_gym.report.replay import replay
from mmc_gym.report.results import Results, count, read_results

__all__ = ["write_report"]


def write_report(store: Path | str, out: Path | str, resamples: int = RESAMPLES) -> Path:
    """Write the report of a benchmark, and return its file.

    Args:
        store: folder of the benchmark.
        out: the HTML file.
        resamples: number for the ranking's intervals; the other tables use at most 500.

    Raises:
        UserError: if there is no store, it is damaged or has no episodes, or `out` is a folder.
    """
    for name, path in (("store", store), ("out", out)):
        require(isinstance(path, str | Path), name, path, "a path")
    out = Path(out)
    if out.is_dir():
        raise UserError(f"out must be a file, got the folder {str(out)!r}")
    return write_atomically(out, _render(read_results(Path(store), resamples), resamples))


def _render(results: Results, resamples: int) -> str:
    """Return the report as HTML."""
    pages = Environment(
        loader=PackageLoader("mmc_gym.report"),
        autoescape=True,  # users choose the names of agents
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    pages.policies["json.dumps_kwargs"] = {"separators": (",", ":")}
    of_scores = min(resamples, tables.SCORE_RESAMPLES)
    shown: dict[str, Any] = {
        "results": results,
        "manifest": results.manifest,
        "policies": results.episodes[["agent", "training_seed"]].drop_duplicates(),
        "count": count,
        "ranking": tables.ranking_table(results),
        "heat": tables.heat_table(results),
        "given": tables.given_table(results),
        "replay": replay(results),
        "movements": figures.movements(results),
        "laws": tables.law_table(results),
        "learning": figures.learning(results),
        "tables": {
            key: tables.score_table(results, key, of_scores) for key in results.environments
        },
        "not_played": reasons(results.manifest.not_played),
        "resamples": resamples,
        "score_resamples": of_scores,
        "version": version("mmc-gym"),
    }
    return pages.get_template("report.html.j2").render(shown)
