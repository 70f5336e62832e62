"""Figures: style and files, hand paths, speed profiles and postures."""

from __future__ import annotations

import io
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from mmc_gym._files import write_atomically

Floats = NDArray[np.float64]

EXAMPLES = 4  # paths shown per agent
IN_A_ROW = 6  # agents
POSTURES = 16  # of a network, at most
LINES = ("-", "--", "-.", (0, (1, 1)))  # so that paths differ without colour, too
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#7f3b8c")  # by Okabe and Ito, for the colour-blind
STYLE: Any = {
    "font.size": 8,
    "axes.titlesize": 9,
    "legend.fontsize": 7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "svg.fonttype": "none",  # text stays text
    "svg.hashsalt": "mmc-gym",  # the same figure gives the same file
}
PLAIN_STYLE: Any = {**STYLE, "text.parse_math": False}  # for names of agents, which users choose


class PlottedMovement(NamedTuple):
    """One movement, as figures draw it."""

    hands: Floats  #: positions of the hand or cursor, segment lengths, (steps + 1, 2)
    target: Floats  #: its position, segment lengths, (2,)
    speeds: Floats  #: of the hand in each step, segment lengths/s, (steps,)


def save_figure(figure: Figure, stem: Path) -> list[Path]:
    """Write `figure` as `stem`.png and `stem`.svg."""
    return [
        write_atomically(stem.with_suffix(f".{format}"), draw_file(figure, format))
        for format in ("png", "svg")
    ]


def draw_file(figure: Figure, format: str, dpi: float = 150, style: Any = STYLE) -> bytes:
    """Return the content of a figure's file, the same for the same figure."""
    buffer = io.BytesIO()
    metadata = {"Date": None} if format == "svg" else {}
    with rc_context(style):
        figure.savefig(buffer, format=format, dpi=dpi, metadata=metadata)
    return buffer.getvalue()


class ShownFigure(Figure):
    """A figure that a notebook shows without pyplot; width and height are in inches."""

    def __init__(self, width: float, height: float) -> None:
        super().__init__(figsize=(width, height), layout="constrained")
        FigureCanvasAgg(self)

    def _repr_png_(self) -> bytes:
        return draw_file(self, "png", dpi=100)


