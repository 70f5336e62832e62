"""Measures of one movement: where it ends, its path and its speed."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from mmc_gym.measures import reaching, speed
from mmc_gym.measures.episode import hand_speed, moving_part
from mmc_gym.network.time_base import minimum_jerk


@pytest.mark.parametrize(
    ("distances", "is_success", "time"),
    [
        ([1, 0.5, 0.04, 0.01], 1, 0.04),  # arrives
        ([1, 0.01, 0.5, 0.04, 0.01], 1, 0.06),  # enters, leaves, settles
        ([1, 0.01, 0.01, 0.06], 0, math.nan),  # settles, and leaves again
        ([1, 0.5, 0.06], 0, math.nan),  # never there
        ([0.01, 0.02], 1, 0.0),  # there from the start
        ([0.01, 1, 0.05], 1, 0.04),  # exactly at the border, at the last moment
    ],
)
def test_success_and_time_are_about_staying(make_episode, distances, is_success, time):
    episode = make_episode(np.outer(distances, [1.0, 0.0]), [0.0, 0.0])
    assert reaching.success(episode) == is_success
    assert reaching.final_distance(episode) == distances[-1]
    assert reaching.time_to_target(episode) == pytest.approx(time, nan_ok=True)


def test_success_with_dwell_is_within_a_part_of_the_reach_for_a_fifth_of_a_second(make_episode):
    hands = np.zeros((101, 2))
    for distance, success in ((0.029, 1), (0.031, 0)):  # of a reach of 3
        hands[:, 0] = distance
        assert reaching.success_1_percent(make_episode(hands, [0.0, 0.0])) == success
    hands[:, 0] = 0.0
    hands[90, 0] = 1.0  # eleven positions, of the last ten steps, count
    assert reaching.success_1_percent(make_episode(hands, [0.0, 0.0])) == 0
    hands[89:91, 0] = 1.0, 0.0
    assert reaching.success_1_percent(make_episode(hands, [0.0, 0.0])) == 1


def test_an_overshoot_is_measured_from_the_nearest_point_so_far(make_episode):
    angles = np.linspace(0, 2 * math.pi, 1001)
    assert reaching.largest_retreat(1 + np.cos(angles)) == pytest.approx(2)
    assert reaching.largest_retreat(np.exp(-angles)) == 0
    hands = np.linspace(0, 1, 101)[:, None] * [1.0, 0.0]
    targets = np.tile([1.0, 0.0], (101, 1))
    assert reaching.overshoot(make_episode(hands, targets)) == 0
    targets[50:] = [2.0, 0.0]
    assert math.isnan(reaching.overshoot(make_episode(hands, targets)))  # it moves


def test_jitter_of_a_circle_is_its_radius_wherever_the_target_goes(make_episode):
    angles = 2 * math.pi * np.arange(101) / 26
    circle = 0.02 * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    way = np.linspace(0, 4, 101)[:, None] * [1.0, 2.0]
    assert reaching.jitter(make_episode(circle, [0.0, 0.0])) == pytest.approx(0.02)
    assert reaching.jitter(make_episode(way + circle + 0.01, way)) == pytest.approx(0.02)
    assert math.isnan(reaching.jitter(make_episode(circle, [0.1, 0.0])))  # not at the target
    circle[-30:] = 0.0  # the last half second are 26 positions
    assert reaching.jitter(make_episode(circle, [0.0, 0.0])) == 0


def test_a_half_circle_is_half_pi_times_its_diameter_and_deviates_by_half_of_it(make_episode):
    angles = np.linspace(0, math.pi, 1001)
    hands = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    assert reaching.linearity_index(hands) == pytest.approx(0.5)
    episode = make_episode(hands, hands[-1])
    assert reaching.path_ratio(episode) == pytest.approx(math.pi / 2, rel=1e-5)
    assert reaching.maximal_deviation(episode) == pytest.approx(0.5)
    there_and_back = make_episode([*hands, *hands[::-1]], [9.0, 9.0])
    assert math.isnan(reaching.maximal_deviation(there_and_back))
    assert math.isnan(reaching.linearity_index(np.ones((5, 2))))


@pytest.mark.parametrize(
    ("hands", "target", "cursors", "ratio"),
    [
        ([[0, 0], [1, 0]], [0.049, 0], None, math.nan),  # starts at its target
        ([[0, 0], [1, 0]], [0.05, 0], None, 20),
        ([[0, 0], [0.5, 0]], [1, 0], None, 0.5),  # stops short
        ([[0, 0], [1, 0]], [[1, 0], [2, 0]], None, math.nan),  # the target moves
        ([[0, 0], [0, 0.1]], [0, 1], [[0, 0], [0, 2]], 2),  # that of the cursor counts
    ],
)
def test_path_ratio_is_over_the_line_to_a_fixed_target(make_episode, hands, target, cursors, ratio):
    cursors = None if cursors is None else np.array(cursors, float)
    value = reaching.path_ratio(make_episode(hands, target, cursors=cursors))
    assert value == pytest.approx(ratio, nan_ok=True)


STEP = 0.02


def smoothness(speeds, step=STEP):
    return speed.sparc(SimpleNamespace(movement_speeds=np.asarray(speeds), control_step=step))


def bell(steps):
    """Speeds of a minimum-jerk movement in so many steps."""
    return hand_speed(minimum_jerk(np.linspace(0, 1, steps + 1))[:, None] * [1.0, 2.0], STEP)


@pytest.mark.parametrize(
    ("profile", "peaks"),
    [
        (np.full(50, 1.5), 1),
        (bell(500), 1),
        *((np.tile(np.sin(np.linspace(0, math.pi, 40)), count), count) for count in (1, 2, 7)),
        ([0.2, 1.0, 0.3, 0.3 + 0.049, 0.1], 1),  # a rise by 5 % of the peak counts
        ([0.2, 1.0, 0.3, 0.3 + 0.051, 0.1], 2),
        (0.9 ** np.arange(50), 1),  # fastest in the first step
        (0.9 ** np.arange(50)[::-1], 1),
        ([*0.9 ** np.arange(50), *0.9 ** np.arange(50)[::-1]], 2),
        (np.zeros(20), 0),
        ([], 0),
    ],
)
def test_peaks_rise_by_a_twentieth_of_the_highest(profile, peaks):
    assert speed.count_peaks(profile) == speed.count_peaks(1e-3 * np.asarray(profile)) == peaks


def test_minimum_jerk_is_the_reference_of_all_shapes():
    speeds = bell(501)
    assert speed.peakedness(speeds) == pytest.approx(15 / 8, rel=1e-4)
    assert speed.peakedness(np.full(7, 0.3)) == pytest.approx(1)
    assert math.isnan(speed.correlation_with_minimum_jerk(np.full(7, 0.3)))
    assert speed.phase_of_peak(speeds) == 0.5
    assert speed.correlation_with_minimum_jerk(speeds) == pytest.approx(1)
    # A raised cosine correlates as the integrals say: with time from 0 to 1, 30 t² (1 − t)² and
    # 1 − cos 2πt have the means 1 and 1, the variances 3/7 and 1/2, and the covariance 45/π⁴.
    time = (np.arange(2000) + 0.5) / 2000
    expected = 45 / math.pi**4 / math.sqrt(3 / 14)
    correlation = speed.correlation_with_minimum_jerk(1 - np.cos(2 * math.pi * time))
    assert correlation == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize(
    "measure",
    [speed.peakedness, speed.phase_of_peak, speed.correlation_with_minimum_jerk, smoothness],
)
def test_shape_and_smoothness_ignore_the_scale_of_speed_and_need_a_movement(measure):
    profile = np.random.default_rng(2).uniform(size=50)
    assert measure(37 * profile) == pytest.approx(measure(profile))
    assert math.isnan(measure(np.zeros(9))) and math.isnan(measure(np.array([])))
    assert moving_part(np.zeros(5)) == moving_part([]) == slice(0, 0)


@pytest.mark.parametrize("rest", [0, 1, 40])
def test_the_moving_part_of_minimum_jerk_is_its_span_whatever_rest_surrounds_it(rest):
    moving = np.pad(bell(4_000), rest)
    part = moving_part(moving)
    span = (part.start - rest) / 4_000, (part.stop - rest) / 4_000
    assert span == pytest.approx(speed.MINIMUM_JERK_SPAN, abs=3e-4)
    speeds = moving[part]
    likeness = speed.correlation_with_minimum_jerk(speeds, speed.MINIMUM_JERK_SPAN)
    assert likeness == pytest.approx(1, abs=1e-6)
    # The numbers in the module's docstring.
    assert speed.peakedness(speeds) == pytest.approx(1.658, abs=5e-4)


def test_smoothness_ignores_duration_and_punishes_a_second_submovement():
    authors_own = np.exp(-5 * np.arange(-1, 1, 0.01) ** 2)
    assert smoothness(authors_own, 0.01) == pytest.approx(-1.41403, abs=5e-6)
    assert smoothness(bell(120)) == pytest.approx(smoothness(bell(60)), abs=0.02)
    assert smoothness(np.concatenate([bell(60), 0.5 * bell(60)])) < smoothness(bell(60)) - 0.1


@pytest.mark.parametrize(
    ("measured", "arguments"),
    [
        (speed.count_peaks, ([math.nan] * 4,)),
        (speed.peakedness, ([math.nan] * 4,)),
        (speed.phase_of_peak, ([],)),
        (speed.correlation_with_minimum_jerk, ([math.nan] * 4,)),
        (reaching.largest_retreat, ([],)),
        (reaching.linearity_index, (np.zeros((0, 2)),)),
        (reaching.linearity_index, (np.zeros((1, 2)),)),
        (reaching.arrival_time, ([], 0.1, 0.02)),
    ],
)
def test_what_is_unknown_or_empty_has_no_value(measured, arguments):
    assert math.isnan(measured(*arguments))
    assert not reaching.stays_within([], 0.1)
