"""Environments of this package and of others, each ready to play whole episodes.

An episode is all its steps and the reset.  The arms of a vector environment begin and end theirs
together; those with autoreset take one more call for the reset, which is not counted as steps.
Actions are drawn beforehand, uniformly, and are the same in every episode.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np

import mmc_gym  # noqa: F401  (registers the environments)

OURS = "MMCReach-v0"
PEER = "Reacher-v5"


@dataclass(frozen=True)
class Contestant:
    """What plays episodes, and how many steps these have.

    Attributes:
        play: plays one episode of every arm.
        steps: steps in it, those of all arms together.
        close: frees what `play` uses.
    """

    play: Callable[[], None]
    steps: int
    close: Callable[[], None]


def single(env_id: str, **arguments: Any) -> Contestant:
    """One environment, as `gym.make` returns it."""
    env = gym.make(env_id, **arguments)
    env.reset(seed=0)
    env.action_space.seed(0)
    actions = [env.action_space.sample() for _ in range(env.spec.max_episode_steps)]

    def play() -> None:
        env.reset()
        for action in actions:
            env.step(action)

    return Contestant(play, len(actions), env.close)


def vector(env_id: str, num_envs: int, mode: str | None = None, **arguments: Any) -> Contestant:
    """A vector environment, as `gym.make_vec` returns it.

    Args:
        env_id: of the environment.
        num_envs: arms.
        mode: Gymnasium's `vectorization_mode`; None chooses the environment's own.
        arguments: of the environment.
    """
    env = gym.make_vec(env_id, num_envs=num_envs, vectorization_mode=mode, **arguments)
    return _vector(env, num_envs, env.spec.max_episode_steps or 0)


def envpool(env_id: str, num_envs: int, threads: int) -> Contestant:
    """EnvPool's vector environment, which C++ threads step."""
    import envpool

    env = envpool.make_gymnasium(env_id, num_envs=num_envs, num_threads=threads, seed=0)
    return _vector(env, num_envs, env.spec.config.max_episode_steps)


def _vector(env: Any, num_envs: int, episode: int) -> Contestant:
    low, high = env.action_space.low, env.action_space.high
    shape = (episode + 1, num_envs, low.shape[-1])
    actions = np.random.default_rng(0).uniform(low, high, shape).astype(env.action_space.dtype)
    env.reset()

    def play() -> None:
        for action in actions[:-1]:
            _, _, _, truncations, _ = env.step(action)
        assert all(truncations), "the episodes did not end together"
        env.step(actions[-1])  # resets

    return Contestant(play, num_envs * episode, env.close)


def dm_control(domain: str, task: str) -> Contestant:
    """One environment of dm_control's suite, as it stands."""
    os.environ.setdefault("MUJOCO_GL", "disabled")  # nothing is drawn
    from dm_control import suite

    env = suite.load(domain, task, task_kwargs={"random": 0})
    spec = env.action_spec()
    env.reset()
    steps = 1
    while not env.step(np.zeros(spec.shape)).last():
        steps += 1
    shape = (steps, *spec.shape)
    actions = np.random.default_rng(0).uniform(spec.minimum, spec.maximum, shape)

    def play() -> None:
        env.reset()
        for action in actions:
            env.step(action)

    return Contestant(play, steps, env.close)
