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
from mmc_gym.benchmark.comparison import Comparison
from mmc_gym.benchmark.entries import Agents, Entry, find_entries, make_together, training_steps
from mmc_gym.benchmark.reference import REFERENCE, has_reference, minimum_jerk_episodes
from mmc_gym.benchmark.statistics import summarize
from mmc_gym.benchmark.store import episode_columns
from mmc_gym.envs.scenarios import EnvLike, name_of
from mmc_gym.interface import read_attribute
from mmc_gym.measures import MEASURES, Episode, episode_seeds, leave_out_failures, run_episodes
from mmc_gym.measures.rollout import check_environment

_REFRESH = 0.1  # seconds between two drawings of the progress bar


def compare(
    agents: Agents,
    env: EnvLike = "MMCReach-v0",
    episodes: int = 200,
    seed: int = 0,
    out: Path | str | None = None,
    console: Console | None = None,
    *,
    env_kwargs: Mapping[str, Any] | None = None,
    allow_pickle: bool = False,
) -> Comparison:
    """Let agents play the same episodes.

    An ideal hand that meets the same targets stands beside them, where there is one (`REFERENCE`).
    All arguments are checked, and the agents made, before the first episode.

    Args:
        agents: names, paths of files, functions, classes, models of stable-baselines3, or other
            objects with `predict`, see `mmc_gym.agents.resolve`.  A mapping gives them labels; a
            list in it is several trainings of one agent, and so is a pattern, "runs/mine-*".
        env: id of a reaching environment, "module:Id", "module:function", or a function or class
            that returns one.
        episodes: how many each agent plays.
        seed: of the starts and targets, see `episode_seeds`, and of the resampling.
        out: folder for data and figure; None writes none.
        console: to print the table to; None prints nothing.  `print(comparison)` does, too.
        env_kwargs: arguments of the environment.  A `control` among them is for agents that act by
            several control modes, or do not tell theirs.
        allow_pickle: whether files that hold pickles may be loaded, which runs whatever code they
            name: those of stable-baselines3 do.

    Raises:
        UserError: if an argument is outside what it accepts.

    Example:
        >>> comparison = compare(["random"], episodes=2)
        >>> comparison
        <Comparison of random in MMCReach-v0, 2 episodes each>
        >>> comparison.headline
        'success at the end: random 0.0 %'
        >>> comparison.episodes.groupby("agent", sort=False).size().to_dict()
        {'random': 2, 'minimum jerk (ideal)': 2}
    """
    given = dict(env_kwargs or {})
    entries = find_entries(agents, allow_pickle=allow_pickle, every_training=False)
    seeds = episode_seeds(seed, episodes)
    if out is not None:
        out = check_folder(out, "out")
    envs: list[gym.Env[Any, Any]] = []
    players: list[Predictor] = []
    try:
        # All are made before the first one plays: a missing file should not cost the others' work.
        for entry in entries:
            made, player = make_together(entry, env, given, check_environment)
            envs.append(made)
            players.append(player)
        played = _play(entries, players, envs, seeds)
        if has_reference(envs[0]):
            entries.append(Entry(REFERENCE, None, REFERENCE))
            played.append(minimum_jerk_episodes(played[0]))
        reach = float(envs[0].get_wrapper_attr("reach"))
    finally:
        for made in envs:
            made.close()
    table = _tidy(entries, played)
    recorded: dict[str, tuple[Episode, ...]] = {}
    for entry, one in zip(entries, played):
        recorded[entry.label] = recorded.get(entry.label, ()) + one
    steps = {entry.label: training_steps(player) for entry, player in zip(entries, players)}
    if REFERENCE in recorded:
        steps.setdefault(REFERENCE, 0)
    summary = summarize(leave_out_failures(table), tuple(MEASURES.values()), seed)
    comparison = Comparison(
        env=name_of(env),
        seed=seed,
        reach=reach,
        recorded=recorded,
        training_steps=steps,
        episodes=table,
        summary=summary,
        env_kwargs=given,
        controls={
            entry.label: str(read_attribute(made, "control")) for entry, made in zip(entries, envs)
        },
    )
    written = comparison.write(out) if out is not None else []  # safe before anything is printed
    if console is not None:
        comparison.print(console)
        print_written(console, written)
    return comparison


def _tidy(entries: Sequence[Entry], played: Sequence[Sequence[Episode]]) -> pd.DataFrame:
    """Return a row per agent, training and episode."""
    tables = []
    for entry, episodes in zip(entries, played):
        who = {"agent": entry.label, "training_seed": entry.training_seed}
        columns = {**who, "episode": range(len(episodes)), **episode_columns(episodes)}
        tables.append(pd.DataFrame(columns).drop(columns="duration"))
    return pd.concat(tables, ignore_index=True).astype({"training_seed": "Int64"})


def _play(
    entries: Sequence[Entry],
    players: Sequence[Predictor],
    envs: Sequence[gym.Env[Any, Any]],
    seeds: Sequence[int],
) -> list[tuple[Episode, ...]]:
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

        played = []
        for entry, player, env in zip(entries, players, envs):
            progress.update(task, description=entry.label)
            played.append(run_episodes(player, env, seeds, advance))
        return played
