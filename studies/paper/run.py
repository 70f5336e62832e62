"""Run experiments of the paper, and write all they find into one folder.

    OUT/table.md, table.html        the report: published beside measured
    OUT/EXPERIMENT/*.png, *.svg     figures
    OUT/EXPERIMENT/*.npz, *.csv     the data behind them
    OUT/EXPERIMENT/result.json      rows, captions and points, of which the report is made
    OUT/networks/*.npz              trained networks, from which an interrupted run goes on

The report covers every experiment whose result in the folder has the same settings, so that
experiments may be run one by one.  A damaged result, or one of another version, is made anew.
"""

from __future__ import annotations

import base64
import json
import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import NamedTuple

from jinja2 import Environment, PackageLoader, StrictUndefined
from pydantic import TypeAdapter
from rich.console import Console
from rich.progress import Progress
from rich.text import Text

from mmc_gym._console import encodable, make_console, print_shares, progress_bar
from mmc_gym._errors import unknown
from mmc_gym._files import check_folder, write_atomically
from studies.paper.experiment import Result, Row, Settings, format_value, write_result
from studies.paper.experiments import (
    bettered,
    forward_and_mixed,
    movements,
    normalization,
    population,
)
from studies.paper.published import POINTS

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


class Experiment(NamedTuple):
    """A description in one line, and a function that writes nothing but under `settings.folder`."""

    description: str
    run: Callable[[Settings], Result]


