from __future__ import annotations

import math

import numpy as np
import pytest

from mmc_gym.measures import reaching as metrics

STEP = 0.02


@pytest.mark.parametrize(
    ("distances", "success", "time"),
    [
        ([1, 0.5, 0.04, 0.01], 1, 0.04),  # arrives
        ([1, 0.01, 0.5, 0.04, 0.01], 1, 0.06),  # enters, leaves, settles
        ([1, 0.01, 0.01, 0.06], 0, math.nan),  # settles, and leaves again
        ([1, 0.5, 0.06], 0, math.nan),  # never there
        ([0.01, 0.02], 1, 0.0),  # there from the start
        ([0.01, 1, 0.05], 1, 0.04),  # exactly at the border, at the last moment
    ],
)
def test_success_and_time_to_target_are_about_staying(distances, success, time):
    assert metrics.success_at_end(distances, 0.05) == success
    assert metrics.final_distance(distances) == distances[-1]
    assert metrics.time_to_target(distances, 0.05, STEP) == pytest.approx(time, nan_ok=True)


def test_there_is_a_time_to_target_exactly_where_there_is_success():
    random = np.random.default_rng(0)
    for _ in range(200):
        distances = random.uniform(0, 0.1, size=random.integers(1, 6))
        arrived = not math.isnan(metrics.time_to_target(distances, 0.05, STEP))
        assert arrived == metrics.success_at_end(distances, 0.05)


def test_the_return_is_the_sum_and_the_action_time_the_median():
    assert metrics.episode_return([-1.0, -0.5, 0.25]) == -1.25
    assert metrics.action_time([1.0, 1.2, 900.0]) == 1.2


def test_an_overshoot_is_measured_from_the_nearest_point_so_far():
    angles = np.linspace(0, 2 * math.pi, 1001)
    assert metrics.overshoot(1 + np.cos(angles)) == pytest.approx(2)
    assert metrics.overshoot(np.exp(-angles)) == 0


def test_success_with_dwell_is_to_be_there_throughout_the_last_steps():
    distances = [1, 0.01, 0.2, 0.03, 0.03, 0.02]
    assert [metrics.success_with_dwell(distances, 0.03, steps) for steps in range(5)] == [
        1,
        1,
        1,
        0,
        0,
    ]
    assert metrics.success_with_dwell([0.01, 0.02], 0.03, 50) == 1
    for tolerance in (0.005, 0.025, 0.5):
        without = metrics.success_with_dwell(distances, tolerance, 0)
        assert without == metrics.success_at_end(distances, tolerance)


@pytest.mark.parametrize(
    ("distances", "time"),
    [
        ([1, 0.5, 0.04, 0.01], 0.0),  # comes and stays
        ([1, 0.01, 0.5, 0.04, 0.01], 0.04),  # passes, and comes back
        ([0.01, 1, 0.05], 0.04),
        ([1, 0.01, 0.06], math.nan),
        ([1, 0.5], math.nan),
    ],
)
def test_settling_lasts_from_the_first_time_at_the_target_to_the_last_arrival(distances, time):
    assert metrics.settling_time(distances, 0.05, STEP) == pytest.approx(time, nan_ok=True)


def test_the_jitter_of_a_circle_is_its_radius_wherever_the_target_is_and_goes():
    angles = np.linspace(0, 2 * math.pi, 51)[:-1]
    circle = 0.03 * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    way = np.linspace(0, 4, 50)[:, None] * [1.0, 2.0]
    assert metrics.jitter(circle, np.zeros((50, 2)), 100) == pytest.approx(0.03)
    assert metrics.jitter(way + circle + 0.2, way, 100) == pytest.approx(0.03)
    assert metrics.jitter(np.concatenate([circle, [[1, 1]] * 6]), np.zeros((56, 2)), 5) == 0


def test_effort_and_work_are_sums_and_unknown_without_servos():
    assert metrics.joint_effort([[1.0, 2.0], [0.5, 0.0]]) == 3.5
    assert metrics.joint_work([[1.0, 2.0], [0.5, 0.0]]) == 3.5
    assert math.isnan(metrics.joint_effort(np.zeros((5, 0))))
    assert math.isnan(metrics.joint_work(np.full((5, 3), np.nan)))


def test_a_slow_action_is_one_in_a_hundred():
    assert metrics.slow_action_time(np.arange(101.0)) == 99.0
    assert math.isnan(metrics.slow_action_time([]))
