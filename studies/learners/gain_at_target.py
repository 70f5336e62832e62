"""Print how strongly agents act near the target: why some bear weak, pushed and sticky motors.

    python -m studies.learners.gain_at_target --agents ppo-0 ppo-drawn-0 mmc

An arm at rest has its hand at a small distance from the target.  The gain is the speed at which the
agent's first action would bring the hand nearer, divided by the distance; the size is that of its
largest action.  A motor that is pushed by a constant action leaves the hand where the agent's own
action cancels the push.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
import tyro
from rich.console import Console

from mmc_gym.agents import resolve_all
from mmc_gym.measures import episode_seeds
from studies.tables import table_of

DISTANCES = (0.02, 0.05, 0.1, 0.2)  # segment lengths
POSTURES = 200


@dataclass(frozen=True)
class Arguments:
    """Print gains near the target."""

    agents: tuple[str, ...] = ("ppo-0", "ppo-drawn-0", "ppo-memory-0", "mmc-body", "mmc")


def first_actions(agent: str, distance: float) -> tuple[float, float]:
    """Return the medians of gain, 1/s, and of the largest action over postures."""
    (resolved,) = resolve_all([agent], every_training=False)
    env: Any = gym.make("MMCReach-v0", **resolved.arguments)
    player = resolved.factory(env)
    gains, sizes, random = [], [], np.random.default_rng(0)
    for seed in episode_seeds(0, POSTURES):
        _, info = env.reset(seed=seed)
        angle, posture = random.uniform(-np.pi, np.pi), env.unwrapped.arm.joint_angles
        target = info["end_effector"] + distance * np.array([np.cos(angle), np.sin(angle)])
        if np.hypot(*target) > sum(env.unwrapped.setup.given_body.segment_lengths):
            continue  # out of reach
        options = {"joint_angles": posture, "target": target}
        observation, _ = env.reset(seed=seed, options=options)
        action, _ = player.predict(observation, deterministic=True)
        info = env.step(action)[-1]
        gains.append((1 - info["distance"] / distance) / env.unwrapped.setup.control_step)
        sizes.append(np.abs(action).max())
    return float(np.median(gains)), float(np.median(sizes))


def main(arguments: Arguments) -> None:
    """Print the gain and the largest action of each agent, by distance."""
    rows = []
    for agent in arguments.agents:
        row: dict[str, str] = {"agent": agent}
        for distance in DISTANCES:
            gain, size = first_actions(agent, distance)
            row[f"at {distance:g}"] = f"{gain:.1f} / s, {size:.2f}"
        rows.append(row)
    Console().print(table_of(rows, "gain, and largest action, by distance in segment lengths"))


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
