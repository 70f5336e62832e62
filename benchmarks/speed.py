"""Speed of this package and of its peers: environments, the network, and agents.

Run it with `make speed`, or `python benchmarks/speed.py`; peers that are not installed (they are in
the `benchmark` extra) are named and left out.  Timed calls take turns; a ratio is the median over
the rounds of each round's ratio.  `runs/speed` keeps the numbers of each run; `--check` fails on a
loss of speed since the earlier runs, see `history`.
"""

from __future__ import annotations

import os
import platform
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from itertools import pairwise
from math import nan
from multiprocessing import get_context
from pathlib import Path
from typing import Any, TypeAlias

import gymnasium as gym
import numpy as np
import torch
import tyro
from gymnasium.error import DependencyNotInstalled
from history import Run, SpeedRow, losses, now, read_runs, write_run
from numpy.typing import NDArray
from peers import (
    DRAWN,
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
    drawn_entries,
)
from rich.console import Console
from rich.table import Table
from timing import interleaved

from mmc_gym import make_agent
from mmc_gym.network import MMCNetwork

Times: TypeAlias = Mapping[Entry, NDArray[np.float64]]
PACKAGES = ("numpy", "gymnasium", "pymunk", "numba", "mujoco", "dm_control", "envpool", "gymnax")
NETWORKS = (10_000, 1_000_000)  # run together; copying few would time the call alone
ITERATIONS = 20  # of a network, per call
COPY = "copy of the state"  # reads and writes each byte once, as any iteration must
AGENTS = ("mmc", "mmc-body", "ppo")


@dataclass
class Arguments:
    """Time the environments in turn.

    Attributes:
        rounds: number of rounds; in each, every environment has one turn.
        seconds: length of a turn: as many episodes as fit into it, at least one.
        growth_rounds: rounds for the table of numbers of arms; 0 leaves it out.
        drawn_rounds: rounds for the table of strengths drawn for each episode; 0 leaves it out.
        out: folder that keeps the numbers of all runs.
        check: whether to fail on a loss of speed since the earlier runs.
    """

    rounds: int = 10
    seconds: float = 0.06
    growth_rounds: int = 3
    drawn_rounds: int = 3
    out: Path = Path("runs/speed")
    check: bool = False


def make_all(entries: Iterable[Entry], console: Console) -> dict[Entry, Player]:
    """Return the environments whose packages are installed; print the names of the others."""
    players = {}
    # Async first: its processes must fork while this one still has no threads.
    for entry in sorted(entries, key=lambda entry: entry.variant != "async"):
        try:
            players[entry] = entry.make()
        except (ImportError, DependencyNotInstalled) as error:
            reason = str(error).partition("\n")[0]
            console.print(f"not installed: {entry.environment} {entry.variant} ({reason})")
    return players


def seconds_per_step(players: Mapping[Entry, Player], rounds: int, seconds: float) -> Times:
    """Return the mean seconds per step of each entry, (rounds,), and close the environments."""
    times = interleaved({entry: player.play for entry, player in players.items()}, rounds, seconds)
    for player in players.values():
        player.close()
    return {entry: values / players[entry].steps for entry, values in times.items()}


def speed(seconds: NDArray[np.float64]) -> str:
    """Return the median steps per second as text, to three significant digits."""
    return f"{float(f'{1 / np.median(seconds):.3g}'):,.0f}"


def ratios(times: Times, entry: Entry, reference: Entry) -> tuple[str, str]:
    """Return the entry's speed relative to the reference, as text: median, and quartiles."""
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
    """Make the table of vector environments, compared with EnvPool on as many threads."""
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
        one_thread, two_threads = (
            [entry for entry in times if (entry.variant, entry.threads) == (engine, threads)]
            for threads in (1, 2)
        )
        memory = bytes_per_arm(engine, [entry.arms for entry in one_thread]) if one_thread else []
        for entry, threaded, size in zip(one_thread, two_threads, memory, strict=True):
            numbers = (
                speed(times[entry]),
                speed(times[threaded]),
                ratios(times, threaded, entry)[0],
                f"{np.median(times[entry]) * 1e6:.2f}",
                f"{size / 1024:.1f}" if entry.arms >= 256 else "",  # few arms vanish in a page
            )
            is_last = threaded is two_threads[-1]
            table.add_row(engine, f"{entry.arms:,}", *numbers, end_section=is_last)
    return table


