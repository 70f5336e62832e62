"""The table of a comparison: a row for each measure, a column for each agent.

Measures are the rows because there will be more of them than agents.  Where the agents do not
fit side by side, they continue in a further table below.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import pandas as pd
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

from mmc_gym.measures.catalogue import Measure

WIDTH = 120  # columns, where there is no terminal to ask
_GAP = 2
_AGENT_WIDTH = 16  # of a name; longer ones continue on the next line
_ASCII = str.maketrans({"µ": "u", "²": "2", "–": "-", "−": "-"})


def make_console() -> Console:
    """Standard output, as wide as the terminal, or 120 columns where there is none."""
    console = Console()
    return console if console.is_terminal else Console(width=WIDTH)


def print_table(
    console: Console,
    summary: pd.DataFrame,
    measures: Sequence[Measure],
    training_steps: Mapping[str, int | None],
    note: str,
) -> None:
    """Print what `summarize` returned, and `note` below it.

    Plain ASCII where the console is no terminal, or has an encoding that lacks the signs.

    Args:
        console: where to.
        summary: columns agent, measure, estimate, low, high, count, missing.
        measures: the rows, in this order.
        training_steps: environment steps spent in training each agent, None if unknown; the
            columns, in this order.
        note: what must be known to read the numbers.
    """
    headings = [f"{m.label}\n[{m.unit}]" if m.unit else m.label for m in measures]
    headings.append("training\n[env steps]")
    best = ["" if m.best == "neither" else m.best for m in measures] + [""]
    rows = {(row["agent"], row["measure"]): row for row in summary.to_dict("records")}
    columns = {
        agent: [
            *(cell(rows[agent, measure.name], measure.decimals) for measure in measures),
            "unknown" if steps is None else f"{steps:,}",
        ]
        for agent, steps in training_steps.items()
    }
    print_columns(console, {"": headings, "best": best}, columns, note)


def print_columns(
    console: Console,
    labels: Mapping[str, Sequence[str]],
    columns: Mapping[str, Sequence[str]],
    note: str,
) -> None:
    """Print a column of cells for each agent, and `note` below them.

    Plain ASCII where the console is no terminal, or has an encoding that lacks the signs.

    Args:
        console: where to.
        labels: what the rows are called, repeated where the agents continue in a further table:
            cells by the heading of their column.
        columns: the agents' cells; as many for each as there are labels.
        note: what must be known to read the numbers.
    """
    plain = not console.is_terminal or not console.encoding.lower().startswith("utf")
    widths = {
        agent: max(_width(cells), min(len(agent), _AGENT_WIDTH)) for agent, cells in columns.items()
    }
    taken = sum(max(_width(cells), len(heading)) for heading, cells in labels.items())
    room = console.width - taken - _GAP * (len(labels) - 1)
    for agents in _side_by_side(widths, room):
        table = Table(box=None, padding=(0, _GAP, 0, 0), pad_edge=False, header_style="bold")
        for heading in labels:
            table.add_column(heading, no_wrap=True)
        for agent in agents:
            table.add_column(
                _text(agent, plain),
                justify="right",
                overflow="fold",
                width=widths[agent],
                vertical="top",
            )
        for row in zip(*labels.values(), *(columns[agent] for agent in agents), strict=True):
            table.add_row(*(_text(content, plain) for content in row))
        console.print(Padding(table, (1, 0)))
    console.print(_text(note, plain))


def cell(row: Mapping[Any, Any], decimals: int) -> str:
    """Statistic, interval below, and below that how many episodes it is about, if not all.

    Example:
        >>> print(cell(dict(estimate=0.5, low=0.4, high=0.61, count=9, missing=1), 2))
        0.50
        [0.40, 0.61]
        9 of 10
    """
    estimate, low, high = row["estimate"], row["low"], row["high"]
    decimals = _decimals(estimate, decimals)
    lines = ["-" if math.isnan(estimate) else f"{estimate:.{decimals}f}"]
    if 0 < estimate < 0.5 * 10**-decimals:
        lines = [f"<{10**-decimals:.{decimals}f}"]  # small, but not nothing
    if not math.isnan(low):
        lines.append(f"[{low:.{decimals}f}, {high:.{decimals}f}]")
    if row["missing"]:
        lines.append(f"{row['count']} of {row['count'] + row['missing']}")
    return "\n".join(lines)


def _decimals(estimate: float, at_most: int) -> int:
    """No more decimals than make three digits: nobody reads the fifth."""
    if not math.isfinite(estimate) or abs(estimate) <= 1:
        return at_most
    digits_before_point = int(math.log10(abs(estimate))) + 1
    return max(0, min(at_most, 3 - digits_before_point))


def _side_by_side(widths: Mapping[str, int], room: int) -> Iterator[list[str]]:
    """Groups of agents whose columns fit into `room`, at least one in each."""
    group: list[str] = []
    used = 0
    for agent, width in widths.items():
        if group and used + _GAP + width > room:
            yield group
            group, used = [], 0
        group.append(agent)
        used += _GAP + width
    yield group


def _width(texts: Sequence[str]) -> int:
    return max(len(line) for text in texts for line in text.splitlines() or [""])


def _text(content: str, plain: bool) -> Text:
    """The first line as it is, the others dimmed: they are about the first."""
    if plain:
        content = content.translate(_ASCII).encode("ascii", "replace").decode()
    first, line_break, rest = content.partition("\n")
    return Text.assemble(first, line_break, (rest, "dim"))


def progress_bar() -> Progress:
    """A bar on stderr: what, how far, since when, until when."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    return Progress(*columns, console=Console(stderr=True))
