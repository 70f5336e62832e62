"""Policies of stable-baselines3 and sb3-contrib; their networks and checkpoints as plain arrays.

Most recipes use stable-baselines3's "MlpPolicy".  YAML files give `TQCGoalPolicy` by its full name,
so that rl_zoo3 finds it too.

A checkpoint is the state of a model as safetensors, from which a training resumes: weights and
optimizers, the entropy coefficient if it is learned, the step counts, the filled part of the
replay buffer, the statistics of a `VecNormalize`, and the SHA-256 of all this.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import safetensors.torch
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from safetensors import SafetensorError
from sb3_contrib.common.torch_layers import BatchRenorm1d
from sb3_contrib.tqc.policies import TQCPolicy
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.policies import ActorCriticPolicy, BasePolicy
from stable_baselines3.common.running_mean_std import RunningMeanStd
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor, FlattenExtractor
from stable_baselines3.common.type_aliases import Schedule
from stable_baselines3.common.vec_env import VecNormalize

from mmc_gym._errors import UserError
from mmc_gym._files import UNSEALED, check_seal, seal, write_atomically
from mmc_gym.agents.policy_network import Activation, Distribution, Float32, PolicyNetwork
from mmc_gym.interface import ObservationLayout

_NO_SPREAD = -80.0  # log standard deviation, too small to change an action
ACTIVATIONS: dict[Activation, type[torch.nn.Module]] = {
    "relu": torch.nn.ReLU,
    "tanh": torch.nn.Tanh,
}


class FlatObservation(BaseFeaturesExtractor):
    """A layer without parameters that turns observations into the form of `MMCReach-v0`."""

    def __init__(self, observation_space: spaces.Space[Any], joint_count: int) -> None:
        self.layout = layout = ObservationLayout(joint_count, reach=1.0)  # of any reach
        super().__init__(observation_space, layout.size + layout.additions(observation_space))

    def forward(self, observations: torch.Tensor | Mapping[str, torch.Tensor]) -> Any:
        """Return the features of observations, (batch, features)."""
        return self.layout.flatten(observations, torch)


class TQCGoalPolicy(TQCPolicy):
    """A `TQCPolicy` that sees a goal environment's observations in the form of `MMCReach-v0`."""

    def __init__(
        self,
        observation_space: spaces.Space[Any],
        action_space: spaces.Box,
        lr_schedule: Schedule,
        **options: Any,
    ) -> None:
        options |= {"features_extractor_class": FlatObservation}
        options |= {"features_extractor_kwargs": {"joint_count": action_space.shape[0]}}
        super().__init__(observation_space, action_space, lr_schedule, **options)


def export_policy(policy: BasePolicy, normalizer: VecNormalize | None = None) -> PolicyNetwork:
    """Return a copy of a policy's network, for any of `ALGORITHMS`.

    The copy includes the observation statistics of the `normalizer`, if there is one.

    Raises:
        ValueError: if a layer, the features extractor or the `normalizer` cannot be copied.
    """
    actor: Any = getattr(policy, "actor", policy)
    distribution: Distribution = "gaussian" if actor is policy else "squashed"
    if isinstance(policy, ActorCriticPolicy):
        hidden, mean, log_std = actor.mlp_extractor.policy_net, actor.action_net, actor.log_std
    elif hasattr(actor, "latent_pi"):
        hidden, mean, log_std = actor.latent_pi, actor.mu, actor.log_std
    else:  # TD3's, which ends with tanh
        hidden, mean = actor.mu[:-2], actor.mu[-2]
        log_std = torch.full_like(mean.bias, _NO_SPREAD)
    layer = actor.features_extractor
    if not isinstance(layer, (FlattenExtractor, FlatObservation)):
        raise ValueError(f"policy must see the observation as it is, got {layer}")
    before: dict[str, torch.Tensor] = {}
    if normalizer is not None and normalizer.norm_obs:
        rms = normalizer.obs_rms
        if isinstance(rms, dict):
            raise ValueError("normalize must have norm_obs False for a goal environment")
        deviation = np.sqrt(rms.var + normalizer.epsilon)
        seen = {"mean": rms.mean, "deviation": deviation, "clip": [normalizer.clip_obs]}
        before |= {f"seen.{name}": torch.Tensor(value) for name, value in seen.items()}
    if lstm := getattr(actor, "lstm_actor", None):
        if lstm.num_layers > 1:
            raise ValueError(f"n_lstm_layers must be 1, got {lstm.num_layers}")
        before |= {"lstm.weight_ih": lstm.weight_ih_l0, "lstm.weight_hh": lstm.weight_hh_l0}
        before["lstm.bias"] = lstm.bias_ih_l0 + lstm.bias_hh_l0
    return export_network(hidden, mean, log_std, distribution, before)


