"""Timing by turns: calls alternate, so that machine drift affects all equally."""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable, Mapping
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Key = TypeVar("Key", bound=Hashable)


def interleaved(
    calls_by_name: Mapping[Key, Callable[[], object]], rounds: int, seconds: float
) -> dict[Key, NDArray[np.float64]]:
    """Return the seconds per call of each, one value per round.

    Args:
        calls_by_name: what is timed.  Two calls of each before the first round warm it up.
        rounds: rounds, in each of which each has one turn.
        seconds: a turn has as many calls as fit into this time, at least one.
    """
    calls = {}
    for name, call in calls_by_name.items():
        call()
        calls[name] = max(1, round(seconds / _seconds(call, 1)))
    times: dict[Key, list[float]] = {name: [] for name in calls_by_name}
    for _ in range(rounds):
        for name, call in calls_by_name.items():
            times[name].append(_seconds(call, calls[name]) / calls[name])
    return {name: np.array(values) for name, values in times.items()}


def _seconds(call: Callable[[], object], calls: int) -> float:
    start = time.perf_counter()
    for _ in range(calls):
        call()
    return time.perf_counter() - start
