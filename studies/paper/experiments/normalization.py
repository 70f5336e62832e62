"""Compare the learned normalizations, twelve architectures of five runs, with the paper's.

A network f learns to bring any vector x = r u, r in ]0, 2], to unit length without turning it
(paper, Sect. "Learning the Normalization Network").  Its loss is the mean squared error over
the two components, MSE = mean |f(r u) − u|²/2, on 2,880 training and 720 validation vectors.

Near the zero vector, where all directions meet, the error is near 1, so that a few short vectors
make up most of the MSE.  Here every run draws its own validation vectors.  So the MSEs of the [2]
networks differ by 0.004, though these networks hardly differ on a dense grid of directions and
lengths.  The published ones differ by 0.0001, like runs that share one validation set.  The table
therefore also has the error over the dense grid, which does not depend on the drawn vectors.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from mmc_gym.geometry import Floats
from mmc_gym.network.normalizers import LearnedNormalizer
from studies.drawing import COLOURS, LINES
from studies.network.fitting import PAPER
from studies.paper.experiment import (
    Captioned,
    ExperimentSettings,
    Result,
    ResultRow,
    mean_and_deviation,
)
from studies.paper.figures import make_panels, styled
from studies.paper.networks import QUICK_RECIPE, TrainedArchitecture, trained_architectures
from studies.paper.published import NORMALIZATION_PUBLISHED, MeanAndDeviation

_FIELDS = ("[8]", "[16]")


def run(settings: ExperimentSettings) -> Result:
    """Train the networks, or read them, and compare their errors with the published ones."""
    trained = trained_architectures(settings)
    histories = {
        name: architecture.validation_mse.mean(axis=0) for name, architecture in trained.items()
    }
    fields = {name: vector_field(trained[name].normalizers[0]) for name in _FIELDS}
    quick = f"quick run: {QUICK_RECIPE.epochs} of {PAPER.epochs} epochs" if settings.quick else ""
    return Result(
        rows=_rows(trained, quick),
        figures={
            "mse_by_architecture": Captioned(
                draw_errors(trained),
                "Validation MSE after training, mean ± standard deviation of the runs, ours "
                "(filled) and as published (open); dots: single runs.",
            ),
            "training_curves": Captioned(
                draw_training_curves(histories),
                "Validation MSE over the epochs, mean of the runs.",
            ),
            "mse_surface": Captioned(
                draw_surfaces(histories), "The same as a surface over epoch and architecture."
            ),
            "vector_field": Captioned(
                draw_vector_fields(fields),
                "Where the networks move their inputs: arrows from input to output; the unit "
                "circle is where they should end.",
            ),
        },
        data={
            "mse": _frame(trained),
            "training": {
                f"{kind} {name}": getattr(architecture, f"{kind}_mse")
                for name, architecture in trained.items()
                for kind in ("training", "validation")
            },
            "vector_field": {
                f"{kind} {name}": array
                for name, pair in fields.items()
                for kind, array in zip(("inputs", "outputs"), pair, strict=True)
            },
        },
        points={7: "vector fields drawn of [8] and [16], each under its name"},
    )


def vector_field(normalizer: LearnedNormalizer) -> tuple[Floats, Floats]:
    """Return vectors on a grid of ±1.6, and the network's outputs for them, (289, 2) each."""
    side = np.linspace(-1.6, 1.6, 17)
    inputs = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    return inputs, normalizer(inputs)


def agreement(ours: MeanAndDeviation, published: MeanAndDeviation) -> str:
    """Say whether two means differ by less than the sum of their standard deviations.

    >>> agreement((0.0036, 0.0015), (0.0043, 0.0002))
    'within the spread of both'
    >>> agreement((0.0030, 0.0001), (0.0043, 0.0002))
    'outside the spread of both: 4.3 × the sum of the deviations'
    """
    apart = abs(ours[0] - published[0]) / (ours[1] + published[1])
    if apart <= 1:
        return "within the spread of both"
    return f"outside the spread of both: {apart:.1f} × the sum of the deviations"


def _rows(trained: Mapping[str, TrainedArchitecture], quick: str) -> list[ResultRow]:
    validation, training, angles = [], [], []
    for name, architecture in trained.items():
        published = NORMALIZATION_PUBLISHED[name]
        grid = f"over the dense grid ours is {mean_and_deviation(architecture.grid_mse, 5)}"
        row = _mse_row(
            f"{name}: validation MSE", architecture.validation_mse, published.validation, quick
        )
        validation.append(replace(row, paper=published.text, note=f"{row.note}; {grid}"))
        training.append(
            _mse_row(f"{name}: training MSE", architecture.training_mse, published.training, quick)
        )
        angles.append(
            ResultRow(
                f"{name}: mean angle error",
                data=f"{published.angle_error:.2f}",
                ours=mean_and_deviation(architecture.angle_error, 2),
                unit="°",
                note=quick or "lengths 0.9 to 1.1; its data: one network",
            )
        )
    return validation + training + angles


def _mse_row(quantity: str, mse: Floats, published: MeanAndDeviation, quick: str) -> ResultRow:
    final = mse[:, -1]
    return ResultRow(
        quantity,
        data="{:.5f} ± {:.5f}".format(*published),
        ours=mean_and_deviation(final, 5),
        note=quick or agreement((final.mean(), final.std()), published),
    )