def export_network(
    hidden: Iterable[torch.nn.Module],
    mean: torch.nn.Linear,
    log_std: torch.nn.Linear | torch.Tensor,
    distribution: Distribution,
    before: Mapping[str, torch.Tensor] | None = None,
) -> PolicyNetwork:
    """Return a copy of an actor's layers as arrays.

    `hidden` are linear layers, each followed by the same one of `ACTIVATIONS`; `mean` is the layer
    of the mean actions, and `log_std` a layer or a parameter.  Normalization before a linear layer
    becomes a part of it.  `before` are tensors of earlier layers, named as in `PolicyNetwork`.
    Other activations raise a `ValueError`.
    """
    hidden, linear, norm = list(hidden), [], None
    for layer in hidden:
        if isinstance(layer, torch.nn.Linear):
            linear.append(_with_norm(layer, norm))
            norm = None
        elif isinstance(layer, BatchRenorm1d):
            norm = layer
    mean = _with_norm(mean, norm)
    if isinstance(log_std, torch.nn.Linear):
        log_std = _with_norm(log_std, norm)
    kinds = {type(layer) for layer in hidden} - {torch.nn.Linear, BatchRenorm1d}
    activation = next((name for name, kind in ACTIVATIONS.items() if kinds == {kind}), None)
    if activation is None:
        raise ValueError(f"policy must have one of {list(ACTIVATIONS)} between layers, got {kinds}")
    parts: dict[str, torch.nn.Linear | torch.Tensor] = {"mean": mean, "log_std": log_std}
    parts |= before or {}
    parts |= {f"hidden.{index}": layer for index, layer in enumerate(linear)}
    tensors: dict[str, Float32] = {}
    for name, part in parts.items():
        if isinstance(part, torch.nn.Linear):
            tensors |= {f"{name}.weight": _array(part.weight), f"{name}.bias": _array(part.bias)}
        else:
            tensors[name] = _array(part)
    return PolicyNetwork(tensors, activation, distribution)


def _with_norm(layer: torch.nn.Linear, norm: BatchRenorm1d | None) -> torch.nn.Linear:
    """Return a layer that does what the normalization and this layer do together."""
    if norm is None:
        return layer
    tensors = norm.state_dict()
    scale = tensors["scale"] / (tensors["ra_var"] + norm.eps).sqrt()
    both = deepcopy(layer)
    with torch.no_grad():
        both.weight.copy_(layer.weight * scale)
        both.bias.copy_(layer.bias + layer.weight @ (tensors["bias"] - tensors["ra_mean"] * scale))
    return both


def _array(parameter: torch.Tensor) -> Float32:
    return parameter.detach().cpu().numpy().copy()


Tensors = dict[str, torch.Tensor]


