"""`mmc-gym compare`: agents play the same episodes, for a table, the data and a figure."""

from __future__ import annotations

import json
import platform
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import gymnasium as gym
import pandas as pd
from rich.console import Console

from mmc_gym._console import cell, make_console, print_columns, print_written, progress_bar
from mmc_gym._files import check_folder, write_atomically
from mmc_gym.agents.base import Predictor
from mmc_gym.agents.resolver import AgentLike
from mmc_gym.benchmark.entries import make_for, single_entries, training_steps
from mmc_gym.benchmark.reference import REFERENCE, has_reference, minimum_jerk_episodes
from mmc_gym.benchmark.statistics import CONFIDENCE, RESAMPLES, summarize
from mmc_gym.benchmark.store import episode_columns
from mmc_gym.measures import MEASURES, Episode, episode_seeds, leave_out_failures, run_episodes
from mmc_gym.measures.catalogue import shown_measures
from mmc_gym.measures.rollout import check_environment, make_environment

_PACKAGES = ("mmc-gym", "gymnasium", "numpy", "scipy", "pandas", "pymunk", "torch")
_REFRESH = 0.1  # seconds between two drawings of the progress bar


@dataclass(frozen=True, eq=False)
class Comparison:
    """The result of a comparison.

    Attributes:
        env: id of the environment.
        seed: of the starts, the targets and the resampling.
        reach: of the arm, segment lengths.
        recorded: the episodes of each agent, and of `REFERENCE` if there are any; the i-th of each
            have the same start and target.
        training_steps: environment steps spent in training each agent; None if unknown.
        episodes: one row per agent and episode: agent, episode, seed, start, target, measures.
        summary: one row per agent and measure, see `statistics.summarize`; of the episodes that
            ended at the target, for measures of `successes_only`.
    """

    env: str
    seed: int
    reach: float
    recorded: Mapping[str, tuple[Episode, ...]]
    training_steps: Mapping[str, int | None]
    episodes: pd.DataFrame
    summary: pd.DataFrame

    @property
    def note(self) -> str:
        """The lines below the table, and in summary.json, that tell how to read the numbers."""
        one, shown = next(iter(self.recorded.values())), shown_measures()
        means = ", ".join(measure.label for measure in shown if measure.statistic == "mean")
        all_told = ", ".join(measure.label for measure in shown if not measure.successes_only)
        reference = (
            f"{REFERENCE}: a hand without an arm, through the same measures. "
            if REFERENCE in self.recorded
            else ""
        )
        return (
            f"{self.env}, {len(one)} episodes, the same starts and targets for all agents. "
            f"Medians ({means}: mean) with {CONFIDENCE:.0%} bootstrap intervals; lengths in "
            f"segment lengths; at the target: within {one[0].tolerance:g}. "
            f"{all_told}: of all episodes; the others: of those that ended at the target, and k of "
            f"{len(one)} have a value (none where the hand started there). {reference}"
            f"Of {len(MEASURES)} measures {len(shown)} are shown; files hold all. "
            "The intervals replicate over episodes (starts and targets), NOT over training seeds: "
            "each agent is the result of one training, or of none."
        )

    @property
    def settings(self) -> dict[str, Any]:
        """Everything that the comparison was made with, ready for JSON."""
        one = next(iter(self.recorded.values()))
        return {
            "environment": self.env,
            "agents": [agent for agent in self.recorded if agent != REFERENCE],
            "reference": REFERENCE if REFERENCE in self.recorded else None,
            "training_steps": {
                agent: steps for agent, steps in self.training_steps.items() if agent != REFERENCE
            },
            "training_seeds_per_agent": 1,
            "episodes": len(one),
            "seed": self.seed,
            "control_step": one[0].control_step,
            "tolerance": one[0].tolerance,
            "confidence": CONFIDENCE,
            "bootstrap_resamples": RESAMPLES,
            "bootstrap_method": "percentile, over episodes",
            "python": platform.python_version(),
            "machine": f"{platform.system()} {platform.machine()}",
            "versions": {package: version(package) for package in _PACKAGES},
            "note": self.note,
        }

    def write(self, out: Path) -> list[Path]:
        """Write episodes.csv, summary.csv, summary.json and the figure into the folder `out`."""
        from mmc_gym._plotting import Movement, paths_and_profiles, save_figure

        summary = self.summary.assign(
            training_steps=self.summary["agent"].map(self.training_steps).astype("Int64")
        )
        # Of an interrupted run, either the old file or the new one is left, never half of it.
        written = [
            write_atomically(out / "episodes.csv", _csv(self.episodes)),
            write_atomically(out / "summary.csv", _csv(summary)),
            write_atomically(out / "summary.json", json.dumps(self.settings, indent=2) + "\n"),
        ]
        movements = {
            agent: [Movement(one.seen_hands, one.target, one.speeds) for one in episodes]
            for agent, episodes in self.recorded.items()
        }
        one = next(iter(self.recorded.values()))[0]
        figure = paths_and_profiles(movements, self.reach, one.tolerance, one.control_step)
        return written + save_figure(figure, out / "paths_and_profiles")


