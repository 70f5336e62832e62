from __future__ import annotations

import math

import gymnasium as gym
import numpy as np
import pandas as pd
import pytest

from mmc_gym import make_agent
from mmc_gym.envs.perturbations import VisuomotorRotation
from mmc_gym.measures.catalogue import MEASURES, leave_out_failures
from mmc_gym.measures.rollout import episode_seeds, run_episodes


def all_of(episode):
    return {measure.name: measure.of(episode) for measure in MEASURES}


def test_measures_have_names_of_their_own():
    names = [measure.name for measure in MEASURES]
    assert len(set(names)) == len(names)
    assert not set(names) & {"agent", "episode", "seed"}


def test_a_table_stays_readable():
    shown = [measure for measure in MEASURES if measure.shown]
    assert 8 <= len(shown) <= 14
    assert max(len(measure.label) for measure in shown) <= 20


def test_every_measure_of_a_hand_that_moves_one_length_in_two_steps_and_stays(make_episode):
    hands = np.array([[0.0, 0.0], [0.5, 0.0], [1.0, 0.0], [1.0, 0.0]])
    episode = make_episode(
        hands,
        [1.0, 0.0],
        0.1,
        joint_angles=[[0.0, 0.0], [3.0, 0.0], [3.0, 4.0], [3.0, 4.0]],
        rewards=np.array([-0.5, 0.0, 0.0]),
        action_times=np.array([1e-5, 2e-5, 9e-5]),
        servo_impulses=np.array([[1.0, 2.0], [1.0, 0.0], [0.0, 0.0]]),
        servo_work=np.array([[2.0, 2.0], [1.0, 0.0], [0.0, 0.0]]),
        reach=2.0,
    )
    assert all_of(episode) == pytest.approx(
        {
            "success": 1.0,
            "success_1_percent": 0.0,  # not there for the two steps of the dwell
            "success_2_percent": 0.0,
            "success_5_percent": 0.0,
            "final_distance": 0.0,
            "time_to_target": 0.2,
            "settling_time": 0.0,
            "overshoot": 0.0,
            "jitter": math.nan,  # nor for the half second of rest
            "path_ratio": 1.0,
            "path_efficiency": 1.0,
            "maximal_deviation": 0.0,
            "joint_path_efficiency": 5 / 7,
            "hand_over_joint_straightness": 1.0,
            "peak_speed": 5.0,
            "peak_to_mean": 1.0,
            "time_to_peak": 0.25,
            "velocity_peaks": 1.0,
            "minimum_jerk_correlation": math.nan,  # of two equal speeds
            "minimum_jerk_rmse": math.nan,
            "sparc": pytest.approx(-1.45, abs=0.1),
            "log_dimensionless_jerk": math.nan,
            "joint_effort": 4.0,
            "joint_work": 5.0,
            "episode_return": -0.5,
            "action_time": 20.0,
            "slow_action_time": pytest.approx(88.6),
        },
        nan_ok=True,
    )


def test_rest_before_and_after_a_movement_does_not_change_its_shape(make_episode):
    s = np.linspace(0, 1, 36)[:, None]
    moving = np.concatenate([10 * s**3 - 15 * s**4 + 6 * s**5, 0.2 * np.sin(2 * s)], axis=-1)
    joints = np.concatenate([s, s**2, s**3], axis=-1)
    short = make_episode(moving, moving[-1], joint_angles=joints)
    long = make_episode(
        np.pad(moving, ((0, 60), (0, 0)), mode="edge"),
        moving[-1],
        joint_angles=np.pad(joints, ((0, 60), (0, 0)), mode="edge"),
    )
    one, other = all_of(short), all_of(long)
    for name in (
        "path_efficiency",
        "maximal_deviation",
        "joint_path_efficiency",
        "hand_over_joint_straightness",
        "peak_to_mean",
        "time_to_peak",
        "minimum_jerk_correlation",
        "minimum_jerk_rmse",
        "sparc",
        "log_dimensionless_jerk",
    ):
        assert one[name] == pytest.approx(other[name]), name


