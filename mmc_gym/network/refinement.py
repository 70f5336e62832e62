"""Refining a learned normalizer until it hardly turns a vector: Levenberg-Marquardt.

Gradient descent leaves angle errors of some tenths of a degree, and an MMC network inherits
them as a floor on its distance to the target.  Here the parts of the error f(x) − u across and
along the direction u of x = r u are made small, with weights w(r) for the lengths,

    E = Σ e²,   e = [w (u × f(x)),  w c (u · f(x) − 1)].

A small MLP has few enough parameters P to solve (JᵀJ + λ diag JᵀJ) Δ = Jᵀe for the step Δ, with
J = ∂e/∂P from backpropagation: δ_K = a (1 − y_K²), δ_k = (W_{k+1}ᵀ δ_{k+1}) (1 − y_k²),
∂(a · y_K)/∂W_k = δ_k y_{k−1}ᵀ, where a is what the output is multiplied with in e.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mmc_gym.network.normalizers import LearnedNormalizer

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
