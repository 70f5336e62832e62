"""Keep the state of a stable-baselines3 model as safetensors: all that a training needs to go on.

That is the policy's weights and optimizers, the entropy coefficient if it is learned, the
statistics that scale rewards, the step counts, and the filled part of the replay buffer.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import safetensors.torch
import torch
from numpy.typing import NDArray
from safetensors import SafetensorError
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.vec_env import VecNormalize

from mmc_gym._errors import UserError
from mmc_gym._files import write_atomically

Tensors = dict[str, torch.Tensor]


def save_checkpoint(model: BaseAlgorithm, head: dict[str, Any], path: Path) -> None:
    """Write the model's state, and `head`, which must be JSON, to `path`, all or nothing."""
    tensors: Tensors = {}
    for name, part in model.get_parameters().items():
        if "state" in part and "param_groups" in part:
            for index, moments in part["state"].items():
                for moment, value in moments.items():
                    tensors[f"optimizer/{name}/{index}/{moment}"] = value
        else:
            tensors |= {f"module/{name}/{key}": value for key, value in part.items()}
    tensors |= {f"variable/{name}": tensor for name, tensor in _variables(model).items()}
    buffer = _replay_buffer(model)
    if buffer is not None:
        rows = buffer.size()
        tensors |= {
            f"replay/{name}": torch.from_numpy(array[:rows])
            for name, array in _arrays(buffer).items()
        }
    content = safetensors.torch.save(
        {name: tensor.detach().contiguous() for name, tensor in tensors.items()},
        metadata={"head": json.dumps({**head, "model": _counts(model)})},
    )
    write_atomically(path, content)


def read_head(path: Path) -> dict[str, Any]:
    """Return the head that `save_checkpoint` was given.

    Raises:
        UserError: if the file is not a checkpoint.
    """
    try:
        with safetensors.safe_open(path, framework="pt") as file:
            head: dict[str, Any] = json.loads(file.metadata()["head"])
            return head
    except (SafetensorError, KeyError, TypeError, ValueError) as error:
        raise UserError(f"{path} does not hold a training: {error}") from error


def load_checkpoint(model: BaseAlgorithm, head: dict[str, Any], path: Path) -> None:
    """Bring a model, made with the same arguments, to the state in the checkpoint with that head.

    Raises:
        UserError: if the file is not a checkpoint, or that of another model, which may then have
            been changed in part.
    """
    try:
        counts = head["model"]
        tensors = safetensors.torch.load_file(path)
        parameters = model.get_parameters()
        found: dict[str, Any] = {
            name: {**part, "state": {}} if "param_groups" in part else {}
            for name, part in parameters.items()
        }
        variables, replayed = _variables(model), Tensors()
        for key, tensor in tensors.items():
            kind, name, *rest = key.split("/")
            if kind == "variable":
                variables.pop(name).data.copy_(tensor)
            elif kind == "module":
                found[name]["/".join(rest)] = tensor
            elif kind == "optimizer":
                index, moment = rest
                found[name]["state"].setdefault(int(index), {})[moment] = tensor
            else:
                replayed["/".join([name, *rest])] = tensor
        if variables:
            raise ValueError(f"it lacks {sorted(variables)}")
        model.set_parameters(found, exact_match=True, device=model.device)
        _restore_buffer(model, replayed, counts)
        _restore_counts(model, counts)
    except (KeyError, TypeError, ValueError, RuntimeError, SafetensorError) as error:
        raise UserError(f"{path} does not hold a training of this kind: {error}") from error


def _variables(model: BaseAlgorithm) -> Tensors:
    """Return what is learned outside of modules: the logarithm of the entropy coefficient."""
    _, names = model._get_torch_save_params()
    return {name: getattr(model, name) for name in names if name == "log_ent_coef"}


def _counts(model: Any) -> dict[str, Any]:
    counts = {"steps": model.num_timesteps, "updates": model._n_updates}
    buffer = _replay_buffer(model)
    if buffer is not None:
        counts |= {"position": buffer.pos, "full": bool(buffer.full)}
    if isinstance(model.env, VecNormalize):
        statistics = model.env.ret_rms
        numbers = (statistics.mean, statistics.var, statistics.count)
        counts["reward_statistics"] = [float(number) for number in numbers]
    return counts


def _restore_counts(model: Any, counts: dict[str, Any]) -> None:
    model.num_timesteps, model._n_updates = counts["steps"], counts["updates"]
    if isinstance(model.env, VecNormalize):
        statistics = model.env.ret_rms
        statistics.mean, statistics.var, statistics.count = counts["reward_statistics"]


def _replay_buffer(model: Any) -> ReplayBuffer | None:
    return getattr(model, "replay_buffer", None)


def _arrays(buffer: ReplayBuffer) -> dict[str, NDArray[Any]]:
    """Return the arrays of a replay buffer that have a row for each step, by name."""
    found: dict[str, NDArray[Any]] = {}
    for name, value in vars(buffer).items():
        parts = value.items() if isinstance(value, dict) else [("", value)]
        for key, array in parts:
            has_rows = isinstance(array, np.ndarray) and array.shape[:1] == (buffer.buffer_size,)
            if has_rows and array.dtype != object:
                found[f"{name}/{key}" if key else name] = array
    return found


def _restore_buffer(model: BaseAlgorithm, replayed: Tensors, counts: dict[str, Any]) -> None:
    buffer = _replay_buffer(model)
    if buffer is None:
        return
    arrays = _arrays(buffer)
    if set(arrays) != set(replayed):
        raise ValueError(f"its replay buffer has {sorted(replayed)}, this one {sorted(arrays)}")
    for name, tensor in replayed.items():
        arrays[name][: len(tensor)] = tensor.numpy()
    buffer.pos, buffer.full = counts["position"], counts["full"]
