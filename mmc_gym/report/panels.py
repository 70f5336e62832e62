"""Panels: small pictures that a phone shows one below the other.

Every agent has one look throughout the report.  Looks differ in line style and marker as well as
in colour, and lines are named where they end.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import cycle
from typing import Any, NamedTuple

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from mmc_gym._plotting import STYLE

_ID = re.compile(r'\bid="([^"]+)"')
_REFERENCE = re.compile(r'(url\(#|href="#)([^")]+)')
_DROPPED = re.compile(r"<metadata>.*?</metadata>|<style[^>]*>.*?</style>|<!--.*?-->", re.DOTALL)
_NUMBER = re.compile(r"(?<=[ \"(,])(-?\d+\.\d{2})\d+")
_FONT = re.compile(r"font: (?:[a-z0-9 ]*?)([\d.]+)px [^;\"]*")


def to_svg(figure: Figure, key: str) -> str:
    """Return the figure as an `svg` element, all ids of which begin with `key`."""
    buffer = io.StringIO()
    with rc_context({**STYLE, "svg.hashsalt": key}):
        figure.savefig(buffer, format="svg", metadata={"Date": None}, transparent=True)
    text = buffer.getvalue()
    text = _DROPPED.sub("", text[text.index("<svg") :])
    used = {name for _, name in _REFERENCE.findall(text)}
    text = _ID.sub(lambda m: f'id="{key}-{m[1]}"' if m[1] in used else "", text)
    text = _REFERENCE.sub(lambda m: f"{m[1]}{key}-{m[2]}", text)
    text = _FONT.sub(lambda m: f"font-size: {m[1]}px", _NUMBER.sub(r"\1", text))
    return re.sub(r"\n\s*", "\n", text).strip()


WIDTH, HEIGHT = 3.5, 2.7  # inches; about the width of a phone
_LABEL_GAP = 0.075  # of the height of the axes, between two names
_NAMES = 1.06  # where they begin, of the width of the axes

_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#7f3b8c", "#a06a00", "#1b1b1b", "#56a0d3")
_LINES: tuple[Any, ...] = ("-", "--", "-.", (0, (1, 1)), (0, (5, 1, 1, 1, 1, 1)), (0, (8, 2)), "-")
_MARKERS = "osD^vPX"


class Look(NamedTuple):
    """How an agent is drawn."""

    colour: str
    line: Any
    marker: str


class Panel(NamedTuple):
    """A picture: its title, what it shows for those who do not see it, and the `svg` element."""

    title: str
    description: str
    svg: str


class Curve(NamedTuple):
    """A line, and the band of its interval."""

    x: ArrayLike
    y: ArrayLike
    low: ArrayLike
    high: ArrayLike


class PanelFigure(NamedTuple):
    """A figure of the report: panels, and the caption of all of them."""

    panels: tuple[Panel, ...]
    caption: str


def looks(agents: Sequence[str]) -> dict[str, Look]:
    """Return the look of each of the agents that figures show."""
    return dict(zip(agents, cycle(map(Look, _COLOURS, _LINES, _MARKERS))))


def shortened(name: str, length: int = 15) -> str:
    """Return a name that fits into a figure."""
    return name if len(name) <= length else f"{name[: length - 1]}…"


@contextmanager
def drawn(width: float = WIDTH, height: float = HEIGHT) -> Iterator[tuple[Figure, Axes]]:
    """Give a figure with one pair of axes, in the style of all figures."""
    with rc_context({**STYLE, "text.parse_math": False, "font.size": 8.5}):
        figure = Figure(figsize=(width, height), layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.subplots()
        axes.tick_params(length=3, width=0.6)
        yield figure, axes


def line_panel(
    key: str,
    title: str,
    description: str,
    curves: Mapping[str, Curve],
    look: Mapping[str, Look],
    finish: Callable[[Axes], None],
    markers: bool = True,
    connected: bool = True,
) -> Panel:
    """Draw a line for each agent, named at its end, on a band of its interval.

    Args:
        key: unique in the page.
        title: see `Panel`.
        description: see `Panel`.
        curves: by agent.
        look: of each agent.
        finish: sets limits, scales and labels of the axes.
        markers: whether to mark every point; else some are.
        connected: whether to connect the points; not if there is nothing between them.
    """
    with drawn() as (figure, axes):
        for number, (agent, curve) in enumerate(curves.items()):
            own = look[agent]
            if connected:
                band = (curve.x, curve.low, curve.high)
                axes.fill_between(*band, color=own.colour, alpha=0.14, linewidth=0)
            axes.plot(
                curve.x,
                curve.y,
                color=own.colour,
                linestyle=own.line if connected else "",
                linewidth=1.4,
                marker=own.marker,
                markersize=4,
                markerfacecolor="white",
                markevery=1 if markers else (0.02 * number, 0.2),
            )
        finish(axes)
        name_lines(axes, {agent: (one.x, one.y) for agent, one in curves.items()}, look)
    return Panel(title, description, to_svg(figure, key))


def name_lines(
    axes: Axes, lines: Mapping[str, tuple[ArrayLike, ArrayLike]], look: Mapping[str, Look]
) -> None:
    """Write each line's name to the right of its end, apart from the others."""
    ends = {}
    for agent, (x, y) in lines.items():
        known = np.flatnonzero(~np.isnan(np.asarray(y, dtype=np.float64)))
        if known.size:
            last = int(known[-1])
            point = (float(np.asarray(x)[last]), float(np.asarray(y)[last]))
            inside = axes.transAxes.inverted().transform(axes.transData.transform(point))
            ends[agent] = (float(np.clip(inside[0], 0, 1)), float(np.clip(inside[1], 0, 1)))
    order = sorted(ends, key=lambda agent: ends[agent][1])
    heights = spread([ends[agent][1] for agent in order], _LABEL_GAP)
    for agent, height in zip(order, heights, strict=True):
        colour, (x, y) = look[agent].colour, ends[agent]
        # An annotation's arrow would take as long as all the rest of the figure.
        axes.text(
            _NAMES,
            height,
            shortened(agent),
            va="center",
            fontsize=8,
            color=colour,
            transform=axes.transAxes,
        )
        axes.plot(
            (x, _NAMES - 0.01),
            (y, height),
            color=colour,
            linewidth=0.5,
            transform=axes.transAxes,
            clip_on=False,
            scalex=False,
            scaley=False,
        )


def spread(positions: Sequence[float], gap: float) -> list[float]:
    """Return ascending positions, moved apart by at least `gap` and as little as possible.

    Example:
        >>> [round(p, 2) for p in spread([0.0, 0.5, 0.5], 0.1)]
        [0.0, 0.45, 0.55]
    """
    groups: list[list[float]] = []  # [middle, number]
    for position in positions:
        groups.append([position, 1])
        while len(groups) > 1:
            (low, below), (high, above) = groups[-2:]
            if high - low >= gap * (below + above) / 2 - 1e-12:
                break
            groups[-2:] = [[(low * below + high * above) / (below + above), below + above]]
    return [
        middle + gap * (place - (number - 1) / 2)
        for middle, number in groups
        for place in range(int(number))
    ]
