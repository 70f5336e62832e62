"""One table, on a console, as HTML and as Markdown; figures of movements."""

import io

import matplotlib.figure
import numpy as np
import pytest
from rich.console import Console

import mmc_gym
from mmc_gym._plotting import PlottedMovement, paths_and_profiles
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
from mmc_gym.network import MMCNetwork

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


def test_an_episode_says_what_it_is(env):
    (episode,) = mmc_gym.run_episodes(mmc_gym.make_agent("mmc", env), env, [5])
    assert repr(episode) == "<Episode of seed 5, 100 steps, 0.000 from the target at the end>"


def test_the_movement_of_a_network_can_be_drawn():
    network = MMCNetwork()
    start = network.state_from_joint_angles([0.3, 0.6, 0.6])
    way = network.trajectory(start, network.inverse([-1.0, 1.5]), 60)
    figure = way.plot()
    (axes,) = figure.axes
    lines = [line.get_xydata() for line in axes.lines]
    np.testing.assert_allclose(lines[0][1:], np.cumsum(way.segments[0], axis=0))
    assert any(len(line) == 60 and np.allclose(line, way.segments.sum(axis=1)) for line in lines)
    assert any(np.array_equal(line, [[-1.0, 1.5]]) for line in lines)
    assert figure._repr_png_().startswith(b"\x89PNG")
    # Of many networks the first four are drawn, on given axes.
    targets = np.random.default_rng(0).uniform(-1, 1, (2, 3, 2))
    axes = matplotlib.figure.Figure().add_subplot()
    figure = network.trajectory(start, network.inverse(targets), 5).plot(axes)
    assert figure is axes.figure
    crosses = [line.get_xydata()[0] for line in axes.lines if line.get_marker() == "+"]
    np.testing.assert_array_equal(crosses, targets.reshape(-1, 2)[:4])


def draw(names):
    """Draw three movements of each agent, each faster than the one before."""
    times = 0.02 * np.arange(101)
    speeds = [factor * np.sin(np.linspace(0, np.pi, 100)) for factor in (1, 2, 3)]
    hands = [np.stack([times * number, 0 * times], axis=-1) for number in (1, 2, 3)]
    movements = [*map(PlottedMovement, hands, np.ones((3, 2)), speeds)]
    agents = dict.fromkeys(names, movements)
    return movements, paths_and_profiles(agents, reach=3.0, tolerance=0.05, control_step=0.02)


def test_paths_differ_without_colour_and_the_profile_is_their_median_speed():
    movements, figure = draw(["oracle", "frozen"])
    above, _, below, _ = figure.axes
    paths = [line for line in above.lines if len(line.get_xdata()) > 1]
    assert len({line.get_linestyle() for line in paths}) == 3
    assert [text.get_text() for text in above.texts] == ["1", "2", "3"]
    assert np.array_equal(paths[0].get_xydata(), movements[0].hands)
    (line,) = below.lines
    assert line.get_xdata() == pytest.approx(0.01 + 0.02 * np.arange(100))
    assert line.get_ydata() == pytest.approx(movements[1].speeds)


def test_at_most_six_agents_are_side_by_side_at_one_scale():
    names = [f"agent {number}" for number in range(10)]
    _, figure = draw(names)
    assert figure.get_figwidth() * 150 < 1400
    shown = [axes for axes in figure.axes if axes.axison]
    above = [axes for axes in shown if axes.get_title()]
    assert [axes.get_title() for axes in above] == names
    tops = [axes.get_position().y0 for axes in above]
    assert tops[:5] == pytest.approx([tops[0]] * 5) and max(tops[5:]) < min(tops[:5])
    assert len({axes.get_ylim() for axes in shown if not axes.get_title()}) == 1
