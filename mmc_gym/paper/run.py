"""Running experiments of the paper and writing all they find into one folder.

    OUT/table.md, table.html        the report: published beside measured
    OUT/EXPERIMENT/*.png, *.svg     figures
    OUT/EXPERIMENT/*.npz, *.csv     the data behind them
    OUT/EXPERIMENT/result.json      rows, captions and points, of which the report is made
    OUT/networks/*.npz              trained networks, from which an interrupted run goes on

The report covers every experiment whose result is in the folder and was made with the same
settings, so that experiments may be run one by one.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from mmc_gym._console import make_console
from mmc_gym._files import write_atomically
from mmc_gym.paper.catalogue import EXPERIMENTS
from mmc_gym.paper.experiment import Experiment, Result, Row, Settings, write_result
from mmc_gym.paper.experiment import Progress as Report
from mmc_gym.paper.report import Section, print_report, to_html, to_markdown


def reproduce(
    names: Sequence[str] = (),
    folder: Path = Path("runs/reproduce"),
    quick: bool = False,
    seed: int = 0,
    jobs: int | None = None,
) -> list[Section]:
    """Run experiments, write figures, data and report, and print the report.

    Args:
        names: of experiments; all of them if there are none.
        folder: where to write.
        quick: run a small part of each experiment, to see that everything works.
        seed: of everything random, not negative.
        jobs: number of processes for long work; by default one per core.

    Returns:
        The sections of the report.

    Raises:
        ValueError: for a name that is no experiment's, before anything is run.
    """
    for name in names:
        if name not in EXPERIMENTS:
            raise ValueError(f"experiment must be one of {', '.join(EXPERIMENTS)}, got {name!r}")
    settings = Settings(quick, seed, folder, (os.cpu_count() or 1) if jobs is None else jobs)
    errors = Console(stderr=True)
    for name, experiment in EXPERIMENTS.items():  # in the catalogue's order, each once
        if not names or name in names:
            run_experiment(experiment, settings, errors)
    sections = read_sections(settings)
    write_atomically(folder / "table.md", to_markdown(sections, quick))
    write_atomically(folder / "table.html", to_html(sections, quick, folder))
    print_report(make_console(), sections, quick)
    return sections


def run_experiment(experiment: Experiment, settings: Settings, console: Console) -> Result:
    """Run one experiment, with a progress bar, and write what it finds."""
    folder = (settings.folder or Path()) / experiment.name
    # Written again last: where it is, everything else is, and is of the same run.
    (folder / "result.json").unlink(missing_ok=True)
    start = time.perf_counter()
    with _progress_bar(experiment.name, console) as report:
        result = experiment.run(settings, report)
    write_result(result, folder)
    content = {
        "settings": _identity(settings),
        "rows": [asdict(row) for row in result.rows],
        "captions": {stem: result.captions.get(stem, stem) for stem in result.figures},
        "points": {str(number): text for number, text in result.points.items()},
    }
    text = json.dumps(content, indent=1, ensure_ascii=False, default=float)
    write_atomically(folder / "result.json", text + "\n")
    console.print(f"{experiment.name}: {time.perf_counter() - start:.1f} s, in {folder}")
    return result


def read_sections(settings: Settings) -> list[Section]:
    """The sections of all experiments whose result with these settings is in the folder."""
    sections = []
    for name, experiment in EXPERIMENTS.items():
        path = (settings.folder or Path()) / name / "result.json"
        content: dict[str, Any] = json.loads(path.read_text("utf-8")) if path.exists() else {}
        if content.get("settings") == _identity(settings):
            sections.append(
                Section(
                    name,
                    experiment.description,
                    tuple(Row(**row) for row in content["rows"]),
                    content["captions"],
                    {int(number): text for number, text in content["points"].items()},
                )
            )
    return sections


def _identity(settings: Settings) -> dict[str, Any]:
    """The settings that a result depends on."""
    return {"quick": settings.quick, "seed": settings.seed}


@contextmanager
def _progress_bar(name: str, console: Console) -> Iterator[Report]:
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task(name, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)
