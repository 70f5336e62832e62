"""Fitting small MLPs of tanh units, several runs of them at once: Adam and Levenberg-Marquardt.

An MLP with K layers computes y_0 = x, y_k = tanh(W_k y_{k−1} + b_k).  With the slope ∂E/∂y_K
of whatever E, backpropagation gives

    δ_K = ∂E/∂y_K (1 − y_K²),   δ_k = (W_{k+1}ᵀ δ_{k+1}) (1 − y_k²),
    ∂E/∂W_k = δ_k y_{k−1}ᵀ,     ∂E/∂b_k = δ_k.

It is written out, because autograd's bookkeeping would cost more than layers of a few units.
Runs stand on a leading axis: parameters are (runs, P), values (runs, units, samples), and
samples (runs, 4, samples), each a column of two inputs and the two wanted outputs.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import sqrt

import torch
from torch import Tensor

Layer = tuple[Tensor, Tensor]
Tick = Callable[[], None]


@dataclass(frozen=True, eq=False)
class Perceptrons:
    """MLPs of one architecture, one per run; fitting changes the parameters in place.

    Attributes:
        widths: units of every layer, from the inputs to the outputs.
        parameters: per layer, weights (out · in) then biases (out), all runs (runs, P).
        trainable: which of the P parameters are fitted, (P,), bool.
    """

    widths: tuple[int, ...]
    parameters: Tensor
    trainable: Tensor

    @classmethod
    def initial(
        cls, widths: tuple[int, ...], generators: Sequence[torch.Generator], biases: bool
    ) -> Perceptrons:
        """Untrained, in float64: Glorot's uniform weights, zero biases (Keras' defaults).

        Args:
            widths: units of every layer.
            generators: the source of the weights of each run.
            biases: whether biases are fitted; otherwise they stay zero and the MLP is odd.
        """
        runs = []
        for generator in generators:
            parts = []
            for inputs, outputs in zip(widths[:-1], widths[1:], strict=True):
                limit = sqrt(6 / (inputs + outputs))
                weights = torch.empty(outputs * inputs, dtype=torch.float64)
                weights.uniform_(-limit, limit, generator=generator)
                parts += [weights, weights.new_zeros(outputs)]
            runs.append(torch.cat(parts))
        parameters = torch.stack(runs)
        trainable = torch.ones_like(parameters[:1]) if biases else (parameters[:1] != 0)
        return cls(widths, parameters, trainable[0].bool())

    def to(self, device: str, dtype: torch.dtype) -> Perceptrons:
        """A copy on another device, in another floating point type."""
        parameters = self.parameters.to(device, dtype, copy=True)
        return Perceptrons(self.widths, parameters, self.trainable.to(device))

    def run(self, index: int) -> Perceptrons:
        """A single run; the parameters are shared."""
        return Perceptrons(self.widths, self.parameters[index : index + 1], self.trainable)

    @cached_property
    def layers(self) -> list[Layer]:
        """Views of the parameters: weights (runs, out, in) and biases (runs, out, 1)."""
        layers, start = [], 0
        for inputs, outputs in zip(self.widths[:-1], self.widths[1:], strict=True):
            middle, end = start + outputs * inputs, start + outputs * (inputs + 1)
            weights = self.parameters[:, start:middle].view(-1, outputs, inputs)
            layers.append((weights, self.parameters[:, middle:end].unsqueeze(2)))
            start = end
        return layers

    def forward(self, inputs: Tensor) -> list[Tensor]:
        """Values of all layers, the inputs first, each (runs, units, samples)."""
        values = [inputs]
        for weights, biases in self.layers:
            values.append(torch.baddbmm(biases, weights, values[-1]).tanh_())
        return values

    def gradient(self, values: list[Tensor], slope: Tensor) -> Tensor:
        """∂E/∂parameters, (runs, P), from `forward`'s values and ∂E/∂y_K (runs, 2, samples)."""
        parts = []
        for delta, inputs in zip(self._deltas(values, slope), values[:-1], strict=True):
            parts += [(delta @ inputs.mT).flatten(1), delta.sum(2)]
        return torch.cat(parts, dim=1)

    def jacobian(self, values: list[Tensor], slope: Tensor) -> Tensor:
        """∂E_s/∂parameters for the E_s of every sample of a single run, (samples, P)."""
        parts = []
        for delta, inputs in zip(self._deltas(values, slope), values[:-1], strict=True):
            parts += [torch.einsum("on,in->noi", delta[0], inputs[0]).flatten(1), delta[0].T]
        return torch.cat(parts, dim=1)

    def _deltas(self, values: list[Tensor], slope: Tensor) -> list[Tensor]:
        deltas: list[Tensor] = []
        for (weights, _), output in zip(reversed(self.layers), reversed(values[1:]), strict=True):
            deltas.append(torch.addcmul(slope, slope * output, output, value=-1))
            slope = weights.mT @ deltas[-1]
        return deltas[::-1]

    def mean_squared_error(self, samples: Tensor) -> Tensor:
        """Mean squared error over samples and outputs, (runs,)."""
        return (self.forward(samples[:, :2])[-1] - samples[:, 2:]).square().mean((1, 2))