def test_a_hand_that_keeps_where_it_is_makes_no_movement(make_episode):
    tremor = 0.01 * np.random.default_rng(0).normal(size=(101, 2))
    found = all_of(make_episode(tremor, [1.0, 1.0]))
    for name in ("sparc", "time_to_peak", "minimum_jerk_correlation", "path_efficiency"):
        assert math.isnan(found[name])


def test_successes_are_within_parts_of_the_reach_for_the_last_fifth_of_a_second(make_episode):
    hands = np.zeros((101, 2))
    hands[:, 0] = 0.05  # of a reach of 3: within 2 %, not within 1 %
    found = all_of(make_episode(hands, [0.0, 0.0]))
    assert [found[f"success_{percent}_percent"] for percent in (1, 2, 5)] == [0, 1, 1]
    hands[90, 0] = 1.0  # eleven positions, of the last ten steps, count
    assert all_of(make_episode(hands, [0.0, 0.0]))["success_5_percent"] == 0
    hands[89:91, 0] = 1.0, 0.05
    assert all_of(make_episode(hands, [0.0, 0.0]))["success_5_percent"] == 1


def test_jitter_is_that_of_the_last_half_second_at_the_target(make_episode):
    angles = 2 * math.pi * np.arange(101) / 26
    circle = 0.02 * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    assert all_of(make_episode(circle, [0.0, 0.0]))["jitter"] == pytest.approx(0.02)
    assert math.isnan(all_of(make_episode(circle, [0.1, 0.0]))["jitter"])


def test_a_half_circle_deviates_by_half_of_the_line_between_its_ends(make_episode):
    angles = np.linspace(0, math.pi, 101)
    hands = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    assert all_of(make_episode(hands, [9.0, 9.0]))["maximal_deviation"] == pytest.approx(0.5)
    there_and_back = np.concatenate([hands, hands[::-1]])
    assert math.isnan(all_of(make_episode(there_and_back, [9.0, 9.0]))["maximal_deviation"])


def test_where_the_target_moves_there_is_no_direct_line_and_no_overshoot(make_episode):
    hands = np.linspace(0, 1, 101)[:, None] * [1.0, 0.0]
    targets = np.tile([1.0, 0.0], (101, 1))
    found = all_of(make_episode(hands, targets))
    assert (found["path_ratio"], found["overshoot"]) == pytest.approx((1, 0))
    targets[50:] = [2.0, 0.0]
    found = all_of(make_episode(hands, targets))
    assert math.isnan(found["path_ratio"]) and math.isnan(found["overshoot"])


def test_a_path_under_a_rotation_is_no_shorter_than_the_direct_line():
    env = gym.make("MMCReach-v0", perturbations=(VisuomotorRotation(60.0),))
    played = run_episodes(make_agent("ik-dls-feedback", env), env, episode_seeds(0, 12))
    there = [episode for episode in played if episode.distances[-1] <= episode.tolerance]
    assert len(there) > 2
    for episode in there:
        path = np.linalg.norm(np.diff(episode.hands, axis=0), axis=-1).sum()
        assert path > episode.distances[0] - episode.tolerance
        assert all_of(episode)["path_ratio"] == pytest.approx(path / episode.distances[0])


def test_who_never_arrives_wins_no_measure_of_how_it_moves(make_episode):
    line = np.linspace([0.0, 0.0], [1.0, 0.0], 51)
    stays = np.zeros((51, 2))
    episodes = {"arrives": make_episode(line, line[-1]), "stays": make_episode(stays, line[-1])}
    frame = pd.DataFrame([all_of(episode) for episode in episodes.values()], index=episodes)
    assert frame.loc["stays", "path_ratio"] == 0  # the data keep it
    seen = leave_out_failures(frame)
    of_all = [measure.name for measure in MEASURES if not measure.successes_only]
    assert seen.drop(columns=of_all).loc["stays"].isna().all()
    pd.testing.assert_frame_equal(seen[of_all], frame[of_all])
    pd.testing.assert_series_equal(seen.loc["arrives"], frame.loc["arrives"])
    assert {"success", "final_distance", "episode_return", "action_time"} < set(of_all)
