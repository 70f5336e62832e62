"""Rollouts of many episodes at once: one call of the agent and one of the environment a step.

    run_episodes            episode 1: step, step, …   episode 2: step, step, …
    run_episodes_together   step of all episodes, step of all episodes, …

The episodes are the same, but for the rounding of an agent's arithmetic on a batch, and ten and
more times as many a second.  What one action takes is not known of them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import ArrayLike, NDArray

from mmc_gym._threads import one_torch_thread
from mmc_gym.body.pymunk.batch_servo_watch import BatchServoWatch
from mmc_gym.envs.vector import MMCReachVectorEnv
from mmc_gym.measures.rollout import Episode, Predictor

Floats = NDArray[np.float64]


def run_episodes_together(
    agent: Predictor,
    env: gym.vector.VectorEnv[Any, Any, Any],
    seeds: Sequence[int],
    options: Sequence[Mapping[str, Any]] | None = None,
) -> tuple[Episode, ...]:
    """Let `agent` play one episode per seed, all at once, without exploration.

    Args:
        agent: whose `predict` takes a batch of observations, and keeps what it remembers in the
            state it returns.  One that draws random actions draws others than one by one.
        env: a native vector environment with an arm for each seed, and a time limit.
        seeds: one per episode, see `episode_seeds`.
        options: of the environment's reset, for each episode, such as `{"trial": 3}`.

    Returns:
        The episodes that `run_episodes` returns, with action times NaN.

    Raises:
        ValueError: if `env` is none such, there are not as many options as seeds, or the agent
            does not give an action for each episode.

    Example:
        >>> from mmc_gym import make_agent
        >>> env = gym.make_vec("MMCReach-v0", num_envs=2)
        >>> first, second = run_episodes_together(make_agent("mmc", env), env, [5, 6])
        >>> first.seed, second.hands.shape
        (5, (101, 2))
    """
    asked: Sequence[Mapping[str, Any]] = [{}] * len(seeds) if options is None else options
    native = _checked(env, len(seeds))
    if len(asked) != len(seeds):
        raise ValueError(f"options must be {len(seeds)}, one per seed, got {len(asked)}")
    arms = native.arms
    shape = (len(seeds), native.setup.joint_count)
    with one_torch_thread(), BatchServoWatch(arms, shape) as watch:
        observation, seen = _reset(native, seeds, asked)
        seen_at = {name: [values] for name, values in seen.items()}
        postures = [arms.joint_angles.copy()]
        impulses: list[Floats] = []
        work: list[Floats] = []
        rewards: list[Floats] = []
        state, episode_start = None, np.ones(len(seeds), dtype=bool)
        for _ in range(native.max_episode_steps or 0):
            action, state = agent.predict(observation, state, episode_start, deterministic=True)
            _check_actions(action, shape)
            observation, reward, _, _, info = native.step(action)
            for name, record in seen_at.items():
                record.append(info[name])
            postures.append(arms.joint_angles.copy())
            impulses.append(watch.impulses.copy())
            work.append(watch.work.copy())
            rewards.append(reward)
            episode_start = np.zeros(len(seeds), dtype=bool)
    records = {
        **{_SEEN[name]: _by_episode(record) for name, record in seen_at.items()},
        "joint_angles": _by_episode(postures),
        "servo_impulses": _by_episode(impulses),
        "servo_work": _by_episode(work),
        "rewards": _by_episode(rewards),
    }
    return tuple(
        Episode(
            seed=seed,
            **{name: values[number] for name, values in records.items()},
            action_times=np.full(len(rewards), np.nan),
            control_step=float(native.parameters.control_step),
            tolerance=float(native.success_distance),
            reach=float(native.reach),
        )
        for number, seed in enumerate(seeds)
    )


_SEEN = {
    "end_effector": "hands",
    "distance": "distances",
    "target": "targets",
    "cursor": "cursors",  # under a visuomotor rotation only
}


def _checked(env: gym.vector.VectorEnv[Any, Any, Any], episodes: int) -> MMCReachVectorEnv:
    native = env.unwrapped
    if not isinstance(native, MMCReachVectorEnv) or native.max_episode_steps is None:
        raise ValueError(
            "env must be a native vector environment with a time limit, such as "
            f"gym.make_vec('MMCReach-v0', num_envs={episodes}), got {env}"
        )
    if native.num_envs != episodes:
        raise ValueError(f"env must have {episodes} arms, one per seed, got {native.num_envs}")
    return native


def _reset(
    env: MMCReachVectorEnv, seeds: Sequence[int], options: Sequence[Mapping[str, Any]]
) -> tuple[Any, dict[str, Floats]]:
    """Start every episode with its own seed and options; observation, and what the infos tell."""
    observation: Any = None
    seen: dict[str, Floats] = {}
    for group in _alike(options):
        mask = np.zeros(len(seeds), dtype=bool)
        mask[group] = True
        asked = {**options[group[0]], "reset_mask": mask}
        observation, info = env.reset(seed=list(seeds), options=asked)
        for name in _SEEN.keys() & info.keys():
            values = seen.setdefault(name, np.zeros(info[name].shape))
            values[group] = info[name][group]
    return observation, seen


def _alike(options: Sequence[Mapping[str, Any]]) -> list[list[int]]:
    """Numbers of the episodes that have the same options, for they are reset together."""
    groups: dict[str, list[int]] = {}
    for number, option in enumerate(options):
        groups.setdefault(repr(sorted(option.items())), []).append(number)
    return list(groups.values())


def _check_actions(action: ArrayLike, shape: tuple[int, int]) -> None:
    if np.shape(action) != shape:
        raise ValueError(f"agent must give actions of shape {shape}, got {np.shape(action)}")


def _by_episode(values: Sequence[Floats]) -> Floats:
    """Arrays (episodes, …) of each step as one, (episodes, steps, …)."""
    return np.stack(values, axis=1)
