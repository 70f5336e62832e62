"""Figures of movements, and the panels, curves and legends of the figures of all experiments."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from mmc_gym.geometry import Floats, node_positions
from studies.drawing import COLOURS, LINES, STYLE
from studies.paper.protocol import EUCLIDEAN, Recording

DISTANCE = "distance [of start to target]"
VELOCITY = "velocity [of start to target / iteration]"

styled = rc_context(STYLE)


def make_panels(
    count: int, width: float, height: float, columns: int | None = None, **shared: Any
) -> tuple[Figure, list[Axes]]:
    """Return a figure of `width` × `height` inches and its panels, by default in one row."""
    figure = Figure(figsize=(width, height), layout="constrained")
    columns = columns or count
    panels = figure.subplots(-(-count // columns), columns, squeeze=False, **shared).ravel()
    for unused in panels[count:]:
        unused.remove()
    return figure, list(panels[:count])


def look(number: int) -> dict[str, Any]:
    """Return the colour and line style of curve `number`, from 0."""
    return {"color": COLOURS[number % len(COLOURS)], "linestyle": LINES[number % len(LINES)]}


def add_legend(figure: Figure, axes: Axes, title: str | None = None) -> None:
    """Add a legend of the curves in `axes`, above all panels."""
    handles, labels = axes.get_legend_handles_labels()
    columns = 1 if figure.get_figwidth() < 5 else 2 if len(labels) > 3 else 3
    figure.legend(
        handles, labels, title=title, frameon=False, ncols=columns, loc="outside upper center"
    )


@styled
def draw_courses(panels: Mapping[str, Mapping[str, Floats]]) -> Figure:
    """Draw the mean and standard deviation of each (movements, iterations), by panel and name."""
    figure, row = make_panels(len(panels), 3.7 * len(panels) + 0.5, 3.6)
    for axes, (label, courses) in zip(row, panels.items(), strict=True):
        for number, (name, course) in enumerate(courses.items()):
            iterations = np.arange(1, course.shape[1] + 1)
            mean, deviation = course.mean(axis=0), course.std(axis=0)
            low, high = np.maximum(mean - deviation, 0), mean + deviation  # no value is negative
            colour = look(number)["color"]
            axes.fill_between(iterations, low, high, color=colour, alpha=0.12, linewidth=0)
            for edge in (low, high):
                axes.plot(iterations, edge, linewidth=0.5, **look(number))
            axes.plot(iterations, mean, linewidth=1.5, label=name, **look(number))
            axes.set_xlim(0, iterations[-1])
        axes.set(xlabel="iteration", ylabel=label, ylim=(0, None))
    add_legend(figure, row[0], title="mean (thick) ± standard deviation (thin)")
    return figure


@styled
def draw_final_distances(runs: Mapping[str, Floats], reference: Floats) -> Figure:
    """Draw the mean final distance of each run, and mean ± deviation over the movements of all.

    Args:
        runs: final distances by architecture, (runs, movements).
        reference: final distances with the Euclidean normalization, (movements,).
    """
    places = np.arange(len(runs))
    means = np.array([of_runs.mean() for of_runs in runs.values()])
    deviations = np.array([of_runs.std() for of_runs in runs.values()])
    low, high = np.maximum(means - deviations, 0), means + deviations
    figure, (axes,) = make_panels(1, max(0.5 * len(runs) + 1.2, 5.6), 3.1)
    label = "± standard deviation over movements"
    axes.fill_between(places, low, high, color=COLOURS[0], alpha=0.15, linewidth=0, label=label)
    axes.plot(places, means, color=COLOURS[0], marker="o", markersize=4, label="mean")
    for place, of_runs in zip(places, runs.values(), strict=True):
        label = "" if place else "mean of one trained network"
        at = np.full(len(of_runs), place)
        axes.plot(at, of_runs.mean(axis=1), "_", color="black", markersize=7, label=label)
    axes.axhline(float(reference.mean()), color=COLOURS[1], linestyle="--", label=EUCLIDEAN)
    axes.set_xticks(places, list(runs), rotation=45, ha="right", rotation_mode="anchor")
    axes.set(
        xlabel="hidden units of the normalization network",
        ylabel="distance after 100 iterations\n[of start to target]",
        ylim=(0, 1.3 * float(high.max())),  # room for the legend above
    )
    axes.legend(frameon=False, ncols=2, loc="upper center")
    return figure


@styled
def draw_profiles(panels: Mapping[str, Mapping[str, Floats]]) -> Figure:
    """Draw velocities of single movements, (iterations,), by panel and name."""
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
    """Draw the cumulative distribution of a value over movements; `label` names the value."""
    figure, (axes,) = make_panels(1, 4.2, 3.3)
    for number, (name, values) in enumerate(samples.items()):
        axes.ecdf(values, linewidth=1.5, label=name, **look(number))
    axes.set(xlabel=label, ylabel="share of movements", ylim=(0, 1))
    add_legend(figure, axes)
    return figure


@styled
def draw_postures(movements: Mapping[str, Recording]) -> Figure:
    """Draw every second posture of single movements, by panel; the first and last are thick."""
    figure, row = make_panels(len(movements), 3.1 * len(movements), 2.5, sharex=True, sharey=True)
    ends: Any = {"color": "black", "linewidth": 1.8, "marker": "o", "markersize": 3.5}
    cross: Any = {"color": COLOURS[1], "markersize": 8, "markeredgewidth": 2}
    for axes, (title, movement) in zip(row, movements.items(), strict=True):
        nodes = node_positions(np.concatenate([movement.start_segments[None], movement.segments]))
        for posture in nodes[2:-1:2]:
            axes.plot(*posture.T, color="0.72", linewidth=0.8, zorder=1)
        hand = nodes[:, -1]
        axes.plot(*hand[::2].T, ".", color=COLOURS[0], markersize=4, zorder=3)
        axes.plot(*hand.T, color=COLOURS[0], linewidth=0.9, label="hand", zorder=2)
        axes.plot(*nodes[0].T, "--", label="start", **ends)
        axes.plot(*nodes[-1].T, "-", label="end", **ends)
        axes.plot(*movement.target, "x", label="target", zorder=4, **cross)
        axes.set(title=title, xlabel="x [segment lengths]", aspect="equal")
    row[0].set_ylabel("y [segment lengths]")
    row[0].legend(frameon=False, loc="lower left")
    return figure


def write_number(
    axes: Axes, number: int, place: tuple[float, float], offset: tuple[float, float], **style: Any
) -> None:
    """Write a number with a white halo next to a point; `offset` is in points."""
    halo = [withStroke(linewidth=2, foreground="white")]
    axes.annotate(
        str(number), place, offset, textcoords="offset points", path_effects=halo, **style
    )
