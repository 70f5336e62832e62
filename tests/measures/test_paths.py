from __future__ import annotations

import math

import numpy as np
import pytest

from mmc_gym.measures import path as paths


def test_a_half_circle_is_half_pi_times_its_diameter():
    angles = np.linspace(0, math.pi, 1001)
    hands = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    assert paths.path_ratio(hands, hands[-1], 0.05) == pytest.approx(math.pi / 2, rel=1e-5)


def test_the_path_ratio_ignores_where_it_is_and_how_large():
    random = np.random.default_rng(0)
    hands, target = random.normal(size=(30, 2)), np.array([3.0, 1.0])
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    moved = 5 * hands @ turn.T + 7, 5 * turn @ target + 7
    assert paths.path_ratio(*moved, 0.05) == pytest.approx(paths.path_ratio(hands, target, 0.05))


def test_a_hand_that_starts_at_its_target_has_no_path_ratio():
    assert math.isnan(paths.path_ratio([[0, 0], [1, 0]], [0.049, 0], 0.05))
    assert paths.path_ratio([[0, 0], [1, 0]], [0.05, 0], 0.05) == pytest.approx(20)


def test_a_hand_that_stops_short_has_a_path_ratio_below_one():
    assert paths.path_ratio([[0, 0], [0.5, 0]], [1, 0], 0.05) == 0.5


def test_the_efficiency_of_a_half_circle_is_two_over_pi_and_its_deviation_a_half():
    angles = np.linspace(0, math.pi, 1001)
    hands = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    assert paths.path_efficiency(hands) == pytest.approx(2 / math.pi, rel=1e-5)
    assert paths.maximal_deviation(hands, hands[0], hands[-1]) == pytest.approx(0.5)


def test_deviation_and_efficiency_ignore_place_size_and_orientation():
    random = np.random.default_rng(0)
    path = random.normal(size=(30, 3))
    turn, _ = np.linalg.qr(random.normal(size=(3, 3)))
    moved = 5 * path @ turn + 7
    assert paths.path_efficiency(moved) == pytest.approx(paths.path_efficiency(path))
    assert paths.maximal_deviation(moved, moved[0], moved[-1]) == pytest.approx(
        paths.maximal_deviation(path, path[0], path[-1])
    )


def test_a_line_is_straight_however_unevenly_it_is_walked():
    line = np.array([[0.0], [0.1], [0.15], [1.0]]) * [3.0, -4.0]
    assert paths.path_efficiency(line) == pytest.approx(1)
    assert paths.maximal_deviation(line, line[0], line[-1]) == pytest.approx(0, abs=1e-12)


def test_a_path_that_goes_nowhere_has_no_shape():
    assert math.isnan(paths.path_efficiency(np.ones((5, 2))))
    assert math.isnan(paths.maximal_deviation(np.ones((5, 2)), [1, 1], [1, 1]))


def hands_of(joint_angles):
    segments = np.cumsum(joint_angles, axis=-1)
    return np.stack([np.cos(segments).sum(-1), np.sin(segments).sum(-1)], axis=-1)


def test_a_straight_line_in_one_space_is_told_from_one_in_the_other():
    joint_angles = np.linspace([0.2, 0.5, 0.9], [1.4, 1.5, 0.3], 100)
    hands = hands_of(joint_angles)
    assert paths.hand_over_joint_straightness(hands, joint_angles) == pytest.approx(-1)
    straight = np.linspace(hands[0], hands[-1], 100)
    bent = joint_angles + np.sin(np.linspace(0, math.pi, 100))[:, None] * [0.2, -0.1, 0.0]
    assert paths.hand_over_joint_straightness(straight, bent) == pytest.approx(1)
    assert -1 < paths.hand_over_joint_straightness(hands_of(bent), bent) < 1
    assert math.isnan(paths.hand_over_joint_straightness(straight, np.zeros((100, 0))))
