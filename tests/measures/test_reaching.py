import math

import numpy as np
import pytest

from mmc_gym.measures import reaching


@pytest.fixture
def at_distances(make_episode):
    def episode_at(distances):
        return make_episode(np.outer(distances, [1.0, 0.0]), [0.0, 0.0])

    return episode_at


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
def test_success_and_time_are_about_staying(at_distances, distances, is_success, time):
    episode = at_distances(distances)
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
