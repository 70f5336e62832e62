"""Play: a window in which the mouse moves the target and an agent moves the arm."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import closing
from typing import Any

import gymnasium as gym
import numpy as np
import pygame

from mmc_gym.agents.base import Predictor
from mmc_gym.agents.resolver import AgentLike, Wrappers, resolve_all
from mmc_gym.benchmark.suite import make_player
from mmc_gym.envs.render import View, open_display
from mmc_gym.envs.scenarios import EnvLike, parse_environment


def play(
    agent: AgentLike = "mmc",
    env: EnvLike = "MMCReach-v0",
    seed: int | None = None,
    *,
    env_kwargs: Mapping[str, Any] | None = None,
    allow_pickle: bool = False,
    wrapper: Wrappers = (),
) -> None:
    """Open a window in which the mouse moves the target and an agent the arm.

    R draws a new posture, Q ends.  Without a `seed` postures differ each time.  The other arguments
    are those of `mmc_gym.compare`; there is no time limit.

    Raises:
        UserError: without a display, for an unknown agent, or for an environment without an arm.
    """
    open_display(must_be_seen=True)
    try:
        given = {**(env_kwargs or {}), "render_mode": "human", "max_episode_steps": -1}
        shared: Any = {"allow_pickle": allow_pickle, "wrapper": wrapper}
        (found,) = resolve_all([agent], every_training=False, **shared)
        world, player = make_player(found, parse_environment(env, given))
        with closing(world):
            for _ in frames(world, player, seed):
                pass
    finally:
        pygame.display.quit()


def frames(
    world: gym.Env[Any, Any], player: Predictor, seed: int | None = None
) -> Iterator[dict[str, Any]]:
    """Play until the window is closed, and yield the info of the start and of each step."""
    reach: Any = world.unwrapped
    view, workspace = View(reach.setup.farthest), reach.setup.workspace
    observation, info = world.reset(seed=seed)
    state = None
    yield info
    while pygame.display.get_init():
        keys = {event.key for event in pygame.event.get(pygame.KEYDOWN)}
        if keys & {pygame.K_q, pygame.K_ESCAPE}:
            return
        if pygame.K_r in keys:
            observation, info = world.reset(options={"target": tuple(info["target"])})
            state = None
        if pygame.mouse.get_focused():
            nearest = workspace.nearest(view.point(pygame.mouse.get_pos()))
            if workspace.contains(nearest):  # no obstacle is there
                reach.set_target(nearest)
        start = np.full(1, state is None)
        action, state = player.predict(observation, state, start, deterministic=True)
        observation, _, _, _, info = world.step(action)
        yield info
