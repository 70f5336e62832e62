"""Tables as values, written to a console, as HTML or as Markdown; and how numbers are written."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from html import escape
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

if TYPE_CHECKING:
    from rich.console import Console

_GAP = 2  # between columns of a console
_NAME_WIDTH = 16  # of a column's heading; longer ones continue on the next line


class Heading(NamedTuple):
    """The heading of a column: label, unit, and which values are better."""

    label: str
    unit: str = ""
    better: str = ""
    is_text: bool = False  #: aligned at the left, as the first column is; numbers at the right


class Cell(NamedTuple):
    """A cell: its text, notes in small print, whether it is the best, its CSS class, and links.

    A link is a scenario and the number of an episode that the report's replay shows.
    """

    text: str
    notes: tuple[str, ...] = ()
    best: bool = False
    look: str = ""
    links: tuple[tuple[str, int], ...] = ()

    @classmethod
    def of(cls, text: str, *notes: str, best: bool = False, look: str = "") -> Cell:
        """Make a cell without the empty ones of its notes."""
        return cls(text, tuple(filter(None, notes)), best, look)


NONE = Cell("–")


class Row(NamedTuple):
    """A row: its name in the first column, the other cells, a note on the name, a CSS class."""

    name: str
    cells: tuple[Cell, ...]
    note: str = ""
    look: str = ""


class Table(NamedTuple):
    """A table: headings (or none), rows, a caption, its title, and its CSS class."""

    headings: tuple[Heading, ...]
    rows: tuple[Row, ...]
    caption: str = ""
    title: str = ""
    look: str = ""


def text_table(rows: Iterable[Sequence[str]], headings: Sequence[str] = ()) -> Table:
    """Return a table of texts; the first of a row is its name."""
    return Table(
        headings=tuple(Heading(label, is_text=True) for label in headings),
        rows=tuple(Row(name, tuple(map(Cell, texts))) for name, *texts in rows),
    )


def to_html(table: Table) -> str:
    """Return a table as HTML, without its caption."""
    headings = "".join(map(_html_heading, table.headings))
    head = f"<thead><tr>{headings}</tr></thead>\n" if headings else ""
    rows = "\n".join(map(_html_row, table.rows))
    return f"<table{_css_class(table.look)}>\n{head}<tbody>\n{rows}\n</tbody>\n</table>"


def _html_heading(heading: Heading) -> str:
    unit = f' <span class="unit">[{escape(heading.unit)}]</span>' if heading.unit else ""
    better = f'<span class="way">{escape(heading.better)}</span>' if heading.better else ""
    label = _html_text(heading.label)
    return f'<th scope="col"><div class="heading">{label}{unit}{better}</div></th>'


def _html_row(row: Row) -> str:
    name = _html_cell(Cell.of(row.name, row.note))
    cells = "".join(f"<td{_css_class(cell.look)}>{_html_cell(cell)}</td>" for cell in row.cells)
    return f'<tr{_css_class(row.look)}><th scope="row">{name}</th>{cells}</tr>'


def _html_cell(cell: Cell) -> str:
    text = f"<strong>{_html_text(cell.text)}</strong>" if cell.best else _html_text(cell.text)
    notes = (re.sub("`(.+?)`", r"<code>\1</code>", escape(note)) for note in cell.notes)
    below = "".join(f'<div class="note">{note}</div>' for note in notes)
    links = "".join(
        f'<button type="button" class="show" data-scenario="{escape(name)}" '
        f'data-instance="{number}">{number}</button>'
        for name, number in cell.links
    )
    return f"{text}{below}{links}"


def _html_text(text: str) -> str:
    return escape(text).replace("\n", "<br>")


def _css_class(name: str) -> str:
    return f' class="{name}"' if name else ""


def to_markdown(table: Table) -> str:
    """Return a table as Markdown, with its caption below; names of rows "focus" are bold."""
    heads = [
        ", ".join(filter(None, [plain(heading.label), heading.unit])) for heading in table.headings
    ]
    lines = [heads, ["---"] * len(heads)]
    for row in table.rows:
        name = f"**{plain(row.name)}**" if row.look == "focus" else plain(row.name)
        note = f": {plain(row.note)}" if row.note else ""
        lines.append([name + note, *map(_markdown_cell, row.cells)])
    caption = ["", plain(table.caption)] if table.caption else []
    return "\n".join([*(f"| {' | '.join(line)} |" for line in lines), *caption])


def _markdown_cell(cell: Cell) -> str:
    links = ", ".join(str(number) for _, number in cell.links)
    return " ".join(filter(None, [plain(cell.text), *map(plain, cell.notes), links]))


def plain(text: str) -> str:
    """Return a text for Markdown, in which names of agents are no markup."""
    return re.sub(r"([\\|*_`\[\]])", r"\\\1", escape(text, quote=False))


def print_table(console: Console, table: Table) -> None:
    """Print a table, and its caption below.

    Columns of numbers that do not fit side by side continue in a further table, where those of text
    are repeated.  A table of texts alone is as wide as the console, and breaks all but their names.
    """
    from rich.padding import Padding
    from rich.table import Table as Shown

    from mmc_gym._console import encodable, text_for

    texts, numbers = _columns(table, partial(encodable, console))
    for group in _side_by_side(console.width, texts, numbers):
        shown = Shown(box=None, padding=(0, _GAP, 0, 0), pad_edge=False, header_style="bold")
        shown.show_header = bool(table.headings)
        for place, column in enumerate(texts):
            is_fixed = place == 0 or bool(numbers)
            shown.add_column(text_for(console, *column[0]), no_wrap=is_fixed, overflow="fold")
        right: Any = {"justify": "right", "overflow": "fold", "vertical": "top"}
        for column in group:
            shown.add_column(text_for(console, *column[0]), **right, width=_width(column))
        for cells in list(zip(*texts, *group, strict=True))[1:]:
            shown.add_row(*(text_for(console, *lines) for lines in cells))
        console.print(Padding(shown, (1, 0)) if numbers else shown)
    if table.caption:
        console.print(text_for(console, table.caption))


_Column: TypeAlias = list[tuple[str, ...]]
"""A heading and cells, each a text and its notes."""


def _columns(table: Table, written: Callable[[str], str]) -> tuple[list[_Column], list[_Column]]:
    """Return the columns of text, and those of numbers, as they are written."""
    rows = [(Cell.of(row.name, row.note), *row.cells) for row in table.rows]
    columns = list(zip(*rows, strict=True))
    headings = table.headings or (Heading("", is_text=True),) * len(columns)
    texts: list[_Column] = []
    numbers: list[_Column] = []
    for place, (heading, cells) in enumerate(zip(headings, columns, strict=True)):
        first = Cell.of(heading.label, f"[{heading.unit}]" if heading.unit else "")
        column = [tuple(map(written, (cell.text, *cell.notes))) for cell in (first, *cells)]
        (texts if place == 0 or heading.is_text else numbers).append(column)
    return texts, numbers


def _width(column: _Column) -> int:
    """Return the width of the widest cell, or of the heading if that is wider and not long."""
    heading, *cells = (max(map(len, "\n".join(lines).split("\n"))) for lines in column)
    return max([*cells, min(heading, _NAME_WIDTH)])


def _side_by_side(
    width: int, texts: Sequence[_Column], numbers: Sequence[_Column]
) -> Iterator[list[_Column]]:
    """Group the columns of numbers that fit next to those of text, at least one in each group."""
    taken = sum(_width(column) + _GAP for column in texts) - _GAP
    group: list[_Column] = []
    used = taken
    for column in numbers:
        if group and used + _GAP + _width(column) > width:
            yield group
            group, used = [], taken
        group.append(column)
        used += _GAP + _width(column)
    yield group


def number(value: float, decimals: int) -> str:
    """Return a number with a true minus sign; "–" for NaN; "<0.01" if it would be rounded to 0.

    >>> number(0.75, 1), number(-0.25, 2), number(-0.001, 2), number(0.001, 2)
    ('0.8', '−0.25', '0.00', '<0.01')
    >>> number(float("nan"), 2)
    '–'
    """
    if not math.isfinite(value):
        return "–"
    text = _digits(value, decimals)
    is_hidden = value > 0 and float(f"{value:.{decimals}f}") == 0
    return f"<{_digits(10.0**-decimals, decimals)}" if is_hidden else text


def count(number_of: int, noun: str) -> str:
    """Return a number and its noun.

    >>> count(1, "seed"), count(1200, "seed")
    ('1 seed', '1,200 seeds')
    """
    return f"{number_of:,} {noun}{'' if number_of == 1 else 's'}"


def interval(low: float, high: float, decimals: int) -> str:
    """Return the ends of an interval in brackets, or "" if it has none.

    >>> interval(0.9, 1.0, 2), interval(float("nan"), float("nan"), 2)
    ('[0.90, 1.00]', '')
    """
    if not math.isfinite(low):
        return ""
    return f"[{_digits(low, decimals)}, {_digits(high, decimals)}]"


def _digits(value: float, decimals: int) -> str:
    text = f"{value:.{decimals}f}"
    return text.removeprefix("-") if float(text) == 0 else text.replace("-", "−")


def estimate_cell(row: Mapping[Any, Any], decimals: int) -> Cell:
    """Return a statistic, its interval, and the number of episodes with a value, if not all.

    A row has estimate, low, high, count, missing.  There are fewer `decimals` if three digits are
    reached without them.

    >>> estimate_cell(dict(estimate=0.5, low=0.4, high=0.61, count=9, missing=1), 2)[:2]
    ('0.50', ('[0.40, 0.61]', '9 of 10'))
    """
    size = abs(row["estimate"])
    if 1 < size < math.inf:
        digits_before_point = int(math.log10(size)) + 1
        decimals = max(0, min(decimals, 3 - digits_before_point))
    part = f"{row['count']} of {row['count'] + row['missing']}" if row["missing"] else ""
    return Cell.of(
        number(row["estimate"], decimals), interval(row["low"], row["high"], decimals), part
    )
