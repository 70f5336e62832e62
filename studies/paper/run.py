"""Run experiments of the paper, and write their results into one folder.

OUT/table.md                    the report: published and measured values
OUT/EXPERIMENT/*.png, *.svg     figures
OUT/EXPERIMENT/*.npz, *.csv     the data behind them
OUT/networks/*.npz              trained networks; an interrupted run resumes from them
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Literal, NamedTuple, TypeAlias

from rich.console import Console
from rich.table import Table
from rich.text import Text
from tyro.conf import Positional

from studies.paper.experiment import (
    ExperimentSettings,
    Result,
    ResultRow,
    format_value,
    write_result,
)
from studies.paper.experiments import (
    bettered,
    forward_and_mixed,
    movements,
    normalization,
    population,
)
from studies.paper.published import POINTS
from studies.tables import markdown_table

TITLE = "The paper's experiments, published and measured"
PAPER = (
    "M. Schilling: Setup of a Recurrent Neural Network as a Body Model for Solving Inverse and "
    "Forward Kinematics as well as Dynamics for a Redundant Manipulator."
)
LEGEND = (
    "“paper” is what the text says, “its data” what the data published with it give, “ours” what "
    "was measured here; ± is the standard deviation."
)
QUICK = "This is a quick run: a small part of each experiment, to see that everything works."

Name: TypeAlias = Literal[
    "normalization",
    "population",
    "accurate",
    "kinematic",
    "dynamic",
    "example",
    "bell-shaped",
    "forward-and-mixed",
]


class Experiment(NamedTuple):
    """A description in one line, and a function that writes into `settings.folder` only."""

    description: str
    run: Callable[[ExperimentSettings], Result]


EXPERIMENTS: Mapping[Name, Experiment] = {
    "normalization": Experiment(
        "errors of twelve normalization networks, five runs each", normalization.run
    ),
    "population": Experiment(
        "hidden units of the normalization networks as a population code", population.run
    ),
    "accurate": Experiment(
        "bettered: a normalization network that hardly turns a vector", bettered.accurate
    ),
    "kinematic": Experiment(
        "420 movements of the kinematic network with every normalizer", movements.kinematic
    ),
    "dynamic": Experiment(
        "420 movements of the dynamic network: rules, decays, schedules, normalizers",
        movements.dynamic,
    ),
    "example": Experiment("the example movement, kinematic and dynamic", movements.example),
    "bell-shaped": Experiment(
        "bettered: a time base makes each movement bell-shaped", bettered.bell_shaped
    ),
    "forward-and-mixed": Experiment(
        "forward and mixed tasks with the network of the inverse tasks", forward_and_mixed.run
    ),
}
"""Experiments by name on the command line, which also names their folder."""

# Columns of the tables, and their relative widths in a terminal.
_COLUMNS = {"quantity": 12, "paper": 8, "its data": 8, "ours": 8, "note": 10}
_POINT_COLUMNS = {"": 1, "subject": 8, "paper": 8, "its data": 8, "ours": 8}


def reproduce(
    experiments: Positional[Sequence[Name]] = (),
    out: Path = Path("runs/paper"),
    quick: bool = False,
    seed: int = 0,
    jobs: int | None = None,
) -> dict[Name, Result]:
    """Run the paper's experiments; write figures, data, and a table with the published values.

    Args:
        experiments: Names of experiments (default: all).
        out: Folder for figures, data and table; networks in it are not trained again.
        quick: Run a small part of each experiment, to see that everything works.
        seed: Seed of everything random.
        jobs: Number of processes that train networks (default: one per core).

    Returns:
        The result of each experiment.
    """
    settings = ExperimentSettings(quick, seed, out, jobs or os.cpu_count() or 1)
    results, console = {}, Console(width=None if sys.stdout.isatty() else 120, highlight=False)
    for name in EXPERIMENTS:  # in this order, each once
        if not experiments or name in experiments:
            start = time.perf_counter()
            results[name] = EXPERIMENTS[name].run(settings)
            write_result(results[name], out / name)
            console.print(f"{name}: {time.perf_counter() - start:.1f} s, in {out / name}")
    (out / "table.md").write_text(to_markdown(results, quick), encoding="utf-8")
    for heading, columns, rows, _ in _parts(results):
        table = Table(title=heading, title_justify="left", box=None, expand=True)
        for column, share in columns.items():
            table.add_column(column, ratio=share, overflow="fold")
        for row in rows:
            table.add_row(*map(Text, row))  # Text: rich would take units in brackets for markup
        console.print(table)
    console.print(f"{QUICK} {LEGEND}" if quick else LEGEND)
    return results


class _Part(NamedTuple):
    """A table of the report, and the captions of the figures below it, by file."""

    heading: str
    columns: Mapping[str, int]
    rows: Sequence[Sequence[str]]
    captions: Mapping[str, str]


def _parts(results: Mapping[Name, Result]) -> Iterator[_Part]:
    for name, result in results.items():
        heading = f"{name}: {EXPERIMENTS[name].description}"
        captions = {f"{name}/{stem}.png": shown.caption for stem, shown in result.figures.items()}
        yield _Part(heading, _COLUMNS, [_cells(row) for row in result.rows], captions)
    rows = []
    for number, point in POINTS.items():
        findings = [result.points[number] for result in results.values() if number in result.points]
        ours = "; ".join(findings) or "not measured in this run"
        rows.append((str(number), point.subject, point.paper, point.data, ours))
    yield _Part("Where the paper and its data part", _POINT_COLUMNS, rows, {})


def _cells(row: ResultRow) -> tuple[str, ...]:
    quantity = f"{row.quantity} [{row.unit}]" if row.unit else row.quantity
    return (quantity, *map(format_value, (row.paper, row.data, row.ours)), row.note)


def to_markdown(results: Mapping[Name, Result], quick: bool) -> str:
    """Return the report as Markdown; figures are linked as `experiment/figure.png`."""
    blocks = [f"# {TITLE}", PAPER, *([f"**{QUICK}**"] if quick else []), LEGEND]
    for part in _parts(results):
        blocks += [f"## {part.heading}", markdown_table(part.columns, part.rows)]
        blocks += [f"![{text}]({file})\n\n*{text}*" for file, text in part.captions.items()]
    return "\n\n".join(blocks) + "\n"
