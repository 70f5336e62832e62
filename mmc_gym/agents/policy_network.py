"""A trained policy as plain arrays: its network and its memory.

The policy sees observations unchanged, with target and offset in the frame of the arm's first
segment.  Observations of goal environments are brought into the same form.

The network is a small MLP that gives the mean of an action and its spread:

    h_0 = x,  h_k = f(W_k h_{k−1} + b_k),  mean = W h_K + b,  log σ constant, or = W' h_K + b'

    gaussian (PPO):            action = clip(mean + σ ε, −1, 1)
    squashed (SAC, TQC, TD3):  action = tanh(mean + σ ε)

with ε = 0 for the deterministic action.  A2C, TRPO and RecurrentPPO act like PPO; RecurrentPPO has
a layer of LSTM units between x and h_1.  TD3 has no spread.  After a training with `VecNormalize`,
x = clip((features − mean) / deviation, −c, c).  Up to rounding errors, actions are those of the
stable-baselines3 policy that the weights come from, but without PyTorch, and several times faster
for one arm.

A policy with a memory also sees its `History` of observations and actions.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mmc_gym.geometry import in_the_world, turned_back, wrap_angle
from mmc_gym.interface import Observation, ObservationLayout

Float32 = NDArray[np.float32]
Tensors = Mapping[str, Float32]
Activation = Literal["relu", "tanh"]
Distribution = Literal["gaussian", "squashed"]

_SEEN = ("mean", "deviation", "clip")
_LOG_STD_RANGE = (-20.0, 2.0)  # stable-baselines3's, where the spread is an output


def _layer(name: str, tensors: Tensors) -> tuple[Float32, Float32]:
    """Return a linear layer's weight (in, out), for `x @ weight`, and bias (out,).

    The weight is in column-major order, so a row of features takes one pass over memory.
    """
    return np.asfortranarray(tensors[f"{name}.weight"].T), tensors[f"{name}.bias"]


class PolicyNetwork:
    """A network from `input_size` features through layers of `hidden_units` to an action."""

    def __init__(self, tensors: Tensors, activation: Activation, distribution: Distribution):
        """Make a network from its weights.

        Tensors are float32: "hidden.K.weight" (out, in) and "hidden.K.bias" (out,) for each layer K
        from 0, "mean.weight" and "mean.bias", and either "log_std" (actions,) or "log_std.weight"
        and "log_std.bias".  A missing one raises a ValueError.  Optional are "seen.mean" and
        "seen.deviation" (in,) and "seen.clip" (1,); and the LSTM's "lstm.weight_ih" (4 units, in),
        "lstm.weight_hh" (4 units, units) and "lstm.bias" (4 units,), in torch's order of gates.
        """
        depth = sum(name.startswith("hidden.") for name in tensors) // 2
        self.tensors = dict(tensors)
        self._is_normalized = "seen.mean" in tensors
        self.activation: Activation = activation
        self.distribution: Distribution = distribution
        #: number of LSTM units; 0 without an LSTM
        self.memory_units = len(tensors["lstm.bias"]) // 4 if "lstm.bias" in tensors else 0
        first = "lstm.weight_ih" if self.memory_units else "hidden.0.weight"
        try:
            self._hidden = [_layer(f"hidden.{layer}", tensors) for layer in range(depth)]
            self._mean = _layer("mean", tensors)
            is_constant = "log_std" in tensors
            self._log_std = None if is_constant else _layer("log_std", tensors)
            actions = tensors["mean.bias"].shape
            if is_constant and tensors["log_std"].shape != actions:  # as with use_sde
                shape = tensors["log_std"].shape
                raise ValueError(f"tensors must be: log_std of shape {actions}, got {shape}")
            self.input_size: int = tensors[first].shape[-1]
        except KeyError as error:
            raise ValueError(f"tensors must have {error}, got {sorted(tensors)}") from None

    def act(self, features: Float32, random: np.random.Generator | None = None) -> Float32:
        """Return actions (..., action_size) within −1 and 1 for float32 features (..., input_size).

        `random` draws ε; without it, actions are deterministic.  Each row is multiplied alone: sums
        over a whole batch round differently, so an action would depend on the size of the batch.
        """
        return self._act(self._normalized(features), random)

    def act_from(
        self, memory: Float32, features: Float32, random: np.random.Generator | None = None
    ) -> tuple[Float32, Float32]:
        """Return actions as `act` does, for a network with an LSTM, and the memory after them.

        The memory is the LSTM's output and cell state, (..., 2, units); zeros at the start.
        """
        output, cell = memory[..., :1, :], memory[..., 1:, :]
        gates = self._normalized(features)[..., None, :] @ self.tensors["lstm.weight_ih"].T
        gates += output @ self.tensors["lstm.weight_hh"].T + self.tensors["lstm.bias"]
        adds, keeps, new, shows = np.split(gates, 4, axis=-1)
        cell = _sigmoid(keeps) * cell + _sigmoid(adds) * np.tanh(new)
        output = _sigmoid(shows) * np.tanh(cell)
        return self._act(output[..., 0, :], random), np.concatenate((output, cell), axis=-2)

    def _normalized(self, features: Float32) -> Float32:
        if not self._is_normalized:
            return features
        mean, deviation, clip = (self.tensors[f"seen.{name}"] for name in _SEEN)
        normalized: Float32 = np.clip((features - mean) / deviation, -clip, clip)
        return normalized

    def _act(self, inputs: Float32, random: np.random.Generator | None) -> Float32:
        hidden = inputs[..., None, :]
        for weight, bias in self._hidden:
            hidden = hidden @ weight
            hidden += bias
            if self.activation == "relu":
                np.maximum(hidden, 0.0, out=hidden)
            else:
                np.tanh(hidden, out=hidden)
        weight, bias = self._mean
        action: Float32 = (hidden @ weight)[..., 0, :] + bias
        if random is not None:
            noise = random.standard_normal(action.shape, np.float32)
            if self._log_std is None:
                spread = np.exp(self.tensors["log_std"])
            else:
                weight, bias = self._log_std
                log_spread = np.clip((hidden @ weight)[..., 0, :] + bias, *_LOG_STD_RANGE)
                spread = np.exp(log_spread)
            action += spread * noise
        return np.tanh(action) if self.distribution == "squashed" else action.clip(-1.0, 1.0)


def _sigmoid(x: Float32) -> Float32:
    return np.float32(0.5) * (1 + np.tanh(np.float32(0.5) * x))


@dataclass(frozen=True)
class History:
    """A policy's memory: observations and actions of its last steps, the latest first.

    The steps are divided into blocks.  Of each block the policy sees the mean of

        joint angles, hand and target, each minus the present observation; actions

    where hand and target are turned into the present frame of the first segment.  So the values of
    an arm and a target at rest are 0 in any orientation of the world.  A mean over a block filters
    noise, and a difference between blocks is a velocity.  At the start of an episode the memory is
    filled with the first observation and with actions of zero.
    """

    layout: ObservationLayout  #: of the observations
    blocks: Sequence[int]  #: number of steps in each block, the latest block first

    @property
    def size(self) -> int:
        """Number of values that the memory appends to an observation."""
        return len(self.blocks) * self._width

    @property
    def _width(self) -> int:
        return 2 * self.layout.joint_count + 4

    @cached_property
    def _starts(self) -> NDArray[np.intp]:
        return np.cumsum([0, *self.blocks[:-1]])

    def start(self, observation: Observation) -> Float32:
        """Return the memory at an episode's first observation, (..., steps, 2 N + 4)."""
        now = self.observed(observation)
        memory = np.zeros((*now.shape[:-1], sum(self.blocks), self._width), np.float32)
        memory[..., : now.shape[-1]] = now[..., None, :]
        return memory

    def recall(self, now: Float32, memory: Float32) -> Float32:
        """Return the block means, (..., size), that a policy sees; `now` is from `observed`."""
        means = np.add.reduceat(memory, self._starts, axis=-2)  # sums of the steps of each block
        means /= np.array(self.blocks, np.float32)[:, None]
        means[..., : now.shape[-1]] -= now[..., None, :]
        first_angle = now[..., None, 0]
        cosine, sine = np.cos(first_angle), np.sin(first_angle)
        hand = self.layout.joint_count  # column of its x; y, and the same of the target, follow
        for x, y in ((hand, hand + 1), (hand + 2, hand + 3)):
            turned = turned_back(means[..., x], means[..., y], cosine, sine)
            means[..., x], means[..., y] = turned
        return means.reshape(*means.shape[:-2], self.size)

    def appended(self, observation: Float32, memory: Float32) -> tuple[Float32, Float32]:
        """Return what `observed` makes of an observation, and the observation with its memory."""
        now = self.observed(observation, memory)
        return now, np.concatenate((observation, self.recall(now, memory)), axis=-1)

    @staticmethod
    def extended(now: Float32, action: Float32, memory: Float32) -> Float32:
        """Return the memory with one more step: `now` from `observed`, and an action (..., N)."""
        step = np.concatenate((now, action), -1)
        return np.concatenate((step[..., None, :], memory[..., :-1, :]), -2)

    def observed(self, observation: Observation, memory: Float32 | None = None) -> Float32:
        """Return joint angles in radians, then hand and target in the world frame, (..., N + 4).

        Joint angles continue from those in `memory`, without jumps of a whole turn.
        """
        seen = self.layout.split(observation)
        angles = np.arctan2(seen.sines, seen.cosines)
        target = in_the_world(seen.target, angles)
        hand = target - in_the_world(seen.offset, angles)
        if memory is not None:
            before = memory[..., 0, : self.layout.joint_count]
            angles = before + wrap_angle(angles - before)
        return np.concatenate((angles, hand, target), -1).astype(np.float32, copy=False)