def compare(
    agents: Sequence[AgentLike] | Mapping[str, AgentLike],
    env: str = "MMCReach-v0",
    episodes: int = 200,
    seed: int = 0,
    out: Path | None = None,
    console: Console | None = None,
) -> Comparison:
    """Let agents play the same episodes, print a table, and write data and figure.

    An ideal hand that meets the same targets stands beside them, where there is one (`REFERENCE`).
    All arguments are checked, and the agents made, before the first episode.

    Args:
        agents: names, `"module:function"`, factories or objects with `predict`, see
            `entries.single_entries`; a mapping gives them labels.
        env: id of a reaching environment.
        episodes: how many each agent plays.
        seed: of the starts and targets, see `episode_seeds`, and of the resampling.
        out: folder for the files; None writes none.
        console: to print the table to; standard output if None.

    Raises:
        UserError: if an argument is outside what it accepts.

    Example:
        >>> comparison = compare(["random"], episodes=2)  # doctest: +ELLIPSIS
        <BLANKLINE>
        ...
        >>> comparison.episodes.groupby("agent", sort=False).size().to_dict()
        {'random': 2, 'minimum jerk (ideal)': 2}
    """
    entries = single_entries(agents)
    seeds = episode_seeds(seed, episodes)
    if out is not None:
        check_folder(out, "out")
    envs: dict[str, gym.Env[Any, Any]] = {}
    players: dict[str, Predictor] = {}

    def make_world(control: str | None) -> gym.Env[Any, Any]:
        made = make_environment(env, control)
        check_environment(made)
        return made

    try:
        # All are made before the first one plays: a missing file should not cost the others' work.
        for entry in entries:
            envs[entry.label], players[entry.label] = make_for(entry.agent, make_world)
        world = next(iter(envs.values()))
        recorded = _play(players, envs, seeds)
        if REFERENCE not in recorded and has_reference(world):
            recorded[REFERENCE] = minimum_jerk_episodes(next(iter(recorded.values())))
        reach = float(world.get_wrapper_attr("reach"))
    finally:
        for made in envs.values():
            made.close()
    table = _tidy(recorded)
    steps = {label: training_steps(player) for label, player in players.items()}
    if REFERENCE in recorded:
        steps.setdefault(REFERENCE, 0)
    summary = summarize(leave_out_failures(table), tuple(MEASURES.values()), seed)
    comparison = Comparison(env, seed, reach, recorded, steps, table, summary)
    console = console or make_console()
    written = comparison.write(out) if out is not None else []  # safe before anything is printed
    _print_table(console, comparison)
    print_written(console, written)
    return comparison


def _print_table(console: Console, comparison: Comparison) -> None:
    """Print a row for each shown measure and a column for each agent."""
    shown = shown_measures()
    headings = [f"{one.label}\n[{one.unit}]" if one.unit else one.label for one in shown]
    best = ["" if one.best == "neither" else one.best for one in shown]
    rows = {(row["agent"], row["measure"]): row for row in comparison.summary.to_dict("records")}
    columns = {
        agent: [
            *(cell(rows[agent, one.name], one.decimals) for one in shown),
            "unknown" if steps is None else f"{steps:,}",
        ]
        for agent, steps in comparison.training_steps.items()
    }
    labels = {"": [*headings, "training\n[env steps]"], "best": [*best, ""]}
    print_columns(console, labels, columns, comparison.note)


def _tidy(recorded: Mapping[str, Sequence[Episode]]) -> pd.DataFrame:
    """Return a row per agent and episode."""
    tables = []
    for agent, episodes in recorded.items():
        columns = {"agent": agent, "episode": range(len(episodes)), **episode_columns(episodes)}
        tables.append(pd.DataFrame(columns).drop(columns="duration"))
    return pd.concat(tables, ignore_index=True)


def _play(
    players: Mapping[str, Predictor], envs: Mapping[str, gym.Env[Any, Any]], seeds: Sequence[int]
) -> dict[str, tuple[Episode, ...]]:
    # Drawn between episodes only: a drawing thread would disturb the times of the actions.
    with progress_bar(auto_refresh=False) as progress:
        task = progress.add_task("", total=len(players) * len(seeds))
        drawn = 0.0

        def advance(_: Episode) -> None:
            nonlocal drawn
            progress.advance(task)
            if time.monotonic() - drawn > _REFRESH:
                progress.refresh()
                drawn = time.monotonic()

        recorded = {}
        for label, player in players.items():
            progress.update(task, description=label)
            recorded[label] = run_episodes(player, envs[label], seeds, advance)
        return recorded


def _csv(frame: pd.DataFrame) -> str:
    return frame.to_csv(index=False, lineterminator="\n")
