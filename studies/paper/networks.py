"""The paper's normalization networks: twelve architectures, five runs each, trained and kept.

The runs of an architecture are trained as one batch of tensors, architectures in as many processes
as asked for.  Every finished one is a file, named by recipe and seed, so that interrupted work goes
on where it was.  All twelve take 76 seconds of one core; the sixty networks one by one take 349
(`python -m studies.network.normalization_training`).
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple, TypeAlias

import numpy as np

from mmc_gym._files import write_atomically
from mmc_gym._grid import run_grid
from mmc_gym.network.chain import Floats
from mmc_gym.network.fitting import PAPER, FittingSettings, train_normalizers
from mmc_gym.network.normalizers import LearnedNormalizer, angle_errors, mean_squared_error
from studies.paper.experiment import Settings, pack_arrays

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

_NEAR_ONE = np.linspace(0.9, 1.1, 21)  # the lengths that an arm at rest asks for
_FEW_EPOCHS = 500  # take no longer than to start a process, and torch in it


class TrainedArchitecture(NamedTuple):
    """All runs of one architecture.

    Attributes:
        normalizers: one per run.
        training_mse: on the training samples, (runs, epochs).
        validation_mse: on the validation samples, (runs, epochs).
        grid_mse: over all directions and lengths in ]0, 2], free of the luck of samples, (runs,).
        angle_error: mean absolute angle error at lengths 0.9 to 1.1, degrees, (runs,).
    """

    normalizers: tuple[LearnedNormalizer, ...]
    training_mse: Floats
    validation_mse: Floats
    grid_mse: Floats
    angle_error: Floats


def architecture_name(hidden_units: Sequence[int]) -> str:
    """Return hidden layer sizes as the table and figures write them: "[16]", "[16, 16]"."""
    return str(list(hidden_units))


def trained_architectures(
    settings: Settings,
    architectures: Sequence[Units] | None = None,
    weight_decay: float = PAPER.weight_decay,
) -> dict[str, TrainedArchitecture]:
    """Return networks trained by the paper's recipe, from the settings' folder if they are there.

    Args:
        settings: a quick run trains fewer runs for fewer epochs; progress is told in epochs.
        architectures: hidden layer sizes; by default the paper's twelve, or a quick run's five.
        weight_decay: weight decay of the training; the paper's twelve have none.

    Returns:
        All runs of each architecture, by its name, in the order asked for.
    """
    if architectures is None:
        architectures = QUICK_ARCHITECTURES if settings.quick else ARCHITECTURES
    recipe, runs = (QUICK_RECIPE, QUICK_RUNS) if settings.quick else (PAPER, RUNS)
    recipe = replace(recipe, weight_decay=weight_decay)
    tasks = [_Task(tuple(units), recipe, runs, settings.seed) for units in architectures]
    found = {task: _read(task, settings) for task in tasks}
    missing = [task for task in tasks if found[task] is None]
    missing.sort(key=lambda task: sum(task.hidden_units), reverse=True)  # the longest first
    total, left = recipe.epochs * len(tasks), recipe.epochs * len(missing)
    done = total - left
    settings.on_progress(done, total)
    parallel = settings.jobs > 1 and len(missing) > 1 and left > _FEW_EPOCHS

    def report(epochs: int) -> None:
        nonlocal done
        done += epochs
        settings.on_progress(done, total)

    def keep(index: int, trained: TrainedArchitecture) -> None:
        found[missing[index]] = trained
        if settings.folder:
            path = missing[index].path_in(settings.folder)
            write_atomically(path, _packed(trained, settings.version))
        if parallel:
            report(recipe.epochs)

    train = _train if parallel else partial(_train, tick=partial(report, 1))
    run_grid(train, missing, jobs=settings.jobs if parallel else 1, on_result=keep)
    return {
        architecture_name(task.hidden_units): trained for task, trained in found.items() if trained
    }


@dataclass(frozen=True)
class _Task:
    """The training of one architecture, with all that its result depends on but the version."""

    hidden_units: Units
    recipe: FittingSettings
    runs: int
    seed: int

    def path_in(self, folder: Path) -> Path:
        digest = hashlib.sha256(repr(self).encode()).hexdigest()[:12]
        return folder / "networks" / f"{'x'.join(map(str, self.hidden_units))}-{digest}.npz"


def _train(task: _Task, tick: Callable[[], None] = lambda: None) -> TrainedArchitecture:
    """Train one architecture, and measure it."""
    trained = train_normalizers(
        task.hidden_units, task.recipe, task.runs, task.seed, progress=lambda done, total: tick()
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


def _packed(trained: TrainedArchitecture, version: str) -> bytes:
    arrays = trained._asdict()
    normalizers = arrays.pop("normalizers")
    for layer in range(len(normalizers[0].weights)):
        arrays[f"weights_{layer}"] = np.stack([n.weights[layer] for n in normalizers])
        arrays[f"biases_{layer}"] = np.stack([n.biases[layer] for n in normalizers])
    return pack_arrays(arrays | {"version": np.array(version)})


def _read(task: _Task, settings: Settings) -> TrainedArchitecture | None:
    """Return what is kept; None, with a note, if it is damaged or of another version."""
    path = settings.folder and task.path_in(settings.folder)
    if not path or not path.exists():
        return None
    layers = range(len(task.hidden_units) + 1)
    try:
        # Opened here, because numpy leaves a damaged file open.
        with open(path, "rb") as file, np.load(file) as archive:
            arrays = dict(archive)
        version = str(arrays.get("version", "unknown"))
        normalizers = tuple(
            LearnedNormalizer(
                [arrays[f"weights_{layer}"][run] for layer in layers],
                [arrays[f"biases_{layer}"][run] for layer in layers],
            )
            for run in range(task.runs)
        )
        measures = {name: arrays[name] for name in TrainedArchitecture._fields[1:]}
    except Exception as error:  # zip, zlib, tokenizer, key, shape …: each damage has its own
        settings.on_note(f"{path} is damaged and is made anew ({type(error).__name__})")
        return None
    if version != settings.version:
        settings.on_note(f"{path} was made by version {version} and is made anew")
        return None
    return TrainedArchitecture(normalizers, **measures)
