import math

import numpy as np
import pytest

from mmc_gym.measures import path


def test_a_half_circle_is_half_pi_times_its_diameter_and_deviates_by_half_of_it(make_episode):
    angles = np.linspace(0, math.pi, 1001)
    hands = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    assert path.linearity_index(hands) == pytest.approx(0.5)
    episode = make_episode(hands, hands[-1])
    assert path.path_ratio(episode) == pytest.approx(math.pi / 2, rel=1e-5)
    assert path.maximal_deviation(episode) == pytest.approx(0.5)
    there_and_back = make_episode([*hands, *hands[::-1]], [9.0, 9.0])
    assert math.isnan(path.maximal_deviation(there_and_back))
    assert math.isnan(path.linearity_index(np.ones((5, 2))))


@pytest.mark.parametrize(
    ("hands", "target", "ratio"),
    [
        ([[0, 0], [1, 0]], [0.049, 0], math.nan),  # starts at its target
        ([[0, 0], [1, 0]], [0.05, 0], 20),
        ([[0, 0], [0.5, 0]], [1, 0], 0.5),  # stops short
        ([[0, 0], [1, 0]], [[1, 0], [2, 0]], math.nan),  # the target moves
    ],
)
def test_path_ratio_is_over_the_line_to_a_standing_target(make_episode, hands, target, ratio):
    found = path.path_ratio(make_episode(hands, target))
    assert found == pytest.approx(ratio, nan_ok=True)


def test_under_a_rotation_path_ratio_is_that_of_the_cursor(make_episode):
    cursors = np.array([[0.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
    episode = make_episode([[0, 0], [0, 0.1], [0, 0.2]], [1.0, 1.0], cursors=cursors)
    assert path.path_ratio(episode) == pytest.approx(math.sqrt(2))


def hands_of(joint_angles):
    segments = np.cumsum(joint_angles, axis=-1)
    return np.stack([np.cos(segments).sum(-1), np.sin(segments).sum(-1)], axis=-1)


def test_a_line_in_hand_space_differs_from_one_in_joint_space(make_episode):
    joint_angles = np.linspace([0.2, 0.5, 0.9], [1.4, 1.5, 0.3], 100)
    bent = joint_angles + np.sin(np.linspace(0, math.pi, 100))[:, None] * [0.2, -0.1, 0.0]
    hands = hands_of(joint_angles)
    line = np.linspace(hands[0], hands[-1], 100)

    def straighter_in_hand_space(hands, joint_angles):
        episode = make_episode(hands, hands[-1], joint_angles=joint_angles)
        return path.hand_over_joint_straightness(episode)

    assert straighter_in_hand_space(hands, joint_angles) == pytest.approx(-1)
    assert straighter_in_hand_space(line, bent) == pytest.approx(1)
    assert -1 < straighter_in_hand_space(hands_of(bent), bent) < 1
    assert math.isnan(straighter_in_hand_space(line, np.zeros((100, 0))))
