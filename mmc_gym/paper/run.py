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

import base64
import json
import os
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from html import escape
from pathlib import Path
from types import MappingProxyType
from typing import Any

from rich.console import Console
from rich.padding import Padding
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from mmc_gym._console import make_console
from mmc_gym._files import write_atomically
from mmc_gym.paper.experiment import Experiment, Result, Row, Settings, format_value, write_result
from mmc_gym.paper.experiment import Progress as Report
from mmc_gym.paper.experiments import (
    accurate,
    bell_shaped,
    dynamic,
    example,
    forward_and_mixed,
    kinematic,
    normalization,
    population,
)
from mmc_gym.paper.published import POINTS

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
_COLUMNS = ("quantity", "paper", "its data", "ours", "note")
_POINT_COLUMNS = ("", "subject", "paper", "its data", "ours")
_SHARES = {"": 1, "subject": 8, "quantity": 12, "paper": 8, "its data": 8, "ours": 8, "note": 10}
_PLAIN = str.maketrans(
    {"±": "+-", "×": "x", "°": " deg", "–": "-", "−": "-", "“": '"', "”": '"', "≤": "<="}
)
_STYLESHEET = """
body { font: 15px/1.45 system-ui, sans-serif; max-width: 72rem; margin: 2rem auto; padding: 0 1rem }
table { border-collapse: collapse; margin: 1rem 0 } img { max-width: 100% }
th, td { border-bottom: 1px solid #ccc; padding: .25rem .6rem; text-align: left;
         vertical-align: top; font-variant-numeric: tabular-nums }
th:nth-child(3), th:nth-child(4) { min-width: 9.5rem }
@media (min-width: 60rem) { th:first-child:not(:empty) { min-width: 18rem } }
.table { overflow-x: auto } .table table { min-width: 42rem }
figure { margin: 1.5rem 0 } figcaption { color: #555 }
"""


@dataclass(frozen=True)
class Section:
    """What the report shows of one experiment.

    Attributes:
        name: the experiment's, and its folder's.
        description: one line.
        rows: of the table.
        captions: of the figures, by file stem.
        points: what was measured on a point of `POINTS`, by its number.
    """

    name: str
    description: str
    rows: tuple[Row, ...]
    captions: dict[str, str]
    points: dict[int, str]


def to_markdown(sections: Sequence[Section], quick: bool) -> str:
    """The report as Markdown; figures are linked as `experiment/figure.png`."""
    parts = [f"# {TITLE}", PAPER, *([f"**{QUICK}**"] if quick else []), LEGEND]
    for section in sections:
        parts.append(f"## {section.name}: {section.description}")
        parts.append(_markdown_table(_COLUMNS, map(_cells, section.rows)))
        for stem, caption in section.captions.items():
            parts.append(f"![{caption}]({section.name}/{stem}.png)\n\n*{caption}*")
    parts.append("## Where the paper and its data part")
    parts.append(_markdown_table(_POINT_COLUMNS, _points(sections)))
    return "\n\n".join(parts) + "\n"


def to_html(sections: Sequence[Section], quick: bool, folder: Path) -> str:
    """The report as one HTML file that needs no other: figures are read from `folder`."""
    parts = [f"<h1>{escape(TITLE)}</h1>", f"<p>{escape(PAPER)}</p>"]
    parts += [f"<p><strong>{escape(QUICK)}</strong></p>"] if quick else []
    parts.append(f"<p>{escape(LEGEND)}</p>")
    for section in sections:
        parts.append(f"<h2>{escape(section.name)}: {escape(section.description)}</h2>")
        parts.append(_html_table(_COLUMNS, map(_cells, section.rows)))
        for stem, caption in section.captions.items():
            image = base64.b64encode((folder / section.name / f"{stem}.png").read_bytes())
            parts.append(
                f'<figure><img src="data:image/png;base64,{image.decode()}" alt="{escape(stem)}">'
                f"<figcaption>{escape(caption)}</figcaption></figure>"
            )
    parts.append("<h2>Where the paper and its data part</h2>")
    parts.append(_html_table(_POINT_COLUMNS, _points(sections)))
    body = "\n".join(parts)
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(TITLE)}</title><style>{_STYLESHEET}</style></head>\n"
        f"<body>\n{body}\n</body></html>\n"
    )


def print_report(console: Console, sections: Sequence[Section], quick: bool) -> None:
    """Print the tables; in plain signs where the console's encoding lacks the others."""
    plain = not console.encoding.lower().startswith("utf")
    for section in sections:
        title = f"{section.name}: {section.description}"
        console.print(_terminal_table(title, _COLUMNS, map(_cells, section.rows), plain))
    title = "where the paper and its data part"
    console.print(_terminal_table(title, _POINT_COLUMNS, _points(sections), plain))
    console.print(_text(f"{QUICK} {LEGEND}" if quick else LEGEND, plain))


def _cells(row: Row) -> tuple[str, ...]:
    quantity = f"{row.quantity} [{row.unit}]" if row.unit else row.quantity
    return (quantity, *map(format_value, (row.paper, row.data, row.ours)), row.note)


def _points(sections: Sequence[Section]) -> list[tuple[str, ...]]:
    """The rows of the points; what several experiments say of one is joined."""
    rows: list[tuple[str, ...]] = []
    for number, point in POINTS.items():
        found = [section.points[number] for section in sections if number in section.points]
        ours = "; ".join(found) or "not measured in this run"
        rows.append((str(number), point.subject, point.paper, point.data, ours))
    return rows


def _markdown_table(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [columns, ["---"] * len(columns)]
    lines += [[cell.replace("|", "\\|").replace("\n", " ") for cell in row] for row in rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _html_table(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    head = "".join(f"<th>{escape(column)}</th>" for column in columns)
    body = "\n".join(
        f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in rows
    )
    return (
        f'<div class="table"><table><thead><tr>{head}</tr></thead>\n'
        f"<tbody>\n{body}\n</tbody></table></div>"
    )


def _terminal_table(
    title: str, columns: Sequence[str], rows: Iterable[Sequence[str]], plain: bool
) -> Padding:
    table = Table(
        box=None,
        expand=True,
        padding=(0, 2, 0, 0),
        pad_edge=False,
        header_style="bold",
        title=_text(title, plain),
        title_justify="left",
    )
    for column in columns:
        # A share of the width each: else long notes would leave the quantities a word a line.
        table.add_column(column, overflow="fold", vertical="top", ratio=_SHARES[column])
    for row in rows:
        table.add_row(*(_text(cell, plain) for cell in row))
    return Padding(table, (1, 0))


def _text(content: str, plain: bool) -> Text:
    if plain:
        content = content.translate(_PLAIN).encode("ascii", "replace").decode()
    return Text(content)


_EXPERIMENTS: tuple[Experiment, ...] = (
    normalization.EXPERIMENT,
    population.EXPERIMENT,
    accurate.EXPERIMENT,
    kinematic.EXPERIMENT,
    dynamic.EXPERIMENT,
    example.EXPERIMENT,
    bell_shaped.EXPERIMENT,
    forward_and_mixed.EXPERIMENT,
)

EXPERIMENTS: Mapping[str, Experiment] = MappingProxyType({e.name: e for e in _EXPERIMENTS})
"""Experiments by name."""


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
