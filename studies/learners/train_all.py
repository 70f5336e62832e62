"""Train all policies that ship, or some of them, many at once.

    python -m studies.learners.train_all --out mmc_gym/agents/pretrained --jobs 2
    python -m studies.learners.train_all --names ppo sac

A policy that is in the folder, with the same hyperparameters, is not trained again.  An interrupted
run resumes.  `ppo_residual.py` has what `ppo-residual` needs; `studies.learners.ppo_memory` trains
`ppo-memory`.
"""

from __future__ import annotations

import shutil
from concurrent.futures import as_completed
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import loky
import tyro

from mmc_gym import UserError
from mmc_gym.agents import AGENTS
from mmc_gym.agents.policy import PolicyCard, file_stem, load_policy
from mmc_gym.training import hyperparameters
from mmc_gym.training.training import Training
from studies.learners.ppo_residual import HYPERPARAMETERS

OF_STUDIES = {HYPERPARAMETERS.stem: HYPERPARAMETERS}


@dataclass(frozen=True)
class Arguments:
    """Which policies to train, and how many at once."""

    # Folder for the policies and, until they are trained, for their checkpoints
    out: Path = Path("runs/train-all")
    names: tuple[str, ...] = ()  # Names of hyperparameters; all that ship, if not given
    seeds: int | None = None  # Number of trainings of each; as many as ship, if not given
    jobs: int = loky.cpu_count()  # How many are trained at once
    steps: int | None = None  # Environment steps, instead of those of the hyperparameters
    evaluations: int = 25  # Approximate number of evaluations during a training


def train(name: str, seed: int, arguments: Arguments) -> PolicyCard:
    """Train or resume one policy, unless it is there, and return its card."""
    recipe = hyperparameters.read_recipe(str(OF_STUDIES.get(name, name)), steps=arguments.steps)
    stem = file_stem(name, seed)
    with suppress(FileNotFoundError, UserError):  # missing or damaged
        _, card = load_policy(arguments.out / f"{stem}.json")
        if (card.env_id, card.hyperparameters) == (recipe.env_id, recipe.hyperparameters):
            return card
    folder = arguments.out / "checkpoints" / stem
    training = Training(recipe, seed, folder, evaluations=arguments.evaluations)
    card = training.run(resume=True)
    for file in training.policy_files:
        shutil.copy(file, arguments.out)
    shutil.rmtree(training.folder)  # replay buffers are large
    return card


def main(arguments: Arguments) -> None:
    """Train the policies, and print a line for each that is ready."""
    shipped = [name for name in (*hyperparameters.names(), *OF_STUDIES) if name in AGENTS]
    names = arguments.names or shipped
    policies = [
        (name, seed)
        for name in names
        for seed in range(arguments.seeds or AGENTS[name].training_seeds)
    ]
    executor = loky.get_reusable_executor(arguments.jobs, env={"OMP_NUM_THREADS": "1"})
    running = [executor.submit(train, name, seed, arguments) for name, seed in policies]
    for done in as_completed(running):
        card = done.result()
        print(
            f"{card.file_stem:<16} success {card.scores['success']:6.1%}  "
            f"{card.training_steps:>10,} steps  {card.training_seconds:6.0f} s"
        )


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
