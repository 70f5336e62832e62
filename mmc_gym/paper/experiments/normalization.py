"""The learned normalization on its own: twelve architectures, five runs each, beside the paper's.

A network f learns to bring any vector x = r u, r in ]0, 2], to unit length without turning it
(paper, Sect. "Learning the Normalization Network").  Its loss is the mean squared error over
the two components, MSE = mean |f(r u) − u|²/2, on 2,880 training and 720 validation vectors.

Near the zero vector, where all directions meet, the error is near 1, so a few short vectors
make up most of the MSE, and which of them are drawn moves it.  Here every run draws its own
validation vectors, and the [2] networks, which all but agree on the dense grid of directions
and lengths, spread by 0.004 on them; the published ones spread by 0.0001, as runs do that share
one set.  So the table has three errors: on the validation vectors, on the training vectors, and
over the dense grid, which is free of that luck.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd

from mmc_gym.network.fitting import PAPER
from mmc_gym.network.normalizers import LearnedNormalizer
from mmc_gym.paper.experiment import (
    Experiment,
    Progress,
    Result,
    Row,
    Settings,
    mean_and_deviation,
)
from mmc_gym.paper.figures import (
    Errors,
    VectorField,
    draw_normalization_errors,
    draw_surface,
    draw_training_curves,
    draw_vector_fields,
)
from mmc_gym.paper.networks import (
    QUICK_RECIPE,
    TrainedArchitecture,
    Units,
    architecture_name,
    trained_architectures,
)


@dataclass(frozen=True)
class Published:
    """What was published of an architecture; means and standard deviations are of five runs.

    Attributes:
        validation: mean and deviation of the validation MSE after 400 epochs.
        training: the same of the training MSE.
        angle_error: mean absolute angle error at lengths 0.9 to 1.1 of one network, degrees.
        text: the MSE that the paper's text gives.
    """

    validation: tuple[float, float]
    training: tuple[float, float]
    angle_error: float
    text: float | None = None


# Errors: training histories published with the paper.  Angle errors: measured on the networks
# published with it, one for each architecture.
PUBLISHED: dict[Units, Published] = {
    (2,): Published((0.03399, 0.00012), (0.03013, 0.00003), 2.23),
    (4,): Published((0.01433, 0.00106), (0.01262, 0.00104), 3.34),
    (8,): Published((0.00552, 0.00068), (0.00452, 0.00061), 2.64),
    (16,): Published((0.00427, 0.00015), (0.00336, 0.00010), 0.62, text=0.0042),
    (32,): Published((0.00399, 0.00010), (0.00309, 0.00007), 0.76),
    (64,): Published((0.00399, 0.00022), (0.00313, 0.00018), 0.61),
    (128,): Published((0.00414, 0.00035), (0.00329, 0.00030), 0.74),
    (2, 2): Published((0.01621, 0.00016), (0.01417, 0.00002), 4.02),
    (4, 4): Published((0.00360, 0.00022), (0.00322, 0.00023), 1.55),
    (8, 8): Published((0.00116, 0.00024), (0.00123, 0.00016), 0.43),
    (16, 16): Published((0.00035, 0.00006), (0.00062, 0.00010), 0.25, text=0.0003),
    (32, 32): Published((0.00030, 0.00009), (0.00059, 0.00005), 0.56),
}

_FIELD_UNITS: tuple[Units, ...] = ((8,), (16,))
_GRID = np.linspace(-1.6, 1.6, 17)


def run(settings: Settings, progress: Progress) -> Result:
    """Train the networks, or read them, and compare their errors with the published ones."""
    trained = trained_architectures(settings, progress)
    errors = {
        architecture_name(units): Errors(
            len(units), architecture.validation_mse[:, -1], PUBLISHED[units].validation
        )
        for units, architecture in trained.items()
    }
    histories = {
        architecture_name(units): architecture.validation_mse.mean(axis=0)
        for units, architecture in trained.items()
    }
    fields = [
        vector_field(trained[units].normalizers[0], architecture_name(units))
        for units in _FIELD_UNITS
    ]
    quick = f"quick run: {QUICK_RECIPE.epochs} of {PAPER.epochs} epochs" if settings.quick else ""
    return Result(
        rows=tuple(_rows(trained, quick)),
        figures={
            "mse_by_architecture": draw_normalization_errors(errors),
            "training_curves": draw_training_curves(histories),
            "mse_surface": draw_surface(histories),
            "vector_field": draw_vector_fields(fields),
        },
        captions={
            "mse_by_architecture": "Validation MSE after training, mean ± standard deviation of "
            "the runs, ours (filled) and as published (open); dots: single runs.",
            "training_curves": "Validation MSE over the epochs, mean of the runs.",
            "mse_surface": "The same as a surface over epoch and architecture.",
            "vector_field": "Where the networks move their inputs: arrows from input to output; "
            "the unit circle is where they should end.",
        },
        data={
            "mse": _frame(trained),
            "training": _histories(trained),
            "vector_field": {
                f"{name} {field.name}": array
                for field in fields
                for name, array in (("inputs", field.inputs), ("outputs", field.outputs))
            },
        },
        points={7: "vector fields drawn of [8] and [16], each under its name"},
    )


def vector_field(normalizer: LearnedNormalizer, name: str) -> VectorField:
    """Inputs on a grid of ±1.6 and what the network makes of them."""
    inputs = np.stack(np.meshgrid(_GRID, _GRID), axis=-1).reshape(-1, 2)
    return VectorField(name, inputs, normalizer(inputs))


def agreement(ours: tuple[float, float], published: tuple[float, float]) -> str:
    """Whether two means lie within the sum of their standard deviations, in words.

    >>> agreement((0.0036, 0.0015), (0.0043, 0.0002))
    'within the spread of both'
    >>> agreement((0.0030, 0.0001), (0.0043, 0.0002))
    'outside the spread of both: 4.3 × the sum of the deviations'
    """
    apart = abs(ours[0] - published[0]) / (ours[1] + published[1])
    if apart <= 1:
        return "within the spread of both"
    return f"outside the spread of both: {apart:.1f} × the sum of the deviations"


def _rows(trained: Mapping[Units, TrainedArchitecture], quick: str) -> list[Row]:
    validation, training, angles = [], [], []
    for units, architecture in trained.items():
        name, published = architecture_name(units), PUBLISHED[units]
        error = architecture.validation_mse[:, -1]
        grid = mean_and_deviation(architecture.grid_mse, 5)
        note = quick or agreement((error.mean(), error.std()), published.validation)
        validation.append(
            Row(
                f"{name}: validation MSE",
                published.text,
                _plus_minus(published.validation),
                mean_and_deviation(error, 5),
                note=f"{note}; over the dense grid ours is {grid}",
            )
        )
        error = architecture.training_mse[:, -1]
        training.append(
            Row(
                f"{name}: training MSE",
                data=_plus_minus(published.training),
                ours=mean_and_deviation(error, 5),
                note=quick or agreement((error.mean(), error.std()), published.training),
            )
        )
        angles.append(
            Row(
                f"{name}: mean angle error",
                data=f"{published.angle_error:.2f}",
                ours=mean_and_deviation(architecture.angle_error, 2),
                unit="°",
                note=quick or "lengths 0.9 to 1.1; its data: one network",
            )
        )
    return validation + training + angles


def _plus_minus(mean_and_sd: tuple[float, float]) -> str:
    return "{:.5f} ± {:.5f}".format(*mean_and_sd)


def _frame(trained: Mapping[Units, TrainedArchitecture]) -> pd.DataFrame:
    return pd.DataFrame(
        {
            "hidden_units": architecture_name(units),
            "run": number,
            "validation_mse": architecture.validation_mse[number, -1],
            "training_mse": architecture.training_mse[number, -1],
            "grid_mse": architecture.grid_mse[number],
            "angle_error_deg": architecture.angle_error[number],
        }
        for units, architecture in trained.items()
        for number in range(len(architecture.normalizers))
    )


def _histories(trained: Mapping[Units, TrainedArchitecture]) -> dict[str, np.ndarray]:
    return {
        f"{kind} {architecture_name(units)}": history
        for units, architecture in trained.items()
        for kind, history in (
            ("training", architecture.training_mse),
            ("validation", architecture.validation_mse),
        )
    }


EXPERIMENT = Experiment(
    "normalization", "errors of twelve normalization networks, five runs each", run
)
