"""Figures of the hidden units: curves over the input angle, a landscape of them, and tuning."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.projections.polar import PolarAxes

from mmc_gym._plotting import COLOURS, LINES, STYLE
from mmc_gym.network.chain import Floats

_ANGLES = (0, 90, 180, 270, 360)
_COLUMNS = 3  # of panels: the page is no wider


@dataclass(frozen=True, eq=False)
class Layer:
    """Units of a hidden layer, ordered by preferred direction.

    Attributes:
        name: what stands above the panel.
        directions: angle of the input, radians, (directions,).
        activations: (directions, units).
        preferred: preferred directions, radians, (units,).
        width: tuning widths, degrees, (units,).
    """

    name: str
    directions: Floats
    activations: Floats
    preferred: Floats
    width: Floats


def _grid(layers: Sequence[Layer]) -> tuple[int, int]:
    """Columns and rows of panels that hold the layers."""
    columns = min(len(layers), _COLUMNS)
    return columns, -(-len(layers) // columns)


def draw_curves(layers: Sequence[Layer]) -> Figure:
    """Activations over the input angle, a panel per layer, each unit numbered where it peaks."""
    with rc_context(STYLE):
        columns, rows = _grid(layers)
        figure = Figure(figsize=(2.4 * columns + 0.4, 2.5 * rows + 0.3), layout="constrained")
        for number, layer in enumerate(layers, start=1):
            axes = figure.add_subplot(rows, columns, number)
            axes.set_title(layer.name)
            _draw_layer(axes, layer)
            axes.set(xlim=(0, 360), xticks=_ANGLES, ylim=(-1.05, 1.15))
            axes.axhline(0, color="0.8", linewidth=0.6, zorder=0)
        figure.supxlabel("input angle [°]")
        figure.supylabel("activation of hidden unit (tanh)")
    return figure


def _draw_layer(axes: Axes, layer: Layer) -> None:
    degrees = np.degrees(layer.directions)
    for unit, activation in enumerate(layer.activations.T):
        colour = COLOURS[unit % len(COLOURS)]
        line = LINES[unit // len(COLOURS) % len(LINES)]
        axes.plot(degrees, activation, color=colour, linestyle=line, linewidth=1.2)
        # At the preferred direction; in the middle of the plateau of a unit that saturates.
        angle = layer.preferred[unit]
        height = np.interp(angle, layer.directions, activation, period=2 * np.pi)
        axes.annotate(
            str(unit + 1),
            (float(np.degrees(angle)), float(height)),
            (0, 2),
            textcoords="offset points",
            ha="center",
            color=colour,
            path_effects=[withStroke(linewidth=2, foreground="white")],
        )


def draw_landscape(layers: Sequence[Layer]) -> Figure:
    """One curve per unit in three dimensions: input angle, unit, activation."""
    with rc_context(STYLE):
        figure = Figure(figsize=(4 * len(layers), 3.6), layout="constrained")
        for number, layer in enumerate(layers, start=1):
            axes = cast(Any, figure.add_subplot(1, len(layers), number, projection="3d"))
            axes.set_title(layer.name, y=1.0)
            degrees = np.degrees(layer.directions)
            for unit, activation in enumerate(layer.activations.T):
                colour = COLOURS[unit % len(COLOURS)]
                axes.plot(degrees, np.full_like(degrees, unit + 1), activation, color=colour)
            axes.set(
                xlabel="input angle [°]",
                ylabel="hidden unit",
                zlabel="activation",
                xticks=_ANGLES,
                yticks=range(1, layer.activations.shape[1] + 1),
                zlim=(-1, 1),
            )
            axes.view_init(elev=35, azim=-65)
            axes.set_box_aspect((4, 4, 2.4), zoom=0.87)
    return figure


def draw_tuning(layers: Sequence[Layer]) -> Figure:
    """Preferred direction and tuning width of every unit, on circles of their own."""
    with rc_context(STYLE):
        columns, rows = _grid(layers)
        figure = Figure(figsize=(2.4 * columns, 2.9 * rows), layout="constrained")
        for number, layer in enumerate(layers, start=1):
            axes = cast(PolarAxes, figure.add_subplot(rows, columns, number, projection="polar"))
            axes.set_title(layer.name, pad=14)
            inside = layer.activations > (
                (layer.activations.max(axis=0) + layer.activations.min(axis=0)) / 2
            )
            radii = np.linspace(0.35, 1, inside.shape[1])
            for unit, radius in enumerate(radii):
                colour = COLOURS[unit % len(COLOURS)]
                arc = np.where(inside[:, unit], radius, np.nan)
                closed = np.append(layer.directions, 2 * np.pi)
                axes.plot(closed, np.append(arc, arc[0]), color=colour, linewidth=1.6)
                axes.plot(layer.preferred[unit], radius, "o", color=colour, markersize=4)
                axes.annotate(
                    str(unit + 1),
                    (layer.preferred[unit], radius),
                    (3, 3),
                    textcoords="offset points",
                    color=colour,
                    path_effects=[withStroke(linewidth=2, foreground="white")],
                )
            axes.set(ylim=(0, 1.1), yticks=[], xticks=np.radians(_ANGLES[:-1]))
            axes.spines["polar"].set_color("0.8")
    return figure
