"""The hidden units of the normalization networks as a population code of direction.

The activation of a hidden unit for the unit vector in direction φ is (paper, Sect. "Learning the
Normalization Network", the figure of the hidden units)

    h(φ) = tanh(w · (cos φ, sin φ) + b)                       in the first hidden layer,

a bump around its preferred direction.  Here we measure for every unit of any layer

    preferred direction   arg Σ_φ h(φ) e^{iφ}; in the first layer that is arg(w_x + i w_y)
    tuning width          the part of the circle where h(φ) > (max h + min h)/2, in degrees
    coverage              the number of units in their tuning width, by direction, and the
                          largest angle between neighbouring preferred directions

The published figure in three dimensions is of a network trained with a weight decay of 0.0005,
unlike those of the other figures.  Here [8, 8] is shown without and with it.  Weight decay silences
some units: their activation hardly depends on the direction.  They are left out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mmc_gym.geometry import Floats
from mmc_gym.network.normalizers import LearnedNormalizer
from studies.drawing import COLOURS, LINES
from studies.paper.experiment import (
    Captioned,
    ExperimentSettings,
    Result,
    ResultRow,
    mean_and_deviation,
)
from studies.paper.figures import make_panels, styled, write_number
from studies.paper.networks import Units, trained_architectures

ARCHITECTURES: tuple[Units, ...] = ((4,), (8,), (8, 8))
WEIGHT_DECAY = 0.0005  # of the additional [8, 8] networks, see `FittingSettings`
SILENT = 0.01  # a unit whose activation ranges over less than this is silent

_PLAIN, _DECAYED = "[8, 8]", "[8, 8], weight decay"

DIRECTIONS: Floats = np.arange(720) * (2 * np.pi / 720)
"""Directions φ of the inputs, radians, (720,)."""


class Tuning(NamedTuple):
    """Tuning of the units of a layer that are not silent, by preferred direction.

    Attributes:
        activations: h(φ) at `DIRECTIONS`, (directions, units).
        preferred: preferred directions, radians in [0, 2π[, (units,).
        width: tuning widths, degrees, (units,).
        inside: True where h(φ) > (max h + min h)/2, (directions, units).
        active: number of units within their tuning width, by direction, (directions,).
        largest_gap: largest angle between neighbouring preferred directions, degrees; 360
            without units.
        size: number of units in the layer, silent ones too.
    """

    activations: Floats
    preferred: Floats
    width: Floats
    inside: NDArray[np.bool_]
    active: NDArray[np.int_]
    largest_gap: float
    size: int


def tuning(activations: Floats) -> Tuning:
    """Return the tuning of units from their activations at `DIRECTIONS`, (directions, units).

    >>> cosines = np.cos(DIRECTIONS[:, None] - np.radians([10.0, 100.0, 280.0]))
    >>> layer = tuning(cosines)
    >>> np.degrees(layer.preferred).round(6).tolist(), layer.width.round().tolist()
    ([10.0, 100.0, 280.0], [180.0, 180.0, 180.0])
    >>> round(layer.largest_gap, 6), int(layer.active.min()), int(layer.active.max())
    (180.0, 1, 2)
    """
    units = activations.shape[1]
    activations = activations[:, np.ptp(activations, axis=0) >= SILENT]
    moment = np.exp(1j * DIRECTIONS) @ activations
    preferred = np.angle(moment) % (2 * np.pi)
    order = np.argsort(preferred)
    activations, preferred = activations[:, order], preferred[order]
    half = (activations.max(axis=0) + activations.min(axis=0)) / 2
    inside = activations > half
    gaps = np.diff(preferred, append=preferred[:1] + 2 * np.pi)
    return Tuning(
        activations=activations,
        preferred=preferred,
        width=360 * inside.mean(axis=0),
        inside=inside,
        active=inside.sum(axis=1),
        largest_gap=float(np.degrees(gaps.max())) if gaps.size else 360.0,
        size=units,
    )


def layer_tunings(normalizer: LearnedNormalizer) -> list[Tuning]:
    """Return the tuning of every hidden layer of a network."""
    vectors = np.stack([np.cos(DIRECTIONS), np.sin(DIRECTIONS)], axis=-1)
    return [tuning(outputs) for outputs in normalizer.activations(vectors)[:-1]]


def run(settings: ExperimentSettings) -> Result:
    """Measure and draw the hidden units of the networks with 4, 8, and [8, 8] hidden units."""
    trained = trained_architectures(settings, ARCHITECTURES)
    trained[_DECAYED] = trained_architectures(settings, ((8, 8),), WEIGHT_DECAY)[_PLAIN]
    layers: dict[str, tuple[Tuning, ...]] = {}
    for name, architecture in trained.items():
        runs = [layer_tunings(normalizer) for normalizer in architecture.normalizers]
        for number, of_runs in enumerate(zip(*runs, strict=True), start=1):
            suffix = f", layer {number}" if len(runs[0]) > 1 else ""
            layers[name + suffix] = of_runs
    shown = {name: first for name, (first, *_) in layers.items()}
    in_depth = ("[8]", f"{_PLAIN}, layer 2", f"{_DECAYED}, layer 2")
    return Result(
        rows=[
            *(row for name, of_runs in layers.items() for row in _rows(name, of_runs)),
            *(
                ResultRow(
                    f"{name}: MSE over all directions and lengths in ]0, 2]",
                    ours=mean_and_deviation(trained[name].grid_mse, 5),
                    note=f"{len(trained[name].grid_mse)} runs; without the penalty",
                )
                for name in (_PLAIN, _DECAYED)
            ),
        ],
        figures={
            "hidden_units": Captioned(
                draw_activations(shown),
                "Activation of the hidden units over the angle of a unit input vector, numbered "
                "by preferred direction (first run of each network); silent units are left out.",
            ),
            "hidden_units_3d": Captioned(
                draw_activations_in_depth({name: shown[name] for name in in_depth}),
                "The same, one curve per unit.",
            ),
            "tuning": Captioned(
                draw_tunings(shown),
                "Preferred direction (dot) and tuning width (arc) of each unit.",
            ),
        },
        data={
            "hidden_units": {
                "directions": DIRECTIONS,
                **{name: layer.activations for name, layer in shown.items()},
            },
            "tuning": _frame(layers),
        },
        points={
            7: "hidden units drawn of [4], [8] and [8, 8] without weight decay, and of [8, 8] with "
            f"weight decay {WEIGHT_DECAY:g}"
        },
    )


def _frame(layers: Mapping[str, Sequence[Tuning]]) -> pd.DataFrame:
    return pd.concat(
        pd.DataFrame(
            {
                "units": name,
                "run": run,
                "unit": np.arange(len(layer.width)) + 1,
                "preferred_direction_deg": np.degrees(layer.preferred),
                "tuning_width_deg": layer.width,
            }
        )
        for name, of_runs in layers.items()
        for run, layer in enumerate(of_runs)
    )


def _rows(name: str, runs: Sequence[Tuning]) -> list[ResultRow]:
    widths = np.concatenate([run.width for run in runs])
    gaps = np.array([run.largest_gap for run in runs])
    active = np.concatenate([run.active for run in runs])
    units = sum(run.size for run in runs)
    silent = units - widths.size
    silence = f"; {silent} of {units} units are silent and left out" if silent else ""
    return [
        ResultRow(
            f"{name}: tuning width, mean (smallest to largest)",
            paper="“a certain range of the orientation”",
            ours=f"{widths.mean():.0f} ({widths.min():.0f} to {widths.max():.0f})",
            unit="°",
            note=f"{len(runs)} runs{silence}",
        ),
        ResultRow(
            f"{name}: largest gap between preferred directions",
            ours=f"{gaps.mean():.0f} ± {gaps.std():.0f}",
            unit="°",
            note=f"evenly spread units would have {360 / runs[0].size:.0f}°",
        ),
        ResultRow(
            f"{name}: units within their tuning width, mean (fewest to most)",
            paper="“more overlap” with more units",
            ours=f"{active.mean():.1f} ({active.min()} to {active.max()})",
            note=f"of {runs[0].size}, over all directions",
        ),
    ]


_DEGREES = np.degrees(DIRECTIONS)
_ANGLES = (0, 90, 180, 270, 360)
_COLUMNS = 3


@styled
def draw_activations(layers: Mapping[str, Tuning]) -> Figure:
    """Draw activations over the input angle, in a panel per layer; number units at their peaks."""
    rows = -(-len(layers) // _COLUMNS)
    figure, panels = make_panels(len(layers), 7.6, 2.5 * rows + 0.3, _COLUMNS)
    for axes, (name, layer) in zip(panels, layers.items(), strict=True):
        axes.set_title(name)
        for unit, activation in enumerate(layer.activations.T):
            colour, line = COLOURS[unit % len(COLOURS)], LINES[unit // len(COLOURS) % len(LINES)]
            axes.plot(_DEGREES, activation, color=colour, linestyle=line, linewidth=1.2)
            # At the preferred direction: for a unit that saturates, the middle of its plateau.
            angle = layer.preferred[unit]
            height = np.interp(angle, DIRECTIONS, activation, period=2 * np.pi)
            write_number(
                axes, unit + 1, (np.degrees(angle), height), (0, 2), ha="center", color=colour
            )
        axes.set(xlim=(0, 360), xticks=_ANGLES, ylim=(-1.05, 1.15))
        axes.axhline(0, color="0.8", linewidth=0.6, zorder=0)
    figure.supxlabel("input angle [°]")
    figure.supylabel("activation of hidden unit (tanh)")
    return figure


@styled
def draw_activations_in_depth(layers: Mapping[str, Tuning]) -> Figure:
    """Draw a curve per unit in three dimensions: input angle, unit, activation."""
    figure, panels = make_panels(len(layers), 4 * len(layers), 3.6, subplot_kw={"projection": "3d"})
    axes: Any
    for axes, (name, layer) in zip(panels, layers.items(), strict=True):
        axes.set_title(name, y=1.0)
        for unit, activation in enumerate(layer.activations.T):
            colour = COLOURS[unit % len(COLOURS)]
            axes.plot(_DEGREES, np.full_like(_DEGREES, unit + 1), activation, color=colour)
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


@styled
def draw_tunings(layers: Mapping[str, Tuning]) -> Figure:
    """Draw preferred direction and tuning width of every unit, each on its own circle."""
    rows = -(-len(layers) // _COLUMNS)
    polar = {"projection": "polar"}
    figure, panels = make_panels(len(layers), 7.2, 2.9 * rows, _COLUMNS, subplot_kw=polar)
    closed = np.append(DIRECTIONS, 2 * np.pi)
    for axes, (name, layer) in zip(panels, layers.items(), strict=True):
        axes.set_title(name, pad=14)
        radii = np.linspace(0.35, 1, len(layer.preferred))
        for unit, (radius, angle) in enumerate(zip(radii, layer.preferred, strict=True)):
            colour = COLOURS[unit % len(COLOURS)]
            arc = np.where(layer.inside[:, unit], radius, np.nan)
            axes.plot(closed, np.append(arc, arc[0]), color=colour, linewidth=1.6)
            axes.plot(angle, radius, "o", color=colour, markersize=4)
            write_number(axes, unit + 1, (angle, radius), (3, 3), color=colour)
        axes.set(ylim=(0, 1.1), yticks=[], xticks=np.radians(_ANGLES[:-1]))
        axes.spines["polar"].set_color("0.8")
    return figure
