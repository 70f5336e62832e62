"""Timing by turns: the contestants alternate, so that a drift of the machine's speed meets all."""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable, Mapping
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Key = TypeVar("Key", bound=Hashable)


def interleaved(
    contestants: Mapping[Key, Callable[[], object]], rounds: int, seconds: float
) -> dict[Key, NDArray[np.float64]]:
    """Seconds per call of each contestant, one value per round.

    Args:
        contestants: what is called.  Two calls of each before the first round warm it up.
        rounds: rounds, in each of which every contestant has one turn.
        seconds: a turn has as many calls as fit into this time, at least one.
    """
    calls = {}
    for name, call in contestants.items():
        call()
        calls[name] = max(1, round(seconds / _seconds(call, 1)))
    times: dict[Key, list[float]] = {name: [] for name in contestants}
    for _ in range(rounds):
        for name, call in contestants.items():
            times[name].append(_seconds(call, calls[name]) / calls[name])
    return {name: np.array(values) for name, values in times.items()}


def _seconds(call: Callable[[], object], calls: int) -> float:
    start = time.perf_counter()
    for _ in range(calls):
        call()
    return time.perf_counter() - start
