"""Residual learning: the base agent acts as it does alone, and the correction is added to it."""

import gymnasium as gym
import numpy as np
import pytest

from mmc_gym import make_agent
from mmc_gym.agents.policy import corrected
from mmc_gym.training.training import make_vec_env
from mmc_gym.training.vec_env import Residual

COUNT = 6


def wrapped(**arguments: object) -> Residual:
    env = make_vec_env("MMCReach-v0", COUNT, {"control": "joint_delta", **arguments})
    env.seed(3)
    return Residual(env)


def test_without_a_correction_it_is_the_base_agent():
    residual, envs = (
        wrapped(),
        gym.make_vec("MMCReach-v0", COUNT, autoreset_mode="SameStep", control="joint_delta"),
    )
    agent, state = make_agent("mmc", envs), None  # type: ignore[arg-type]
    seen, (observed, _) = residual.reset(), envs.reset(seed=3)
    started = np.ones(COUNT, dtype=bool)
    for step in range(205):  # over two ends of episodes
        np.testing.assert_array_equal(seen[:, :13], observed)
        action, state = agent.predict(observed, state, started)
        np.testing.assert_array_equal(seen[:, 13:], action)
        seen, _, dones, infos = residual.step(np.zeros((COUNT, 3), np.float32))
        observed, _, _, started, vector_infos = envs.step(action)
        np.testing.assert_array_equal(dones, started)
        if step % 100 == 99:
            for index, info in enumerate(infos):
                final = vector_infos["final_obs"][index]
                np.testing.assert_array_equal(info["terminal_observation"][:13], final)
            # The proposal at the end is that of the agent that goes on, not of one that starts.
            stacked = np.stack(vector_infos["final_obs"])
            proposal, _ = agent.predict(stacked, state)
            ends = np.stack([info["terminal_observation"][13:] for info in infos])
            np.testing.assert_array_equal(ends, proposal)


def test_a_correction_is_added_and_bounded():
    proposal = np.array([0.0, 0.9, -0.9], np.float32)
    np.testing.assert_allclose(
        corrected(proposal, np.ones(3, np.float32)), [1.0, 1.0, 0.1], rtol=1e-6
    )
    np.testing.assert_array_equal(corrected(proposal, np.zeros(3, np.float32)), proposal)


def test_the_observation_space_has_room_for_the_proposal():
    space = wrapped().observation_space
    assert space.shape == (16,)
    assert space.contains(wrapped().reset()[0])


def test_goal_environments_and_unknown_agents_are_refused():
    goal = make_vec_env("MMCReachGoal-v0", 2, {})
    with pytest.raises(ValueError, match="venv must have Box observations"):
        Residual(goal)
    with pytest.raises(ValueError, match=r"base_agent must be one of \['mmc'\], got 'ik'"):
        Residual(make_vec_env("MMCReach-v0", 2, {}), "ik")
