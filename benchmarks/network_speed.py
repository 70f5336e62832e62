"""The network of hinges by the number of joints, and the network in torch.

Run it with `python benchmarks/network_speed.py`.  The network of hinges settles on random poses of
chains of 7, 14 and 28 joints.  torch, without and with gradients back to the start, is compared
with numpy; they take turns, and ratios are medians of those of each round.  `speed` compares the
network with a plain copy of its state, and times the agents.
"""

from __future__ import annotations

import time
import tracemalloc
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np
import torch
import tyro
from rich.console import Console
from rich.table import Table
from timing import interleaved

from mmc_gym.network import LearnedNormalizer, MMCNetwork
from mmc_gym.network.differentiable import TorchNetwork
from mmc_gym.robots import HingeArm, HingeNetwork

BATCHES = (1_000, 10_000, 100_000)
ITERATIONS = 20  # of `run`, per call


@dataclass
class Arguments:
    """Time the networks.

    Attributes:
        rounds: rounds, in each of which each has one turn.
        seconds: least duration of a turn.
        tables: what to time; "hinges" takes up to a minute to compile for every chain.
        device: of torch, such as "cuda"; numpy stays on the processor.
    """

    rounds: int = 9
    seconds: float = 0.02
    tables: tuple[Literal["hinges", "torch"], ...] = ("hinges", "torch")
    device: str = "cpu"


def repeated(arm: HingeArm, times: int) -> HingeArm:
    """Return a chain of arms, each on the hand of the one before."""
    axes, points, home = [], [], np.eye(4)
    for _ in range(times):
        axes.append(arm.axes @ home[:3, :3].T)
        points.append(arm.points @ home[:3, :3].T + home[:3, 3])
        home = home @ arm.home
    limits = np.tile(arm.limits, (times, 1))
    return HingeArm(np.concatenate(axes), np.concatenate(points), home, limits)


def hinge_table(arguments: Arguments) -> Table:
    """Iterations, time and memory until a pose is found, by the number of joints."""
    table = Table(title="Network of hinges: Pandas on Pandas, poses within 1 mm and 0.01 rad")
    for heading in ("joints", "nodes", "solved", "iterations", "µs alone", "µs in 256", "kB alone"):
        table.add_column(heading, justify="right")
    count = 256
    for times in (1, 2, 4):
        arm = repeated(HingeArm.named("panda"), times)
        network = HingeNetwork(arm)
        random = np.random.default_rng(0)
        poses = arm.forward(random.uniform(*arm.limits.T, (count, arm.joint_count)))
        task = poses[:, :3, 3], poses[:, :3, :3]
        network.solve(*task)  # compiles
        seconds = []
        for position, rotation in zip(*task):
            start = time.process_time()
            network.solve(position, rotation)
            seconds.append(time.process_time() - start)
        start = time.process_time()
        solution = network.solve(*task)
        together = (time.process_time() - start) / count
        tracemalloc.start()
        network.solve(position, rotation)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        table.add_row(
            str(arm.joint_count),
            str(arm.node_count),
            f"{solution.is_solved.mean():.1%}",
            f"{np.median(solution.iterations):.0f}",
            f"{np.median(seconds) * 1e6:,.0f}",
            f"{together * 1e6:,.0f}",
            f"{peak / 1000:,.0f}",
        )
    return table


def torch_table(arguments: Arguments) -> Table:
    """Time per arm and iteration of numpy and torch, one thread each."""
    table = Table(
        title=f"torch on {arguments.device}: ns per arm and iteration, {ITERATIONS} of them"
    )
    for heading in ("network", "precision"):
        table.add_column(heading)
    for heading in ("batch", "numpy", "torch", "torch / numpy", "with gradients"):
        table.add_column(heading, justify="right")
    networks = {
        "kinematic": MMCNetwork(),
        "dynamic": MMCNetwork(dynamics="paper"),
        "learned": MMCNetwork(normalizer=LearnedNormalizer.shipped()),
    }
    for name, network in networks.items():
        for dtype in (np.float64, np.float32):
            for batch in BATCHES:
                calls = torch_calls(network, np.dtype(dtype), batch, arguments.device)
                times = interleaved(calls, arguments.rounds, arguments.seconds)
                scale = 1e9 / batch / ITERATIONS
                cells = {key: f"{np.median(value) * scale:,.1f}" for key, value in times.items()}
                ratio = np.median(times["torch"] / times["numpy"])
                row = (np.dtype(dtype).name, f"{batch:,}", cells["numpy"], cells["torch"])
                table.add_row(name, *row, f"{ratio:.1f}", cells["gradients"])
    return table


def torch_calls(
    network: MMCNetwork, dtype: np.dtype, batch: int, device: str
) -> dict[str, Callable[[], object]]:
    """Return runs of one network in numpy and in torch, there with gradients, too."""
    random = np.random.default_rng(0)
    posture = random.uniform(-np.pi, np.pi, (batch, 3)).astype(dtype)
    target = random.uniform(-1.5, 1.5, (batch, 2)).astype(dtype)
    state, clamps = network.state_from_joint_angles(posture), network.inverse(target)
    calls = {"numpy": partial(network.run, state, clamps, ITERATIONS)}
    twin = TorchNetwork(network, device=device, dtype=getattr(torch, dtype.name))
    angles = torch.from_numpy(posture).to(device).requires_grad_()
    held = twin.inverse(torch.from_numpy(target).to(device))

    def wait() -> None:
        if device != "cpu":
            torch.accelerator.synchronize()

    def run() -> None:
        with torch.no_grad():
            twin(begin, held, ITERATIONS)
        wait()

    def run_back() -> None:
        twin(twin.state_from_joint_angles(angles), held, ITERATIONS).end_effector.sum().backward()
        wait()

    with torch.no_grad():
        begin = twin.state_from_joint_angles(angles)
    return calls | {"torch": run, "gradients": run_back}


def main(arguments: Arguments) -> None:
    """Print the tables."""
    torch.set_num_threads(1)
    console = Console(width=100)
    tables = {"hinges": hinge_table, "torch": torch_table}
    for name in arguments.tables:
        console.print(tables[name](arguments))


if __name__ == "__main__":
    main(tyro.cli(Arguments))