def adam(
    perceptrons: Perceptrons,
    training: Tensor,
    validation: Tensor,
    generators: Sequence[torch.Generator],
    epochs: int,
    batch_size: int,
    learning_rate: float,
    tick: Tick,
) -> Tensor:
    """Descend the mean squared error with Adam, as Keras defines it.

    Args:
        perceptrons: what is fitted.
        training: samples to fit, (runs, 4, n).
        validation: other samples, (runs, 4, m).
        generators: the source of each run's order of samples.
        epochs: passes over the training samples.
        batch_size: samples per update.
        learning_rate: step size.
        tick: called after every epoch.

    Returns:
        Mean squared errors of training (as the batches were met) and validation (after the
        epoch), (runs, epochs, 2).
    """
    parameters = perceptrons.parameters
    mean, variance = torch.zeros_like(parameters), torch.zeros_like(parameters)
    count, update, history = training.shape[2], 0, []
    for _ in range(epochs):
        orders = [torch.randperm(count, generator=generator) for generator in generators]
        order = torch.stack(orders).to(training.device)[:, None].expand_as(training)
        total = training.new_zeros(len(parameters))
        for batch in torch.split(training.gather(2, order), batch_size, dim=2):
            values = perceptrons.forward(batch[:, :2])
            error = values[-1] - batch[:, 2:]
            total += error.square().sum((1, 2))
            gradient = perceptrons.gradient(values, error / batch.shape[2])
            gradient *= perceptrons.trainable
            update += 1
            mean.lerp_(gradient, 0.1)
            variance.mul_(0.999).addcmul_(gradient, gradient, value=0.001)
            # Keras adds its 1e-7 before the bias correction, torch's Adam adds 1e-8 after it.
            step = learning_rate * sqrt(1 - 0.999**update) / (1 - 0.9**update)
            parameters.addcdiv_(mean, variance.sqrt().add_(1e-7), value=-step)
        validation_error = perceptrons.mean_squared_error(validation)
        history.append(torch.stack([total / (2 * count), validation_error], dim=1))
        tick()
    return torch.stack(history, dim=1)


def levenberg_marquardt(
    perceptrons: Perceptrons,
    training: Tensor,
    validation: Tensor,
    projections: Sequence[Tensor],
    iterations: int,
    tick: Tick,
) -> Tensor:
    """Minimize the sum of squares of e = a · (y − wanted), over samples and projections a.

    Every iteration solves (JᵀJ + λ diag JᵀJ) Δ = Jᵀe and takes Δ off the parameters, with λ
    raised until that lowers the error.

    Args:
        perceptrons: a single run.
        training: samples to fit, (1, 4, n).
        validation: other samples, (1, 4, m).
        projections: the a's, each (1, 2, n).
        iterations: number of iterations.
        tick: called after every iteration.

    Returns:
        Mean squared errors of training and validation after every iteration, (iterations, 2).
    """
    parameters, free = perceptrons.parameters, perceptrons.trainable
    wanted = training[:, 2:]

    def evaluate() -> tuple[list[Tensor], Tensor]:
        values = perceptrons.forward(training[:, :2])
        error = values[-1] - wanted
        return values, torch.cat([(along * error).sum(1)[0] for along in projections])

    values, residuals = evaluate()
    damping, history = 0.01, []
    for _ in range(iterations):
        jacobian = torch.cat([perceptrons.jacobian(values, along) for along in projections])
        jacobian = jacobian[:, free]
        normal, slope = jacobian.T @ jacobian, jacobian.T @ residuals
        scale = normal.diagonal() + 1e-12  # a unit that saturates has no slope left
        start, square = parameters.clone(), residuals.dot(residuals)
        for _ in range(10):
            change = torch.linalg.solve(normal + torch.diag(damping * scale), slope)
            parameters[0, free] = start[0, free] - change
            values, residuals = evaluate()
            if residuals.dot(residuals) < square:
                damping = max(damping / 3, 1e-12)
                break
            damping *= 4
        else:
            parameters.copy_(start)
            values, residuals = evaluate()
        errors = [perceptrons.mean_squared_error(samples) for samples in (training, validation)]
        history.append(torch.cat(errors))
        tick()
    return torch.stack(history)
