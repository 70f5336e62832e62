"""A trained policy as plain arrays: a small MLP that gives the mean of an action, and its spread.

    h_0 = x,  h_k = f(W_k h_{k−1} + b_k),  mean = W h_K + b,  log σ constant, or = W' h_K + b'

    gaussian (PPO):            action = clip(mean + σ ε, −1, 1)
    squashed (SAC and TQC):    action = tanh(mean + σ ε)

with ε = 0 for the deterministic action.  It does what the policy of stable-baselines3 that the
weights are from does, to rounding errors, without PyTorch, and for one arm several times faster.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]
Tensors = Mapping[str, Float32]
Activation = Literal["relu", "tanh"]
Distribution = Literal["gaussian", "squashed"]

_LOG_STD_RANGE = (-20.0, 2.0)  # stable-baselines3's, where the spread is an output


class PolicyNetwork:
    """The network: `input_size` features, layers of `hidden_units`, an action of `action_size`."""

    def __init__(self, tensors: Tensors, activation: Activation, distribution: Distribution):
        """Make a network of its weights.

        Args:
            tensors: float32: "hidden.K.weight" (out, in) and "hidden.K.bias" (out,) for each layer
                K from 0, "mean.weight" and "mean.bias", and either "log_std" (actions,) or
                "log_std.weight" and "log_std.bias".
            activation: f.
            distribution: of the actions.

        Raises:
            ValueError: if the names or shapes of the tensors are not those of such a network.
        """
        for name, value, accepted in (
            ("activation", activation, get_args(Activation)),
            ("distribution", distribution, get_args(Distribution)),
        ):
            if value not in accepted:
                raise ValueError(f"{name} must be one of {accepted}, got {value!r}")
        depth = sum(name.startswith("hidden.") for name in tensors) // 2
        hidden = [f"hidden.{index}" for index in range(depth)]
        spread_is_constant = "log_std" in tensors
        heads = ["mean"] if spread_is_constant else ["mean", "log_std"]
        names = {f"{layer}.{part}" for layer in hidden + heads for part in ("weight", "bias")}
        names |= {"log_std"} if spread_is_constant else set()
        if depth == 0 or set(tensors) != names:
            raise ValueError(f"tensors must be {sorted(names)}, got {sorted(tensors)}")
        sizes = [tensors["hidden.0.weight"].shape[-1]]
        sizes += [len(tensors[f"{layer}.bias"]) for layer in hidden]
        action_size = len(tensors["mean.bias"])
        shapes: dict[str, tuple[int, ...]] = {"log_std": (action_size,)}
        for layer, inputs, outputs in (
            *zip(hidden, sizes, sizes[1:]),
            *((head, sizes[-1], action_size) for head in heads),
        ):
            shapes |= {f"{layer}.weight": (outputs, inputs), f"{layer}.bias": (outputs,)}
        for name, tensor in tensors.items():
            if tensor.shape != shapes[name] or tensor.dtype != np.float32:
                raise ValueError(
                    f"{name} must be float32 of shape {shapes[name]}, "
                    f"got {tensor.dtype} of shape {tensor.shape}"
                )
        self.tensors = dict(tensors)
        self.activation: Activation = activation
        self.distribution: Distribution = distribution
        self.input_size, self.hidden_units = sizes[0], tuple(sizes[1:])
        self.action_size = action_size
        # As columns, so that one row of features takes one pass over contiguous memory.
        layers = {
            layer: (np.asfortranarray(tensors[f"{layer}.weight"].T), tensors[f"{layer}.bias"])
            for layer in hidden + heads
        }
        self._hidden = [layers[layer] for layer in hidden]
        self._mean = layers["mean"]
        self._log_std = tensors["log_std"] if spread_is_constant else layers["log_std"]

    def act(self, features: Float32, random: np.random.Generator | None = None) -> Float32:
        """Return actions (..., action_size) within −1 and 1 for float32 features (..., input_size).

        They are deterministic without a generator that draws ε.
        """
        hidden = features
        for weight, bias in self._hidden:
            hidden = hidden @ weight
            hidden += bias
            if self.activation == "relu":
                np.maximum(hidden, 0.0, out=hidden)
            else:
                np.tanh(hidden, out=hidden)
        weight, bias = self._mean
        action: Float32 = hidden @ weight + bias
        if random is not None:
            log_std = self._log_std
            if isinstance(log_std, tuple):
                log_std = np.clip(hidden @ log_std[0] + log_std[1], *_LOG_STD_RANGE)
            noise = random.standard_normal(action.shape, np.float32)
            action = action + np.exp(log_std) * noise
        return np.tanh(action) if self.distribution == "squashed" else action.clip(-1.0, 1.0)
