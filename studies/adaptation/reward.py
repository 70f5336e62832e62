"""Count the trials that SAC and PPO need to adapt to a visuomotor rotation from reward alone.

    python -m studies.adaptation.reward

Those of stable-baselines3 learn to reach the eight targets of `centre-out`; then the cursor is
rotated, and they continue to learn after each trial of a second.  Now and then all targets are
played once without exploration, for the hand angle at peak speed (degrees from the target, −30 is
fully adapted) and success.  `SAC-emptied` continues with an empty memory of transitions, because
those from before the rotation contradict those after it.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import tyro
from rich.console import Console
from rich.table import Table
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.env_util import make_vec_env

import mmc_gym
from mmc_gym.experiments.learning import initial_direction
from mmc_gym.measures import run_episodes

STEPS = 50  # of a trial
DIRECTIONS = 8


@dataclass(frozen=True)
class Arguments:
    """Let learners adapt by reward."""

    degrees: float = 30.0  # of the rotation
    sac_steps: int = 15_000  # steps of SAC before the rotation
    ppo_steps: int = 300_000  # the same of PPO
    trials: int = 300  # with the rotation
    every: int = 20  # trials between two measurements
    seed: int = 0  # of all trainings
    # names of those that learn; SAC, PPO, or SAC-emptied
    learners: tuple[str, ...] = ("SAC", "PPO")
    out: Path = Path("runs/reward-adaptation.json")  # file of the curves, JSON


def make(turned: float) -> gym.Env[Any, Any]:
    """Return the environment of the trials, with a rotated cursor if `turned` is not 0."""
    name = f"centre-out+rotation-{turned:g}" if turned else "centre-out"
    return mmc_gym.make(name, max_episode_steps=STEPS)


def measured(model: BaseAlgorithm, env: gym.Env[Any, Any]) -> tuple[float, float]:
    """Return the mean hand angle in the eight trials, degrees, and success."""
    options = [{"trial": trial} for trial in range(DIRECTIONS)]
    episodes = run_episodes(model, env, range(DIRECTIONS), options=options)
    hands = np.array([episode.hands for episode in episodes])
    targets = np.array([episode.target for episode in episodes])
    reached = [episode.distances[-1] <= episode.tolerance for episode in episodes]
    return float(np.mean(initial_direction(hands, targets))), float(np.mean(reached))


def curve(model: BaseAlgorithm, arguments: Arguments) -> list[tuple[int, float, float]]:
    """Rotate the cursor, and return trials, hand angle and success while the model learns."""
    turned = make(arguments.degrees)
    model.set_env(make_vec_env(lambda: make(arguments.degrees), seed=arguments.seed))
    points = [(0, *measured(model, turned))]
    for trials in range(arguments.every, arguments.trials + 1, arguments.every):
        model.learn(arguments.every * STEPS, reset_num_timesteps=False)
        points.append((trials, *measured(model, turned)))
    return points


def trained_sac(arguments: Arguments) -> SAC:
    """Return SAC at its defaults, which learns after every step."""
    env = make_vec_env(lambda: make(0.0), seed=arguments.seed)
    return SAC("MlpPolicy", env, seed=arguments.seed, device="cpu").learn(arguments.sac_steps)


def sac_without_memory(arguments: Arguments) -> SAC:
    """Return the same with no transitions in its memory."""
    model = trained_sac(arguments)
    if model.replay_buffer is not None:
        model.replay_buffer.reset()
    model.learning_starts = model.num_timesteps + STEPS
    return model


def trained_ppo(arguments: Arguments) -> PPO:
    """Return PPO at its defaults in eight environments, which now learns after each trial."""
    env = make_vec_env(lambda: make(0.0), 8, seed=arguments.seed)
    settings: dict[str, Any] = {"seed": arguments.seed, "device": "cpu"}
    first = PPO("MlpPolicy", env, **settings).learn(arguments.ppo_steps)
    alone = make_vec_env(lambda: make(0.0), seed=arguments.seed)
    model = PPO("MlpPolicy", alone, n_steps=STEPS, batch_size=STEPS, **settings)
    model.set_parameters(first.get_parameters())
    return model


LEARNERS: dict[str, Callable[[Arguments], BaseAlgorithm]] = {
    "SAC": trained_sac,
    "SAC-emptied": sac_without_memory,
    "PPO": trained_ppo,
}


def main(arguments: Arguments) -> None:
    """Train, rotate the cursor, and print the curves."""
    console, curves = Console(), {}
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    for name in arguments.learners:
        curves[name] = curve(LEARNERS[name](arguments), arguments)
        arguments.out.write_text(json.dumps(curves, indent=1), encoding="utf-8")
        console.print(f"{name}: {arguments.trials} trials done")
    table = Table(title=f"hand angle, ° (success, %), in a rotation of {arguments.degrees}°")
    for heading in ("trials", *curves):
        table.add_column(heading, justify="right")
    for rows in zip(*curves.values(), strict=True):
        texts = (f"{direction:.1f} ({100 * success:.0f})" for _, direction, success in rows)
        table.add_row(str(rows[0][0]), *texts)
    console.print(table)


if __name__ == "__main__":
    main(tyro.cli(Arguments))
