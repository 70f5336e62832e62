"""Train SAC of stable-baselines3 at its defaults in `Reacher-v5`: the learned rival of `reacher`.

python -m studies.other_bodies.reacher_sac --out runs/reacher-sac
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import gymnasium as gym
import torch
import tyro
from stable_baselines3 import SAC
from stable_baselines3.common.monitor import Monitor


@dataclass(frozen=True)
class Arguments:
    """Train SAC on one core, and keep models on the way.

    Attributes:
        at: environment steps after which the model is kept; the training ends with the last.
        seed: of the training.
        out: folder for the models, sac_STEPS.zip.
    """

    at: tuple[int, ...] = (50_000, 100_000, 200_000, 300_000, 400_000, 500_000)
    seed: int = 0
    out: Path = Path("runs/reacher-sac")


def main(arguments: Arguments) -> None:
    """Train, and keep the models."""
    torch.set_num_threads(1)
    env = Monitor(gym.make("Reacher-v5"))
    model = SAC("MlpPolicy", env, seed=arguments.seed, device="cpu")
    for steps in arguments.at:
        model.learn(steps - model.num_timesteps, reset_num_timesteps=False, log_interval=100)
        model.save(arguments.out / f"sac_{steps}.zip")
        print(f"{steps:,} steps", flush=True)


if __name__ == "__main__":
    main(tyro.cli(Arguments))
