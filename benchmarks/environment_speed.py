"""Steps per second of `MMCReach-v0` beside `Reacher-v5`, both as `gym.make` returns them.

Run it with `python benchmarks/environment_speed.py` (needs the `dev` extra, for MuJoCo).  The
environments take turns in short rounds, so that a drift of the machine's speed meets all of
them; the ratio is the median over the rounds of each round's own ratio.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import gymnasium as gym
import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

import mmc_gym  # noqa: F401  (registers the environments)

PEER = "Reacher-v5"
CONTESTANTS: dict[str, tuple[str, dict[str, str]]] = {
    PEER: (PEER, {}),
    "MMCReach-v0": ("MMCReach-v0", {}),
    "MMCReach-v0, joint_delta": ("MMCReach-v0", {"control": "joint_delta"}),
    "MMCReach-v0, joint_velocity": ("MMCReach-v0", {"control": "joint_velocity"}),
    "MMCReach-v0, joint_torque": ("MMCReach-v0", {"control": "joint_torque"}),
    "MMCReachGoal-v0": ("MMCReachGoal-v0", {}),
}


@dataclass
class Arguments:
    """Time the environments in turn.

    Attributes:
        rounds: rounds, in each of which every environment has one turn.
        steps: steps in a turn.
    """

    rounds: int = 30
    steps: int = 2000


def seconds_per_step(env: gym.Env, actions: list[np.ndarray]) -> float:
    """Mean time of a step under the given actions, resets when an episode ends included."""
    start = time.perf_counter()
    for action in actions:
        _, _, terminated, truncated, _ = env.step(action)
        if terminated or truncated:
            env.reset()
    return (time.perf_counter() - start) / len(actions)


def main(arguments: Arguments) -> None:
    """Print one row per environment: median time of a step, steps per second, ratio."""
    envs, actions = {}, {}
    for name, (env_id, options) in CONTESTANTS.items():
        envs[name] = gym.make(env_id, **options)
        envs[name].reset(seed=0)
        envs[name].action_space.seed(0)
        actions[name] = [envs[name].action_space.sample() for _ in range(arguments.steps)]
    times = {
        name: np.array([seconds_per_step(envs[name], actions[name])])[:0] for name in CONTESTANTS
    }  # one turn each to warm up
    for _ in range(arguments.rounds):
        for name in CONTESTANTS:
            times[name] = np.append(times[name], seconds_per_step(envs[name], actions[name]))

    table = Table(title=f"{arguments.rounds} rounds of {arguments.steps} steps, interleaved")
    table.add_column("environment")
    for heading in ("µs per step", "steps per second", f"ratio to {PEER}", "quartiles"):
        table.add_column(heading, justify="right")
    for name, seconds in times.items():
        median = np.median(seconds)
        low, middle, high = np.percentile(times[PEER] / seconds, [25, 50, 75])
        table.add_row(
            name,
            f"{median * 1e6:.1f}",
            f"{1 / median:,.0f}",
            f"{middle:.2f}",
            f"{low:.2f} – {high:.2f}",
        )
    Console(width=100).print(table)


if __name__ == "__main__":
    main(tyro.cli(Arguments))
