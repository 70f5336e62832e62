"""Figures of movements: courses over the iterations, final distances, and postures of the arm."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from matplotlib import colormaps, rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from matplotlib.patheffects import withStroke
from matplotlib.projections.polar import PolarAxes

from mmc_gym._plotting import COLOURS, LINES, STYLE
from mmc_gym.network.chain import Floats, node_positions
from mmc_gym.paper.protocol import Recording

DISTANCE = "distance [of start to target]"
VELOCITY = "velocity [of start to target / iteration]"

_MARKERS = "osD^v"


def draw_courses(panels: Mapping[str, Mapping[str, Floats]]) -> Figure:
    """Mean and standard deviation over the iterations, a panel side by side for each quantity.

    Args:
        panels: label of the vertical axis, and what is drawn: name, (movements, iterations).
    """
    with rc_context(STYLE):
        figure = Figure(figsize=(3.7 * len(panels) + 0.5, 3.6), layout="constrained")
        row = figure.subplots(1, len(panels), squeeze=False)[0]
        for axes, (label, courses) in zip(row, panels.items(), strict=True):
            for number, (name, course) in enumerate(courses.items()):
                _draw_course(axes, name, course, number)
            axes.set(xlabel="iteration", ylabel=label, ylim=(0, None))
        _add_legend(figure, row[0], title="mean (thick) ± standard deviation (thin)")
    return figure


def _draw_course(axes: Axes, name: str, course: Floats, number: int) -> None:
    iterations = np.arange(1, course.shape[1] + 1)
    mean, deviation = course.mean(axis=0), course.std(axis=0)
    colour, line = COLOURS[number % len(COLOURS)], LINES[number % len(LINES)]
    edges = np.maximum(mean - deviation, 0), mean + deviation  # neither can be negative
    axes.fill_between(iterations, *edges, color=colour, alpha=0.12, linewidth=0)
    for edge in edges:
        axes.plot(iterations, edge, color=colour, linestyle=line, linewidth=0.5)
    axes.plot(iterations, mean, color=colour, linestyle=line, linewidth=1.5, label=name)
    axes.set_xlim(0, iterations[-1])


def draw_profiles(panels: Mapping[str, Mapping[str, Floats]]) -> Figure:
    """Velocities of single movements over the iterations, a panel side by side for each title.

    Args:
        panels: title, and what is drawn: name, (iterations,).
    """
    with rc_context(STYLE):
        figure = Figure(figsize=(3.1 * len(panels) + 0.6, 3.2), layout="constrained")
        row = figure.subplots(1, len(panels), squeeze=False, sharey=True)[0]
        for axes, (title, profiles) in zip(row, panels.items(), strict=True):
            for number, (name, profile) in enumerate(profiles.items()):
                axes.plot(
                    np.arange(1, len(profile) + 1),
                    profile,
                    color=COLOURS[number % len(COLOURS)],
                    linestyle=LINES[number % len(LINES)],
                    linewidth=1.5,
                    label=name,
                )
            axes.set(title=title, xlabel="iteration", xlim=(0, None))
        row[0].set_ylabel(VELOCITY)
        row[0].set_ylim(bottom=0)
        _add_legend(figure, row[0])
    return figure


def draw_shares(samples: Mapping[str, Floats], label: str) -> Figure:
    """Cumulative distributions: the share of the movements with at most a value.

    Args:
        samples: name, and a value per movement, (movements,).
        label: of the horizontal axis.
    """
    with rc_context(STYLE):
        figure = Figure(figsize=(4.2, 3.3), layout="constrained")
        axes = figure.subplots()
        for number, (name, values) in enumerate(samples.items()):
            axes.ecdf(
                values,
                color=COLOURS[number % len(COLOURS)],
                linestyle=LINES[number % len(LINES)],
                linewidth=1.5,
                label=name,
            )
        axes.set(xlabel=label, ylabel="share of movements", ylim=(0, 1))
        _add_legend(figure, axes)
    return figure


def draw_errors(panels: Mapping[str, Mapping[str, Floats]], factor: float) -> Figure:
    """Errors over the iterations on a logarithmic axis, a panel side by side for each title.

    Args:
        panels: title, and what is drawn: name, (iterations,), in segment lengths.
        factor: per iteration, drawn as a slope to compare with.
    """
    with rc_context(STYLE):
        figure = Figure(figsize=(2.7 * len(panels) + 0.6, 3.4), layout="constrained")
        row = figure.subplots(1, len(panels), squeeze=False, sharey=True)[0]
        for axes, (title, errors) in zip(row, panels.items(), strict=True):
            for number, (name, error) in enumerate(errors.items()):
                iterations = np.arange(1, len(error) + 1)
                axes.plot(
                    iterations,
                    error,
                    color=(*COLOURS, "black")[number],
                    linestyle=LINES[number % len(LINES)],
                    marker=_MARKERS[number],
                    markevery=(10 * number, len(error) // 6),
                    markersize=3,
                    label=name,
                )
            axes.plot(
                iterations, factor**iterations, color="0.6", linewidth=0.8, label=f"{factor:.4f}ᵏ"
            )
            axes.set(title=title, xlabel="iteration k", yscale="log", ylim=(1e-4, 5))
        row[0].set_ylabel("error [segment lengths]")
        _add_legend(figure, row[0])
    return figure


def draw_final_distances(
    names: Sequence[str],
    runs: Sequence[Floats],
    reference: Floats,
    reference_name: str,
    iterations: int,
) -> Figure:
    """Mean final distance of each run, and mean ± standard deviation over the movements of all.

    Args:
        names: of the architectures.
        runs: final distances of each, (runs, movements).
        reference: final distances of the network to compare with, (movements,).
        reference_name: what it is called.
        iterations: after which the distances were measured.
    """
    places = np.arange(len(names))
    means = np.array([of_runs.mean() for of_runs in runs])
    deviations = np.array([of_runs.std() for of_runs in runs])
    with rc_context(STYLE):
        figure = Figure(figsize=(max(0.5 * len(names) + 1.2, 4.2), 3.1), layout="constrained")
        axes = figure.subplots()
        axes.fill_between(
            places,
            np.maximum(means - deviations, 0),
            means + deviations,
            color=COLOURS[0],
            alpha=0.15,
            linewidth=0,
            label="± standard deviation over movements",
        )
        axes.plot(places, means, color=COLOURS[0], marker="o", markersize=4, label="mean")
        for place, of_runs in zip(places, runs, strict=True):
            means_of_runs = of_runs.mean(axis=1)
            axes.plot(
                np.full(len(means_of_runs), place),
                means_of_runs,
                "_",
                color="black",
                markersize=7,
                label="mean of one trained network" if place == 0 else None,
            )
        axes.axhline(
            float(reference.mean()), color=COLOURS[1], linestyle="--", label=reference_name
        )
        axes.set_xticks(places, names, rotation=45, ha="right", rotation_mode="anchor")
        axes.set(
            xlabel="hidden units of the normalization network",
            ylabel=f"distance after {iterations} iterations\n[of start to target]",
            ylim=(0, 1.3 * float((means + deviations).max())),  # the legend stands above
        )
        axes.legend(frameon=False, ncols=2, loc="upper center")
    return figure


def draw_postures(movements: Mapping[str, Recording], every: int = 2) -> Figure:
    """Postures of the arm in single movements, a panel side by side for each title.

    Args:
        movements: title, and a recording of one movement.
        every: a posture is drawn each so many iterations; the first and the last are thick.
    """
    with rc_context(STYLE):
        figure = Figure(figsize=(3.1 * len(movements), 2.5), layout="constrained")
        row = figure.subplots(1, len(movements), squeeze=False, sharex=True, sharey=True)[0]
        for axes, (title, movement) in zip(row, movements.items(), strict=True):
            _draw_movement(axes, movement, every)
            axes.set(title=title, xlabel="x [segment lengths]", aspect="equal")
        row[0].set_ylabel("y [segment lengths]")
        row[0].legend(frameon=False, loc="lower left")
    return figure


def _draw_movement(axes: Axes, movement: Recording, every: int) -> None:
    postures = np.concatenate([movement.start_segments[None], movement.segments])
    nodes = node_positions(postures)
    for posture in nodes[every:-1:every]:
        axes.plot(*posture.T, color="0.72", linewidth=0.8, zorder=1)
    axes.plot(*nodes[::every, -1].T, ".", color=COLOURS[0], markersize=4, zorder=3)
    axes.plot(*nodes[:, -1].T, color=COLOURS[0], linewidth=0.9, label="hand", zorder=2)
    for posture, line, name in ((nodes[0], "--", "start"), (nodes[-1], "-", "end")):
        axes.plot(
            *posture.T, line, color="black", linewidth=1.8, marker="o", markersize=3.5, label=name
        )
    axes.plot(
        *movement.target,
        "x",
        color=COLOURS[1],
        markersize=8,
        markeredgewidth=2,
        label="target",
        zorder=4,
    )


def _add_legend(figure: Figure, axes: Axes, title: str | None = None) -> None:
    """What is drawn in all panels, above them."""
    handles, labels = axes.get_legend_handles_labels()
    columns = 1 if figure.get_figwidth() < 5 else 2 if len(labels) > 3 else 3
    figure.legend(
        handles, labels, title=title, frameon=False, ncols=columns, loc="outside upper center"
    )


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


def draw_normalization_errors(errors: Mapping[str, Errors]) -> Figure:
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


@dataclass(frozen=True, eq=False)
class Curves:
    """Angle errors by length, (lengths,), and distances, (movements, iterations)."""

    mean_error: Floats
    worst_error: Floats
    distance: Floats


def draw_accurate(lengths: Floats, curves: Mapping[str, Curves], exact: str) -> Figure:
    """Draw the errors of all but the exact normalizer, and the distances of all."""
    with rc_context(STYLE):
        figure = Figure(figsize=(7.2, 3.2), layout="constrained")
        left, right = figure.subplots(1, 2)
        for number, (name, curve) in enumerate(curves.items()):
            colour, line = COLOURS[number], LINES[number]
            if name != exact:
                _draw_errors(left, lengths, curve, name, colour, line)
            mean = curve.distance.mean(axis=0)
            iterations = np.arange(1, len(mean) + 1)
            # Wide below, so that curves that coincide are both seen.
            width = 3.5 if name == exact else 1.3
            right.plot(
                *(iterations, mean),
                color="0.75" if name == exact else colour,
                linestyle=line,
                linewidth=width,
                label=name,
            )
        left.set(yscale="log", xlim=(0, 3), xlabel="length of input [segment lengths]")
        left.set_ylabel("angle error [°]")
        left.legend(frameon=False)
        right.set(yscale="log", xlabel="iteration", ylabel="normalized distance to target")
        right.legend(frameon=False)
    return figure


def _draw_errors(
    axes: Axes, lengths: Floats, curve: Curves, name: str, colour: str, line: object
) -> None:
    axes.plot(lengths, curve.worst_error, color=colour, linewidth=0.6, label=f"{name}, worst")
    axes.plot(
        *(lengths, curve.mean_error),
        color=colour,
        linestyle=line,
        linewidth=1.5,
        label=f"{name}, mean",
    )
