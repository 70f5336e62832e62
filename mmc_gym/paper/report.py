"""The report of a reproduction: published beside measured, as Markdown, HTML, and on a terminal.

It is made of sections, one for each experiment, and of the points on which the paper's text and
its data part.  All three forms are of the same tables.
"""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

from rich.console import Console
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from mmc_gym.paper.experiment import Row, format_value
from mmc_gym.paper.points import POINTS

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
