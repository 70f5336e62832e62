"""Normalizers bring each segment vector back to its length after an iteration.

Euclidean (the classical network):   L = ℓ · L̃ / |L̃|
Learned (the paper, Sect. "Learning Non-Linearities"): a small MLP f, with tanh in hidden and
output units, is trained to map any vector onto the unit circle without turning it,

    L = ℓ · f(L̃ / ℓ),      f(x) = tanh(W_K … tanh(W_1 x + b_1) … + b_K).

Inside the network the batch is the last axis, (rows, 2, batch), so that an iteration is one matrix
product over contiguous memory.  `normalize_rows` takes that layout and works in place.  A call of
the normalizer takes the usual layout, (..., 2).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from pathlib import Path
from typing import Literal, get_args

import numpy as np
import safetensors.numpy
from numpy.typing import ArrayLike
from safetensors import SafetensorError, safe_open
from typing_extensions import override

from mmc_gym._errors import UserError, require, require_array, require_choice
from mmc_gym._files import UNSEALED, check_seal, seal, write_atomically
from mmc_gym.geometry import Floats

ShippedNormalizer = Literal["accurate", "paper"]
WEIGHTS = Path(__file__).parent / "weights"

# A library for matrices sums the columns that are left over from its blocks in another order, and
# the rows, too, if it shares them out among threads: OpenBLAS does beyond so many multiplications.
_BLOCK, _MOST_UNSHARED = 8, 2**18

# Vectors normalized at once: what the layers make of them stays in the second-level cache.
_AT_ONCE = 1024


def whole_blocks(columns: int) -> int:
    """Return the columns with which `product` gives each the same bits in any batch."""
    return -(-columns // _BLOCK) * _BLOCK


def product(matrix: Floats, columns: Floats, out: Floats | None = None) -> Floats:
    """Return matrix @ columns; in float64 each of `whole_blocks` has the same bits among any."""
    step = max(_BLOCK, _MOST_UNSHARED // matrix.size // _BLOCK * _BLOCK)
    if columns.shape[1] <= step:
        return matrix.dot(columns, out)
    out = np.empty((len(matrix), columns.shape[1]), columns.dtype) if out is None else out
    for start in range(0, columns.shape[1], step):
        part = slice(start, start + step)
        np.matmul(matrix, columns[:, part], out=out[:, part])
    return out


class Normalizer(ABC):
    """Brings vectors to given lengths, keeping (about) their direction."""

    @abstractmethod
    def normalize_rows(self, rows: Floats, lengths: Floats) -> None:
        """Normalize vectors in place.

        The batch is last, (n, 2, batch).  Lengths are of the same dtype, (n, 1) or (n, batch).
        """

    def __call__(self, vectors: ArrayLike, lengths: ArrayLike = 1.0) -> Floats:
        """Return normalized copies of `vectors` (..., 2); `lengths` broadcasts against (...)."""
        vectors = require_array("vectors", vectors)
        require(vectors.shape[-1:] == (2,), "vectors", vectors.shape, "of shape (..., 2)")
        lengths = require_array("lengths", lengths).astype(vectors.dtype)
        shape = np.broadcast_shapes(vectors.shape[:-1], lengths.shape)
        # Each vector may have another length, so each is a row with a batch of one.
        rows = np.broadcast_to(vectors, (*shape, 2)).reshape(-1, 2, 1).copy()
        self.normalize_rows(rows, np.broadcast_to(lengths, shape).reshape(-1, 1))
        return rows.reshape(*shape, 2)


class EuclideanNormalizer(Normalizer):
    """L = ℓ · L̃ / |L̃|, exact.

    The zero vector becomes (ℓ, 0), as atan2(0, 0) = 0 says.
    """

    @override
    def normalize_rows(self, rows: Floats, lengths: Floats) -> None:
        # Gives the zero vector a direction; below the rounding error of all other vectors.
        rows[:, 0] += _NUDGE[rows.dtype.char]
        squares = rows * rows
        scale = squares[:, 0] + squares[:, 1]
        np.sqrt(scale, out=scale)
        np.divide(lengths, scale, out=scale)
        np.multiply(rows, scale[:, None], out=rows)

    def __repr__(self) -> str:
        return "EuclideanNormalizer()"


# The square of each is still a normal number of its dtype.
_NUDGE = {"d": 1e-150, "f": 1e-18}


_SEAL = "sha256"  # entry of the metadata, see `seal`


class LearnedNormalizer(Normalizer):
    """L = ℓ · f(L̃ / ℓ) with the MLP f, every layer tanh(W x + b), in float64.

    The `card` has strings that describe its training, stored with the weights.
    """

    def __init__(
        self,
        weights: Sequence[ArrayLike],
        biases: Sequence[ArrayLike],
        card: dict[str, str] | None = None,
    ) -> None:
        """Make a normalizer of layers from 2 inputs to 2 outputs.

        Weights are (outputs, inputs), biases (outputs,).
        """
        self.weights = [np.array(require_array("weights", layer), np.float64) for layer in weights]
        self.biases = [np.array(require_array("biases", layer), np.float64) for layer in biases]
        self.card = dict(card or {})
        shapes = [weight.shape for weight in self.weights]
        bias_shapes = [bias.shape for bias in self.biases]
        widths = [2, *(bias.size for bias in self.biases)]
        ends_in_2 = bool(shapes) and widths[-1] == 2
        are_vectors = all(len(shape) == 1 for shape in bias_shapes)
        are_layers = shapes == [*zip(widths[1:], widths[:-1], strict=True)]
        if not (ends_in_2 and are_vectors and are_layers):
            raise UserError(
                f"layers must lead from 2 inputs to 2 outputs, got weights of shapes {shapes} "
                f"and biases of shapes {bias_shapes}"
            )
        if not all(np.isfinite(values).all() for values in (*self.weights, *self.biases)):
            raise UserError("weights and biases must be finite, got some that are not")
        self._layers: dict[str, list[tuple[Floats, Floats]]] = {}

    @property
    def hidden_units(self) -> tuple[int, ...]:
        """Sizes of the hidden layers, such as (16, 16)."""
        return tuple(len(bias) for bias in self.biases[:-1])

    def activations(self, vectors: ArrayLike) -> list[Floats]:
        """Return the output of every layer for vectors (..., 2) scaled to 1, each (..., units)."""
        outputs = self._forward(np.asarray(vectors, dtype=np.float64).reshape(-1, 2).T)
        shape = np.shape(vectors)[:-1]
        return [output.T.reshape(*shape, -1) for output in outputs]

    @override
    def normalize_rows(self, rows: Floats, lengths: Floats) -> None:
        count, _, batch = rows.shape
        shape, size = (2, count, batch), count * batch
        inputs = np.zeros((2, whole_blocks(size)), dtype=rows.dtype)
        np.divide(rows.transpose(1, 0, 2), lengths, out=inputs[:, :size].reshape(shape))
        for start in range(0, inputs.shape[1], _AT_ONCE):
            part = inputs[:, start : start + _AT_ONCE]
            part[:] = self._forward(part)[-1]
        output = inputs[:, :size].reshape(shape)
        np.multiply(output.transpose(1, 0, 2), lengths[:, None], out=rows)

    def _forward(self, inputs: Floats) -> list[Floats]:
        dtype = inputs.dtype
        outputs: list[Floats] = []
        if dtype.char not in self._layers:
            self._layers[dtype.char] = [
                (weight.astype(dtype), bias.astype(dtype)[:, None])
                for weight, bias in zip(self.weights, self.biases, strict=True)
            ]
        for weight, bias in self._layers[dtype.char]:
            inputs = product(weight, inputs)
            inputs += bias
            np.tanh(inputs, out=inputs)
            outputs.append(inputs)
        return outputs

    def save(self, path: Path | str) -> None:
        """Write weights, biases and card as one safetensors file, atomically."""
        tensors = {f"layers.{index}.weight": weight for index, weight in enumerate(self.weights)}
        tensors |= {f"layers.{index}.bias": bias for index, bias in enumerate(self.biases)}
        metadata = {**self.card, _SEAL: UNSEALED}
        write_atomically(path, seal(safetensors.numpy.save(tensors, metadata=metadata)))

    @classmethod
    def load(cls, path: Path | str) -> LearnedNormalizer:
        """Read a file that `save` wrote, and that has not been changed since."""
        require(not Path(path).is_dir(), "path", str(path), "a file, no folder")
        try:
            with safe_open(path, framework="numpy") as file:
                tensors = {name: file.get_tensor(name) for name in file.keys()}
                card = file.metadata() or {}
            check_seal(Path(path).read_bytes(), card.pop(_SEAL, ""))
            layers = range((len(tensors) + 1) // 2)
            weights = [tensors[f"layers.{index}.weight"] for index in layers]
            biases = [tensors[f"layers.{index}.bias"] for index in layers]
            return cls(weights, biases, card)
        except (SafetensorError, KeyError, ValueError) as error:
            raise UserError(f"{path} does not hold a normalizer: {error}") from error

    @classmethod
    def shipped(cls, name: ShippedNormalizer = "accurate") -> LearnedNormalizer:
        """Load a trained 2-16-16-2 normalizer that ships with the package.

        It was trained for angle accuracy ("accurate") or by the paper's recipe ("paper").
        """
        require_choice("name", name, get_args(ShippedNormalizer))
        return cls.load(WEIGHTS / f"{name}-16x16.safetensors")

    def __repr__(self) -> str:
        return f"LearnedNormalizer(hidden_units={self.hidden_units})"
