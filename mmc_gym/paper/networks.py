"""The paper's normalization networks: twelve architectures, five runs each, trained and kept.

The runs of an architecture are trained together, as one batch of tensors, and architectures in
as many processes as asked for.  Every finished architecture is a file of its own, named by all
that its content depends on, so that work which was interrupted goes on where it was.

Together, the runs of all twelve take 76 seconds of one core; one network at a time, the sixty
take 349 (`python benchmarks/normalization_training.py`).
"""

from __future__ import annotations

import hashlib
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mmc_gym._files import write_atomically
from mmc_gym._grid import run_grid
from mmc_gym.network.fitting import PAPER, Recipe, train_normalizers
from mmc_gym.network.normalizers import LearnedNormalizer, angle_errors, mean_squared_error
from mmc_gym.paper.experiment import Progress, Settings, pack_arrays

Units: TypeAlias = "tuple[int, ...]"
_Arrays: TypeAlias = "dict[str, NDArray[Any]]"

# In the order of the paper's figures.
ARCHITECTURES: tuple[Units, ...] = (
    *((2,), (4,), (8,), (16,), (32,), (64,), (128,)),
    *((2, 2), (4, 4), (8, 8), (16, 16), (32, 32)),
)
RUNS = 5

QUICK_ARCHITECTURES: tuple[Units, ...] = ((4,), (8,), (16,), (8, 8), (16, 16))
QUICK_RUNS = 2
QUICK_RECIPE = replace(PAPER, epochs=20)

_NEAR_ONE = np.linspace(0.9, 1.1, 21)  # the lengths that an arm at rest asks for
_FEW_EPOCHS = 500  # take no longer than to start a process, and torch in it


@dataclass(frozen=True, eq=False)
class TrainedArchitecture:
    """All runs of one architecture.

    Attributes:
        hidden_units: sizes of the hidden layers.
        normalizers: one per run.
        training_mse: on the training samples, (runs, epochs).
        validation_mse: on the validation samples, (runs, epochs).
        grid_mse: over all directions and lengths in ]0, 2], free of the luck of samples, (runs,).
        angle_error: mean absolute angle error at lengths 0.9 to 1.1, degrees, (runs,).
    """

    hidden_units: Units
    normalizers: tuple[LearnedNormalizer, ...]
    training_mse: NDArray[np.float64]
    validation_mse: NDArray[np.float64]
    grid_mse: NDArray[np.float64]
    angle_error: NDArray[np.float64]


def architecture_name(hidden_units: Sequence[int]) -> str:
    """Hidden layer sizes as the table and figures write them: "[16]", "[16, 16]"."""
    return str(list(hidden_units))


def trained_architectures(
    settings: Settings,
    progress: Progress,
    architectures: Sequence[Units] | None = None,
    weight_decay: float = PAPER.weight_decay,
) -> dict[Units, TrainedArchitecture]:
    """Networks trained by the paper's recipe, from the settings' folder where they are there.

    Args:
        settings: a quick run trains fewer architectures and runs, for fewer epochs.
        progress: called with (epochs done, their total number).
        architectures: hidden layer sizes; by default the paper's twelve, or a quick run's five.
        weight_decay: of the training; the paper's twelve have none.

    Returns:
        All runs of each architecture, in the order asked for.
    """
    if architectures is None:
        architectures = QUICK_ARCHITECTURES if settings.quick else ARCHITECTURES
    recipe, runs = (QUICK_RECIPE, QUICK_RUNS) if settings.quick else (PAPER, RUNS)
    recipe = replace(recipe, weight_decay=weight_decay)
    tasks = [_Task(tuple(units), recipe, runs, settings.seed) for units in architectures]
    folder = settings.folder / "networks" if settings.folder else None
    results = {task: _read(task, folder) for task in tasks}
    missing = [task for task in tasks if not results[task]]
    missing.sort(key=lambda task: sum(task.hidden_units), reverse=True)  # the longest first
    total = sum(task.recipe.epochs for task in tasks)
    before = total - sum(task.recipe.epochs for task in missing)
    progress(before, total)
    parallel = settings.jobs > 1 and len(missing) > 1 and total - before > _FEW_EPOCHS

    done = before

    def report(epochs: int) -> None:
        nonlocal done
        done += epochs
        progress(done, total)

    def keep(index: int, arrays: _Arrays) -> None:
        task = missing[index]
        results[task] = arrays
        if folder:
            write_atomically(folder / task.file_name, pack_arrays(arrays))
        if parallel:
            report(task.recipe.epochs)

    if parallel:
        run_grid(_train, missing, jobs=settings.jobs, on_result=keep)
    else:
        run_grid(partial(_train, tick=partial(report, 1)), missing, jobs=1, on_result=keep)
    return {task.hidden_units: _unpacked(task, results[task]) for task in tasks}


@dataclass(frozen=True)
class _Task:
    """The training of one architecture, with all that its result depends on."""

    hidden_units: Units
    recipe: Recipe
    runs: int
    seed: int

    @property
    def file_name(self) -> str:
        digest = hashlib.sha256(repr(self).encode()).hexdigest()[:12]
        return f"{'x'.join(map(str, self.hidden_units))}-{digest}.npz"


def _train(task: _Task, tick: Callable[[], None] = lambda: None) -> _Arrays:
    """Train one architecture, and measure it."""
    trained = train_normalizers(
        task.hidden_units,
        task.recipe,
        task.runs,
        task.seed,
        progress=lambda done, total: tick(),
    )
    normalizers = [run.normalizer for run in trained]
    arrays: _Arrays = {
        "training_mse": np.stack([run.training_mse for run in trained]),
        "validation_mse": np.stack([run.validation_mse for run in trained]),
        "grid_mse": np.array([mean_squared_error(n, directions=180) for n in normalizers]),
        "angle_error": np.array(
            [np.degrees(angle_errors(n, _NEAR_ONE, directions=720)).mean() for n in normalizers]
        ),
    }
    for layer in range(len(task.hidden_units) + 1):
        arrays[f"weights_{layer}"] = np.stack([n.weights[layer] for n in normalizers])
        arrays[f"biases_{layer}"] = np.stack([n.biases[layer] for n in normalizers])
    return arrays


def _read(task: _Task, folder: Path | None) -> _Arrays:
    """What an earlier run kept; nothing if it kept none, or what is there is damaged."""
    if not folder or not (folder / task.file_name).exists():
        return {}
    try:
        # Opened here, because numpy leaves a damaged file open.
        with open(folder / task.file_name, "rb") as file, np.load(file) as arrays:
            return dict(arrays)
    except (OSError, ValueError, EOFError, zipfile.BadZipFile):
        return {}


def _unpacked(task: _Task, arrays: Mapping[str, NDArray[Any]]) -> TrainedArchitecture:
    layers = range(len(task.hidden_units) + 1)
    normalizers = tuple(
        LearnedNormalizer(
            [arrays[f"weights_{layer}"][run] for layer in layers],
            [arrays[f"biases_{layer}"][run] for layer in layers],
        )
        for run in range(task.runs)
    )
    measured = ("training_mse", "validation_mse", "grid_mse", "angle_error")
    return TrainedArchitecture(task.hidden_units, normalizers, *(arrays[name] for name in measured))
