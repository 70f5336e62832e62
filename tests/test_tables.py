"""One table, on a console, as HTML and as Markdown."""

import io

import pytest
from rich.console import Console

from mmc_gym._tables import (
    Cell,
    Heading,
    Row,
    Table,
    estimate_cell,
    print_table,
    text_table,
    to_html,
    to_markdown,
)

TABLE = Table(
    headings=(Heading("agent"), *(Heading(f"success {n}", "%", "more is better") for n in "abc")),
    rows=(
        Row("<b>|me", (Cell("97.5", ("[90, 99]",), best=True), Cell("–"), Cell("1")), look="focus"),
        Row("other", (Cell("50.0"), Cell("7", links=(("random", 3),)), Cell("2")), note="a note"),
    ),
    caption="Means.",
)


def printed(table, width):
    console = Console(file=io.StringIO(), width=width)
    print_table(console, table)
    return console.file.getvalue()


def test_html_escapes_names_and_has_units_notes_links_and_the_best():
    html = to_html(TABLE)
    assert "&lt;b&gt;|me" in html and "<b>" not in html
    assert '<span class="unit">[%]</span><span class="way">more is better</span>' in html
    assert '<strong>97.5</strong><div class="note">[90, 99]</div>' in html
    assert 'data-scenario="random" data-instance="3">3</button>' in html
    assert "<thead>" not in to_html(text_table([("one", "two\nlines")]))


def test_markdown_has_a_line_for_each_row_and_no_markup_in_names():
    head, rule, *rows, _, caption = to_markdown(TABLE).splitlines()
    assert head == "| agent | success a, % | success b, % | success c, % |"
    assert rule == "| --- | --- | --- | --- |"
    assert rows[0] == r"| **&lt;b&gt;\|me** | 97.5 \[90, 99\] | – | 1 |"
    assert (rows[1], caption) == ("| other: a note | 50.0 | 7 3 | 2 |", "Means.")


@pytest.mark.parametrize("width", [120, 26])
def test_columns_of_a_console_that_do_not_fit_follow_below_with_the_names_again(width):
    lines = printed(TABLE, width).splitlines()
    assert max(map(len, lines)) <= width and lines[-1].strip() == "Means."
    assert sum("a note" in line for line in lines) == (1 if width == 120 else 3)
    assert sum("[90, 99]" in line for line in lines) == 1


def test_texts_alone_are_broken_but_for_their_names():
    lines = printed(text_table([("a long name", "word " * 20)], ("what", "is")), 40).splitlines()
    assert lines[0].split() == ["what", "is"] and lines[1].startswith("a long name  word")
    assert max(map(len, lines)) <= 40 and len(lines) == 5


@pytest.mark.parametrize(("estimate", "text"), [(0.5, "0.50"), (12.345, "12.3"), (1234.5, "1234")])
def test_an_estimate_has_three_digits_and_how_many_have_a_value(estimate, text):
    cell = estimate_cell({"estimate": estimate, "low": 0, "high": 1, "count": 9, "missing": 1}, 2)
    assert (cell.text, cell.notes[1]) == (text, "9 of 10")


def test_degrees_are_spelt_out_where_the_console_has_no_such_sign():
    table = Table((Heading("a"), Heading("turn", "°")), (Row("b 30°", (Cell("1°/s"),)),))
    shown = printed(table, 60)
    assert shown.isascii() and "[deg]" in shown
    assert "b 30 deg" in shown and "1 deg/s" in shown
