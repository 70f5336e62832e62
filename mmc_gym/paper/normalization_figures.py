"""Figures of the normalization networks: errors, training curves, their surface, vector fields."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from matplotlib import colormaps, rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from mmc_gym._plotting import COLOURS, LINES, STYLE
from mmc_gym.network.chain import Floats


@dataclass(frozen=True, eq=False)
class Errors:
    """Errors of an architecture.

    Attributes:
        layers: number of its hidden layers.
        ours: of each run, (runs,).
        published: mean and standard deviation.
    """

    layers: int
    ours: Floats
    published: tuple[float, float]


@dataclass(frozen=True, eq=False)
class VectorField:
    """Vectors and what a network makes of them, each (n, 2)."""

    name: str
    inputs: Floats
    outputs: Floats


def draw_errors(errors: Mapping[str, Errors]) -> Figure:
    """MSE by architecture, mean ± standard deviation on a log axis, ours beside the published."""
    with rc_context(STYLE):
        figure = Figure(figsize=(7.4, 3.4), layout="constrained")
        axes = figure.subplots()
        places = np.arange(len(errors))
        columns = list(errors.values())
        ours = np.array([[e.ours.mean(), e.ours.std()] for e in columns])
        published = np.array([e.published for e in columns])
        for place, column in enumerate(columns):
            x = np.full(len(column.ours), place + 0.12)
            axes.plot(x, column.ours, ".", color="0.65", markersize=4)
        for layers in sorted({e.layers for e in columns}):
            group = np.array([e.layers == layers for e in columns])
            _draw_series(axes, places[group] + 0.12, ours[group], COLOURS[0], "-", "o", None)
            _draw_series(axes, places[group] - 0.12, published[group], COLOURS[1], "--", "s", "w")
        ours_key, published_key = axes.containers[0], axes.containers[1]
        axes.legend([ours_key, published_key], ["ours", "published"], frameon=False)
        axes.set(yscale="log", xlabel="units of the hidden layers", ylabel="validation MSE")
        axes.set_xticks(places, list(errors))
    return figure


def _draw_series(
    axes: Axes, x: Floats, means: Floats, colour: str, line: str, marker: str, fill: str | None
) -> None:
    mean, deviation = means.T
    # A mean less its deviation may be negative, which a log axis cannot show.
    low = np.minimum(deviation, 0.9 * mean)
    axes.errorbar(
        x,
        mean,
        yerr=np.stack([low, deviation]),
        color=colour,
        linestyle=line,
        marker=marker,
        markerfacecolor=fill or colour,
        markersize=4.5,
        linewidth=1.1,
        capsize=2.5,
    )


def draw_training_curves(histories: Mapping[str, Floats]) -> Figure:
    """MSE over epochs, one panel for a single hidden layer and one for two."""
    with rc_context(STYLE):
        figure = Figure(figsize=(7.2, 3.4), layout="constrained")
        panels = figure.subplots(1, 2, sharey=True)
        for axes, (title, group) in zip(panels, _by_layers(histories).items(), strict=True):
            colours = colormaps["viridis"](np.linspace(0, 0.85, max(len(group), 2)))
            for number, (name, mse) in enumerate(group.items()):
                epochs = np.arange(1, len(mse) + 1)
                line = LINES[number % len(LINES)]
                axes.plot(epochs, mse, color=colours[number], linestyle=line, label=name)
            axes.set(title=title, xlabel="epoch", yscale="log", xlim=(0, None))
            axes.legend(frameon=False, ncols=2, loc="upper right")
        panels[0].set_ylabel("validation MSE")
    return figure


def draw_surface(histories: Mapping[str, Floats]) -> Figure:
    """log10 MSE over epoch and architecture, one surface for each number of hidden layers."""
    with rc_context(STYLE):
        figure = Figure(figsize=(8.4, 3.9), layout="constrained")
        limits = np.log10([min(mse.min() for mse in histories.values()), 0.5])
        for number, (title, group) in enumerate(_by_layers(histories).items(), start=1):
            axes = cast(Any, figure.add_subplot(1, 2, number, projection="3d"))
            axes.set_title(title, y=0.98)
            _draw_one_surface(axes, group, limits)
    return figure


def _draw_one_surface(axes: Any, histories: Mapping[str, Floats], limits: Floats) -> None:
    heights = np.log10(np.stack(list(histories.values())))
    epochs, places = np.meshgrid(np.arange(1, heights.shape[1] + 1), np.arange(len(heights)))
    low, high = limits
    axes.plot_surface(
        *(epochs, places, heights),
        cmap="viridis",
        vmin=low,
        vmax=high,
        rcount=len(heights),
        ccount=60,
        alpha=0.85,
    )
    for place, height in enumerate(heights):
        axes.plot(epochs[place], np.full(len(height), place), height, "k", linewidth=0.5)
    axes.locator_params("x", nbins=4)
    axes.set(xlabel="epoch", zlabel="log$_{10}$ validation MSE", zlim=limits)
    axes.set_yticks(np.arange(len(heights)), list(histories), ha="left", va="center")
    axes.set_ylabel("units of the hidden layers", labelpad=12)
    axes.view_init(elev=28, azim=-50)
    axes.set_box_aspect((4, 4, 2.8), zoom=0.86)


def _by_layers(histories: Mapping[str, Floats]) -> dict[str, dict[str, Floats]]:
    return {
        title: {name: mse for name, mse in histories.items() if ("," in name) == deep}
        for title, deep in (("one hidden layer", False), ("two hidden layers", True))
    }


def draw_vector_fields(fields: Sequence[VectorField]) -> Figure:
    """Arrows from inputs to outputs, and the unit circle on which the outputs should lie."""
    with rc_context(STYLE):
        figure = Figure(figsize=(3.6 * len(fields), 3.8), layout="constrained")
        panels = figure.subplots(1, len(fields), sharey=True, squeeze=False)[0]
        for axes, field in zip(panels, fields, strict=True):
            axes.set_title(field.name)
            axes.add_patch(Circle((0, 0), 1, fill=False, color=COLOURS[1], linewidth=1.4))
            axes.quiver(
                *field.inputs.T,
                *(field.outputs - field.inputs).T,
                angles="xy",
                scale_units="xy",
                scale=1,
                color=COLOURS[0],
                width=0.004,
            )
            axes.set(xlim=(-1.75, 1.75), ylim=(-1.75, 1.75), aspect="equal")
            axes.set_xlabel("x [segment lengths]")
        panels[0].set_ylabel("y [segment lengths]")
    return figure
