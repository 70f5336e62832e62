"""The network as a torch module: gradients flow through its iterations, on any device.

`model` has the equations, and the function for the linear part of an iteration.  Iterations need no
value on the host, so an accelerator never waits.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import prod
from typing import Any

import torch
from torch import Tensor

from mmc_gym._errors import UserError, require, require_batch, require_whole
from mmc_gym.network import chain
from mmc_gym.network.chain import Pair, held_rows, linear_operator
from mmc_gym.network.model import MMCNetwork
from mmc_gym.network.normalizers import EuclideanNormalizer, LearnedNormalizer

_STRAIGHT = 64  # roundings within which vectors are in one line


@dataclass(frozen=True, eq=False)
class TorchState:
    """Values of all variables of a batch of networks, as `MMCState` has them.

    The properties show them with the batch first.
    """

    values: Tensor  #: one row per variable with the batch on the last axes, (rows, 2, ...)
    segment_count: int  #: N

    @property
    def vectors(self) -> Tensor:
        """All vectors v_ij, shape (..., N(N+1)/2, 2), in the order of `chain.vector_pairs`."""
        rows = self.values[: self.segment_count * (self.segment_count + 1) // 2]
        return rows.movedim((0, 1), (-2, -1))

    @property
    def segments(self) -> Tensor:
        """Segment vectors, normalized, shape (..., N, 2)."""
        return self.vectors[..., : self.segment_count, :]

    @property
    def joint_angles(self) -> Tensor:
        """Relative joint angles of the segments in ]−π, π], shape (..., N)."""
        x, y = self.segments.unbind(-1)
        angles = torch.atan2(y, x)
        turns = angles.diff(prepend=torch.zeros_like(angles[..., :1]))
        return torch.pi - (torch.pi - turns) % (2 * torch.pi)

    @property
    def end_effector(self) -> Tensor:
        """Sum of the segments: the position of the hand in this posture, shape (..., 2)."""
        return self.segments.sum(-2)


class TorchNetwork(torch.nn.Module):
    """An `MMCNetwork` in torch, equal to it up to rounding (1e-12 in float64).

    Rounding decides to which side an exactly stretched arm bends.

    Clamps are a mapping from pairs of nodes to vectors (..., 2), as for `MMCNetwork.clamp`.
    Tensors are converted to the module's device and dtype.  Their values are not checked, so values
    that are not finite spread.

    The weights of a learned normalizer are trainable, and so are the biases of each layer unless
    they are all zero: an odd normalizer stays odd.  Other parameters become trainable on request,
    as in `network.damping.requires_grad_()`.

    By default the network is the paper's, `MMCNetwork()`, and device and dtype are torch's.

    >>> network = TorchNetwork(MMCNetwork(damping=4), dtype=torch.float64)
    >>> angles = torch.tensor([0.3, 0.6, 0.6], dtype=torch.float64, requires_grad=True)
    >>> state = network.state_from_joint_angles(angles)
    >>> state = network(state, network.inverse([-1.0, 1.5]), iterations=10)
    >>> state.joint_angles.sum().backward()
    >>> angles.grad.shape
    torch.Size([3])
    """

    segment_lengths: torch.nn.Parameter  #: (N,)
    damping: torch.nn.Parameter  #: d, the weight of the present value in the mean
    velocity_damping: torch.nn.Parameter  #: d_v, how slowly the velocity follows
    velocity_decay: torch.nn.Parameter  #: factor on the velocity in each iteration
    #: Takes vectors (n, 2, batch) and lengths (n, 1), returns vectors so long; you may replace it.
    normalizer: torch.nn.Module
    triangles: Tensor

    def __init__(
        self,
        network: MMCNetwork | None = None,
        *,
        device: torch.device | str | None = None,
        dtype: torch.dtype | None = None,
    ) -> None:
        super().__init__()
        network = MMCNetwork() if network is None else network
        dtype = torch.get_default_dtype() if dtype is None else dtype
        require(isinstance(network, MMCNetwork), "network", network, "an MMCNetwork")
        self.segment_count, self.row_count = network.segment_count, network.row_count
        self.dynamics, self.schedule = network.dynamics, network.schedule

        def tensor(value: Any) -> Tensor:
            return torch.tensor(value, device=device, dtype=dtype)

        for name in ("segment_lengths", "damping", "velocity_damping", "velocity_decay"):
            value = tensor(getattr(network, name))
            setattr(self, name, torch.nn.Parameter(value, requires_grad=False))
        triangles = tensor(chain.triangle_products(self.segment_count))
        self.register_buffer("triangles", triangles, persistent=False)
        normalizer = network.normalizer
        if isinstance(normalizer, LearnedNormalizer):
            self.normalizer = _Learned(normalizer, tensor)
        else:
            accepted = "an EuclideanNormalizer or LearnedNormalizer"
            require(type(normalizer) is EuclideanNormalizer, "normalizer", normalizer, accepted)
            self.normalizer = _Euclidean()

    def to_numpy(self) -> MMCNetwork:
        """Return the network in numpy with the present parameters, if all are in their range.

        Its normalizer must be the one that it was made with.
        """
        if not isinstance(self.normalizer, _Euclidean | _Learned):
            raise UserError(f"normalizer must be the original one, got {self.normalizer}")
        numbers = ("damping", "velocity_damping", "velocity_decay")
        return MMCNetwork(
            tuple(self.segment_lengths.tolist()),
            normalizer=self.normalizer.to_numpy(),
            dynamics=self.dynamics,
            schedule=self.schedule,
            **{name: getattr(self, name).item() for name in numbers},
        )

    def state_from_joint_angles(self, joint_angles: Any) -> TorchState:
        """Return the state of arms at rest in a posture; joint angles (..., N) in radians."""
        angles = self._tensor("joint_angles", joint_angles, (self.segment_count,)).cumsum(-1)
        units = torch.stack([angles.cos(), angles.sin()], dim=-1)
        return self.state_from_segments(self.segment_lengths[:, None] * units)

    def state_from_segments(self, segments: Any) -> TorchState:
        """Return the state at rest with these segment vectors (..., N, 2), the others consistent.

        They are not normalized before the first iteration.
        """
        count = self.segment_count
        segments = self._tensor("segments", segments, (count, 2)).movedim((-2, -1), (0, 1))
        nodes = torch.cat([torch.zeros_like(segments[:1]), segments.cumsum(0)])
        others = [nodes[j] - nodes[i] for i, j in chain.vector_pairs(count)[count:]]
        parts = [segments, torch.stack(others)]
        if self.schedule == "delayed":
            parts.append(segments)
        if self.dynamics != "kinematic":
            parts.append(torch.zeros_like(segments))
        return TorchState(torch.cat(parts), count)

    def inverse(self, target: Any) -> dict[Pair, Any]:
        """Hold the end effector at `target` (..., 2): the inverse task."""
        return {(0, self.segment_count): target}

    def forward(
        self, state: TorchState, clamps: Mapping[Pair, Any] | None = None, iterations: int = 1
    ) -> TorchState:
        """Return the state after `iterations` iterations; `state` itself stays as it is.

        Like `MMCNetwork.run`, it bends arms that lie in one line with their targets.  Clamps hold
        vectors, (..., 2), by their pair of nodes.  Batch axes of the state and of clamps are
        broadcast against each other.
        """
        require_whole("iterations", iterations, least=0)
        accepted = "a TorchState of a network of this kind"
        has_rows = isinstance(state, TorchState) and len(state.values) == self.row_count
        require(has_rows and state.segment_count == self.segment_count, "state", state, accepted)
        held = held_rows(self, "clamps", {} if clamps is None else clamps, self._tensor)
        begin = state.values.movedim((0, 1), (-2, -1))
        shapes = [begin.shape[:-2], *(value.shape[:-1] for value in held.values())]
        batch = require_batch("clamps", shapes)
        values = begin.expand(*batch, -1, -1).movedim((-2, -1), (0, 1))
        held = {row: value.expand(*batch, -1).movedim(-1, 0) for row, value in held.items()}
        values = self._bend_where_stuck(values, held)
        values = torch.stack([held.get(row, free) for row, free in enumerate(values.unbind())])
        flat = values.view(self.row_count, 2, prod(batch))
        rows = [row in held for row in range(self.row_count)]
        is_held = torch.tensor(rows, device=flat.device)[:, None, None]
        operator = linear_operator(self, tuple(held), self.triangles, torch)
        for _ in range(iterations):
            if self.schedule == "delayed":
                flat = self._normalized(flat, is_held)
            flat = (operator @ flat.flatten(1)).view_as(flat)
            if self.schedule == "synchronous":
                flat = self._normalized(flat, is_held)
        return TorchState(flat.view_as(values), self.segment_count)

    def _normalized(self, values: Tensor, is_held: Tensor) -> Tensor:
        start = len(self.triangles) if self.schedule == "delayed" else 0
        end = start + self.segment_count
        segments = values[start:end]
        normalized = self.normalizer(segments, self.segment_lengths[:, None])
        normalized = torch.where(is_held[start:end], segments, normalized)
        return torch.cat([values[:start], normalized, values[end:]])

    def _bend_where_stuck(self, values: Tensor, held: Mapping[int, Tensor]) -> Tensor:
        """Do as `MMCNetwork` does, but without waiting for values on the host."""
        count, hand = self.segment_count, len(self.triangles) - 1
        if hand not in held:
            return values
        segments, target, lengths = values[:count], held[hand], self.segment_lengths
        with torch.no_grad():
            reach, eps = lengths.sum(), torch.finfo(values.dtype).eps
            others = torch.cat([segments[1:], torch.stack(list(held.values()))])
            across = (segments[0, 0] * others[:, 1] - segments[0, 1] * others[:, 0]).abs()
            is_in_line = (across <= _STRAIGHT * eps * lengths[0] * reach).all(0)
            # The nearest reachable point.
            inner = (2 * lengths.max() - reach).clamp(min=0.0)
            radius = torch.hypot(*target).clamp(inner, reach)
            bearing = torch.atan2(target[1], target[0])
            way = torch.stack([bearing.cos(), bearing.sin()]) * radius - segments.sum(0)
            is_stuck = is_in_line & (torch.hypot(*way) > 1e-3 * reach)
            is_stuck &= (target != values[hand]).any()
        bent = TorchState(values, count).joint_angles + chain.BEND
        return torch.where(is_stuck, self.state_from_joint_angles(bent).values, values)

    def _tensor(self, name: str, value: Any, trailing: tuple[int, ...]) -> Tensor:
        try:
            tensor = torch.as_tensor(value, dtype=self.damping.dtype, device=self.damping.device)
        except (TypeError, ValueError, RuntimeError) as error:
            raise UserError(f"{name} must be a tensor or numbers, got {value!r}") from error
        shape = tuple(tensor.shape)
        accepted = f"of shape (..., {', '.join(map(str, trailing))})"
        require(shape[-len(trailing) :] == trailing, name, shape, accepted)
        return tensor


class _Euclidean(torch.nn.Module):
    """L = ℓ · L̃ / |L̃|, see `EuclideanNormalizer`."""

    def forward(self, vectors: Tensor, lengths: Tensor) -> Tensor:
        x, y = vectors.unbind(1)
        x = x + torch.finfo(x.dtype).tiny ** 0.5  # gives the zero vector a direction
        scale = lengths / (x * x + y * y).sqrt()
        return torch.stack([scale * x, scale * y], dim=1)

    def to_numpy(self) -> EuclideanNormalizer:
        return EuclideanNormalizer()


class _Learned(torch.nn.Module):
    """L = ℓ · f(L̃ / ℓ) with the MLP f, see `LearnedNormalizer`."""

    def __init__(self, normalizer: LearnedNormalizer, tensor: Callable[[Any], Tensor]) -> None:
        super().__init__()
        self.weights = torch.nn.ParameterList(map(tensor, normalizer.weights))
        self.biases = torch.nn.ParameterList(map(tensor, normalizer.biases))
        for parameter, bias in zip(self.biases, normalizer.biases):
            parameter.requires_grad_(bool(bias.any()))

    def forward(self, vectors: Tensor, lengths: Tensor) -> Tensor:
        values = (vectors / lengths[:, None]).movedim(1, -1)
        for weight, bias in zip(self.weights, self.biases):
            values = torch.nn.functional.linear(values, weight, bias).tanh()
        return values.movedim(-1, 1) * lengths[:, None]

    def to_numpy(self) -> LearnedNormalizer:
        return LearnedNormalizer(
            [weight.tolist() for weight in self.weights], [bias.tolist() for bias in self.biases]
        )
