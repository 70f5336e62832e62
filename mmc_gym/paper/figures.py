"""Figures of movements, and what the figures of all experiments share.

A function that draws is decorated with `styled`; its panels come from `make_panels`, the look of
a curve from `look`, and the legend of all panels from `add_legend`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mmc_gym._plotting import COLOURS, LINES, STYLE
from mmc_gym.network.chain import Floats, node_positions
from mmc_gym.paper.protocol import Recording

DISTANCE = "distance [of start to target]"
VELOCITY = "velocity [of start to target / iteration]"

styled = rc_context(STYLE)


def make_panels(
    count: int, width: float, height: float, columns: int | None = None, **shared: Any
) -> tuple[Figure, list[Axes]]:
    """Return a figure, in inches, and its panels, side by side or in so many columns."""
    figure = Figure(figsize=(width, height), layout="constrained")
    columns = columns or count
    panels = figure.subplots(-(-count // columns), columns, squeeze=False, **shared).ravel()
    for unused in panels[count:]:
        unused.remove()
    return figure, list(panels[:count])


def look(number: int) -> dict[str, Any]:
    """Return colour and line of a curve, by its number from 0."""
    return {"color": COLOURS[number % len(COLOURS)], "linestyle": LINES[number % len(LINES)]}


def add_legend(figure: Figure, axes: Axes, title: str | None = None) -> None:
    """Add a legend above the panels, of the curves in `axes`."""
    handles, labels = axes.get_legend_handles_labels()
    columns = 1 if figure.get_figwidth() < 5 else 2 if len(labels) > 3 else 3
    figure.legend(
        handles, labels, title=title, frameon=False, ncols=columns, loc="outside upper center"
    )


@styled
def draw_courses(panels: Mapping[str, Mapping[str, Floats]]) -> Figure:
    """Draw mean and standard deviation over the iterations, a panel for each quantity.

    Args:
        panels: courses by the label of the vertical axis and by name, (movements, iterations).
    """
    figure, row = make_panels(len(panels), 3.7 * len(panels) + 0.5, 3.6)
    for axes, (label, courses) in zip(row, panels.items(), strict=True):
        for number, (name, course) in enumerate(courses.items()):
            _draw_course(axes, name, course, number)
        axes.set(xlabel="iteration", ylabel=label, ylim=(0, None))
    add_legend(figure, row[0], title="mean (thick) ± standard deviation (thin)")
    return figure


def _draw_course(axes: Axes, name: str, course: Floats, number: int) -> None:
    iterations = np.arange(1, course.shape[1] + 1)
    mean, deviation = course.mean(axis=0), course.std(axis=0)
    low, high = np.maximum(mean - deviation, 0), mean + deviation  # neither can be negative
    colour = look(number)["color"]
    axes.fill_between(iterations, low, high, color=colour, alpha=0.12, linewidth=0)
    for edge in (low, high):
        axes.plot(iterations, edge, linewidth=0.5, **look(number))
    axes.plot(iterations, mean, linewidth=1.5, label=name, **look(number))
    axes.set_xlim(0, iterations[-1])


@styled
def draw_profiles(panels: Mapping[str, Mapping[str, Floats]]) -> Figure:
    """Draw velocities of single movements over the iterations, a panel for each title.

    Args:
        panels: profiles by title and name, (iterations,).
    """
    figure, row = make_panels(len(panels), 3.1 * len(panels) + 0.6, 3.2, sharey=True)
    for axes, (title, profiles) in zip(row, panels.items(), strict=True):
        for number, (name, profile) in enumerate(profiles.items()):
            iterations = np.arange(1, len(profile) + 1)
            axes.plot(iterations, profile, linewidth=1.5, label=name, **look(number))
        axes.set(title=title, xlabel="iteration", xlim=(0, None))
    row[0].set_ylabel(VELOCITY)
    row[0].set_ylim(bottom=0)
    add_legend(figure, row[0])
    return figure


@styled
def draw_shares(samples: Mapping[str, Floats], label: str) -> Figure:
    """Draw cumulative distributions: the share of the movements with at most a value.

    Args:
        samples: a value per movement by name, (movements,).
        label: of the horizontal axis.
    """
    figure, (axes,) = make_panels(1, 4.2, 3.3)
    for number, (name, values) in enumerate(samples.items()):
        axes.ecdf(values, linewidth=1.5, label=name, **look(number))
    axes.set(xlabel=label, ylabel="share of movements", ylim=(0, 1))
    add_legend(figure, axes)
    return figure


@styled
def draw_postures(movements: Mapping[str, Recording], every: int = 2) -> Figure:
    """Draw postures of the arm in single movements, a panel for each title.

    Args:
        movements: a recording of one movement by title.
        every: a posture is drawn each so many iterations; the first and the last are thick.
    """
    figure, row = make_panels(len(movements), 3.1 * len(movements), 2.5, sharex=True, sharey=True)
    for axes, (title, movement) in zip(row, movements.items(), strict=True):
        _draw_movement(axes, movement, every)
        axes.set(title=title, xlabel="x [segment lengths]", aspect="equal")
    row[0].set_ylabel("y [segment lengths]")
    row[0].legend(frameon=False, loc="lower left")
    return figure


def _draw_movement(axes: Axes, movement: Recording, every: int) -> None:
    nodes = node_positions(np.concatenate([movement.start_segments[None], movement.segments]))
    for posture in nodes[every:-1:every]:
        axes.plot(*posture.T, color="0.72", linewidth=0.8, zorder=1)
    hand = nodes[:, -1]
    axes.plot(*hand[::every].T, ".", color=COLOURS[0], markersize=4, zorder=3)
    axes.plot(*hand.T, color=COLOURS[0], linewidth=0.9, label="hand", zorder=2)
    ends: Any = {"color": "black", "linewidth": 1.8, "marker": "o", "markersize": 3.5}
    axes.plot(*nodes[0].T, "--", label="start", **ends)
    axes.plot(*nodes[-1].T, "-", label="end", **ends)
    cross: Any = {"color": COLOURS[1], "markersize": 8, "markeredgewidth": 2}
    axes.plot(*movement.target, "x", label="target", zorder=4, **cross)
