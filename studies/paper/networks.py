"""Train the paper's normalization networks, twelve architectures with five runs each.

The runs of an architecture are trained as one batch of tensors, architectures in several processes.
Each finished architecture is written to a file named after recipe, seed and version, so an
interrupted run resumes.  All twelve take 76 seconds of one core; the sixty networks one by one take
349 (`python -m studies.network.normalization_training`).
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple, TypeAlias

import loky
import numpy as np

from mmc_gym import __version__
from mmc_gym.geometry import Floats
from mmc_gym.network.normalizers import LearnedNormalizer
from studies.network.fitting import (
    PAPER,
    FittingSettings,
    angle_errors,
    mean_squared_error,
    train_normalizers,
)
from studies.paper.experiment import ExperimentSettings, tracked

Units: TypeAlias = "tuple[int, ...]"

# In the order of the paper's figures.
ARCHITECTURES: tuple[Units, ...] = (
    *((2,), (4,), (8,), (16,), (32,), (64,), (128,)),
    *((2, 2), (4, 4), (8, 8), (16, 16), (32, 32)),
)
RUNS = 5

QUICK_ARCHITECTURES: tuple[Units, ...] = ((4,), (8,), (16,), (8, 8), (16, 16))
QUICK_RUNS = 2
QUICK_RECIPE = replace(PAPER, epochs=20)

_NEAR_ONE = np.linspace(0.9, 1.1, 21)  # the lengths that an arm at rest normalizes


class TrainedArchitecture(NamedTuple):
    """All runs of one architecture.

    Attributes:
        normalizers: one per run.
        training_mse: on the training samples, (runs, epochs).
        validation_mse: on the validation samples, (runs, epochs).
        grid_mse: over a grid of directions and lengths in ]0, 2], without samples, (runs,).
        angle_error: mean absolute angle error at lengths 0.9 to 1.1, degrees, (runs,).
    """

    normalizers: tuple[LearnedNormalizer, ...]
    training_mse: Floats
    validation_mse: Floats
    grid_mse: Floats
    angle_error: Floats


def architecture_name(hidden_units: Sequence[int]) -> str:
    """Return the name of an architecture in table and figures, such as "[16]" or "[16, 16]"."""
    return str(list(hidden_units))


def trained_architectures(
    settings: ExperimentSettings,
    architectures: Sequence[Units] | None = None,
    weight_decay: float = PAPER.weight_decay,
) -> dict[str, TrainedArchitecture]:
    """Return networks trained by the paper's recipe; read those that are in the settings' folder.

    Args:
        settings: a quick run has fewer runs of fewer epochs.
        architectures: hidden layer sizes; by default the paper's twelve, or a quick run's five.
        weight_decay: weight decay of the training; the paper's twelve have none.

    Returns:
        All runs of each architecture, by name, in the order of `architectures`.
    """
    if architectures is None:
        architectures = QUICK_ARCHITECTURES if settings.quick else ARCHITECTURES
    recipe, runs = (QUICK_RECIPE, QUICK_RUNS) if settings.quick else (PAPER, RUNS)
    recipe = replace(recipe, weight_decay=weight_decay)
    trainings = [_Training(tuple(units), recipe, runs, settings.seed) for units in architectures]
    missing = [training for training in trainings if not training.file_in(settings.folder).exists()]
    missing.sort(key=lambda training: sum(training.hidden_units), reverse=True)  # the longest first
    executor = loky.get_reusable_executor(settings.jobs) if settings.jobs > 1 else None
    trained = (executor.map if executor else map)(_train, missing)
    for training, result in zip(missing, tracked(trained, "networks", len(missing)), strict=True):
        _write(result, training.file_in(settings.folder))
    return {
        architecture_name(training.hidden_units): _read(training.file_in(settings.folder))
        for training in trainings
    }


@dataclass(frozen=True)
class _Training:
    """Everything that the training of one architecture depends on."""

    hidden_units: Units
    recipe: FittingSettings
    runs: int
    seed: int
    version: str = __version__

    def file_in(self, folder: Path) -> Path:
        """Return the file that keeps the result."""
        digest = hashlib.sha256(repr(self).encode()).hexdigest()[:12]
        return folder / "networks" / f"{'x'.join(map(str, self.hidden_units))}-{digest}.npz"


def _train(training: _Training) -> TrainedArchitecture:
    """Train one architecture and measure its errors."""
    trained = train_normalizers(
        training.hidden_units, training.recipe, training.runs, training.seed
    )
    normalizers = tuple(run.normalizer for run in trained)
    angles = [angle_errors(normalizer, _NEAR_ONE, directions=720) for normalizer in normalizers]
    return TrainedArchitecture(
        normalizers=normalizers,
        training_mse=np.stack([run.training_mse for run in trained]),
        validation_mse=np.stack([run.validation_mse for run in trained]),
        grid_mse=np.array([mean_squared_error(n, directions=180) for n in normalizers]),
        angle_error=np.array([np.degrees(errors).mean() for errors in angles]),
    )


def _write(trained: TrainedArchitecture, file: Path) -> None:
    """Write a result; the file exists only when it is complete."""
    arrays = trained._asdict()
    normalizers = arrays.pop("normalizers")
    for layer in range(len(normalizers[0].weights)):
        arrays[f"weights_{layer}"] = np.stack([n.weights[layer] for n in normalizers])
        arrays[f"biases_{layer}"] = np.stack([n.biases[layer] for n in normalizers])
    file.parent.mkdir(parents=True, exist_ok=True)
    unfinished = file.with_suffix(".unfinished.npz")
    np.savez_compressed(unfinished, **arrays)
    unfinished.replace(file)


def _read(file: Path) -> TrainedArchitecture:
    """Read a result."""
    with np.load(file) as archive:
        arrays = dict(archive)
    layers = range(sum(name.startswith("weights_") for name in arrays))
    normalizers = tuple(
        LearnedNormalizer(
            [arrays[f"weights_{layer}"][run] for layer in layers],
            [arrays[f"biases_{layer}"][run] for layer in layers],
        )
        for run in range(len(arrays["weights_0"]))
    )
    measures = {name: arrays[name] for name in TrainedArchitecture._fields[1:]}
    return TrainedArchitecture(normalizers, **measures)