def _frame(trained: Mapping[str, TrainedArchitecture]) -> pd.DataFrame:
    return pd.concat(
        pd.DataFrame(
            {
                "hidden_units": name,
                "run": range(len(architecture.normalizers)),
                "validation_mse": architecture.validation_mse[:, -1],
                "training_mse": architecture.training_mse[:, -1],
                "grid_mse": architecture.grid_mse,
                "angle_error_deg": architecture.angle_error,
            }
        )
        for name, architecture in trained.items()
    )


@styled
def draw_errors(trained: Mapping[str, TrainedArchitecture]) -> Figure:
    """Draw the MSE by architecture, ours and the published one, mean ± deviation on a log axis."""
    figure, (axes,) = make_panels(1, 7.4, 3.4)
    finals = [architecture.validation_mse[:, -1] for architecture in trained.values()]
    ours = np.array([(final.mean(), final.std()) for final in finals])
    published = np.array([NORMALIZATION_PUBLISHED[name].validation for name in trained])
    deep = np.array(["," in name for name in trained])
    places = np.arange(len(trained))
    for place, final in enumerate(finals):
        axes.plot(np.full(len(final), place + 0.12), final, ".", color="0.65", markersize=4)
    filled: Any = {"color": COLOURS[0], "linestyle": "-", "marker": "o"}
    hollow: Any = {"color": COLOURS[1], "linestyle": "--", "marker": "s", "markerfacecolor": "w"}
    for group in (~deep, deep):
        _draw_series(axes, places[group] + 0.12, ours[group], **filled)
        _draw_series(axes, places[group] - 0.12, published[group], **hollow)
    axes.legend(axes.containers[:2], ["ours", "published"], frameon=False)
    axes.set(yscale="log", xlabel="units of the hidden layers", ylabel="validation MSE")
    axes.set_xticks(places, list(trained))
    return figure


def _draw_series(axes: Axes, x: Floats, errors: Floats, **style: Any) -> None:
    mean, deviation = errors.T
    # The mean minus the deviation may be negative, which a log axis cannot show.
    bars = np.stack([np.minimum(deviation, 0.9 * mean), deviation])
    axes.errorbar(x, mean, yerr=bars, markersize=4.5, linewidth=1.1, capsize=2.5, **style)


@styled
def draw_training_curves(histories: Mapping[str, Floats]) -> Figure:
    """Draw the MSE over epochs, in one panel for one hidden layer and one for two."""
    figure, panels = make_panels(2, 7.2, 3.4, sharey=True)
    for axes, (title, group) in zip(panels, _by_layers(histories).items(), strict=True):
        colours = colormaps["viridis"](np.linspace(0, 0.85, max(len(group), 2)))
        for number, (name, mse) in enumerate(group.items()):
            epochs, line = np.arange(1, len(mse) + 1), LINES[number % len(LINES)]
            axes.plot(epochs, mse, color=colours[number], linestyle=line, label=name)
        axes.set(title=title, xlabel="epoch", yscale="log", xlim=(0, None))
        axes.legend(frameon=False, ncols=2, loc="upper right")
    panels[0].set_ylabel("validation MSE")
    return figure


@styled
def draw_surfaces(histories: Mapping[str, Floats]) -> Figure:
    """Draw log10 MSE over epoch and architecture, a surface for each number of hidden layers."""
    limits = np.log10([min(mse.min() for mse in histories.values()), 0.5])
    figure, panels = make_panels(2, 8.4, 3.9, subplot_kw={"projection": "3d"})
    for axes, (title, group) in zip(panels, _by_layers(histories).items(), strict=True):
        axes.set_title(title, y=0.98)
        _draw_surface(axes, group, limits)
    return figure


def _draw_surface(axes: Any, histories: Mapping[str, Floats], limits: Floats) -> None:
    heights = np.log10(np.stack(list(histories.values())))
    epochs, places = np.meshgrid(np.arange(1, heights.shape[1] + 1), np.arange(len(heights)))
    low, high = limits
    look = {"cmap": "viridis", "vmin": low, "vmax": high, "alpha": 0.85}
    axes.plot_surface(epochs, places, heights, rcount=len(heights), ccount=60, **look)
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


@styled
def draw_vector_fields(fields: Mapping[str, tuple[Floats, Floats]]) -> Figure:
    """Draw arrows from inputs to outputs, (n, 2), and the unit circle where these should lie."""
    figure, panels = make_panels(len(fields), 3.6 * len(fields), 3.8, sharey=True)
    for axes, (name, (inputs, outputs)) in zip(panels, fields.items(), strict=True):
        axes.set_title(name)
        axes.add_patch(Circle((0, 0), 1, fill=False, color=COLOURS[1], linewidth=1.4))
        arrows: Any = {"angles": "xy", "scale_units": "xy", "scale": 1, "width": 0.004}
        axes.quiver(*inputs.T, *(outputs - inputs).T, color=COLOURS[0], **arrows)
        axes.set(xlim=(-1.75, 1.75), ylim=(-1.75, 1.75), aspect="equal")
        axes.set_xlabel("x [segment lengths]")
    panels[0].set_ylabel("y [segment lengths]")
    return figure
