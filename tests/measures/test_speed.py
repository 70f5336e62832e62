from __future__ import annotations

import math

import numpy as np
import pytest

from mmc_gym.measures import speed as profiles
from mmc_gym.measures.episode import hand_speed, moving_part

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
    speeds = hand_speed(hands, STEP)
    assert speeds == pytest.approx(np.full(50, 1.5))
    assert profiles.highest_speed(speeds) == pytest.approx(1.5)
    assert profiles.count_peaks(np.full(50, 1.5)) == 1


def test_the_hand_speed_of_a_circle_is_radius_times_angular_velocity():
    angles = 2.0 * STEP * np.arange(200)
    hands = 0.7 * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    assert hand_speed(hands, STEP) == pytest.approx(np.full(199, 1.4), rel=1e-3)


def test_minimum_jerk_has_one_peak_1_875_times_as_high_as_the_mean():
    speeds = hand_speed(minimum_jerk(500), STEP)
    assert profiles.highest_speed(speeds) / speeds.mean() == pytest.approx(1.875, rel=1e-4)
    assert profiles.count_peaks(speeds) == 1


@pytest.mark.parametrize("count", [1, 2, 3, 7])
def test_every_submovement_is_a_velocity_peak(count):
    profile = np.tile(np.sin(np.linspace(0, math.pi, 40)), count)
    assert profiles.count_peaks(profile) == count


@pytest.mark.parametrize(("rise", "peaks"), [(0.049, 1), (0.051, 2)])
def test_a_rise_counts_from_five_percent_of_the_peak(rise, peaks):
    assert profiles.count_peaks([0.2, 1.0, 0.3, 0.3 + rise, 0.1]) == peaks


def test_a_movement_fastest_in_its_first_or_last_step_has_a_peak_there():
    decay = np.exp(-np.arange(50) / 10)
    assert profiles.count_peaks(decay) == 1
    assert profiles.count_peaks(decay[::-1]) == 1
    assert profiles.count_peaks([*decay, *decay[::-1]]) == 2


def test_a_hand_at_rest_has_no_peak():
    assert profiles.count_peaks(np.zeros(20)) == 0
    assert profiles.count_peaks([]) == 0


def test_the_number_of_peaks_ignores_the_scale_of_speed():
    profile = np.random.default_rng(1).uniform(size=200)
    assert profiles.count_peaks(profile) == profiles.count_peaks(1e-3 * profile)


def test_minimum_jerk_is_the_measures_own_reference():
    speeds = hand_speed(minimum_jerk(501), STEP)
    assert profiles.peakedness(speeds) == pytest.approx(15 / 8, rel=1e-4)
    assert profiles.phase_of_peak(speeds) == 0.5
    assert profiles.correlation_with_minimum_jerk(speeds) == pytest.approx(1)
    assert profiles.second_rise(speeds) == 0


def test_an_exponential_approach_is_not_bell_shaped():
    speeds = 0.9 ** np.arange(40)
    assert profiles.peakedness(speeds) == pytest.approx(0.1 * 40 / (1 - 0.9**40))
    assert profiles.phase_of_peak(speeds) == 0.5 / 40
    assert profiles.correlation_with_minimum_jerk(speeds) < 0
    assert profiles.second_rise(speeds) == 0


def test_a_raised_cosine_correlates_with_minimum_jerk_as_the_integrals_say():
    # In both, time runs from 0 to 1; 30 t² (1 − t)² and 1 − cos 2πt have the means 1 and 1, the
    # variances 3/7 and 1/2, and the covariance 45/π⁴.
    time = (np.arange(2000) + 0.5) / 2000
    expected = 45 / math.pi**4 / math.sqrt(3 / 14)
    speeds = 1 - np.cos(2 * math.pi * time)
    assert profiles.correlation_with_minimum_jerk(speeds) == pytest.approx(expected, abs=1e-5)


def test_the_shape_of_a_profile_ignores_the_scale_of_speed():
    profile = np.random.default_rng(2).uniform(size=50)
    for measure in (
        profiles.peakedness,
        profiles.phase_of_peak,
        profiles.correlation_with_minimum_jerk,
        profiles.second_rise,
    ):
        assert measure(profile) == pytest.approx(measure(37 * profile))


def test_a_constant_speed_has_a_mean_and_no_bell():
    assert profiles.peakedness(np.full(7, 0.3)) == pytest.approx(1)
    assert math.isnan(profiles.correlation_with_minimum_jerk(np.full(7, 0.3)))


def test_a_hand_at_rest_has_no_shape():
    assert math.isnan(profiles.peakedness(np.zeros(9)))
    assert math.isnan(profiles.phase_of_peak(np.zeros(9)))
    assert math.isnan(profiles.correlation_with_minimum_jerk(np.zeros(9)))
    assert profiles.second_rise(np.zeros(9)) == 0


