"""How well an agent does: over fixed episodes, played at once, each with an arm of its own."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np

from mmc_gym.agents.base import Agent, ReachInterface
from mmc_gym.agents.policy import PolicyAgent, PolicyCard
from mmc_gym.agents.policy_network import PolicyNetwork

EVALUATION_SEED = 1_000_000  # far from the seeds that a comparison starts from


def evaluate(network: PolicyNetwork, card: PolicyCard, episodes: int) -> dict[str, float]:
    """How the deterministic policy does over fixed episodes; see `evaluate_agent`."""

    def make(interface: ReachInterface) -> Agent[Any]:
        return PolicyAgent(network, card, interface)

    arguments = card.hyperparameters.get("env_kwargs", {})
    return evaluate_agent(make, card.env_id, arguments, episodes, EVALUATION_SEED)


def evaluate_agent(
    make: Callable[[ReachInterface], Agent[Any]],
    env_id: str,
    arguments: dict[str, Any],
    episodes: int,
    seed: int,
) -> dict[str, float]:
    """How an agent does over episodes that are played at once, each with an arm of its own.

    Args:
        make: makes the agent.
        env_id: environment that it acts in.
        arguments: of the environment.
        episodes: how many.
        seed: of the first episode; the others have the next ones.

    Returns:
        success: part of the episodes that end at the target.
        final_distance: mean, segment lengths.
        episode_return: mean.
        time_at_target: part of the time that is spent at the target.
        time_to_target: median over the successes, until the hand is there to stay, seconds; there
            is none without a success.
    """
    env = gym.make_vec(env_id, episodes, autoreset_mode="Disabled", **arguments)
    interface = ReachInterface.of(env)
    agent = make(interface)
    observations, infos = env.reset(seed=seed)
    state, over, step = None, np.zeros(episodes, dtype=bool), 0
    returns, at_target, last_away = (np.zeros(episodes) for _ in range(3))
    while not over.all():
        actions, state = agent.predict(observations, state, deterministic=True)
        observations, rewards, _, over, infos = env.step(actions)
        step += 1
        returns += rewards
        at_target += infos["is_success"]
        last_away[~infos["is_success"]] = step
    env.close()
    success = infos["is_success"]
    scores = {
        "success": float(success.mean()),
        "final_distance": float(infos["distance"].mean()),
        "episode_return": float(returns.mean()),
        "time_at_target": float(at_target.mean()) / step,
    }
    if success.any():
        steps = float(np.median(last_away[success])) + 1
        scores["time_to_target"] = round(steps * interface.control_step, 3)
    return scores
