"""Write to the terminal: consoles, texts in their encoding, and progress bars."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from pathlib import Path

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.text import Text

WIDTH = 120  # columns, without a terminal and without COLUMNS
_NARROWEST = 40  # columns; fewer, such as COLUMNS=0, would leave out columns of tables
_ASCII = str.maketrans(
    {"µ": "u", "²": "2", "½": "1/2", "–": "-", "−": "-", "×": "x", "±": "+-", "≤": "<="}
    | {"°": "deg", "“": '"', "”": '"'}
)


def make_console(*, stderr: bool = False) -> Console:
    """Return a console as wide as the terminal or COLUMNS; `WIDTH` if neither, or too narrow."""
    console = Console(stderr=stderr)
    has_width = console.is_terminal or os.environ.get("COLUMNS", "").isdigit()
    is_wide_enough = has_width and console.width >= _NARROWEST
    return console if is_wide_enough else Console(stderr=stderr, width=WIDTH)


def progress_bar() -> Progress:
    """Return a progress bar with task, count and times on stderr; hidden without a terminal."""
    console = make_console(stderr=True)
    return Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    )


def print_written(console: Console, paths: Iterable[Path]) -> None:
    """Print the paths of written files, one unbroken line each, so that they can be copied."""
    for path in paths:
        name = str(path).encode(console.encoding, "replace").decode(console.encoding)
        console.print(f"wrote {name}", highlight=False, markup=False, soft_wrap=True)


def text_for(console: Console, text: str, *notes: str) -> Text:
    """Return a text for the console, with notes below it, dimmed."""
    below = ((f"\n{encodable(console, note)}", "dim") for note in notes)
    return Text.assemble(encodable(console, text), *below)


def encodable(console: Console, content: str) -> str:
    """Return a text, in plain ASCII unless the console is a terminal with a UTF encoding."""
    if console.is_terminal and console.encoding.lower().startswith("utf"):
        return content
    content = re.sub(r"(?<=\d)°", " deg", content)
    return content.translate(_ASCII).encode("ascii", "replace").decode()