def test_only_a_rise_after_the_peak_is_a_second_one():
    assert profiles.second_rise([0.5, 0.2, 1.0, 0.4, 0.3]) == 0
    assert profiles.second_rise([0.5, 2.0, 0.4, 0.6, 0.1, 0.5]) == pytest.approx(0.2)


def test_the_moving_part_of_minimum_jerk_is_its_span():
    speeds = hand_speed(minimum_jerk(10_000), STEP)
    part = moving_part(speeds)
    assert (part.start / 10_000, part.stop / 10_000) == pytest.approx(
        profiles.MINIMUM_JERK_SPAN, abs=1e-4
    )
    assert moving_part(np.zeros(5)) == slice(0, 0)
    assert moving_part([]) == slice(0, 0)


@pytest.mark.parametrize("rest", [0, 1, 40])
def test_the_moving_part_of_minimum_jerk_is_recognized_whatever_rest_surrounds_it(rest):
    moving = np.pad(hand_speed(minimum_jerk(4_000), STEP), rest)
    speeds, span = moving[moving_part(moving)], profiles.MINIMUM_JERK_SPAN
    assert profiles.correlation_with_minimum_jerk(speeds, span) == pytest.approx(1, abs=1e-6)
    assert profiles.difference_from_minimum_jerk(speeds, span) == pytest.approx(0, abs=2e-3)
    # The numbers in the module's docstring.
    assert profiles.peakedness(speeds) == pytest.approx(1.658, abs=5e-4)
    assert profiles.smoothness_by_jerk(speeds) == pytest.approx(-4.41, abs=5e-3)


def test_the_log_dimensionless_jerk_of_minimum_jerk_is_that_of_the_integral():
    # 720 / (15/8)² = 204.8.
    speeds = hand_speed(minimum_jerk(20_000), STEP)
    assert profiles.smoothness_by_jerk(speeds) == pytest.approx(-math.log(204.8), abs=1e-3)


def test_the_log_dimensionless_jerk_of_a_parabola_is_that_of_the_integral():
    # s = 4 t (1 − t) has the peak 1 and the second derivative −8 throughout.
    time = (np.arange(50) + 0.5) / 50
    found = profiles.smoothness_by_jerk(4 * time * (1 - time))
    assert found == pytest.approx(-math.log(64), abs=1e-3)


@pytest.mark.parametrize("steps", [35, 50, 100])
def test_fifty_samples_a_second_tell_enough_of_a_minimum_jerk_movement(steps):
    speeds = hand_speed(minimum_jerk(steps), STEP)
    assert profiles.smoothness_by_jerk(speeds) == pytest.approx(-math.log(204.8), abs=0.25)
    assert profiles.peakedness(speeds) == pytest.approx(15 / 8, rel=0.01)


def test_the_rmse_of_a_constant_speed_is_the_deviation_of_minimum_jerk():
    assert profiles.difference_from_minimum_jerk(np.ones(5_000)) == pytest.approx(math.sqrt(3 / 7))


def test_sparc_is_that_of_the_authors_own_example():
    time = np.arange(-1, 1, 0.01)
    assert profiles.spectral_arc_length(np.exp(-5 * time**2), 0.01) == pytest.approx(
        -1.41403, abs=5e-6
    )


def test_sparc_of_a_falling_spectrum_lies_between_the_diagonal_and_the_sides():
    # The arc goes 1 along and 1 − 0.05 down.
    for width in (0.1, 0.3, 1.0):
        time = np.arange(-5 * width, 5 * width, 0.02)
        found = profiles.spectral_arc_length(np.exp(-((time / width) ** 2)), 0.02)
        assert -1.95 < found < -math.hypot(1, 0.95)


def test_smoothness_ignores_size_and_duration_and_punishes_a_second_submovement():
    bell = hand_speed(minimum_jerk(60), STEP)
    slow = hand_speed(minimum_jerk(120), STEP)
    double = np.concatenate([bell, 0.5 * bell])
    for measure, close in (
        (lambda speeds: profiles.spectral_arc_length(speeds, STEP), 0.02),
        (profiles.smoothness_by_jerk, 0.1),
    ):
        assert measure(3 * bell) == pytest.approx(measure(bell))
        assert measure(slow) == pytest.approx(measure(bell), abs=close)
        assert measure(double) < measure(bell) - 0.1


def test_a_hand_at_rest_has_no_smoothness():
    for nothing in (np.zeros(9), np.array([])):
        assert math.isnan(profiles.spectral_arc_length(nothing, STEP))
        assert math.isnan(profiles.smoothness_by_jerk(nothing))
        assert math.isnan(profiles.difference_from_minimum_jerk(nothing))
    assert math.isnan(profiles.smoothness_by_jerk(np.ones(9)))
