"""How much memory an arm of the native vector environment takes."""

from __future__ import annotations

import os
from collections.abc import Sequence
from itertools import pairwise
from math import nan
from multiprocessing import get_context
from pathlib import Path

import gymnasium as gym
from contestants import OURS


def bytes_per_arm(engine: str, counts: Sequence[int]) -> list[float]:
    """Growth of a fresh process with a vector environment of each size, after its first steps."""
    with get_context("spawn").Pool(1) as pool:
        return pool.apply(_grow, (engine, counts))


def _grow(engine: str, counts: Sequence[int]) -> list[float]:
    envs, sizes = [], []
    for count in (1, *counts):  # the first one brings the libraries
        envs.append(gym.make_vec(OURS, num_envs=count, engine=engine))
        envs[-1].reset(seed=0)
        for _ in range(2):
            envs[-1].step(envs[-1].action_space.sample())
        sizes.append(_resident_size())
    grown = (after - before for before, after in pairwise(sizes))
    return [size / count for size, count in zip(grown, counts, strict=True)]


def _resident_size() -> float:
    """Resident size of this process in bytes; not a number where there is no /proc."""
    pages = Path("/proc/self/statm")
    return int(pages.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") if pages.exists() else nan
