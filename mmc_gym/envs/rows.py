"""Rows: what belongs to some arms, in arrays that have a row for every arm."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Bools = NDArray[np.bool_]


def pick(observation: Any, arms: Any) -> Any:
    """The rows of an observation, an array or a dict of them, that belong to `arms`."""
    if isinstance(observation, dict):
        return {key: values[arms] for key, values in observation.items()}
    return observation[arms]


def put(observation: Any, arms: NDArray[np.intp], rows: Any) -> None:
    """Write rows into an observation, an array or a dict of them."""
    if isinstance(observation, dict):
        for key, values in observation.items():
            values[arms] = rows[key]
    else:
        observation[arms] = rows


def spread(info: dict[str, Any], mask: Bools) -> dict[str, Any]:
    """Gymnasium's vector infos: rows of the masked arms in arrays for all, each with its mask."""
    infos: dict[str, Any] = {}
    everywhere = mask.all()
    for name, values in info.items():
        if everywhere:
            infos[name] = values
        else:
            infos[name] = np.zeros((len(mask), *values.shape[1:]), values.dtype)
            infos[name][mask] = values
        infos[f"_{name}"] = mask.copy()
    return infos


def check_mask(mask: Any, count: int) -> Bools:
    """The mask of the arms to reset; None stands for all.

    Raises:
        ValueError: if it is no numpy array of `count` bools, or all are False.
    """
    if mask is None:
        return np.ones(count, dtype=bool)
    fine = isinstance(mask, np.ndarray) and mask.dtype == bool
    if not fine or mask.shape != (count,) or not mask.any():
        raise ValueError(
            f"options['reset_mask'] must be a numpy array of {count} bools, not all False, "
            f"got {mask!r}"
        )
    return np.array(mask)


def check_seeds(seed: int | Sequence[int | None] | None, count: int) -> list[int | None]:
    """A seed for each arm, or None; from one number, it and those that follow it.

    Raises:
        ValueError: if there are not `count` of them, or one is negative.
    """
    if seed is None:
        return [None] * count
    if isinstance(seed, (int, np.integer)):
        seeds: list[int | None] = [int(seed) + arm for arm in range(count)]
    else:
        seeds = list(seed)
    if len(seeds) != count or any(one is not None and one < 0 for one in seeds):
        raise ValueError(f"seed must be a number of at least 0, or {count} of them, got {seed!r}")
    return seeds
