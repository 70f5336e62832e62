"""Training the MLPs that learn to normalize, several runs of them at once.

Each MLP f sees vectors x = r u of random length r in direction u, and is to answer u (paper,
Sect. "Learning the Normalization Network").  There are two recipes:

* `PAPER`: the paper's.  Adam on the mean squared error |f(x) − u|²/2.  For lengths near 1 it
  ends at mean angle errors of .25 to .5 degrees.
* `ACCURATE`: what the MMC network needs.  Without biases the MLP is odd, f(−x) = −f(x), so that
  it keeps directions down to the shortest vectors; after Adam, `refinement` takes over.

Runs stand on a leading axis: parameters are (runs, P), values (runs, units, samples), samples
(runs, 4, n), each a column of x and u.  The gradient is written out, because autograd's
bookkeeping would cost more than layers of a few units:

    δ_K = ∂E/∂y_K (1 − y_K²),   δ_k = (W_{k+1}ᵀ δ_{k+1}) (1 − y_k²),   ∂E/∂W_k = δ_k y_{k−1}ᵀ

Weight decay λ is the L2 penalty λ Σ w² on the weights of all layers, added to E, as Keras'
`kernel_regularizer=l2(λ)` in every layer would do; so ∂E/∂W_k gains 2 λ W_k, and Adam scales it
as the rest.  The paper's sixty networks have none.

What the package ships was trained, in about a minute, by

    OMP_NUM_THREADS=1 python -m mmc_gym.network.fitting
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from math import inf, pi, sqrt
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from mmc_gym._grid import one_torch_thread
from mmc_gym.network.normalizers import LearnedNormalizer, angle_errors, mean_squared_error

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Refinement:
    """How a normalizer is refined.

    Attributes:
        iterations: steps to take.
        near: lengths within this of 1 weigh 1: they are what an arm at rest asks for.
        far_weight: weight of all other lengths.
        short: length below which the weight falls to 0, because near the zero vector, where
            all directions meet, no MLP does well.
        length_weight: c, weight of the length error relative to the angle error.
    """

    iterations: int = 300
    near: float = 0.3
    far_weight: float = 0.1
    short: float = 0.05
    length_weight: float = 0.3


def refine(
    normalizer: LearnedNormalizer,
    vectors: ArrayLike,
    refinement: Refinement | None = None,
    after_iteration: Callable[[LearnedNormalizer], None] | None = None,
) -> LearnedNormalizer:
    """A normalizer that turns vectors less than the given one.

    An odd MLP, one whose biases are all zero, stays odd.

    Args:
        normalizer: where to begin.
        vectors: vectors to do better on, none of them zero, shape (n, 2).
        refinement: iterations and weights.
        after_iteration: called with the normalizer of every iteration.

    Returns:
        The refined normalizer, without a card.
    """
    refinement = refinement or Refinement()
    vectors = np.asarray(vectors, dtype=np.float64)
    projections = _projections(vectors, refinement)
    is_free = np.concatenate(
        [
            np.concatenate([np.ones(weight.size, bool), np.full(bias.size, bool(np.any(bias)))])
            for weight, bias in zip(normalizer.weights, normalizer.biases, strict=True)
        ]
    )
    values = [vectors, *normalizer.activations(vectors)]
    errors = _errors(values[-1], projections)
    damping = 0.01
    for _ in range(refinement.iterations):
        jacobian = np.concatenate([_jacobian(normalizer, values, a) for a in projections])
        jacobian = jacobian[:, is_free]
        normal, slope = jacobian.T @ jacobian, jacobian.T @ errors
        scale = normal.diagonal() + 1e-12  # a unit that saturates has no slope left
        for _ in range(10):
            step = np.zeros(len(is_free))
            step[is_free] = np.linalg.solve(normal + np.diag(damping * scale), slope)
            candidate = _moved(normalizer, -step)
            candidate_values = [vectors, *candidate.activations(vectors)]
            candidate_errors = _errors(candidate_values[-1], projections)
            if candidate_errors @ candidate_errors < errors @ errors:
                normalizer, values, errors = candidate, candidate_values, candidate_errors
                damping = max(damping / 3, 1e-12)
                break
            damping *= 4
        if after_iteration:
            after_iteration(normalizer)
    return LearnedNormalizer(normalizer.weights, normalizer.biases)


def _projections(vectors: Array, refinement: Refinement) -> list[Array]:
    """What f(x) − u is multiplied with: weighted directions across and along u, each (n, 2)."""
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    along = vectors / lengths
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    weight = np.where(abs(lengths - 1) <= refinement.near, 1.0, refinement.far_weight)
    weight *= np.minimum(lengths / refinement.short, 1)
    return [weight * across, weight * refinement.length_weight * along]


def _errors(output: Array, projections: list[Array]) -> Array:
    """The e's of all vectors, (2 n,)."""
    across, along = projections
    # u · (f − u) = u · f − 1, and the weight of u is the length of the projection itself.
    wanted = np.linalg.norm(along, axis=1)
    errors: Array = np.concatenate([(across * output).sum(1), (along * output).sum(1) - wanted])
    return errors


