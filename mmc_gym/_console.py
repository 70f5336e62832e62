"""Write to the terminal: numbers, tables and progress bars."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.padding import Padding
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table
from rich.text import Text

WIDTH = 120  # columns, without a terminal and without COLUMNS
_NARROWEST = 40  # columns; fewer, such as COLUMNS=0, would leave out columns of tables
_GAP = 2
_NAME_WIDTH = 16  # of a column's heading; longer ones continue on the next line
_ASCII = str.maketrans(
    {"µ": "u", "²": "2", "½": "1/2", "–": "-", "−": "-", "×": "x", "±": "+-", "≤": "<="}
    | {"°": " deg", "“": '"', "”": '"'}
)


def make_console(*, stderr: bool = False) -> Console:
    """Return an output, as wide as the terminal or COLUMNS says, 120 columns otherwise."""
    console = Console(stderr=stderr)
    has_width = console.is_terminal or os.environ.get("COLUMNS", "").isdigit()
    fits = has_width and console.width >= _NARROWEST
    return console if fits else Console(stderr=stderr, width=WIDTH)


def progress_bar(*, auto_refresh: bool = True) -> Progress:
    """Return a bar on stderr: task, progress, elapsed and remaining time; none without a terminal.

    With `auto_refresh` a thread draws, ten times a second; without it no thread disturbs timings.
    """
    console = make_console(stderr=True)
    return Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
        transient=True,
        auto_refresh=auto_refresh,
        disable=not console.is_terminal,
    )


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


def cell(row: Mapping[Any, Any], decimals: int) -> str:
    """Return a statistic, its interval below, and the number of episodes with a value, if not all.

    A row has estimate, low, high, count, missing.  There are fewer `decimals` if three digits are
    reached without them.

    >>> print(cell(dict(estimate=0.5, low=0.4, high=0.61, count=9, missing=1), 2))
    0.50
    [0.40, 0.61]
    9 of 10
    """
    decimals = _three_digits(row["estimate"], decimals)
    lines = [number(row["estimate"], decimals), interval(row["low"], row["high"], decimals)]
    if row["missing"]:
        lines.append(f"{row['count']} of {row['count'] + row['missing']}")
    return "\n".join(line for line in lines if line)


def _three_digits(estimate: float, at_most: int) -> int:
    if not math.isfinite(estimate) or abs(estimate) <= 1:
        return at_most
    digits_before_point = int(math.log10(abs(estimate))) + 1
    return max(0, min(at_most, 3 - digits_before_point))


def print_list(
    console: Console, rows: Iterable[Sequence[str]], headings: Sequence[str] = ()
) -> None:
    """Print rows of text, as wide as the console, without breaking the first text of a row."""
    table = _table()
    table.show_header = bool(headings)
    for number, row in enumerate(rows):
        for column, heading in enumerate(headings or row) if number == 0 else ():
            table.add_column(heading, no_wrap=column == 0, overflow="fold")
        table.add_row(*(Text(_encodable(console, content)) for content in row))
    console.print(table)


def print_columns(
    console: Console,
    labels: Mapping[str, Sequence[str]],
    columns: Mapping[str, Sequence[str]],
    note: str,
) -> None:
    """Print columns of text and columns of numbers, and below `note`, how to read them.

    The `labels`, texts of the rows by heading, are aligned at the left; `columns`, numbers of the
    rows by heading, at the right.  Columns that do not fit side by side continue in a further
    table, where the labels are repeated.
    """
    widths = {
        name: max(_width(cells), min(_width([name]), _NAME_WIDTH))
        for name, cells in columns.items()
    }
    taken = sum(max(_width(cells), len(heading)) for heading, cells in labels.items())
    room = console.width - taken - _GAP * (len(labels) - 1)
    for names in _side_by_side(widths, room):
        table = _table()
        for heading in labels:
            table.add_column(heading, no_wrap=True)
        for name in names:
            table.add_column(
                text_for(console, name),
                justify="right",
                overflow="fold",
                width=widths[name],
                vertical="top",
            )
        for row in zip(*labels.values(), *(columns[name] for name in names), strict=True):
            table.add_row(*(text_for(console, content) for content in row))
        console.print(Padding(table, (1, 0)))
    console.print(text_for(console, note))


def print_written(console: Console, paths: Iterable[Path]) -> None:
    """Print the written files, an unbroken line each, so that they can be copied."""
    for path in paths:
        name = str(path).encode(console.encoding, "replace").decode(console.encoding)
        console.print(f"wrote {name}", highlight=False, markup=False, soft_wrap=True)


def text_for(console: Console, content: str) -> Text:
    """Return a text for the console, with all lines but the first dimmed."""
    first, line_break, rest = _encodable(console, content).partition("\n")
    return Text.assemble(first, line_break, (rest, "dim"))


def _encodable(console: Console, content: str) -> str:
    """Return a text, in plain ASCII if the console is no terminal or its encoding lacks signs."""
    if console.is_terminal and console.encoding.lower().startswith("utf"):
        return content
    return content.translate(_ASCII).encode("ascii", "replace").decode()


def _table() -> Table:
    return Table(box=None, padding=(0, _GAP, 0, 0), pad_edge=False, header_style="bold")


def _side_by_side(widths: Mapping[str, int], room: int) -> Iterator[list[str]]:
    """Group the names whose columns fit into `room`, at least one in each group."""
    group: list[str] = []
    used = 0
    for name, width in widths.items():
        if group and used + _GAP + width > room:
            yield group
            group, used = [], 0
        group.append(name)
        used += _GAP + width
    yield group


def _width(texts: Sequence[str]) -> int:
    return max(len(line) for text in texts for line in text.splitlines() or [""])