def drawn_table(rounds: int, console: Console) -> Table:
    """Make the table that compares strengths drawn for each episode with fixed strengths.

    Some strengths take the physics longer, so the time of fixed ones is a mean over three.
    """
    headings = ("µs per step", "with equal strengths", "without perturbations")
    title = "native, strengths drawn for each episode; speed relative to arms"
    table = empty_table(title, ("engine", "perturbation"), headings)
    for engine, arms in zip(ENGINES, (256, 4096), strict=True):
        entries = drawn_entries(engine, arms)
        times = seconds_per_step(make_all(entries.values(), console), rounds, 0.02)
        for family, strength_range, strengths in DRAWN if times else ():
            name = f"{family}-{strength_range}"
            drawn = times[entries[name]]
            fixed = [times[entries[f"{family}-{strength}"]] for strength in strengths]
            references = np.mean(fixed, axis=0), times[entries[""]]
            compared = (f"{np.median(reference / drawn):.2f}" for reference in references)
            microseconds = f"{np.median(drawn) * 1e6 * arms:.0f}"
            table.add_row(f"{engine}, {arms:,} arms", name, microseconds, *compared)
    return table


def bytes_per_arm(engine: str, counts: Sequence[int]) -> list[float]:
    """Return the bytes per arm of vector environments of `counts` arms, from a fresh process."""
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


def network_times(arguments: Arguments) -> dict[str, dict[int, NDArray[np.float64]]]:
    """Return seconds per arm and iteration, (rounds,), by call (a copy or network) and arms."""
    random, times_by_call = np.random.default_rng(0), dict[str, dict[int, NDArray[np.float64]]]()
    for count in NETWORKS:
        posture = random.uniform(-np.pi, np.pi, (count, 3))
        target = random.uniform(-1.5, 1.5, (count, 2))
        network = MMCNetwork(dynamics="paper")
        state, clamps = network.state_from_joint_angles(posture), network.inverse(target)
        calls = {COPY: state.values.copy, "numpy": partial(network.run, state, clamps, ITERATIONS)}
        times = interleaved(calls, arguments.rounds, arguments.seconds / 3)
        for name, seconds in times.items():
            iterations = 1 if name == COPY else ITERATIONS
            times_by_call.setdefault(name, {})[count] = seconds / iterations / count
    return times_by_call


def agent_times(arguments: Arguments) -> dict[str, NDArray[np.float64]]:
    """Return seconds per action of each of `AGENTS`, (rounds,), for one arm.

    They are means over all looks of an episode, each with the state that the agent has then: the
    first looks, at an arm at rest, are no measure of the others.
    """
    env = gym.make(OURS)
    agents = {name: make_agent(name, env) for name in AGENTS}
    looks = {name: looks_of(agent, env) for name, agent in agents.items()}
    calls = {name: partial(act_again, agent, looks[name]) for name, agent in agents.items()}
    torch.set_num_threads(1)  # small networks act faster on one thread
    times = interleaved(calls, arguments.rounds, arguments.seconds / 3)
    return {name: seconds / len(looks[name]) for name, seconds in times.items()}


def looks_of(agent: Any, env: gym.Env[Any, Any]) -> list[tuple[Any, Any]]:
    """Return what an agent acts on in an episode: observations, each with the agent's state."""
    observation, _ = env.reset(seed=0)
    state, looks, is_over = None, [], False
    while not is_over:
        looks.append((observation, state))
        action, state = agent.predict(observation, state, deterministic=True)
        observation, _, terminated, truncated, _ = env.step(action)
        is_over = terminated or truncated
    return looks


def act_again(agent: Any, looks: Iterable[tuple[Any, Any]]) -> None:
    """Let an agent choose all actions of an episode once more."""
    for observation, state in looks:
        agent.predict(observation, state, deterministic=True)


