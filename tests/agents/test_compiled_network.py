"""The agent `mmc` on the compiled network acts as the one on numpy's."""

import copy
import pickle

import gymnasium as gym
import numpy as np
import pytest

from mmc_gym.agents.mmc import dynamic_mmc
from mmc_gym.interface import ReachInterface


def largest_difference(env, agents, steps=100, seed=0, **reset):
    """Between the actions of two agents that see what the first one's actions lead to."""
    (observation, _), states, worst = env.reset(seed=seed, **reset), [None, None], 0.0
    for _ in range(steps):
        outcomes = [agent.predict(observation, s) for agent, s in zip(agents, states)]
        (first, second), states = zip(*outcomes)
        assert first.dtype == second.dtype == np.float32
        worst = max(worst, float(np.abs(first - second).max()))
        observation, *_ = env.step(first)
    return worst


def both(env):
    interface = ReachInterface.of(env)
    plain = dynamic_mmc(interface)
    return plain, plain.with_engine("numba")


@pytest.mark.parametrize("control", ["joint_position", "joint_delta", "joint_velocity"])
def test_a_single_arm(control):
    env = gym.make("MMCReach-v0", control=control)
    assert max(largest_difference(env, both(env), seed=seed) for seed in range(3)) < 1e-6


@pytest.mark.parametrize(
    ("env_id", "arguments"),
    [
        ("MMCReachGoal-v0", {}),
        ("MMCReachPursuit-v0", {}),
        ("MMCReach-v0", {"joint_limits": ((-3.0, 3.0),) * 3}),
    ],
)
def test_whatever_the_single_arm_sees(env_id, arguments):
    env = gym.make(env_id, **arguments)
    assert largest_difference(env, both(env)) < 1e-6


def test_a_straight_arm_in_one_line_with_its_target():
    env = gym.make("MMCReach-v0")
    start = {"joint_angles": [0.3, 0.0, 0.0], "target": [np.cos(0.3), np.sin(0.3)]}
    assert largest_difference(env, both(env), options=start) < 1e-6


def test_many_arms():
    env = gym.make_vec("MMCReach-v0", 40)
    assert largest_difference(env, both(env), steps=99) < 1e-6


def test_a_new_episode_and_what_is_refused():
    env = gym.make("MMCReach-v0")
    _, agent = both(env)
    observation, _ = env.reset(seed=0)
    first, state = agent.predict(observation)
    for _ in range(3):
        _, state = agent.predict(observation, state)
    again, _ = agent.predict(observation, state, episode_start=np.array([True]))
    np.testing.assert_array_equal(again, first)
    with pytest.raises(ValueError, match="observation must have shape"):
        agent.predict(observation[:-1], state)
    with pytest.raises(ValueError, match="must be finite"):
        agent.predict(np.full_like(observation, np.nan), state)


def test_copies_go_on_as_the_agent_does():
    env = gym.make("MMCReach-v0")
    _, agent = both(env)
    observation, _ = env.reset(seed=0)
    _, state = agent.predict(observation)
    action, _ = agent.predict(observation, state)
    for other in (copy.deepcopy(agent), pickle.loads(pickle.dumps(agent))):
        np.testing.assert_array_equal(other.predict(observation, state)[0], action)
