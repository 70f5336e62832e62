"""Measure what untuned learners reach in `MMCReach-v0`, each with its own defaults.

The learners are stable-baselines3's PPO (eight environments), SAC and TD3 (one environment).  Each
training is what a new user would type,

    PPO("MlpPolicy", make_vec_env("MMCReach-v0", 8, seed=seed), seed=seed, device="cpu")

on one thread.  After each of the step counts `--at` its policy plays the same 200 episodes on
pymunk, without exploration.  A policy of PPO has then learned from all rollouts completed before.
Success means that the hand is within the success distance when the episode ends; the table has the
median over seeds, the worst and the best.  Minutes are wall time without evaluations, with `--jobs`
trainings at once; the files also have processor time.

    python -m studies.learners.plain_learners --learners ppo --out runs/plain-learners
    python -m studies.learners.plain_learners --learners sac td3 --steps 200000
    python -m studies.learners.plain_learners --learners    # only prints the results

An interrupted training starts again, but keeps its evaluations.  A finished training is not run
again: choose another folder if the environment's code has changed.
"""

from __future__ import annotations

import time
from contextlib import closing
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any, Literal

import gymnasium as gym
import loky
import numpy as np
import pandas as pd
import tyro
from rich.console import Console
from stable_baselines3 import PPO, SAC, TD3
from stable_baselines3.common.env_util import make_vec_env

from mmc_gym.measures.reaching import final_distance, success
from mmc_gym.measures.rollout import run_episodes
from studies.tables import table_of

Learner = Literal["ppo", "sac", "td3"]

LABELS = {"ppo": "PPO", "sac": "SAC", "td3": "TD3"}
ENV = "MMCReach-v0"
ENVIRONMENTS = {"ppo": 8}  # the others have one
EPISODES = 200
EVALUATION_SEED = 2_000_000  # far from the seeds of trainings


@dataclass(frozen=True)
class Arguments:
    """Train and evaluate, then print all results in the folder."""

    # learners to train; without any, only the results in the folder are printed
    learners: tuple[Learner, ...] = ("ppo", "sac", "td3")
    seeds: tuple[int, ...] = (0, 1, 2, 3, 4)  # training seeds of each learner
    # largest number of environment steps; a training ends with its last evaluation
    steps: int = 1_000_000
    # environment steps after which the policy is evaluated
    at: tuple[int, ...] = (50_000, 100_000, 200_000, 500_000, 1_000_000)
    jobs: int = 2  # number of trainings at once
    out: Path = Path("runs/plain-learners")  # folder for the results


@dataclass(frozen=True)
class Training:
    """One training: learner, seed, steps of the evaluations, and file of the results."""

    learner: Learner
    seed: int
    marks: tuple[int, ...]
    file: Path

    def rows(self) -> dict[int, dict[str, Any]]:
        """Return the finished evaluations, by environment steps."""
        if not self.file.exists():
            return {}
        rows = pd.read_csv(self.file).to_dict("records")
        return {row["steps"]: row for row in rows}

    def run(self) -> None:
        """Train, and write a row after each evaluation."""
        rows, left = self.rows(), list(self.marks)
        learner: Any = self.make_learner()
        begun = self._now()

        def evaluate(*_: Any) -> bool:
            nonlocal begun
            if learner.num_timesteps >= left[0]:
                paused = self._now()
                row: dict[str, Any] = {"learner": self.learner, "seed": self.seed}
                row |= {"steps": left.pop(0), **self.evaluate(learner)}
                row |= dict(zip(("seconds", "cpu_seconds"), np.round(paused - begun, 1)))
                rows[row["steps"]] = row
                table = pd.DataFrame([rows[steps] for steps in sorted(rows)])
                self.file.parent.mkdir(parents=True, exist_ok=True)
                table.to_csv(self.file, index=False, lineterminator="\n")
                line = "{learner}-{seed}: success {success:.3f} after {steps:,} steps, {seconds} s"
                print(line.format_map(row), flush=True)
                begun += self._now() - paused
            return bool(left)

        learner.learn(self.marks[-1], callback=evaluate)

    def make_learner(self) -> PPO | SAC | TD3:
        """Return the learner with its defaults."""
        algorithm = {"ppo": PPO, "sac": SAC, "td3": TD3}[self.learner]
        count = ENVIRONMENTS.get(self.learner, 1)
        env = make_vec_env(ENV, count, seed=self.seed)
        return algorithm("MlpPolicy", env, seed=self.seed, device="cpu")

    def evaluate(self, learner: Any) -> dict[str, float]:
        """Return success, and the median final distance in segment lengths.

        It has no effect on the training: all random numbers come from its own environment.
        """
        with closing(gym.make_vec(ENV, EPISODES, autoreset_mode="Disabled")) as env:
            seeds = range(EVALUATION_SEED, EVALUATION_SEED + EPISODES)
            episodes = run_episodes(learner, env, seeds, records_effort=False)
        return {
            "success": float(np.mean([success(episode) for episode in episodes])),
            "final_distance": float(np.median([final_distance(episode) for episode in episodes])),
        }

    @staticmethod
    def _now() -> np.ndarray:
        return np.array([time.perf_counter(), time.process_time()])


def trainings(arguments: Arguments) -> list[Training]:
    """Return the trainings that are not finished, seed by seed."""
    marks = tuple(sorted(mark for mark in set(arguments.at) if mark <= arguments.steps))
    unfinished = []
    for seed, learner in product(arguments.seeds, arguments.learners):
        file = arguments.out / f"{learner}-{seed}.csv"
        training = Training(learner, seed, marks, file)
        if not training.rows().keys() >= set(marks):
            unfinished.append(training)
    return unfinished


def read_results(folder: Path) -> pd.DataFrame:
    """Return all rows of a folder, with learners in the order of `LABELS`."""
    tables = [pd.read_csv(path) for path in sorted(folder.glob("*-*.csv"))]
    return pd.concat(tables).sort_values("learner", key=lambda names: names.map([*LABELS].index))


def cells(results: pd.DataFrame) -> list[dict[str, str]]:
    """Return a row for each learner: seeds, success by number of steps, and wall time."""
    rows = []
    for learner, group in results.groupby("learner", sort=False):
        row = {"learner": LABELS[str(learner)], "seeds": str(group["seed"].nunique())}
        for steps in sorted(results["steps"].unique()):
            values = group.loc[group["steps"] == steps, "success"]
            ends = f"[{values.min():.3f}, {values.max():.3f}]"
            text = f"{values.median():.3f}\n{ends}" if len(values) else "–"
            is_all = len(values) in (0, group["seed"].nunique())
            row[f"{steps:,} steps"] = text if is_all else f"{text}\n{len(values)} seeds"
        last = group[group["steps"] == group["steps"].max()]
        row["minutes"] = f"{last['seconds'].median() / 60:.1f}"
        rows.append(row)
    return rows


def main(arguments: Arguments) -> None:
    """Run unfinished trainings; print the table of all results."""
    executor = loky.get_reusable_executor(arguments.jobs, env={"OMP_NUM_THREADS": "1"})
    list(executor.map(Training.run, trainings(arguments)))
    Console().print(table_of(cells(read_results(arguments.out))))


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