def rows_of(
    times: Mapping[Any, NDArray[np.float64]], names: Mapping[Any, str], peer: Any
) -> list[SpeedRow]:
    """Return a row per call, with its speed relative to the peer; none if the peer is missing."""
    if peer not in times:
        return []
    rows = []
    for key, seconds in times.items():
        low, middle, high = np.percentile(times[peer] / seconds, [25, 50, 75]).tolist()
        # How 64 processes share a few cores says nothing of this package.
        ours = (
            key.variant != "async" and not is_peer(key) if isinstance(key, Entry) else key != peer
        )
        median = float(np.median(seconds))
        rows.append(SpeedRow(names[key], ours, median, names[peer], middle, low, high))
    return rows


def rows_table(title: str, unit: str, scale: float, rows: Iterable[SpeedRow]) -> Table:
    """Make a table of rows, with their seconds times `scale` in `unit`, and their ratios."""
    table = empty_table(title, ("",), (unit, "ratio", "quartiles"))
    for row in rows:
        numbers = (
            f"{row.seconds * scale:.3g}",
            f"{row.ratio:.3g}",
            f"{row.low:.3g} – {row.high:.3g}",
        )
        table.add_row(row.name, *numbers)
    return table


def is_peer(entry: Entry) -> bool:
    """Return whether an environment belongs to another package."""
    return not entry.environment.startswith("MMC")


def name_of(entry: Entry) -> str:
    """Return the name of an entry, the same in all runs."""
    kind = f"{entry.environment} {entry.variant}".strip()
    threads = "processes" if entry.variant == "async" else threads_of(entry)
    return kind if entry.arms == 1 else f"{kind}, {entry.arms:,} arms, {threads}"


def threads_of(entry: Entry) -> str:
    """Return the number of threads that step the arms, in words."""
    return f"{entry.threads} thread{'s' * (entry.threads > 1)}"


def empty_table(title: str, words: Iterable[str], numbers: Iterable[str]) -> Table:
    """Make a table with columns of words, then of numbers."""
    table = Table(title=title)
    for heading in words:
        table.add_column(heading, no_wrap=True)
    for heading in numbers:
        table.add_column(heading, justify="right")
    return table


def machine() -> str:
    """Return the machine, and the versions of Python and of the timed packages, as text."""
    facts = [f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"]
    for package in PACKAGES:
        try:
            facts.append(f"{package} {version(package)}")
        except PackageNotFoundError:
            continue
    return ", ".join(facts)


def main(arguments: Arguments) -> None:
    """Print the tables, keep the numbers, draw the figures; with `--check`, fail on a loss."""
    console = Console(width=120, highlight=False)
    console.print(machine())
    players = make_all((*SINGLE, *VECTOR), console)
    times = seconds_per_step(players, arguments.rounds, arguments.seconds)
    console.print(single_table(times))
    console.print(vector_table(times))
    console.print(WHAT_THEY_SIMULATE)
    rows = rows_of(times, {entry: name_of(entry) for entry in times}, REFERENCE)
    networks, agents = network_times(arguments), agent_times(arguments)
    network_rows = []
    for count in NETWORKS:
        call_times = {call: seconds[count] for call, seconds in networks.items()}
        names = {call: f"network, {call}, {count:,} arms" for call in call_times}
        network_rows += rows_of(call_times, names, COPY)
    title = "an iteration of the network, dynamic; ratio to a copy of its state"
    console.print(rows_table(title, "ns per arm", 1e9, network_rows))
    agent_rows = rows_of(agents, {name: f"one action of {name}" for name in agents}, "ppo")
    console.print(rows_table("an action for one arm; ratio to ppo", "µs", 1e6, agent_rows))
    arguments.out.mkdir(parents=True, exist_ok=True)
    if arguments.growth_rounds:
        players = make_all(GROWTH, console)
        console.print(growth_table(seconds_per_step(players, arguments.growth_rounds, 0.02)))
    if arguments.drawn_rounds:
        console.print(drawn_table(arguments.drawn_rounds, console))
    file = write_run(Run(now(), machine(), (*rows, *network_rows, *agent_rows)), arguments.out)
    runs = read_runs(arguments.out)
    console.print(f"wrote {file}; {len(runs)} runs are there")
    if lost := losses(runs):
        console.print("\n".join(["slower than before:", *lost]))
        if arguments.check:
            raise SystemExit(1)


if __name__ == "__main__":
    main(tyro.cli(Arguments))
