"""Steps per second of `MMCReach-v0` beside other reaching environments.

Run it with `make benchmark`, or `python benchmarks/environment_speed.py`; peers that are not
installed (they are in the `benchmark` extra) are named and left out.  The environments take
turns, and a ratio is the median over the rounds of each round's own ratio.  The last table shows
how the native vector environment grows with the number of its arms.
"""

from __future__ import annotations

import os
import platform
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from itertools import pairwise
from math import nan
from multiprocessing import get_context
from pathlib import Path
from typing import TypeAlias

import gymnasium as gym
import numpy as np
import tyro
from gymnasium.error import DependencyNotInstalled
from numpy.typing import NDArray
from peers import (
    ENGINES,
    GROWTH,
    OURS,
    PEER,
    REFERENCE,
    SINGLE,
    VECTOR,
    WHAT_THEY_SIMULATE,
    Entry,
    Player,
)
from rich.console import Console
from rich.table import Table
from timing import interleaved

Times: TypeAlias = Mapping[Entry, NDArray[np.float64]]
PACKAGES = ("numpy", "gymnasium", "pymunk", "numba", "mujoco", "dm_control", "envpool")


@dataclass
class Arguments:
    """Time the environments in turn.

    Attributes:
        rounds: rounds, in each of which every environment has one turn.
        seconds: a turn is as many episodes as fit into this time, at least one.
        growth_rounds: rounds for the last table; 0 leaves it out.
    """

    rounds: int = 10
    seconds: float = 0.06
    growth_rounds: int = 3


def make_all(entries: Iterable[Entry], console: Console) -> dict[Entry, Player]:
    """Make those whose packages are installed, and name the others."""
    made = {}
    # Processes fork off while this one still has no threads.
    for entry in sorted(entries, key=lambda entry: entry.variant != "async"):
        try:
            made[entry] = entry.make()
        except (ImportError, DependencyNotInstalled) as error:
            reason = str(error).partition("\n")[0]
            console.print(f"not installed: {entry.environment} {entry.variant} ({reason})")
    return made


def seconds_per_step(made: Mapping[Entry, Player], rounds: int, seconds: float) -> Times:
    """Return the mean time of a step, one value per round."""
    times = interleaved({entry: one.play for entry, one in made.items()}, rounds, seconds)
    for one in made.values():
        one.close()
    return {entry: values / made[entry].steps for entry, values in times.items()}


def speed(seconds: NDArray[np.float64]) -> str:
    """Return steps per second to three digits."""
    return f"{float(f'{1 / np.median(seconds):.3g}'):,.0f}"


def ratios(times: Times, entry: Entry, reference: Entry) -> tuple[str, str]:
    """Return how many times as fast as the reference: median and quartiles over the rounds."""
    if reference not in times:
        return "–", "–"
    low, middle, high = np.percentile(times[reference] / times[entry], [25, 50, 75])
    digits = 2 if middle < 10 else 1
    return f"{middle:.{digits}f}", f"{low:.{digits}f} – {high:.{digits}f}"


def single_table(times: Times) -> Table:
    """Make the table of single environments."""
    headings = ("µs per step", "steps per second", f"ratio to {PEER}", "quartiles")
    table = empty_table("one arm", ("environment", ""), headings)
    for entry in filter(times.__contains__, SINGLE):
        microseconds = f"{np.median(times[entry]) * 1e6:.1f}"
        numbers = (microseconds, speed(times[entry]), *ratios(times, entry, REFERENCE))
        table.add_row(entry.environment, entry.variant, *numbers)
    return table


def vector_table(times: Times) -> Table:
    """Make the table of vector environments, beside EnvPool's with as many threads."""
    headings = ("arms", "threads", "steps per second", f"to {PEER}", "quartiles", "to EnvPool")
    title = f"many arms; ratios to one {PEER}, and to EnvPool with as many threads"
    table = empty_table(title, ("environment", ""), headings)
    peers = {entry.threads: entry for entry in VECTOR if entry.variant == "EnvPool"}
    for entry in filter(times.__contains__, VECTOR):
        peer = peers.get(entry.threads)
        to_peer = ratios(times, entry, peer)[0] if peer else "–"
        threads = "processes" if entry.variant == "async" else str(entry.threads)
        numbers = (speed(times[entry]), *ratios(times, entry, REFERENCE), to_peer)
        table.add_row(entry.environment, entry.variant, str(entry.arms), threads, *numbers)
    return table


def growth_table(times: Times) -> Table:
    """Make the table of the native vector environment by number of arms."""
    headings = ("arms", "1 thread", "2 threads", "ratio", "µs per arm", "KiB per arm")
    table = empty_table("native, steps per second by number of arms", ("engine",), headings)
    for engine in ENGINES:
        alone, two = (
            [entry for entry in times if (entry.variant, entry.threads) == (engine, threads)]
            for threads in (1, 2)
        )
        memory = bytes_per_arm(engine, [entry.arms for entry in alone]) if alone else []
        for one, both, size in zip(alone, two, memory, strict=True):
            numbers = (
                speed(times[one]),
                speed(times[both]),
                ratios(times, both, one)[0],
                f"{np.median(times[one]) * 1e6:.2f}",
                f"{size / 1024:.1f}" if one.arms >= 256 else "",  # few arms vanish in a page
            )
            table.add_row(engine, f"{one.arms:,}", *numbers, end_section=both is two[-1])
    return table


def bytes_per_arm(engine: str, counts: Sequence[int]) -> list[float]:
    """Return by how much a fresh process grows per arm of vector environments of these sizes."""
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
    """Return the resident size of this process in bytes; NaN where there is no /proc."""
    pages = Path("/proc/self/statm")
    return int(pages.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") if pages.exists() else nan


def empty_table(title: str, words: Iterable[str], numbers: Iterable[str]) -> Table:
    """Make a table with columns of words, then of numbers."""
    table = Table(title=title)
    for heading in words:
        table.add_column(heading, no_wrap=True)
    for heading in numbers:
        table.add_column(heading, justify="right")
    return table


def machine() -> str:
    """Name the machine and the versions."""
    found = [f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"]
    for package in PACKAGES:
        try:
            found.append(f"{package} {version(package)}")
        except PackageNotFoundError:
            continue
    return ", ".join(found)


def main(arguments: Arguments) -> None:
    """Print the tables."""
    console = Console(width=120, highlight=False)
    console.print(machine())
    made = make_all((*SINGLE, *VECTOR), console)
    times = seconds_per_step(made, arguments.rounds, arguments.seconds)
    console.print(single_table(times))
    console.print(vector_table(times))
    console.print(WHAT_THEY_SIMULATE)
    if arguments.growth_rounds:
        made = make_all(GROWTH, console)
        console.print(growth_table(seconds_per_step(made, arguments.growth_rounds, 0.02)))


if __name__ == "__main__":
    main(tyro.cli(Arguments))