def _jacobian(normalizer: LearnedNormalizer, values: list[Array], projection: Array) -> Array:
    """∂(a · y_K)/∂parameters of every vector, (n, P)."""
    parts: list[Array] = []
    slope = projection
    for index in reversed(range(len(normalizer.weights))):
        delta = slope * (1 - values[index + 1] ** 2)
        outer = delta[:, :, None] * values[index][:, None, :]
        parts = [outer.reshape(len(delta), -1), delta, *parts]
        slope = delta @ normalizer.weights[index]
    return np.concatenate(parts, axis=1)


def _moved(normalizer: LearnedNormalizer, change: Array) -> LearnedNormalizer:
    """The normalizer with `change` (P,) added to its weights and biases, layer by layer."""
    weights, biases, start = [], [], 0
    for weight, bias in zip(normalizer.weights, normalizer.biases, strict=True):
        middle, end = start + weight.size, start + weight.size + bias.size
        weights.append(weight + change[start:middle].reshape(weight.shape))
        biases.append(bias + change[middle:end])
        start = end
    return LearnedNormalizer(weights, biases)


Errors: TypeAlias = NDArray[np.float64]
Progress: TypeAlias = Callable[[int, int], None]
_Layers: TypeAlias = "list[tuple[Tensor, Tensor]]"


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
        weight_decay: λ of the penalty λ Σ w² on the weights, biases left out, during Adam; recorded
            errors are without it.
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
    weight_decay: float = 0.0
    biases: bool = True
    precision: Literal["float32", "float64"] = "float32"
    refinement: Refinement = field(default_factory=lambda: Refinement(iterations=0))

    def __post_init__(self) -> None:
        for name in ("samples", "epochs", "batch_size"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be 1 or more, got {getattr(self, name)}")
        if not 0 <= self.weight_decay < inf:
            raise ValueError(
                f"weight_decay must be finite and not negative, got {self.weight_decay}"
            )
        if not 0 < self.held_out < self.samples:
            raise ValueError(
                "validation_share must leave samples to train and to validate on, "
                f"got {self.validation_share} of {self.samples}"
            )
        if not self.length_ranges or any(not 0 <= low < high for low, high in self.length_ranges):
            raise ValueError(
                f"length_ranges must be pairs 0 <= low < high, got {self.length_ranges}"
            )

    @property
    def held_out(self) -> int:
        """Number of validation samples."""
        return round(self.validation_share * self.samples)


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
    progress: Progress | None = None,
) -> list[TrainedNormalizer]:
    """Train `runs` MLPs of one architecture together.

    Run r depends on `seed` and r only, whatever the number of runs, up to rounding; its samples
    are the same for every architecture.  On one machine the same arguments give the same
    weights, bit for bit; a refinement's last digits depend on the number of threads that numpy's
    BLAS uses as well.  Random numbers come from own generators.  Torch computes on one thread
    meanwhile, which is fastest for layers this small.

    Args:
        hidden_units: sizes of the hidden layers.
        recipe: `ACCURATE`, `PAPER`, or another.
        runs: number of MLPs, each with its own samples, initial weights and order of samples.
        seed: not negative.
        device: torch's name of the device for Adam; the refinement is numpy's.
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
    widths = (2, *hidden_units, 2)
    total = recipe.epochs + runs * recipe.refinement.iterations
    done = 0

    def tick() -> None:
        nonlocal done
        done += 1
        if progress:
            progress(done, total)

    with one_torch_thread():
        generators = [_generator(seed, run) for run in range(runs)]
        samples = torch.stack([_draw_samples(recipe, generator) for generator in generators])
        parameters = torch.stack([_initial_parameters(widths, g) for g in generators])
        parameters, history = _adam(parameters, widths, samples, generators, recipe, device, tick)
    trained = []
    for run in range(runs):
        normalizer = _normalizer(parameters[run], widths)
        normalizer, refined = _refined(normalizer, samples[run].numpy().T, recipe, tick)
        training_mse, validation_mse = np.concatenate([history[run], refined]).T
        card = {"seed": f"{seed}, run {run}", "validation_mse": f"{validation_mse[-1]:.4g}"}
        card |= _card(normalizer, recipe)
        normalizer = LearnedNormalizer(normalizer.weights, normalizer.biases, card)
        trained.append(TrainedNormalizer(normalizer, training_mse, validation_mse))
    return trained


def _refined(
    normalizer: LearnedNormalizer, samples: Errors, recipe: Recipe, tick: Callable[[], None]
) -> tuple[LearnedNormalizer, Errors]:
    """The normalizer after its refinement on samples (n, 4), and the history (iterations, 2)."""
    validation, training = np.split(samples, [recipe.held_out])
    history: list[list[float]] = []

    def record(current: LearnedNormalizer) -> None:
        errors = [(current(part[:, :2]) - part[:, 2:]) ** 2 for part in (training, validation)]
        history.append([float(error.mean()) for error in errors])
        tick()

    normalizer = refine(normalizer, training[:, :2], recipe.refinement, record)
    return normalizer, np.reshape(history, (-1, 2))


def _card(normalizer: LearnedNormalizer, recipe: Recipe) -> dict[str, str]:
    near = np.degrees(angle_errors(normalizer, np.linspace(0.9, 1.1, 21)))
    everywhere = np.degrees(angle_errors(normalizer, np.geomspace(1e-6, 3.0, 200), directions=720))
    mse = mean_squared_error(normalizer, directions=360)
    return {
        "recipe": repr(recipe),
        "epochs": str(recipe.epochs),
        "refinement_iterations": str(recipe.refinement.iterations),
        "mse": f"{mse:.4g} (all lengths to 2)",
        "mean_angle_error_deg": f"{near.mean():.4g} (lengths 0.9 to 1.1)",
        "worst_angle_error_deg": f"{everywhere.max():.4g} (lengths 1e-6 to 3)",
        "torch": str(torch.__version__),
    }


def _draw_samples(recipe: Recipe, generator: torch.Generator) -> Tensor:
    """Inputs r u and answers u, shuffled, shape (4, samples), rows r u_x, r u_y, u_x, u_y."""
    count = recipe.samples
    angles = torch.arange(count, dtype=torch.float64) * (2 * pi / count)
    ranges = torch.tensor(recipe.length_ranges, dtype=torch.float64)
    low, high = ranges[torch.arange(count) % len(ranges)].T
    # rand is in [0, 1[: counted down from the top it leaves out the zero vector.
    lengths = high - (high - low) * torch.rand(count, dtype=torch.float64, generator=generator)
    directions = torch.stack([angles.cos(), angles.sin()])
    samples = torch.cat([lengths * directions, directions])
    return samples[:, torch.randperm(count, generator=generator)]


def _initial_parameters(widths: Sequence[int], generator: torch.Generator) -> Tensor:
    """Glorot's uniform weights and zero biases (Keras' defaults), shape (P,)."""
    parts = []
    for inputs, outputs in pairwise(widths):
        limit = sqrt(6 / (inputs + outputs))
        weights = torch.empty(outputs * inputs, dtype=torch.float64)
        weights.uniform_(-limit, limit, generator=generator)
        parts += [weights, weights.new_zeros(outputs)]
    return torch.cat(parts)


def _normalizer(parameters: Tensor, widths: Sequence[int]) -> LearnedNormalizer:
    layers = _layers(parameters[None], widths)
    weights = [weights[0].numpy() for weights, _ in layers]
    return LearnedNormalizer(weights, [biases[0, :, 0].numpy() for _, biases in layers])


def _layers(parameters: Tensor, widths: Sequence[int]) -> _Layers:
    """Views of parameters (runs, P): per layer weights (runs, out, in), biases (runs, out, 1)."""
    layers, start = [], 0
    for inputs, outputs in pairwise(widths):
        middle, end = start + outputs * inputs, start + outputs * (inputs + 1)
        weights = parameters[:, start:middle].view(-1, outputs, inputs)
        layers.append((weights, parameters[:, middle:end].unsqueeze(2)))
        start = end
    return layers


def _forward(layers: _Layers, inputs: Tensor) -> list[Tensor]:
    """Values of all layers, the inputs first, each (runs, units, samples)."""
    values = [inputs]
    for weights, biases in layers:
        values.append(torch.baddbmm(biases, weights, values[-1]).tanh_())
    return values


def _gradient(layers: _Layers, values: list[Tensor], slope: Tensor) -> Tensor:
    """∂E/∂parameters, (runs, P), from the slope ∂E/∂y_K, (runs, 2, samples)."""
    parts: list[Tensor] = []
    for index in reversed(range(len(layers))):
        output = values[index + 1]
        delta = torch.addcmul(slope, slope * output, output, value=-1)
        parts = [(delta @ values[index].mT).flatten(1), delta.sum(2), *parts]
        slope = layers[index][0].mT @ delta
    return torch.cat(parts, dim=1)


def _penalty_gradient(layers: _Layers, weight_decay: float) -> Tensor:
    """∂(λ Σ w²)/∂parameters, (runs, P): 2 λ w for weights, 0 for biases."""
    parts: list[Tensor] = []
    for weights, biases in layers:
        parts += [2 * weight_decay * weights.flatten(1), torch.zeros_like(biases[..., 0])]
    return torch.cat(parts, dim=1)


def _adam(
    parameters: Tensor,
    widths: Sequence[int],
    samples: Tensor,
    generators: Sequence[torch.Generator],
    recipe: Recipe,
    device: str,
    tick: Callable[[], None],
) -> tuple[Tensor, Errors]:
    """Adam on the mean squared error; the fitted parameters, and the history (runs, epochs, 2)."""
    dtype = torch.float32 if recipe.precision == "float32" else torch.float64
    # The biases are what starts at zero.
    trainable = (parameters != 0).to(device, dtype) if not recipe.biases else None
    parameters, samples = parameters.to(device, dtype, copy=True), samples.to(device, dtype)
    validation, training = samples[..., : recipe.held_out], samples[..., recipe.held_out :]
    layers, count = _layers(parameters, widths), training.shape[2]
    mean, variance = torch.zeros_like(parameters), torch.zeros_like(parameters)
    history, update = [], 0
    for _ in range(recipe.epochs):
        orders = [torch.randperm(count, generator=generator) for generator in generators]
        order = torch.stack(orders).to(device)[:, None].expand_as(training)
        total = training.new_zeros(len(parameters))
        for batch in torch.split(training.gather(2, order), recipe.batch_size, dim=2):
            values = _forward(layers, batch[:, :2])
            error = values[-1] - batch[:, 2:]
            total += error.square().sum((1, 2))
            gradient = _gradient(layers, values, error / batch.shape[2])
            if recipe.weight_decay:
                gradient += _penalty_gradient(layers, recipe.weight_decay)
            if trainable is not None:
                gradient *= trainable
            update += 1
            mean.lerp_(gradient, 0.1)
            variance.mul_(0.999).addcmul_(gradient, gradient, value=0.001)
            # Keras adds its 1e-7 before the bias correction, torch's Adam adds 1e-8 after it.
            step = recipe.learning_rate * sqrt(1 - 0.999**update) / (1 - 0.9**update)
            parameters.addcdiv_(mean, variance.sqrt().add_(1e-7), value=-step)
        error = _forward(layers, validation[:, :2])[-1] - validation[:, 2:]
        history.append(torch.stack([total / (2 * count), error.square().mean((1, 2))], dim=1))
        tick()
    return parameters.double().cpu(), torch.stack(history, dim=1).double().cpu().numpy()


def _generator(seed: int, run: int) -> torch.Generator:
    # A seed sequence, so that run 1 of seed 0 and run 0 of seed 1 share nothing.  Drawing on the
    # CPU gives every device the same samples.
    state = np.random.SeedSequence((seed, run)).generate_state(1, np.uint64)
    return torch.Generator().manual_seed(int(state[0]))


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
