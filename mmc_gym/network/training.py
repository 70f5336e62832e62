"""Training the MLPs that learn to normalize, several runs of them at once.

Each MLP f sees vectors x = r u of random length r in direction u, and is to answer u (paper,
Sect. "Learning the Normalization Network").  There are two recipes:

* `PAPER`: the paper's.  Adam on the mean squared error |f(x) − u|²/2.  For lengths near 1 it
  ends at mean angle errors of .25 to .5 degrees, from which the MMC network inherits a floor.
* `ACCURATE`: what the MMC network needs.  Without biases the MLP is odd, f(−x) = −f(x), so that
  it keeps directions down to the shortest vectors; and after Adam, Levenberg-Marquardt refines
  angle and length, the parts of f(x) − u across and along u, weighted for lengths near 1:

      E = Σ w(r)² [(u × f)² + c² (u · f − 1)²]

  An MLP this small has few enough parameters to solve for the best step exactly, which leads
  two to three orders of magnitude further than gradient descent.

What the package ships is trained, in less than a minute, by

    python -m mmc_gym.network.training
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from math import pi
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from mmc_gym.network.normalization import LearnedNormalizer, angle_errors, mean_squared_error
from mmc_gym.network.perceptrons import Perceptrons, adam, levenberg_marquardt


@dataclass(frozen=True)
class Refinement:
    """Levenberg-Marquardt iterations on the angle and length errors.

    Attributes:
        iterations: how many.
        near: lengths within this of 1 weigh 1: they are what a body model at rest asks for.
        far_weight: weight of all other lengths.
        length_weight: c, weight of the length error relative to the angle error.
    """

    iterations: int = 300
    near: float = 0.3
    far_weight: float = 0.1
    length_weight: float = 0.3


@dataclass(frozen=True)
class Recipe:
    """How normalization MLPs are trained; the defaults are the paper's values.

    Attributes:
        name: written on the card of what was trained.
        samples: number of vectors, their directions spread evenly over the circle.
        length_ranges: lengths are uniform in ]low, high]; sample k takes range k mod their number.
        validation_share: share of the samples, drawn at random, that is not trained on.
        epochs: passes of Adam over the training samples.
        batch_size: samples per update.
        learning_rate: Adam's step size.
        biases: whether units have biases; without them the MLP is odd.
        precision: floating point type to train in.
        refinement: what follows Adam, which is nothing at zero iterations.

    Raises:
        ValueError: if a value is out of range.
    """

    name: str = "paper"
    samples: int = 3600
    length_ranges: tuple[tuple[float, float], ...] = ((0.0, 2.0),)
    validation_share: float = 0.2
    epochs: int = 400
    batch_size: int = 16
    learning_rate: float = 0.001
    biases: bool = True
    precision: Literal["float32", "float64"] = "float32"
    refinement: Refinement = field(default_factory=lambda: Refinement(iterations=0))

    def __post_init__(self) -> None:
        for name in ("samples", "epochs", "batch_size"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be 1 or more, got {getattr(self, name)}")
        held_out = round(self.validation_share * self.samples)
        if not 0 < held_out < self.samples:
            raise ValueError(
                "validation_share must leave samples to train and to validate on, "
                f"got {self.validation_share} of {self.samples}"
            )
        if not self.length_ranges or any(not 0 <= low < high for low, high in self.length_ranges):
            raise ValueError(
                f"length_ranges must be pairs 0 <= low < high, got {self.length_ranges}"
            )


PAPER = Recipe()
ACCURATE = Recipe(
    name="accurate",
    samples=7200,
    length_ranges=((0.0, 3.0), (0.8, 1.2)),
    epochs=100,
    biases=False,
    precision="float64",
    refinement=Refinement(),
)
RECIPES = {recipe.name: recipe for recipe in (ACCURATE, PAPER)}


@dataclass(frozen=True, eq=False)
class TrainedNormalizer:
    """A normalizer and how it came about.

    Attributes:
        normalizer: the trained MLP; its card tells recipe, seed, and measured errors.
        training_mse: mean squared error on the training samples, one entry per epoch (mean over
            its batches, as they were met), then one per refinement iteration.
        validation_mse: the same on the validation samples, after each epoch or iteration.
    """

    normalizer: LearnedNormalizer
    training_mse: NDArray[np.float64]
    validation_mse: NDArray[np.float64]


def train_normalizers(
    hidden_units: Sequence[int] = (16, 16),
    recipe: Recipe = ACCURATE,
    runs: int = 1,
    seed: int = 0,
    device: str = "cpu",
    progress: Callable[[int, int], None] | None = None,
) -> list[TrainedNormalizer]:
    """Train `runs` MLPs of one architecture together.

    Run r depends on `seed` and r only, whatever the number of runs, up to rounding; its samples
    are the same for every architecture.  On one machine the same arguments give the same
    weights, bit for bit.  Random numbers come from own generators.  Torch computes on one thread
    meanwhile, which is fastest for layers this small.

    Args:
        hidden_units: sizes of the hidden layers.
        recipe: `ACCURATE`, `PAPER`, or another.
        runs: number of MLPs, each with its own samples, initial weights and order of samples.
        seed: not negative.
        device: torch's name of the device to train on.
        progress: called with (epochs and refinement iterations done, their total number).

    Returns:
        One trained normalizer per run.

    Raises:
        ValueError: if `runs`, a layer size, or `seed` is out of range.
    """
    for name, value, least in (("runs", runs, 1), ("seed", seed, 0)):
        if value < least:
            raise ValueError(f"{name} must be {least} or more, got {value}")
    if not hidden_units or min(hidden_units) < 1:
        raise ValueError(f"hidden_units must be 1 or more each, got {tuple(hidden_units)}")
    dtype = torch.float32 if recipe.precision == "float32" else torch.float64
    iterations = recipe.refinement.iterations
    tick = _counter(progress, recipe.epochs + runs * iterations)
    generators = [_generator(seed, run) for run in range(runs)]

    with _one_thread():
        samples = torch.stack([_draw_samples(recipe, generator) for generator in generators])
        samples = samples.to(device, dtype)
        held_out = round(recipe.validation_share * recipe.samples)
        validation, training = samples[..., :held_out], samples[..., held_out:]
        widths = (2, *hidden_units, 2)
        perceptrons = Perceptrons.initial(widths, generators, recipe.biases).to(device, dtype)
        descent = adam(
            perceptrons,
            training,
            validation,
            generators,
            recipe.epochs,
            recipe.batch_size,
            recipe.learning_rate,
            tick,
        )
        histories = list(descent)
        if iterations:
            for run in range(runs):  # one by one: each has its own step size, and J is large
                one = slice(run, run + 1)
                projections = _projections(training[one], recipe.refinement)
                refined = levenberg_marquardt(
                    perceptrons.run(run),
                    training[one],
                    validation[one],
                    projections,
                    iterations,
                    tick,
                )
                histories[run] = torch.cat([histories[run], refined])
    final = perceptrons.to("cpu", torch.float64)
    return [
        _trained(final.run(run), history.double().cpu().numpy(), recipe, f"{seed}, run {run}")
        for run, history in enumerate(histories)
    ]


def _trained(
    perceptron: Perceptrons, history: NDArray[np.float64], recipe: Recipe, seed: str
) -> TrainedNormalizer:
    weights = [weight[0].numpy() for weight, _ in perceptron.layers]
    biases = [bias[0, :, 0].numpy() for _, bias in perceptron.layers]
    measured = LearnedNormalizer(weights, biases)
    near = np.degrees(angle_errors(measured, np.linspace(0.9, 1.1, 21)))
    everywhere = np.degrees(angle_errors(measured, np.geomspace(1e-6, 3.0, 500)))
    card = {
        "recipe": repr(recipe),
        "seed": seed,
        "epochs": str(recipe.epochs),
        "refinement_iterations": str(recipe.refinement.iterations),
        "validation_mse": f"{history[-1, 1]:.4g}",
        "mse": f"{mean_squared_error(measured):.4g} (all lengths to 2)",
        "mean_angle_error_deg": f"{near.mean():.4g} (lengths 0.9 to 1.1)",
        "worst_angle_error_deg": f"{everywhere.max():.4g} (lengths 1e-6 to 3)",
        "torch": str(torch.__version__),
    }
    normalizer = LearnedNormalizer(weights, biases, card)
    return TrainedNormalizer(normalizer, history[:, 0].copy(), history[:, 1].copy())


def _draw_samples(recipe: Recipe, generator: torch.Generator) -> Tensor:
    """Inputs r u and answers u, shuffled, shape (4, samples), rows r u_x, r u_y, u_x, u_y."""
    count = recipe.samples
    angles = torch.arange(count, dtype=torch.float64) * (2 * pi / count)
    ranges = torch.tensor(recipe.length_ranges, dtype=torch.float64)
    low, high = ranges[torch.arange(count) % len(ranges)].T
    lengths = high - (high - low) * torch.rand(count, dtype=torch.float64, generator=generator)
    directions = torch.stack([angles.cos(), angles.sin()])
    samples = torch.cat([lengths * directions, directions])
    return samples[:, torch.randperm(count, generator=generator)]


def _projections(samples: Tensor, refinement: Refinement) -> tuple[Tensor, Tensor]:
    """What to multiply f(x) − u with for its weighted parts across and along u, (runs, 2, n)."""
    direction = samples[:, 2:]
    length = samples[:, :2].norm(dim=1, keepdim=True)
    weight = torch.where((length - 1).abs() <= refinement.near, 1.0, refinement.far_weight)
    weight = weight * (2 * length).clamp(max=1)  # no MLP does well where all directions meet
    left = torch.cat([-direction[:, 1:], direction[:, :1]], dim=1)
    return weight * left, weight * refinement.length_weight * direction


def _counter(progress: Callable[[int, int], None] | None, total: int) -> Callable[[], None]:
    """A function that counts its calls and reports them."""
    done = 0

    def tick() -> None:
        nonlocal done
        done += 1
        if progress:
            progress(done, total)

    return tick


def _generator(seed: int, run: int) -> torch.Generator:
    # A seed sequence, so that run 1 of seed 0 and run 0 of seed 1 share nothing.  Drawing on the
    # CPU gives every device the same samples.
    state = np.random.SeedSequence((seed, run)).generate_state(1, np.uint64)
    return torch.Generator().manual_seed(int(state[0]))


@contextmanager
def _one_thread() -> Iterator[None]:
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


def main(arguments: Sequence[str] | None = None) -> None:
    """Train the normalizers that the package ships and write their files."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--folder", type=Path, default=Path(__file__).parent / "weights")
    folder = parser.parse_args(arguments).folder
    for name, recipe in RECIPES.items():
        normalizer = train_normalizers(recipe=recipe)[0].normalizer
        path = folder / f"{name}-16x16.safetensors"
        normalizer.save(path)
        print(path, *(f"{key}: {value}" for key, value in normalizer.card.items()), sep="\n  ")


if __name__ == "__main__":
    main()
