"""Tables on the terminal and in Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from rich.table import Table


def table_of(rows: Sequence[Mapping[str, str]], title: str | None = None) -> Table:
    """Return a table with a row for each mapping, headed by its keys; the first column is text."""
    table = Table(title=title, title_justify="left")
    for number, heading in enumerate(rows[0]):
        table.add_column(heading, justify="right" if number else "left", no_wrap=not number)
    for row in rows:
        table.add_row(*row.values())
    return table


def markdown_table(headings: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """Return a table in Markdown; a line break within a cell becomes a space."""
    heads = list(headings)
    texts = [[text.replace("|", "\\|").replace("\n", " ") for text in row] for row in rows]
    lines = [heads, ["---"] * len(heads), *texts]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
