"""Train MLPs that normalize vectors, several runs at once.

Each MLP f gets vectors x = r u of random length r in direction u, and learns to return u (paper,
Sect. "Learning the Normalization Network").  There are two recipes:

* `PAPER`: the paper's.  Adam on the mean squared error E = |f(x) − u|²/2.  For lengths near 1 it
  ends at mean angle errors of .25 to .5 degrees.
* `ACCURATE`: what the MMC network needs.  Without biases the MLP is odd, f(−x) = −f(x), so that
  it keeps the direction of even the shortest vectors.  After Adam, Levenberg and Marquardt's method
  refines it.

Weight decay λ adds the L2 penalty λ Σ w² on the weights of all layers to E, as Keras'
`kernel_regularizer=l2(λ)` in every layer does: ∂E/∂W_k gains 2 λ W_k.  The paper's sixty networks
have none.

Runs are the leading axis: parameters are (runs, P), values (runs, units, samples), samples
(runs, 4, n), each a column of x and u.

This command trains the normalizers that ship with the package, in about a minute:

    OMP_NUM_THREADS=1 python -m studies.network.fitting
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import pi, sqrt
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np
import torch
import tyro
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from mmc_gym import UserError
from mmc_gym.geometry import Floats
from mmc_gym.network.normalizers import WEIGHTS, LearnedNormalizer, Normalizer

Array: TypeAlias = NDArray[np.float64]
_Layers: TypeAlias = "list[tuple[Tensor, Tensor]]"

BATCH_SIZE = 16  # samples per update of Adam
LEARNING_RATE = 0.001  # step size of Adam

# What the refinement weighs:
NEAR = 0.3  # lengths within this of 1 have weight 1, because an arm at rest needs them
FAR_WEIGHT = 0.1  # of all other lengths
SHORT = 0.05  # length below which the weight falls to 0: no MLP does well near the zero vector
LENGTH_WEIGHT = 0.3  # c, weight of the length error relative to the angle error


@dataclass(frozen=True)
class FittingSettings:
    """Settings of the training of normalization MLPs; the defaults are the paper's values.

    Attributes:
        name: name that is written on the card.
        samples: number of vectors, their directions spread evenly over the circle.  A random fifth
            of them is held out of the training, for validation.
        length_ranges: lengths are uniform in ]low, high]; sample k takes range k mod their number.
        epochs: passes of Adam over the training samples.
        weight_decay: λ of the penalty λ Σ w² on the weights, without the biases, during Adam;
            recorded errors are without it.
        biases: whether units have biases; without them the MLP is odd.
        precision: floating point type to train in.
        refinement_iterations: iterations of Levenberg and Marquardt's method after Adam.
    """

    name: str = "paper"
    samples: int = 3600
    length_ranges: tuple[tuple[float, float], ...] = ((0.0, 2.0),)
    epochs: int = 400
    weight_decay: float = 0.0
    biases: bool = True
    precision: Literal["float32", "float64"] = "float32"
    refinement_iterations: int = 0

    @property
    def held_out(self) -> int:
        """Number of validation samples."""
        return round(0.2 * self.samples)


PAPER = FittingSettings()
ACCURATE = FittingSettings(
    name="accurate",
    samples=7200,
    length_ranges=((0.0, 3.0), (0.8, 1.2)),
    epochs=100,
    biases=False,
    precision="float64",
    refinement_iterations=300,
)
RECIPES = {recipe.name: recipe for recipe in (ACCURATE, PAPER)}


@dataclass(frozen=True, eq=False)
class TrainedNormalizer:
    """A normalizer and the history of its training.

    Attributes:
        normalizer: the trained MLP; its card has recipe, seed, and measured errors.
        training_mse: mean squared error on the training samples in each epoch of Adam, the mean
            over its batches at the time, (epochs,).
        validation_mse: mean squared error on the validation samples after each epoch, (epochs,).
    """

    normalizer: LearnedNormalizer
    training_mse: Array
    validation_mse: Array


def train_normalizers(
    hidden_units: Sequence[int] = (16, 16),
    recipe: FittingSettings = ACCURATE,
    runs: int = 1,
    seed: int = 0,
) -> list[TrainedNormalizer]:
    """Train `runs` MLPs of one architecture together.

    Up to rounding, run r depends only on `seed` and r, not on the number of runs.  Its samples are
    the same for every architecture.  On one machine the same arguments give the same weights, bit
    for bit; after a refinement the last digits also depend on the number of threads of numpy's
    BLAS.  Torch's global random numbers do not change.  Torch computes on one thread, which is
    fastest for layers this small.

    Args:
        hidden_units: sizes of the hidden layers.
        recipe: `ACCURATE`, `PAPER`, or another.
        runs: number of MLPs, each with its own samples, initial weights and order of samples.
        seed: seed of all random numbers, not negative.

    Returns:
        One trained normalizer per run.

    Raises:
        UserError: if `runs` or a layer size is out of range, or there is no layer.
    """
    if min(runs, *hidden_units, len(hidden_units)) < 1:
        raise UserError(
            f"runs and hidden_units must be at least 1, got {runs} and {tuple(hidden_units)}"
        )
    widths = (2, *hidden_units, 2)
    generators = [_generator(seed, run) for run in range(runs)]
    samples = torch.stack([_draw_samples(recipe, generator) for generator in generators])
    parameters = torch.stack([_initial_parameters(widths, g) for g in generators])
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        parameters, history = _adam(parameters, widths, samples, generators, recipe)
    finally:
        torch.set_num_threads(threads)
    trained = []
    for run in range(runs):
        validation, training = np.split(samples[run].numpy().T, [recipe.held_out])
        refined = _refine(parameters[run], widths, training[:, :2], recipe.refinement_iterations)
        normalizer = _normalizer(refined, widths)
        error = np.mean((normalizer(validation[:, :2]) - validation[:, 2:]) ** 2)
        card = {"seed": f"{seed}, run {run}", "validation_mse": f"{error:.4g}"}
        card |= _card(normalizer, recipe)
        normalizer = LearnedNormalizer(normalizer.weights, normalizer.biases, card)
        trained.append(TrainedNormalizer(normalizer, *history[run].T))
    return trained


def _card(normalizer: LearnedNormalizer, recipe: FittingSettings) -> dict[str, str]:
    near = np.degrees(angle_errors(normalizer, np.linspace(0.9, 1.1, 21)))
    everywhere = np.degrees(angle_errors(normalizer, np.geomspace(1e-6, 3.0, 200), directions=720))
    mse = mean_squared_error(normalizer, directions=360)
    return {
        "recipe": repr(recipe),
        "mse": f"{mse:.4g} (all lengths to 2)",
        "mean_angle_error_deg": f"{near.mean():.4g} (lengths 0.9 to 1.1)",
        "worst_angle_error_deg": f"{everywhere.max():.4g} (lengths 1e-6 to 3)",
        "torch": str(torch.__version__),
    }


def _generator(seed: int, run: int) -> torch.Generator:
    # With a seed sequence run 1 of seed 0 and run 0 of seed 1 share nothing.
    state = np.random.SeedSequence((seed, run)).generate_state(1, np.uint64)
    return torch.Generator().manual_seed(int(state[0]))


def _draw_samples(recipe: FittingSettings, generator: torch.Generator) -> Tensor:
    """Draw inputs r u and answers u, shuffled: rows r u_x, r u_y, u_x, u_y, (4, samples)."""
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
    """Draw Glorot's uniform weights, with zero biases (Keras' defaults), shape (P,)."""
    parts = []
    for inputs, outputs in pairwise(widths):
        limit = sqrt(6 / (inputs + outputs))
        weights = torch.empty(outputs * inputs, dtype=torch.float64)
        weights.uniform_(-limit, limit, generator=generator)
        parts += [weights, weights.new_zeros(outputs)]
    return torch.cat(parts)


def _normalizer(parameters: Tensor, widths: Sequence[int]) -> LearnedNormalizer:
    """Make a normalizer of the parameters (P,) of one run."""
    layers = _layers(parameters[None], widths)
    weights = [weights[0].numpy() for weights, _ in layers]
    return LearnedNormalizer(weights, [biases[0, :, 0].numpy() for _, biases in layers])


def _layers(parameters: Tensor, widths: Sequence[int]) -> _Layers:
    """View parameters (runs, P) as layers: weights (runs, out, in) and biases (runs, out, 1)."""
    layers, start = [], 0
    for inputs, outputs in pairwise(widths):
        middle, end = start + outputs * inputs, start + outputs * (inputs + 1)
        weights = parameters[:, start:middle].view(-1, outputs, inputs)
        layers.append((weights, parameters[:, middle:end].unsqueeze(2)))
        start = end
    return layers


def _forward(layers: _Layers, inputs: Tensor) -> list[Tensor]:
    """Return the values of all layers, the inputs first, each (runs, units, samples)."""
    values = [inputs]
    for weights, biases in layers:
        values.append(torch.baddbmm(biases, weights, values[-1]).tanh_())
    return values


def _gradient(layers: _Layers, values: list[Tensor], slope: Tensor) -> Tensor:
    """Return ∂E/∂parameters, (runs, P), from the slope ∂E/∂y_K, (runs, 2, samples).

    It is written out, because autograd costs more than layers of a few units:

        δ_K = ∂E/∂y_K (1 − y_K²),   δ_k = (W_{k+1}ᵀ δ_{k+1}) (1 − y_k²),   ∂E/∂W_k = δ_k y_{k−1}ᵀ
    """
    parts: list[Tensor] = []
    for index in reversed(range(len(layers))):
        output = values[index + 1]
        delta = torch.addcmul(slope, slope * output, output, value=-1)
        parts = [(delta @ values[index].mT).flatten(1), delta.sum(2), *parts]
        slope = layers[index][0].mT @ delta
    return torch.cat(parts, dim=1)


def _adam(
    parameters: Tensor,
    widths: Sequence[int],
    samples: Tensor,
    generators: Sequence[torch.Generator],
    recipe: FittingSettings,
) -> tuple[Tensor, Array]:
    """Run Adam; return the fitted parameters and the history of errors (runs, epochs, 2)."""
    dtype = torch.float32 if recipe.precision == "float32" else torch.float64
    is_weight = (parameters != 0).to(dtype)  # only biases start at zero
    parameters, samples = parameters.to(dtype, copy=True), samples.to(dtype)
    validation, training = samples[..., : recipe.held_out], samples[..., recipe.held_out :]
    layers, count = _layers(parameters, widths), training.shape[2]
    mean, variance = torch.zeros_like(parameters), torch.zeros_like(parameters)
    history, update = [], 0
    for _ in range(recipe.epochs):
        orders = [torch.randperm(count, generator=generator) for generator in generators]
        order = torch.stack(orders)[:, None].expand_as(training)
        total = training.new_zeros(len(parameters))
        for batch in torch.split(training.gather(2, order), BATCH_SIZE, dim=2):
            values = _forward(layers, batch[:, :2])
            error = values[-1] - batch[:, 2:]
            total += error.square().sum((1, 2))
            gradient = _gradient(layers, values, error / batch.shape[2])
            if recipe.weight_decay:
                gradient += 2 * recipe.weight_decay * is_weight * parameters
            if not recipe.biases:
                gradient *= is_weight
            update += 1
            mean.lerp_(gradient, 0.1)
            variance.mul_(0.999).addcmul_(gradient, gradient, value=0.001)
            # Keras adds its 1e-7 before the bias correction, torch's Adam adds 1e-8 after it.
            step = LEARNING_RATE * sqrt(1 - 0.999**update) / (1 - 0.9**update)
            parameters.addcdiv_(mean, variance.sqrt().add_(1e-7), value=-step)
        error = _forward(layers, validation[:, :2])[-1] - validation[:, 2:]
        history.append(torch.stack([total / (2 * count), error.square().mean((1, 2))], dim=1))
    return parameters.double(), torch.stack(history, dim=1).double().numpy()


def _refine(parameters: Tensor, widths: Sequence[int], vectors: Array, iterations: int) -> Tensor:
    """Refine an MLP so that it turns vectors less; return its new parameters (P,).

    Adam leaves angle errors of some tenths of a degree, and with them a floor under an MMC
    network's distance to its target.  Here the parts of f(x) − u across and along u are made
    small, with weights w(r) for the lengths of the vectors x = r u, (n, 2),

        E = Σ e²,   e = [w (u × f(x)),  w c (u · f(x) − 1)]

    A small MLP has few enough parameters P to solve (JᵀJ + λ diag JᵀJ) Δ = Jᵀe, with J = ∂e/∂P, for
    the step Δ (Levenberg and Marquardt).  An odd MLP, whose biases are all zero, stays odd.
    """
    projections = _projections(vectors)
    is_free = (parameters != 0).numpy()  # only the biases of an odd MLP are 0
    normalizer = _normalizer(parameters, widths)
    values: list[Floats] = [vectors, *normalizer.activations(vectors)]
    errors = _errors(values[-1], projections)
    damping = 0.01
    for _ in range(iterations):
        jacobian = np.concatenate([_jacobian(normalizer, values, a) for a in projections])
        jacobian = jacobian[:, is_free]
        normal, slope = jacobian.T @ jacobian, jacobian.T @ errors
        scale = normal.diagonal() + 1e-12  # a unit that saturates has no slope left
        for _ in range(10):
            moved = parameters.clone()
            step = np.linalg.solve(normal + np.diag(damping * scale), slope)
            moved[is_free] -= torch.from_numpy(step)
            candidate = _normalizer(moved, widths)
            candidate_values: list[Floats] = [vectors, *candidate.activations(vectors)]
            candidate_errors = _errors(candidate_values[-1], projections)
            if candidate_errors @ candidate_errors < errors @ errors:
                parameters, normalizer = moved, candidate
                values, errors = candidate_values, candidate_errors
                damping = max(damping / 3, 1e-12)
                break
            damping = min(4 * damping, 1e300)  # it grows for ever where nothing more is gained
    return parameters


def _projections(vectors: Array) -> list[Array]:
    """Return weighted directions across and along u, (n, 2) each, for projections of f(x) − u."""
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    along = vectors / lengths
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    weight = np.where(abs(lengths - 1) <= NEAR, 1.0, FAR_WEIGHT)
    weight *= np.minimum(lengths / SHORT, 1)
    return [weight * across, weight * LENGTH_WEIGHT * along]


def _errors(output: Floats, projections: list[Array]) -> Array:
    """Return the errors e of all vectors, (2 n,)."""
    across, along = projections
    # u · (f − u) = u · f − 1, and the weight of u is the length of the projection itself.
    ideal = np.linalg.norm(along, axis=1)
    errors: Array = np.concatenate([(across * output).sum(1), (along * output).sum(1) - ideal])
    return errors


def _jacobian(normalizer: LearnedNormalizer, values: list[Floats], projection: Array) -> Array:
    """Return ∂(a · y_K)/∂parameters of every vector, a its `projection`, (n, P)."""
    parts: list[Array] = []
    slope = projection
    for index in reversed(range(len(normalizer.weights))):
        delta = slope * (1 - values[index + 1] ** 2)
        outer = delta[:, :, None] * values[index][:, None, :]
        parts = [outer.reshape(len(delta), -1), delta, *parts]
        slope = delta @ normalizer.weights[index]
    return np.concatenate(parts, axis=1)


def angle_errors(normalizer: Normalizer, lengths: ArrayLike, directions: int = 3600) -> Floats:
    """Measure by how much a normalizer turns vectors; the ideal is 0.

    Args:
        normalizer: the normalizer to measure.
        lengths: lengths of the vectors to normalize, shape (n,).
        directions: number of directions, spread evenly over the circle.

    Returns:
        Absolute angles in radians between input and output, shape (n, directions).
    """
    units = _directions(directions)
    output = normalizer(np.asarray(lengths, dtype=np.float64)[:, None, None] * units)
    x, y = units.T
    across = x * output[..., 1] - y * output[..., 0]
    along = x * output[..., 0] + y * output[..., 1]
    errors: Floats = np.abs(np.arctan2(across, along))
    return errors


def mean_squared_error(normalizer: Normalizer, directions: int = 3600) -> float:
    """Return the mean of |output − direction|²/2, the paper's loss, over an even grid of vectors.

    Args:
        normalizer: the normalizer to measure; its inputs have 1,000 lengths, spread evenly over the
            paper's ]0, 2].
        directions: number of directions, spread evenly over the circle.
    """
    units = _directions(directions)
    lengths = np.arange(0.001, 2.0, 0.002)
    return float(np.mean((normalizer(lengths[:, None, None] * units) - units) ** 2))


def _directions(count: int) -> Floats:
    """Return unit vectors spread evenly over the circle, (count, 2)."""
    angles = np.arange(count) * (2 * np.pi / count)
    return np.stack([np.cos(angles), np.sin(angles)], axis=-1)


def main(folder: Path = WEIGHTS) -> None:
    """Train the normalizers that the package ships, and write their files.

    Args:
        folder: where to write; by default the package's own, whose files are overwritten.
    """
    for name, recipe in RECIPES.items():
        normalizer = train_normalizers(recipe=recipe)[0].normalizer
        path = folder / f"{name}-16x16.safetensors"
        normalizer.save(path)
        print(path, *(f"{key}: {value}" for key, value in normalizer.card.items()), sep="\n  ")


if __name__ == "__main__":
    tyro.cli(main)
