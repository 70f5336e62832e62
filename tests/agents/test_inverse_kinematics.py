"""Inverse kinematics: where it arrives, and what it does in the hard cases."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mmc_gym.agents import inverse_kinematics as ik
from mmc_gym.geometry import reachable_radii, wrap_angle

ARMS = ((1.0,), (1.0, 1.0), (1.0, 1.0, 1.0), (2.0, 1.0, 0.5), (0.5,) * 7)
UNEQUAL = (1.0, 0.7, 1.3)
every_arm = pytest.mark.parametrize("lengths", ARMS)
angles = st.floats(-np.pi, np.pi)


def polar(radius, angle):
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)


def random_reaches(lengths, count=200):
    """Postures uniform in the joint angles, targets area-uniform over the reachable set."""
    random = np.random.default_rng(1)
    inner, outer = reachable_radii(lengths)
    radii = np.sqrt(random.uniform(inner**2, outer**2, count))
    targets = polar(radii, random.uniform(-np.pi, np.pi, count))
    return random.uniform(-np.pi, np.pi, (count, len(lengths))), targets


def distances(joint_angles, target, lengths):
    return np.linalg.norm(ik.hand_position(joint_angles, lengths) - target, axis=-1)


@every_arm
def test_reaches_random_targets_from_random_postures(lengths):
    postures, targets = random_reaches(lengths)
    for _ in range(30):
        postures = ik.iterate(postures, targets, lengths, 10)
    assert (distances(postures, targets, lengths) <= 1e-6).mean() >= 0.99


@given(st.data())
@settings(max_examples=30)
def test_stays_finite_and_ends_no_farther_away_from_anywhere(data):
    lengths = data.draw(st.sampled_from(ARMS))
    posture = np.array(data.draw(st.lists(angles, min_size=len(lengths), max_size=len(lengths))))
    target = polar(data.draw(st.floats(0.0, 2 * sum(lengths))), data.draw(angles))
    first = distances(posture, target, lengths)
    after = ik.iterate(posture, target, lengths, 100)
    assert np.isfinite(after).all()
    assert distances(after, target, lengths) <= first + 0.01 * sum(lengths)  # of a bend


@every_arm
def test_joints_turn_the_short_way_round_so_angles_do_not_jump_at_pi(lengths):
    postures, targets = random_reaches(lengths)
    change = ik.damped_step(postures, targets, lengths) - postures
    assert np.abs(change).max() <= np.pi + 1e-9
    turns = 2 * np.pi * np.arange(-2, len(lengths) - 2)
    turned = ik.damped_step(postures + turns, targets, lengths) - (postures + turns)
    np.testing.assert_allclose(wrap_angle(turned - change), 0, atol=1e-6)


def hard_cases():
    """Arms, postures and targets where a naive iteration gets stuck."""
    for lengths in ((1.0, 1.0), (1.0, 1.0, 1.0), (0.5,) * 7):  # stretched, in line with the target
        for share in (-0.9, -0.3, 0.3, 0.9):
            yield lengths, np.zeros(len(lengths)), [share * sum(lengths), 0.0]
    for radius in (0.5, 1.5, 2.5):  # folded, in line with the target
        yield (1.0, 1.0, 1.0), [0.0, np.pi, np.pi], [radius, 0.0]
    for lengths in (arm for arm in ARMS if reachable_radii(arm)[0] == 0.0):  # its own base
        yield lengths, np.linspace(0.4, 0.9, len(lengths)), [0.0, 0.0]
    yield (2.0, 1.0, 0.5), [0.3, 0.5, 0.7], polar(0.5, 1.0)  # the inner rim
    # Joints on each other, and on the target.
    for posture in ([0.0, np.pi, 0.5], [0.3, 0.5, np.pi], [0.0, np.pi, 0.0], [0.0, 0.5, 0.5]):
        for target in (*np.cumsum(polar(1.0, np.cumsum(posture)), axis=0), [0.0, 0.0]):
            yield (1.0, 1.0, 1.0), posture, target


@every_arm
def test_targets_are_reached_from_where_iterations_get_stuck(lengths):
    cases = [case[1:] for case in hard_cases() if case[0] == lengths]
    if cases:
        postures, targets = map(np.array, zip(*cases))
        for _ in range(60):  # each begins with a look at whether it is stuck
            postures = ik.iterate(postures, targets, lengths, 10)
        np.testing.assert_array_less(distances(postures, targets, lengths), 0.05)


@every_arm
def test_points_at_targets_out_of_reach_and_rests(lengths):
    posture, target = random_reaches(lengths, 1)[0][0], polar(1.5 * sum(lengths), 2.0)
    for iterations in (1200, 30):
        posture = ik.iterate(posture, target, lengths, iterations)
        hand = ik.hand_position(posture, lengths)
        np.testing.assert_allclose(hand, polar(sum(lengths), 2.0), atol=0.05)


@pytest.mark.parametrize("target", [[0.5, 0.2], [0.98, -0.4], [-1.0, 2.0]])
def test_one_iteration_is_what_the_textbook_says(target):
    posture, target = np.array([0.4, -1.2, 2.0]), np.array(target)
    hand, matrix = ik.jacobian(posture, UNEQUAL)
    error = target - hand
    short = error * min(1.0, 0.1 / np.linalg.norm(error))
    after = ik.damped_step(posture, target, UNEQUAL, damping=0.2)
    expected = matrix.T @ np.linalg.solve(matrix @ matrix.T + 0.04 * np.eye(2), short)
    np.testing.assert_allclose(after - posture, expected, atol=1e-12)
