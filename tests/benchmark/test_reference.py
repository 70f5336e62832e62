import math

import gymnasium as gym
import numpy as np
import pytest

from mmc_gym.benchmark.suite import minimum_jerk_episodes
from mmc_gym.measures import measure_all
from mmc_gym.measures.rollout import episode_seeds, run_episodes
from mmc_gym.network.time_base import minimum_jerk


def test_the_hand_goes_straight_to_the_target_by_minimum_jerk_and_rests(make_episode):
    (ideal,) = minimum_jerk_episodes([make_episode(np.zeros((101, 2)), [1.2, 1.6])])
    steps = (0.2 + 2.0 / 4) / 0.02
    expected = minimum_jerk(np.arange(101) / steps)[:, None] * [1.2, 1.6]
    assert ideal.hands == pytest.approx(expected, abs=1e-9)
    found = measure_all(ideal)
    assert found["success"] == found["success_1_percent"] == found["velocity_peaks"] == 1
    assert found["path_ratio"] == pytest.approx(1)
    assert found["peak_speed"] == pytest.approx(15 / 8 * 2.0 / 0.7, rel=1e-2)
    assert found["minimum_jerk_correlation"] > 0.999
    for name in ("joint_effort", "joint_work", "action_time"):
        assert math.isnan(found[name])


def test_it_starts_and_is_asked_as_the_agents_are_whatever_they_do(env, oracle, frozen):
    seeds = episode_seeds(0, 5)
    one = minimum_jerk_episodes(run_episodes(oracle, env, seeds))
    other = minimum_jerk_episodes(run_episodes(frozen, env, seeds))
    for first, second in zip(one, other, strict=True):
        assert np.array_equal(first.hands, second.hands)


def test_it_follows_a_target_that_jumps(frozen):
    env = gym.make("MMCReachDoubleStep200-v0")
    for ideal in minimum_jerk_episodes(run_episodes(frozen, env, episode_seeds(1, 5))):
        assert ideal.distances[-1] == pytest.approx(0, abs=1e-9)
        turn = np.linalg.norm(np.diff(ideal.hands, 2, axis=0), axis=-1)
        assert turn.max() < 0.1  # no corner: the velocity changes little in a step


def test_episodes_may_differ_in_length(make_episode):
    asked = [make_episode(np.zeros((steps, 2)), [2.0, 0.0]) for steps in (101, 31)]
    long, short = minimum_jerk_episodes(asked)
    assert np.array_equal(long.hands[:31], short.hands)
    assert minimum_jerk_episodes([]) == ()