def paths_and_profiles(
    movements: Mapping[str, Sequence[PlottedMovement]],
    reach: float,
    tolerance: float,
    control_step: float,
    figure: Figure | None = None,
) -> Figure:
    """Draw the hand paths of each agent and, below, the speed profile of all its movements.

    Args:
        movements: of each agent, by its heading; `IN_A_ROW` in a row.
        reach: radius of the disc that the hand can reach, segment lengths.
        tolerance: distance from the target that counts as success, segment lengths.
        control_step: seconds.
        figure: to draw on; a new one if None, that can be read at a width of 800 pixels.
    """
    rows = -(-len(movements) // IN_A_ROW)
    columns = -(-len(movements) // rows)
    side = min(max(5.0 / columns, 1.45), 2.5)  # inches
    with rc_context(STYLE):
        figure = figure or ShownFigure(max(columns * side, 5.0), rows * (side + 1.8) + 0.6)
        axes = figure.subplots(
            2 * rows, columns, squeeze=False, sharey="row", height_ratios=(side, 1.1) * rows
        )
        pairs = np.moveaxis(axes.reshape(rows, 2, columns), 1, 0).reshape(2, -1)
        for above, below in pairs[:, len(movements) :].T:
            above.axis("off")
            below.axis("off")
        drawn = pairs[:, : len(movements)].T
        for (above, below), (name, each) in zip(drawn, movements.items(), strict=True):
            above.set_title(textwrap.fill(name, 16))
            draw_paths(above, each, reach, tolerance)
            draw_speed(below, each, control_step)
        top = max(below.get_ylim()[1] for _, below in drawn)
        for above, below in axes.reshape(rows, 2, columns)[:, :, 0]:
            above.set_ylabel("[segment lengths]")
            below.set_ylabel("hand speed\n[segment lengths/s]")
            below.set_ylim(0, top)
        axes[1, 0].legend(frameon=False, loc="upper right")
        count = len(next(iter(movements.values())))
        caption = (
            f"Above: hand paths in episodes 1 to {min(count, EXAMPLES)}, from the open circle to "
            "the dot; the cross is the target, the ring around it the distance that counts as "
            f"success; dotted: reach. Below: hand speed, median and quartiles over {count} "
            "episodes (starts and targets, the same for all agents; not training seeds: one "
            "training run each)."
        )
        caption = textwrap.fill(caption, round(17 * figure.get_figwidth()))
        figure.supxlabel(caption, fontsize=7, linespacing=1.4)
    return figure


def draw_paths(
    axes: Axes, movements: Sequence[PlottedMovement], reach: float, tolerance: float
) -> None:
    """Draw the hand paths of the first `EXAMPLES` movements, with their targets and the reach."""
    halo = [withStroke(linewidth=2, foreground="white")]
    axes.add_patch(Circle((0, 0), reach, fill=False, color="0.6", linestyle=":", linewidth=0.8))
    for number, (hands, (x, y), _) in enumerate(movements[:EXAMPLES]):
        colour = COLOURS[number]
        axes.plot(*hands.T, color=colour, linestyle=LINES[number], linewidth=1.1)
        axes.plot(x, y, "+", color="black", markersize=8, markeredgewidth=0.6)
        axes.add_patch(Circle((x, y), tolerance, fill=False, linewidth=0.8))
        axes.plot(*hands[0], "o", color=colour, markersize=5, markerfacecolor="white")
        axes.plot(*hands[-1], "o", color=colour, markersize=2.5)
        style: Any = {"color": colour, "path_effects": halo, "zorder": 5}
        axes.annotate(str(number + 1), (x, y), (5, 4), textcoords="offset points", **style)
    border = 1.05 * reach
    axes.set(xlim=(-border, border), ylim=(-border, border), aspect="equal")


def plot_postures(nodes: NDArray[Any], ends: NDArray[Any], axes: Axes | None = None) -> Figure:
    """Draw successive postures of the first `EXAMPLES` arms, later ones darker.

    Nodes are base, joints and hand in each posture, (postures, arms, N + 1, 2); ends are the arms'
    targets, (arms, 2).  Without `axes` there is a new figure.
    """
    count = len(nodes)
    # Show more of the early postures: the first steps are the largest.
    shown = np.unique(np.geomspace(1, count, min(count, POSTURES)).round().astype(int)) - 1
    with rc_context(STYLE):
        axes = axes or ShownFigure(3.6, 3.6).add_subplot()
        arms = zip(nodes.swapaxes(0, 1)[:EXAMPLES], ends, COLOURS, strict=False)
        for postures, (x, y), colour in arms:
            for place, posture in enumerate(postures[shown], start=1):
                share = place / len(shown)
                axes.plot(*posture.T, color=colour, linewidth=0.6 + 1.4 * share, alpha=share**2)
            axes.plot(*postures[-1].T, "o", color=colour, markersize=3, markerfacecolor="white")
            axes.plot(*postures[:, -1].T, ".-", color="0.4", linewidth=0.7, markersize=2, zorder=3)
            axes.plot(x, y, "+", color="black", markersize=9, markeredgewidth=0.8, zorder=4)
        axes.plot(0, 0, "s", color="0.4", markersize=5)
        axes.set(xlabel="x [segment lengths]", ylabel="y [segment lengths]", aspect="equal")
    whole = axes.get_figure(root=True)
    assert whole is not None
    return whole


def draw_speed(axes: Axes, movements: Sequence[PlottedMovement], control_step: float) -> None:
    """Draw the median and the quartiles over all movements of the speed in each step."""
    longest = max(len(movement.speeds) for movement in movements)
    padded = np.full((len(movements), longest), np.nan)
    for row, movement in zip(padded, movements, strict=True):
        row[: len(movement.speeds)] = movement.speeds  # NaNs drop out of the quartiles
    low, median, high = np.nanpercentile(padded, (25, 50, 75), axis=0)
    # A difference quotient is the speed in the middle of its step.
    times = (np.arange(len(median)) + 0.5) * control_step
    axes.fill_between(times, low, high, color="0.8", linewidth=0, label="quartiles")
    axes.plot(times, median, color="black", linewidth=1.2, label="median")
    axes.set_xlabel("time [s]")