def save_checkpoint(model: BaseAlgorithm, head: dict[str, Any], path: Path) -> None:
    """Write the model's state and `head` (anything JSON can hold) to `path`, atomically."""
    tensors: Tensors = {}
    for name, part in model.get_parameters().items():
        if "state" in part and "param_groups" in part:
            for index, moments in part["state"].items():
                for moment, value in moments.items():
                    tensors[f"optimizer/{name}/{index}/{moment}"] = torch.as_tensor(value)
        else:
            tensors |= {f"module/{name}/{key}": value for key, value in part.items()}
    tensors |= {f"variable/{name}": tensor for name, tensor in _variables(model).items()}
    for name, statistics in _statistics(model).items():
        for moment in ("mean", "var", "count"):
            value = np.array(getattr(statistics, moment), np.float64)
            tensors[f"statistics/{name}/{moment}"] = torch.from_numpy(value)
    counts = {"steps": model.num_timesteps, "updates": model._n_updates}
    buffer = getattr(model, "replay_buffer", None)
    if buffer is not None:
        counts |= {"position": buffer.pos, "full": bool(buffer.full)}
        for name, array in _arrays(buffer).items():
            tensors[f"replay/{name}"] = torch.from_numpy(array[: buffer.size()])
    content = safetensors.torch.save(
        {name: tensor.detach().contiguous() for name, tensor in tensors.items()},
        metadata={"head": json.dumps({**head, "model": counts}), "sha256": UNSEALED},
    )
    write_atomically(path, seal(content))


def read_head(path: Path) -> dict[str, Any]:
    """Return the checkpoint's head, with the model's counts; a `UserError` if it is damaged."""
    content = path.read_bytes()
    try:
        with safetensors.safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
        check_seal(content, metadata.get("sha256", ""))
        return json.loads(metadata["head"])
    except (SafetensorError, KeyError, TypeError, ValueError) as error:
        raise UserError(f"{path} does not hold a training: {error}") from error


def load_checkpoint(model: Any, head: dict[str, Any], path: Path) -> None:
    """Load a checkpoint into a model that was made with the same arguments.

    `head` is what `read_head` returned, after it checked the file.
    """
    counts = head["model"]
    parameters: dict[str, Any] = {
        name: {**part, "state": {}} if "param_groups" in part else {}
        for name, part in model.get_parameters().items()
    }
    buffer = getattr(model, "replay_buffer", None)
    variables, arrays = _variables(model), _arrays(buffer) if buffer is not None else {}
    for key, tensor in safetensors.torch.load_file(path).items():
        kind, name, *rest = key.split("/")
        if kind == "variable":
            variables[name].data.copy_(tensor)
        elif kind == "statistics":
            setattr(_statistics(model)[name], rest[0], tensor.numpy())
        elif kind == "module":
            parameters[name]["/".join(rest)] = tensor
        elif kind == "optimizer":
            index, moment = rest
            parameters[name]["state"].setdefault(int(index), {})[moment] = tensor
        else:
            arrays["/".join([name, *rest])][: len(tensor)] = tensor.numpy()
    model.set_parameters(parameters, exact_match=True, device=model.device)
    if buffer is not None:
        buffer.pos, buffer.full = counts["position"], counts["full"]
    model.num_timesteps, model._n_updates = counts["steps"], counts["updates"]
    model._last_obs = ()  # None would make stable-baselines3 reset, which counts in statistics


def _variables(model: BaseAlgorithm) -> Tensors:
    """Return learned tensors that are in no module: SAC's and TQC's entropy coefficient, if any."""
    learned = getattr(model, "log_ent_coef", None)
    return {} if learned is None else {"log_ent_coef": learned}


def _statistics(model: BaseAlgorithm) -> dict[str, RunningMeanStd]:
    """Return the statistics of the model's `VecNormalize`, by name; empty without it."""
    normalize = model.get_vec_normalize_env()
    known = {} if normalize is None else vars(normalize)
    return {name: known[name] for name in ("obs_rms", "ret_rms") if name in known}


def _arrays(buffer: ReplayBuffer) -> dict[str, NDArray[Any]]:
    """Return the arrays of a replay buffer that have a row for each step, by name."""
    arrays: dict[str, NDArray[Any]] = {}
    for name, value in vars(buffer).items():
        parts = value.items() if isinstance(value, dict) else [("", value)]
        for key, array in parts:
            has_rows = isinstance(array, np.ndarray) and array.shape[:1] == (buffer.buffer_size,)
            if has_rows and array.dtype != object:
                arrays[f"{name}/{key}" if key else name] = array
    return arrays
