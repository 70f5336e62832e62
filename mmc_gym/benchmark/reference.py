"""A reference for all movements: a hand that follows minimum jerk, without an arm.

    x(t) = x₀ + (g − x₀) (10 τ³ − 15 τ⁴ + 6 τ⁵),     τ = t/T,     T = T₀ + d/v̄

from the start x₀ to the target g at the distance d, and then rest.  T is that of the agents that
plan (`mmc_gym.agents.planners`: 0.2 s and a second for each 4 segment lengths), so that they differ
from it in shape alone.  Where the target moves, the hand follows by the rest of a minimum-jerk
movement from its present state, as they do.  Measures that need an arm are NaN.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np

from mmc_gym.agents.planners import HandPlan, begin, follow, minimum_jerk_step, step
from mmc_gym.measures.episode import Episode, Floats

REFERENCE = "minimum jerk (ideal)"
"""The hand's name in tables and data."""


def has_reference(env: gym.Env[Any, Any]) -> bool:
    """Tell whether all hands in `env` meet the same targets at the same times.

    They do not where a target moves on when it is reached, as in via points.
    """
    setup = getattr(env.unwrapped, "setup", None)
    return getattr(getattr(setup, "task", None), "advance", "time") == "time"


def minimum_jerk_episodes(episodes: Sequence[Episode]) -> tuple[Episode, ...]:
    """Return the ideal movements from the starts to the targets of recorded episodes.

    Args:
        episodes: of any agent; only the start, the targets and the number of steps matter.

    Returns:
        As many episodes, of the same lengths: N = 0 joints, rewards and action times NaN.
    """
    if not episodes:
        return ()
    longest = max(len(episode.targets) for episode in episodes)
    targets = np.stack(
        [
            np.pad(episode.targets, ((0, longest - len(episode.targets)), (0, 0)), mode="edge")
            for episode in episodes
        ],
        axis=1,
    )
    starts = np.stack([episode.seen_hands[0] for episode in episodes])
    hands = np.stack(_follow(starts, targets, episodes[0].control_step), axis=1)
    return tuple(
        _episode(episode, hand[: len(episode.hands)])
        for episode, hand in zip(episodes, hands, strict=True)
    )


def _follow(starts: Floats, targets: Floats, control_step: float) -> list[Floats]:
    """Return hand positions (episodes, 2) at all times, for targets (times, episodes, 2)."""
    plan = HandPlan(starts, np.zeros_like(starts), np.zeros_like(starts))
    movement = begin(starts, targets[0], control_step)
    hands: list[Floats] = [starts]
    for target in targets[:-1]:
        movement = follow(movement, plan.position, target, control_step)
        plan = minimum_jerk_step(plan, movement.target, movement.remaining)
        movement = step(movement)
        hands.append(np.asarray(plan.position, dtype=np.float64))
    return hands


def _episode(like: Episode, hands: Floats) -> Episode:
    steps = len(like.rewards)
    unknown, no_joints = np.full(steps, np.nan), np.zeros((steps + 1, 0))
    return replace(
        like,
        hands=hands,
        cursors=None,
        distances=np.linalg.norm(hands - like.targets, axis=-1),
        joint_angles=no_joints,
        servo_impulses=no_joints[1:],
        servo_work=no_joints[1:],
        rewards=unknown,
        action_times=unknown,
    )
