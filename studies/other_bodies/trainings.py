"""Train the learned rivals on one core, and keep models on the way, and their actors.

"sac" is SAC of stable-baselines3 at its defaults in `Reacher-v5`, for `reacher`.  "tqc" is TQC with
hindsight replay in `PandaReachJoints-v3`, for `panda`, with the settings of rl_zoo3 for
`PandaReach-v1`; it sees what panda-gym shows: position and velocity of the hand, and the target,
but no joint angles.

    python -m studies.other_bodies.trainings sac --out runs/reacher-sac    # hours
    python -m studies.other_bodies.trainings tqc --out runs/panda-tqc      # 20 minutes
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import gymnasium as gym
import torch
import tyro
from stable_baselines3 import SAC, HerReplayBuffer
from stable_baselines3.common.monitor import Monitor

from studies.other_bodies.actors import save_actor

TQC_SETTINGS: dict[str, Any] = {
    "buffer_size": 1_000_000,
    "batch_size": 256,
    "ent_coef": "auto",
    "gamma": 0.95,
    "learning_rate": 1e-3,
    "learning_starts": 1000,
    "replay_buffer_class": HerReplayBuffer,
    "replay_buffer_kwargs": {"goal_selection_strategy": "future", "n_sampled_goal": 4},
    "policy_kwargs": {"net_arch": [64, 64], "n_critics": 1},
}
STEPS = {
    "sac": (50_000, 100_000, 200_000, 300_000, 400_000, 500_000),
    "tqc": (10_000, 20_000, 50_000),
}


@dataclass(frozen=True)
class Arguments:
    """Train one of them."""

    algorithm: tyro.conf.Positional[Literal["sac", "tqc"]]  # which
    # environment steps after which a model is kept, the last at the end; none for `STEPS`
    at: tuple[int, ...] = ()
    seed: int = 0  # of the training
    out: Path = Path("runs/trainings")  # folder: sac_100000.zip, and its actor as .safetensors


def make_model(algorithm: str, seed: int) -> Any:
    """Make the untrained model."""
    if algorithm == "sac":
        return SAC("MlpPolicy", Monitor(gym.make("Reacher-v5")), seed=seed, device="cpu")
    import panda_gym  # noqa: F401  registers the environment
    from sb3_contrib import TQC

    env = Monitor(gym.make("PandaReachJoints-v3"))
    return TQC("MultiInputPolicy", env, seed=seed, device="cpu", **TQC_SETTINGS)


def main(arguments: Arguments) -> None:
    """Train, and keep the models."""
    torch.set_num_threads(1)
    model = make_model(arguments.algorithm, arguments.seed)
    for steps in arguments.at or STEPS[arguments.algorithm]:
        model.learn(steps - model.num_timesteps, reset_num_timesteps=False, log_interval=100)
        file = arguments.out / f"{arguments.algorithm}_{steps}.zip"
        model.save(file)
        save_actor(model, file.with_suffix(".safetensors"))
        print(f"{steps:,} steps", flush=True)


if __name__ == "__main__":
    main(tyro.cli(Arguments))
