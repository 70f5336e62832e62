from __future__ import annotations

import math

import numpy as np
import pytest

from mmc_gym.evaluation import metrics

STEP = 0.02


def straight(speeds):
    """Hand positions along x that move with `speeds` in the control steps."""
    x = np.concatenate([[0.0], np.cumsum(speeds) * STEP])
    return np.stack([x, np.zeros_like(x)], axis=-1)


def minimum_jerk(steps):
    s = np.linspace(0, 1, steps + 1)
    x = 10 * s**3 - 15 * s**4 + 6 * s**5
    return np.stack([x, 2 * x], axis=-1)


def test_a_straight_line_at_constant_speed():
    hands = straight(np.full(50, 1.5))
    speeds = metrics.hand_speed(hands, STEP)
    assert speeds == pytest.approx(np.full(50, 1.5))
    assert metrics.path_ratio(hands, hands[-1], 0.05) == pytest.approx(1)
    assert metrics.peak_speed(speeds) == pytest.approx(1.5)
    assert metrics.velocity_peaks(np.full(50, 1.5)) == 1


def test_the_hand_speed_of_a_circle_is_radius_times_angular_velocity():
    angles = 2.0 * STEP * np.arange(200)
    hands = 0.7 * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    assert metrics.hand_speed(hands, STEP) == pytest.approx(np.full(199, 1.4), rel=1e-3)


def test_a_half_circle_is_half_pi_times_its_diameter():
    angles = np.linspace(0, math.pi, 1001)
    hands = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    assert metrics.path_ratio(hands, hands[-1], 0.05) == pytest.approx(math.pi / 2, rel=1e-5)


def test_the_path_ratio_ignores_where_it_is_and_how_large():
    random = np.random.default_rng(0)
    hands, target = random.normal(size=(30, 2)), np.array([3.0, 1.0])
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    moved = 5 * hands @ turn.T + 7, 5 * turn @ target + 7
    assert metrics.path_ratio(*moved, 0.05) == pytest.approx(
        metrics.path_ratio(hands, target, 0.05)
    )


def test_a_hand_that_starts_at_its_target_has_no_path_ratio():
    assert math.isnan(metrics.path_ratio([[0, 0], [1, 0]], [0.049, 0], 0.05))
    assert metrics.path_ratio([[0, 0], [1, 0]], [0.05, 0], 0.05) == pytest.approx(20)


def test_a_hand_that_stops_short_has_a_path_ratio_below_one():
    assert metrics.path_ratio([[0, 0], [0.5, 0]], [1, 0], 0.05) == 0.5


def test_minimum_jerk_has_one_peak_1_875_times_as_high_as_the_mean():
    speeds = metrics.hand_speed(minimum_jerk(500), STEP)
    assert metrics.peak_speed(speeds) / speeds.mean() == pytest.approx(1.875, rel=1e-4)
    assert metrics.velocity_peaks(speeds) == 1


@pytest.mark.parametrize("count", [1, 2, 3, 7])
def test_every_submovement_is_a_velocity_peak(count):
    profile = np.tile(np.sin(np.linspace(0, math.pi, 40)), count)
    assert metrics.velocity_peaks(profile) == count


@pytest.mark.parametrize(("rise", "peaks"), [(0.049, 1), (0.051, 2)])
def test_a_rise_counts_from_five_percent_of_the_peak(rise, peaks):
    assert metrics.velocity_peaks([0.2, 1.0, 0.3, 0.3 + rise, 0.1]) == peaks


def test_a_movement_fastest_in_its_first_or_last_step_has_a_peak_there():
    decay = np.exp(-np.arange(50) / 10)
    assert metrics.velocity_peaks(decay) == 1
    assert metrics.velocity_peaks(decay[::-1]) == 1
    assert metrics.velocity_peaks([*decay, *decay[::-1]]) == 2


def test_a_hand_at_rest_has_no_peak():
    assert metrics.velocity_peaks(np.zeros(20)) == 0
    assert metrics.velocity_peaks([]) == 0


def test_the_number_of_peaks_ignores_the_scale_of_speed():
    profile = np.random.default_rng(1).uniform(size=200)
    assert metrics.velocity_peaks(profile) == metrics.velocity_peaks(1e-3 * profile)


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


def test_minimum_jerk_is_the_measures_own_reference():
    speeds = metrics.hand_speed(minimum_jerk(501), STEP)
    assert metrics.peak_to_mean(speeds) == pytest.approx(15 / 8, rel=1e-4)
    assert metrics.time_to_peak(speeds) == 0.5
    assert metrics.minimum_jerk_correlation(speeds) == pytest.approx(1)
    assert metrics.second_rise(speeds) == 0


def test_an_exponential_approach_is_not_bell_shaped():
    speeds = 0.9 ** np.arange(40)
    assert metrics.peak_to_mean(speeds) == pytest.approx(0.1 * 40 / (1 - 0.9**40))
    assert metrics.time_to_peak(speeds) == 0.5 / 40
    assert metrics.minimum_jerk_correlation(speeds) < 0
    assert metrics.second_rise(speeds) == 0


def test_a_raised_cosine_correlates_with_minimum_jerk_as_the_integrals_say():
    # In both, time runs from 0 to 1; 30 t² (1 − t)² and 1 − cos 2πt have the means 1 and 1, the
    # variances 3/7 and 1/2, and the covariance 45/π⁴.
    time = (np.arange(2000) + 0.5) / 2000
    expected = 45 / math.pi**4 / math.sqrt(3 / 14)
    speeds = 1 - np.cos(2 * math.pi * time)
    assert metrics.minimum_jerk_correlation(speeds) == pytest.approx(expected, abs=1e-5)


def test_the_shape_of_a_profile_ignores_the_scale_of_speed():
    profile = np.random.default_rng(2).uniform(size=50)
    for measure in (
        metrics.peak_to_mean,
        metrics.time_to_peak,
        metrics.minimum_jerk_correlation,
        metrics.second_rise,
    ):
        assert measure(profile) == pytest.approx(measure(37 * profile))


def test_a_constant_speed_has_a_mean_and_no_bell():
    assert metrics.peak_to_mean(np.full(7, 0.3)) == pytest.approx(1)
    assert math.isnan(metrics.minimum_jerk_correlation(np.full(7, 0.3)))


def test_a_hand_at_rest_has_no_shape():
    assert math.isnan(metrics.peak_to_mean(np.zeros(9)))
    assert math.isnan(metrics.time_to_peak(np.zeros(9)))
    assert math.isnan(metrics.minimum_jerk_correlation(np.zeros(9)))
    assert metrics.second_rise(np.zeros(9)) == 0


def test_only_a_rise_after_the_peak_is_a_second_one():
    assert metrics.second_rise([0.5, 0.2, 1.0, 0.4, 0.3]) == 0
    assert metrics.second_rise([0.5, 2.0, 0.4, 0.6, 0.1, 0.5]) == pytest.approx(0.2)


def test_an_overshoot_is_measured_from_the_nearest_point_so_far():
    angles = np.linspace(0, 2 * math.pi, 1001)
    assert metrics.overshoot(1 + np.cos(angles)) == pytest.approx(2)
    assert metrics.overshoot(np.exp(-angles)) == 0
