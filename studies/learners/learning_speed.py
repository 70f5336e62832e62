"""Time the training of a policy from nothing until it reaches: PPO on many analytic arms.

stable-baselines3's PPO learns on the analytic engine (extra `fast`).  Its policies are copied
during the training, without counting that time, and scored after it: on pymunk, with targets that
they have not seen.  The table shows when 95 % and 98 % of the targets were reached for the first
time, by seed and as the median, in wall time and in processor time, which other work on the machine
does not lengthen.  A profile shows where the processor time goes.
"""

from __future__ import annotations

import copy
import cProfile
import pstats
import time
from dataclasses import dataclass
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
import torch
import tyro
from rich.console import Console
from rich.table import Table
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from typing_extensions import override

import mmc_gym  # noqa: F401  (registers the environments)
from mmc_gym.training.vec_env import GymnasiumVecEnv

SHARES = (0.95, 0.98)
SETTINGS: dict[str, Any] = dict(
    n_steps=16,
    batch_size=1024,
    n_epochs=3,
    learning_rate=1e-3,
    gamma=0.9,
    ent_coef=0.003,
    policy_kwargs=dict(
        net_arch=[64, 64], activation_fn=torch.nn.ReLU, optimizer_kwargs=dict(fused=True)
    ),
)


@dataclass
class Arguments:
    """Time trainings."""

    seeds: int = 5  # number of training seeds, from 0
    arms: int = 512  # number of arms that learn together
    steps: int = 400_000  # steps of a training, of all arms together
    threads: int = 1  # threads of torch and of the environment
    targets: int = 500  # number of targets with which each policy is scored
    profile: bool = True  # show where the processor time of another, short training goes


class Snapshot(NamedTuple):
    """A policy, with the steps and seconds of training until then."""

    steps: int
    wall: float
    processor: float
    weights: dict[str, torch.Tensor]


class Clock(BaseCallback):
    """Copy the policy before every update; the copying is not timed."""

    def __init__(self) -> None:
        super().__init__()
        self.snapshots: list[Snapshot] = []

    @override
    def _on_training_start(self) -> None:
        self._wall, self._processor = time.perf_counter(), time.process_time()

    @override
    def _on_step(self) -> bool:
        return True

    @override
    def _on_rollout_end(self) -> None:
        wall, processor = time.perf_counter(), time.process_time()
        weights = copy.deepcopy(self.model.policy.state_dict())
        self.snapshots.append(
            Snapshot(self.num_timesteps, wall - self._wall, processor - self._processor, weights)
        )
        self._wall += time.perf_counter() - wall
        self._processor += time.process_time() - processor


def make_model(arguments: Arguments, seed: int) -> PPO:
    """Return an untrained model."""
    arms = gym.make_vec(
        "MMCReach-v0",
        arguments.arms,
        engine="analytic",
        autoreset_mode="SameStep",
        threads=arguments.threads,
    )
    return PPO("MlpPolicy", GymnasiumVecEnv(arms), seed=seed, device="cpu", **SETTINGS)


def share_reached(model: PPO, weights: dict[str, torch.Tensor], targets: int) -> float:
    """Return the share of targets at which a policy ends its episodes, on pymunk."""
    model.policy.load_state_dict(weights)
    arms = gym.make_vec("MMCReach-v0", targets)
    observations, _ = arms.reset(seed=1_000_000)
    for _ in range(100):
        actions, _ = model.predict(observations, deterministic=True)
        observations, _, _, _, infos = arms.step(actions)
    return float(infos["is_success"].mean())


def times_to(arguments: Arguments, seed: int) -> tuple[dict[float, Snapshot | None], float]:
    """Train; return the first snapshot to reach each share, and the steps per processor second."""
    model, clock = make_model(arguments, seed), Clock()
    model.learn(arguments.steps, callback=clock)
    first_snapshots: dict[float, Snapshot | None] = dict.fromkeys(SHARES)
    for snapshot in clock.snapshots:
        reached = share_reached(model, snapshot.weights, arguments.targets)
        for share in SHARES:
            if reached >= share and first_snapshots[share] is None:
                first_snapshots[share] = snapshot
        if all(first_snapshots.values()):
            break
    last = clock.snapshots[-1]
    return first_snapshots, last.steps / last.processor


def main(arguments: Arguments) -> None:
    """Print the table, and the profile."""
    torch.set_num_threads(arguments.threads)
    torch.distributions.Distribution.set_default_validate_args(False)
    console = Console(width=100)
    table = Table(title=f"PPO on {arguments.arms:,} analytic arms, scored on pymunk")
    for heading in ("seed", "reached", "steps", "seconds", "processor seconds"):
        table.add_column(heading, justify="right")
    times: dict[float, list[tuple[float, float]]] = {share: [] for share in SHARES}
    make_model(arguments, 0).learn(arguments.arms)  # compile first
    for seed in range(arguments.seeds):
        first_snapshots, speed = times_to(arguments, seed)
        for share, snapshot in first_snapshots.items():
            wall, processor = np.inf, np.inf
            steps = "never"
            if snapshot is not None:
                steps, wall, processor = f"{snapshot.steps:,}", snapshot.wall, snapshot.processor
            times[share].append((wall, processor))
            table.add_row(str(seed), f"{share:.0%}", steps, f"{wall:.1f}", f"{processor:.1f}")
        console.print(f"seed {seed}: {speed:,.0f} steps per processor second")
    for share, both in times.items():
        wall, processor = np.median(both, axis=0)
        table.add_row("median", f"{share:.0%}", "", f"{wall:.1f}", f"{processor:.1f}")
    console.print(table)
    if arguments.profile:
        with cProfile.Profile() as profile:
            make_model(arguments, 0).learn(10 * arguments.arms * SETTINGS["n_steps"])
        pstats.Stats(profile).sort_stats("tottime").print_stats(14)


if __name__ == "__main__":
    main(tyro.cli(Arguments))
