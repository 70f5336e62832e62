"""Figures of movements: courses over the iterations, final distances, and postures of the arm."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

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
