"""Measure what untuned learners reach in a reaching environment, each with its own defaults.

stable-baselines3's PPO (eight environments), SAC and TD3 (one), and PPO as CleanRL sets it up (one,
see `cleanrl_ppo.py`).  Each training is what a new user would type,

    PPO("MlpPolicy", make_vec_env("MMCReach-v0", 8, seed=seed), seed=seed, device="cpu")

on one thread.  Where it passes one of the step counts `--at`, its policy plays 200 episodes without
exploration, the same for all, on pymunk: so a policy of PPO has learned from the rollouts that were
complete before.  Success is a hand within the success distance when the episode ends; the table has
its median over seeds, the worst and the best.  Minutes are wall time, without the evaluations, of
as many trainings at once as `--jobs` says; the files have processor time, too.

    python -m studies.learners.plain_learners --learners ppo cleanrl --out runs/plain-learners
    python -m studies.learners.plain_learners --learners sac td3 --steps 200000
    python -m studies.learners.plain_learners --learners --plot plain.png   # trains nothing

An interrupted training starts again, but keeps its evaluations.  A finished one is not run again:
after a change of the environment's code choose another folder.
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
import yaml
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, NullLocator, PercentFormatter
from rich.console import Console
from stable_baselines3 import PPO, SAC, TD3
from stable_baselines3.common.env_util import make_vec_env

from mmc_gym.measures.reaching import final_distance, success
from mmc_gym.measures.rollout import run_episodes
from studies.drawing import COLOURS, LINES, STYLE
from studies.learners.cleanrl_ppo import CleanRLPPO
from studies.tables import table_of

Learner = Literal["ppo", "sac", "td3", "cleanrl"]

LABELS = {"ppo": "PPO, sb3", "sac": "SAC, sb3", "td3": "TD3, sb3", "cleanrl": "PPO, CleanRL's"}
ENVIRONMENTS = {"ppo": 8}  # the others have one
MARKERS = "osD^"
EPISODES = 200
EVALUATION_SEED = 2_000_000  # far from those of trainings


@dataclass(frozen=True)
class Arguments:
    """Train and evaluate, then print all results in the folder.

    Attributes:
        learners: to train; none of them only shows the results in the folder.
        seeds: of the trainings, for each learner.
        steps: environment steps of a training, at most: it ends where it is last evaluated.
        at: environment steps after which the policy is evaluated.
        jobs: trainings at once.
        env: id of the environment.
        env_kwargs: its arguments, as NAME=VALUE.
        out: folder for the results.
        plot: PNG to draw success against steps into.
        markdown: print the table as Markdown.
    """

    learners: tuple[Learner, ...] = ("ppo", "sac", "td3", "cleanrl")
    seeds: tuple[int, ...] = (0, 1, 2, 3, 4)
    steps: int = 1_000_000
    at: tuple[int, ...] = (50_000, 100_000, 200_000, 500_000, 1_000_000)
    jobs: int = 2
    env: str = "MMCReach-v0"
    env_kwargs: tuple[str, ...] = ()
    out: Path = Path("runs/plain-learners")
    plot: Path | None = None
    markdown: bool = False


@dataclass(frozen=True)
class Training:
    """One training: learner, seed, steps of the evaluations, environment and file."""

    learner: Learner
    seed: int
    marks: tuple[int, ...]
    env: str
    env_kwargs: tuple[str, ...]
    file: Path

    @property
    def settings(self) -> dict[str, Any]:
        """The arguments of the environment."""
        return {
            name: yaml.safe_load(value)
            for name, _, value in (text.partition("=") for text in self.env_kwargs)
        }

    def rows(self) -> dict[int, dict[str, Any]]:
        """Return the finished evaluations, by environment steps.

        Raises:
            ValueError: if they are of another environment.
        """
        if not self.file.exists():
            return {}
        rows = pd.read_csv(self.file, keep_default_na=False).to_dict("records")
        if (rows[0]["env"], rows[0]["env_kwargs"]) != (self.env, " ".join(self.env_kwargs)):
            raise ValueError(f"out has results of another environment: {self.file}")
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
                found: dict[str, Any] = {"learner": self.learner, "seed": self.seed}
                found |= {"env": self.env, "env_kwargs": " ".join(self.env_kwargs)}
                found |= {"steps": left.pop(0), **self.evaluate(learner)}
                found |= dict(zip(("seconds", "cpu_seconds"), np.round(paused - begun, 1)))
                rows[found["steps"]] = found
                table = pd.DataFrame([rows[steps] for steps in sorted(rows)])
                self.file.parent.mkdir(parents=True, exist_ok=True)
                table.to_csv(self.file, index=False, lineterminator="\n")
                line = "{learner}-{seed}: success {success:.3f} after {steps:,} steps, {seconds} s"
                print(line.format_map(found), flush=True)
                begun += self._now() - paused
            return bool(left)

        learner.learn(self.marks[-1], callback=evaluate)

    def make_learner(self) -> PPO | SAC | TD3 | CleanRLPPO:
        """Return the learner with its defaults."""
        if self.learner == "cleanrl":
            return CleanRLPPO(gym.make(self.env, **self.settings), self.seed)
        algorithm = {"ppo": PPO, "sac": SAC, "td3": TD3}[self.learner]
        count = ENVIRONMENTS.get(self.learner, 1)
        env = make_vec_env(self.env, count, seed=self.seed, env_kwargs=self.settings)
        return algorithm("MlpPolicy", env, seed=self.seed, device="cpu")

    def evaluate(self, learner: Any) -> dict[str, float]:
        """Return success, and the median final distance in segment lengths.

        It draws no random numbers but those of its own environment, and changes no training.
        """
        settings = {**self.settings, "engine": "pymunk", "autoreset_mode": "Disabled"}
        with closing(gym.make_vec(self.env, EPISODES, **settings)) as env:
            seeds = range(EVALUATION_SEED, EVALUATION_SEED + EPISODES)
            episodes = run_episodes(learner, env, seeds, records_effort=False)
        return {
            "success": float(np.mean([success(one) for one in episodes])),
            "final_distance": float(np.median([final_distance(one) for one in episodes])),
        }

    @staticmethod
    def _now() -> np.ndarray:
        return np.array([time.perf_counter(), time.process_time()])


def trainings(arguments: Arguments) -> list[Training]:
    """Return the trainings that are not finished, seed by seed."""
    marks = tuple(sorted(mark for mark in set(arguments.at) if mark <= arguments.steps))
    found = []
    for seed, learner in product(arguments.seeds, arguments.learners):
        file = arguments.out / f"{learner}-{seed}.csv"
        one = Training(learner, seed, marks, arguments.env, arguments.env_kwargs, file)
        if not one.rows().keys() >= set(marks):
            found.append(one)
    return found


def read_results(folder: Path) -> pd.DataFrame:
    """Return all rows of a folder, learners in the order of `LABELS`."""
    tables = [pd.read_csv(path, keep_default_na=False) for path in sorted(folder.glob("*-*.csv"))]
    return pd.concat(tables).sort_values("learner", key=lambda names: names.map([*LABELS].index))


def cells(results: pd.DataFrame) -> list[dict[str, str]]:
    """Return a row for each learner: success after so many steps, seeds, and wall time."""
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


def to_markdown(rows: list[dict[str, str]]) -> str:
    """Return the table as Markdown."""
    lines = [[*rows[0]], ["---"] * len(rows[0]), *([*row.values()] for row in rows)]
    return "\n".join("| " + " | ".join(line).replace("\n", " ") + " |" for line in lines)


def draw(results: pd.DataFrame) -> Figure:
    """Draw success against steps: the median over seeds, and a band from the worst to the best."""
    with rc_context(STYLE):
        figure = Figure(figsize=(5.0, 3.4), layout="constrained")
        axes = figure.subplots()
        for place, (learner, group) in enumerate(results.groupby("learner", sort=False)):
            seeds = group.groupby("steps")["success"]
            median, colour, line = seeds.median(), COLOURS[place], LINES[place]
            label = f"{LABELS[str(learner)]} ({group['seed'].nunique()} seeds)"
            axes.fill_between(median.index, seeds.min(), seeds.max(), color=colour, alpha=0.15)
            axes.plot(median, color=colour, linestyle=line, marker=MARKERS[place], label=label)
        axes.set(xscale="log", ylim=(-0.02, 1.02))
        axes.set(xlabel="environment steps of training", ylabel="success [% of 200 episodes]")
        axes.set_xticks(sorted(results["steps"].unique()))
        axes.xaxis.set_major_formatter(EngFormatter(sep=""))
        axes.xaxis.set_minor_locator(NullLocator())
        axes.yaxis.set_major_formatter(PercentFormatter(1.0, symbol=""))
        axes.legend(frameon=False, handlelength=4)
        axes.set_title("Median over seeds; band: worst to best", loc="left")
    return figure


def main(arguments: Arguments) -> None:
    """Run unfinished trainings; print the table of all results."""
    executor = loky.get_reusable_executor(arguments.jobs, env={"OMP_NUM_THREADS": "1"})
    list(executor.map(Training.run, trainings(arguments)))
    results = read_results(arguments.out)
    if arguments.markdown:
        print(to_markdown(cells(results)))
    else:
        Console().print(table_of(cells(results)))
    if arguments.plot is not None:
        with rc_context(STYLE):
            draw(results).savefig(arguments.plot, dpi=150)


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
