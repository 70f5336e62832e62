"""`mmc-gym compare`: agents play the same episodes."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import gymnasium as gym
import pandas as pd
from rich.console import Console

from mmc_gym._console import print_written, progress_bar
from mmc_gym._files import check_folder
from mmc_gym.agents.base import Predictor
from mmc_gym.agents.resolver import AgentLike
from mmc_gym.benchmark.comparison import Comparison
from mmc_gym.benchmark.entries import make_for, single_entries, training_steps
from mmc_gym.benchmark.reference import REFERENCE, has_reference, minimum_jerk_episodes
from mmc_gym.benchmark.statistics import summarize
from mmc_gym.benchmark.store import episode_columns
from mmc_gym.measures import MEASURES, Episode, episode_seeds, leave_out_failures, run_episodes
from mmc_gym.measures.rollout import check_environment, make_environment

_REFRESH = 0.1  # seconds between two drawings of the progress bar


def compare(
    agents: Sequence[AgentLike] | Mapping[str, AgentLike],
    env: str = "MMCReach-v0",
    episodes: int = 200,
    seed: int = 0,
    out: Path | str | None = None,
    console: Console | None = None,
) -> Comparison:
    """Let agents play the same episodes.

    An ideal hand that meets the same targets stands beside them, where there is one (`REFERENCE`).
    All arguments are checked, and the agents made, before the first episode.

    Args:
        agents: names, `"module:function"`, factories or objects with `predict`, see
            `entries.single_entries`; a mapping gives them labels.
        env: id of a reaching environment.
        episodes: how many each agent plays.
        seed: of the starts and targets, see `episode_seeds`, and of the resampling.
        out: folder for data and figure; None writes none.
        console: to print the table to; None prints nothing.  `print(comparison)` does, too.

    Raises:
        UserError: if an argument is outside what it accepts.

    Example:
        >>> comparison = compare(["random"], episodes=2)
        >>> comparison
        <Comparison of random in MMCReach-v0, 2 episodes each>
        >>> comparison.headline
        'random ends at the target in none of 2 episodes.'
        >>> comparison.episodes.groupby("agent", sort=False).size().to_dict()
        {'random': 2, 'minimum jerk (ideal)': 2}
    """
    entries = single_entries(agents)
    seeds = episode_seeds(seed, episodes)
    if out is not None:
        out = Path(out)
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
    written = comparison.write(out) if out is not None else []  # safe before anything is printed
    if console is not None:
        comparison.print(console)
        print_written(console, written)
    return comparison


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
