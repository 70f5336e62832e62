"""A policy with a memory sees what it observed and did, as its training showed it."""

import gymnasium as gym
import numpy as np
import pytest

from mmc_gym import make_agent
from mmc_gym._errors import UserError
from mmc_gym.agents.policy_network import History
from mmc_gym.interface import ObservationLayout
from mmc_gym.measures.rollout import run_episodes

LAYOUT = ObservationLayout(3, 3.0)
HISTORY = History(LAYOUT, (1, 2, 3))


def observed(count: int = 4) -> np.ndarray:
    """Observations of consecutive steps of one arm, (steps, 15)."""
    env = gym.make("MMCReach-v0", engine="analytic")
    seen = [env.reset(seed=1)[0]]
    for _ in range(count - 1):
        seen.append(env.step(np.full(3, 0.5, np.float32))[0])
    return np.array(seen)


def test_before_an_episode_nothing_has_moved():
    first, *_ = observed()
    recalled = HISTORY.recall(HISTORY.observed(first), HISTORY.start(first))
    np.testing.assert_allclose(recalled, 0.0, atol=1e-6)


def test_a_history_has_what_was_seen_and_done_less_what_is_seen_now():
    seen = observed()
    memory, action = HISTORY.start(seen[0]), np.full(3, 0.5, np.float32)
    for one in seen[:-1]:
        memory = HISTORY.extended(HISTORY.observed(one, memory), action, memory)
    recalled = HISTORY.recall(HISTORY.observed(seen[-1], memory), memory).reshape(3, 10)
    angles = np.unwrap(np.arctan2(seen[:, 3:6], seen[:, :3]), axis=0)
    np.testing.assert_allclose(recalled[0, :3], angles[-2] - angles[-1], atol=1e-5)
    np.testing.assert_allclose(recalled[1, :3], angles[[0, 1]].mean(0) - angles[-1], atol=1e-5)
    np.testing.assert_allclose(recalled[:, 5:7], 0.0, atol=1e-5)  # the target stays
    np.testing.assert_allclose(recalled[:2, 7:], 0.5)
    np.testing.assert_allclose(recalled[2, 7:], 0.0)  # nothing was done before the episode


def test_one_arm_acts_as_in_a_batch():
    one, many = gym.make("MMCReach-v0"), gym.make_vec("MMCReach-v0", 2)
    alone = run_episodes(make_agent("ppo-memory", one), one, [5, 6])
    together = run_episodes(make_agent("ppo-memory", many), many, [5, 6])
    for each, same in zip(alone, together, strict=True):
        np.testing.assert_allclose(each.hands, same.hands, atol=1e-4)


def test_a_state_of_other_arms_is_refused():
    env = gym.make_vec("MMCReach-v0", 2)
    agent, (observations, _) = make_agent("ppo-memory", env), env.reset(seed=0)
    _, state = agent.predict(observations)
    with pytest.raises(UserError, match=r"state must be what predict returned.* \(3, 68, 10\)"):
        agent.predict(observations[[0, 1, 1]], state)


def test_a_new_episode_knows_nothing_of_the_last_and_changes_no_other():
    env = gym.make_vec("MMCReach-v0", 2)
    agent, (first, _), state = make_agent("ppo-memory", env), env.reset(seed=0), None
    observations = first
    for _ in range(5):
        actions, state = agent.predict(observations, state, deterministic=True)
        observations, *_ = env.step(actions)
    _, fresh = agent.predict(first, None, deterministic=True)
    _, continued = agent.predict(first, state, deterministic=True)
    _, restarted = agent.predict(first, state, np.array([True, False]), deterministic=True)
    np.testing.assert_array_equal(restarted[0], fresh[0])
    np.testing.assert_array_equal(restarted[1], continued[1])
    assert not np.array_equal(fresh, continued)
