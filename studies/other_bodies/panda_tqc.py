"""Train TQC with hindsight replay in `PandaReachJoints-v3`: the learned rival of `panda`.

The settings are rl_zoo3's of `PandaReach-v1`.  Its policy sees what panda-gym shows: position and
velocity of the hand, and the target, but no joint angles.

    python -m studies.other_bodies.panda_tqc --out runs/panda-tqc
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import gymnasium as gym
import panda_gym  # noqa: F401  registers the environment
import torch
import tyro
from sb3_contrib import TQC
from stable_baselines3 import HerReplayBuffer
from stable_baselines3.common.monitor import Monitor


@dataclass(frozen=True)
class Arguments:
    """Train TQC on one core, and keep models on the way.

    Attributes:
        at: environment steps after which the model is kept; the training ends with the last.
        seed: of the training.
        out: folder for the models, tqc_STEPS.zip.
    """

    at: tuple[int, ...] = (10_000, 20_000, 50_000)
    seed: int = 0
    out: Path = Path("runs/panda-tqc")


def main(arguments: Arguments) -> None:
    """Train, and keep the models."""
    torch.set_num_threads(1)
    model = TQC(
        "MultiInputPolicy",
        Monitor(gym.make("PandaReachJoints-v3")),
        seed=arguments.seed,
        device="cpu",
        buffer_size=1_000_000,
        batch_size=256,
        ent_coef="auto",
        gamma=0.95,
        learning_rate=1e-3,
        learning_starts=1000,
        replay_buffer_class=HerReplayBuffer,
        replay_buffer_kwargs={"goal_selection_strategy": "future", "n_sampled_goal": 4},
        policy_kwargs={"net_arch": [64, 64], "n_critics": 1},
    )
    for steps in arguments.at:
        model.learn(steps - model.num_timesteps, reset_num_timesteps=False)
        model.save(arguments.out / f"tqc_{steps}.zip")
        print(f"{steps:,} steps", flush=True)


if __name__ == "__main__":
    main(tyro.cli(Arguments))
