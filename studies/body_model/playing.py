"""Let agents play the same episodes of scenarios, and format their success for tables."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from contextlib import closing
from typing import Any, TypeAlias

import numpy as np

from mmc_gym import MismatchWarning
from mmc_gym.agents.base import Agent
from mmc_gym.agents.body_model.agent import mmc_body
from mmc_gym.agents.body_model.parts import ALL_PARTS, Parts
from mmc_gym.agents.resolver import resolve_all
from mmc_gym.benchmark.statistics import sample_interval
from mmc_gym.benchmark.suite import make_player
from mmc_gym.envs.scenarios import Playable
from mmc_gym.interface import CannotActError, ReachInterface
from mmc_gym.measures import Episode, episode_seeds, run_episodes
from mmc_gym.measures.reaching import success

Make: TypeAlias = Callable[[Any], Agent[Any]]
"""A function that makes an agent for an environment."""
EpisodesByTraining: TypeAlias = list[tuple[Episode, ...]]
"""The episodes of an agent, by training; agents without training have one entry."""


def body_model(
    parts: Parts = ALL_PARTS, build: Callable[..., Agent[Any]] = mmc_body, **settings: Any
) -> Make:
    """Return a function that makes an agent with a body model of these parts."""
    return lambda env: build(ReachInterface.of(env), parts, **settings)


def play(
    agent: str | Make, scenario: Playable, episodes: int, seed: int, control: str | None = None
) -> EpisodesByTraining:
    """Return the episodes of an agent: those of the benchmark if the seed is 0 and `control` None.

    Every agent plays the same postures, targets and noise, in another control mode if it is given.
    The list is empty if the agent cannot act in the scenario.
    """
    arguments = {} if control is None else {"control": control}
    instances = scenario.instances(episodes)
    seeds = episode_seeds(seed, len(instances))
    by_training = []
    for resolved_agent in resolve_all(agent if isinstance(agent, str) else {"agent": agent}):
        try:
            with warnings.catch_warnings():  # the arm may differ from the training's
                warnings.simplefilter("ignore", MismatchWarning)
                env, player = make_player(resolved_agent, scenario.with_arguments(**arguments))
        except CannotActError:
            continue
        with closing(env), closing(scenario.make_vec(len(seeds), env.unwrapped.control)) as arms:
            by_training.append(
                run_episodes(player, arms, seeds, options=instances, records_effort=False)
            )
    return by_training


def successes(by_training: EpisodesByTraining) -> np.ndarray:
    """Return 1 for a success and 0 for a failure, (trainings, episodes)."""
    return np.array([[success(episode) for episode in episodes] for episodes in by_training])


def percent(by_training: EpisodesByTraining, *, interval: bool = False) -> str:
    """Return the success in per cent.

    With `interval`, its interval over trainings and episodes follows, unless all ended alike.
    """
    if not by_training:
        return "–"
    share = sample_interval(successes(by_training), "mean")
    text = f"{100 * share.estimate:.1f}"
    if interval and share.low < share.high:
        text += f" [{100 * share.low:.0f}, {100 * share.high:.0f}]"
    return text