EXPERIMENTS: Mapping[str, Experiment] = {
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
"""Experiments by name on the command line, which is that of their folder too."""

# Columns of the tables, and their shares of a terminal's width.
_COLUMNS = {"quantity": 12, "paper": 8, "its data": 8, "ours": 8, "note": 10}
_POINT_COLUMNS = {"": 1, "subject": 8, "paper": 8, "its data": 8, "ours": 8}


@dataclass(frozen=True)
class Identity:
    """Settings that a result depends on, and version of the package."""

    quick: bool
    seed: int
    version: str = "unknown"


@dataclass(frozen=True)
class Section:
    """The report's section on an experiment, as `result.json` holds it.

    Attributes:
        settings: what the result depends on.
        rows: lines of the table.
        captions: captions of the figures, by file stem.
        points: findings by number of a point of `POINTS`.
    """

    settings: Identity
    rows: tuple[Row, ...]
    captions: dict[str, str]
    points: dict[int, str]


_SECTION = TypeAdapter(Section)


class StaleResult(Exception):
    """A result must be made anew; the message names the file and says why."""


def reproduce(
    names: Sequence[str] = (),
    folder: Path | str = Path("runs/reproduce"),
    quick: bool = False,
    seed: int = 0,
    jobs: int | None = None,
) -> dict[str, Section]:
    """Run experiments, write figures, data and report, and print the report.

    Args:
        names: names of experiments; all of them if there are none.
        folder: takes all that is written.
        quick: run a small part of each experiment, to see that everything works.
        seed: seed of everything random, not negative.
        jobs: number of processes for long work; by default one per core.

    Returns:
        The sections of the report, by experiment.

    Raises:
        UserError: for a wrong argument, before anything is run.
    """
    for name in names:
        if name not in EXPERIMENTS:
            raise unknown("experiment", name, EXPERIMENTS)
    folder = check_folder(folder, "out")
    sections = {}
    with progress_bar() as bar:
        settings = Settings(
            quick=quick,
            seed=seed,
            folder=folder,
            jobs=(os.cpu_count() or 1) if jobs is None else jobs,
            on_note=lambda line: bar.console.print(Text(line), soft_wrap=True),
        )
        for name in EXPERIMENTS:  # in this order, each once
            anew = not names or name in names
            if not anew:
                try:
                    section = read_section(folder / name, settings)
                except StaleResult as reason:
                    settings.on_note(f"{reason} and is made anew")
                    anew = True
            if anew:
                section = run_experiment(name, folder / name, settings, bar)
            if section:
                sections[name] = section
    write_atomically(folder / "table.md", to_markdown(sections, quick))
    write_atomically(folder / "table.html", to_html(sections, quick, folder))
    print_report(make_console(), sections, quick)
    return sections


def run_experiment(name: str, folder: Path, settings: Settings, bar: Progress) -> Section:
    """Run one experiment, with a progress bar, and write its result into `folder`."""
    path = folder / "result.json"
    # Written again last: where it is, everything else is, and is of the same run.
    path.unlink(missing_ok=True)
    start = time.perf_counter()
    task = bar.add_task(name, total=None)

    def report(done: int, total: int) -> None:
        bar.update(task, completed=done, total=total)

    result = EXPERIMENTS[name].run(replace(settings, on_progress=report))
    bar.remove_task(task)
    write_result(result, folder)
    section = Section(
        settings=_identity(settings),
        rows=tuple(result.rows),
        captions={stem: figure.caption for stem, figure in result.figures.items()},
        points=dict(result.points),
    )
    text = json.dumps(asdict(section), indent=1, ensure_ascii=False, default=float)
    write_atomically(path, text + "\n")
    settings.on_note(f"{name}: {time.perf_counter() - start:.1f} s, in {folder}")
    return section


def read_section(folder: Path, settings: Settings) -> Section | None:
    """Return the result in `folder`; None if there is none, or only one with other settings.

    Raises:
        StaleResult: if it is damaged, or of another version of the package.
    """
    path, wanted = folder / "result.json", _identity(settings)
    if not path.exists():
        return None
    try:
        section = _SECTION.validate_json(path.read_bytes())
    except (OSError, ValueError):  # pydantic's errors are ValueErrors
        raise StaleResult(f"{path} is damaged") from None
    version = section.settings.version
    if replace(section.settings, version=wanted.version) != wanted:
        return None
    if version != wanted.version:
        raise StaleResult(f"{path} was made by version {version}")
    for stem in section.captions:
        if not (folder / f"{stem}.png").exists():
            raise StaleResult(f"{folder / stem}.png is missing")
    return section


def _identity(settings: Settings) -> Identity:
    return Identity(settings.quick, settings.seed, settings.version)


class _Part(NamedTuple):
    """A table of the report, and the captions of the figures below it, by file stem."""

    heading: str
    columns: Mapping[str, int]
    rows: Sequence[Sequence[str]]
    folder: str
    captions: Mapping[str, str]


def _parts(sections: Mapping[str, Section]) -> list[_Part]:
    parts = []
    for name, section in sections.items():
        heading = f"{name}: {EXPERIMENTS[name].description}"
        rows = [_cells(row) for row in section.rows]
        parts.append(_Part(heading, _COLUMNS, rows, name, section.captions))
    rows = []
    for number, point in POINTS.items():
        found = [s.points[number] for s in sections.values() if number in s.points]
        ours = "; ".join(found) or "not measured in this run"
        rows.append((str(number), point.subject, point.paper, point.data, ours))
    return [*parts, _Part("Where the paper and its data part", _POINT_COLUMNS, rows, "", {})]


def _cells(row: Row) -> tuple[str, ...]:
    quantity = f"{row.quantity} [{row.unit}]" if row.unit else row.quantity
    return (quantity, *map(format_value, (row.paper, row.data, row.ours)), row.note)


def to_markdown(sections: Mapping[str, Section], quick: bool) -> str:
    """Return the report as Markdown; figures are linked as `experiment/figure.png`."""
    blocks = [f"# {TITLE}", PAPER, *([f"**{QUICK}**"] if quick else []), LEGEND]
    for part in _parts(sections):
        lines = [[*part.columns], ["---" for _ in part.columns]]
        lines += [
            [cell.replace("|", "\\|").replace("\n", " ") for cell in row] for row in part.rows
        ]
        table = "\n".join(f"| {' | '.join(line)} |" for line in lines)
        blocks += [f"## {part.heading}", table]
        for stem, caption in part.captions.items():
            blocks.append(f"![{caption}]({part.folder}/{stem}.png)\n\n*{caption}*")
    return "\n\n".join(blocks) + "\n"


def to_html(sections: Mapping[str, Section], quick: bool, folder: Path) -> str:
    """Return the report as one HTML file that needs no other: figures are read from `folder`."""

    def image(part: _Part, stem: str) -> str:
        return base64.b64encode((folder / part.folder / f"{stem}.png").read_bytes()).decode()

    templates = Environment(
        loader=PackageLoader("studies.paper"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    return templates.get_template("table.html.j2").render(
        title=TITLE,
        paper=PAPER,
        quick=QUICK if quick else "",
        legend=LEGEND,
        parts=_parts(sections),
        image=image,
    )


def print_report(console: Console, sections: Mapping[str, Section], quick: bool) -> None:
    """Print the tables; in plain signs where the console's encoding lacks the others."""
    for heading, columns, rows, *_ in _parts(sections):
        print_shares(console, heading[0].lower() + heading[1:], columns, rows)
    console.print(encodable(console, f"{QUICK} {LEGEND}" if quick else LEGEND))
