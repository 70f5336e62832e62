"""The network on a body that is sensed, measured, or locked."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mmc_gym import UserError
from mmc_gym.geometry import segments_from_joint_angles, wrap_angle
from mmc_gym.network import MMCNetwork
from mmc_gym.network.embodied import Embodiment, embodied_run

DYNAMICS = ("kinematic", "paper", "reference")


def run_to(network, state, target, body, iterations=1):
    return embodied_run(network, state, network.inverse(target), body, iterations)


def postures(seed, batch, count=3):
    return np.random.default_rng(seed).uniform(-np.pi, np.pi, (batch, count))


def targets(seed, batch):
    return np.random.default_rng(seed).uniform(-1.5, 1.5, (batch, 2))


@pytest.mark.parametrize("dynamics", DYNAMICS)
def test_with_nothing_known_of_the_body_it_is_the_network_bit_for_bit(dynamics, normalizer):
    network = MMCNetwork((1.0, 0.8, 1.2), dynamics=dynamics, normalizer=normalizer)
    state = network.state_from_joint_angles(postures(0, 7))
    target = targets(1, 7)
    expected = network.run(state, network.inverse(target), 20)
    same_lengths = Embodiment(segment_lengths=np.array(network.segment_lengths))
    unlocked = Embodiment(locked=np.zeros(3, dtype=bool), joint_angles=np.zeros(3))
    unweighted = Embodiment(sensed=np.ones((7, 3, 2)))
    for body in (Embodiment(), same_lengths, unlocked, unweighted):
        actual = run_to(network, state, target, body, 20)
        np.testing.assert_array_equal(actual.values, expected.values)


@pytest.mark.parametrize("dynamics", DYNAMICS)
def test_an_arm_has_the_same_bits_in_any_batch(dynamics, normalizer):
    network = MMCNetwork((1.0, 0.8, 1.2), dynamics=dynamics, normalizer=normalizer)
    angles, target, rng = postures(0, 19), targets(1, 19), np.random.default_rng(2)
    lengths, locked = rng.uniform(0.5, 1.5, (19, 3)), rng.random((19, 3)) < 0.4
    sensed = rng.uniform(-1, 1, (19, 3, 2))
    sensing = {"segment_lengths": lengths, "sensed": sensed, "weight": 4.0}
    locking = {"locked": locked, "joint_angles": angles}
    for known in ({"segment_lengths": lengths}, sensing, locking, sensing | locking):

        def end(arms, known=known):
            state = network.state_from_joint_angles(angles[arms])
            part = {k: v if k == "weight" else v[arms] for k, v in known.items()}
            return run_to(network, state, target[arms], Embodiment(**part), 5).values

        together = end(slice(None))
        for arms in (slice(1), slice(2), slice(3), slice(13), slice(-7, None)):
            np.testing.assert_array_equal(end(arms), together[..., arms])


def test_each_arm_of_a_batch_may_have_its_own_lengths(normalizer):
    lengths = np.array([[1.0, 1.0, 1.0], [1.0, 1.0, 1.5], [2.0, 0.5, 0.7]])
    equal = MMCNetwork(normalizer=normalizer)
    state, target = equal.state_from_joint_angles(postures(0, 3)), targets(1, 3)
    together = run_to(equal, state, target, Embodiment(segment_lengths=lengths), 30)
    for index, arm_lengths in enumerate(lengths):
        network = MMCNetwork(tuple(arm_lengths), normalizer=normalizer)
        arm_state = type(state)(state.values[..., index], 3)
        alone = network.run(arm_state, network.inverse(target[index]), 30)
        np.testing.assert_allclose(together.values[..., index], alone.values, atol=1e-12)


@pytest.mark.parametrize("weight", [0.5, 3.0])
def test_a_sensed_posture_is_one_more_computation_in_the_mean(weight):
    network = MMCNetwork(damping=4.0)
    start, target = network.state_from_joint_angles([0.3, 0.6, 0.6]), np.array([-1.0, 1.5])
    sensed = segments_from_joint_angles(np.array([0.1, 0.9, 0.2]), (1.0, 1.0, 1.0))
    l_1, l_2, l_3 = start.segments
    d_1, d_2, r = l_1 + l_2, l_2 + l_3, target
    triangles = [(d_1 - l_2) + (r - d_2), (d_1 - l_1) + (d_2 - l_3), (d_2 - l_2) + (r - d_1)]
    mean = (triangles + 2 * start.segments + weight * sensed) / (4.0 + weight)
    body = Embodiment(sensed=sensed, weight=weight)
    following = run_to(network, start, target, body)
    expected = mean / np.linalg.norm(mean, axis=-1, keepdims=True)
    np.testing.assert_allclose(following.segments, expected, atol=1e-12)


@pytest.mark.parametrize(("count", "weight"), [(2, 5.0), (3, 1.0), (5, 0.2)])
def test_posture_and_hand_are_fused_where_the_squares_of_what_they_miss_are_least(count, weight):
    """Those of the hand, and `weight` times those of the segments: the best estimate of both."""
    network = MMCNetwork((1.0,) * count, damping=count + 1)
    start, random = network.state_from_joint_angles(postures(0, 20, count)), targets(5, 20)
    hand = start.end_effector + 0.1 * random
    body = Embodiment(sensed=start.segments, weight=weight)
    segments = run_to(network, start, hand, body, 3000).segments
    missed = hand - segments.sum(axis=1)
    across = np.stack([-segments[..., 1], segments[..., 0]], axis=-1)
    slope = (across * (missed[:, None] + weight * start.segments)).sum(axis=-1)
    np.testing.assert_allclose(slope, 0.0, atol=1e-4)
    assert (np.linalg.norm(missed, axis=-1) > 1e-4).any()


@given(
    joints=st.lists(st.tuples(st.booleans(), st.floats(0.3, 2.0)), min_size=2, max_size=5),
    dynamics=st.sampled_from(DYNAMICS),
    seed=st.integers(0, 2**31),
)
def test_locked_joints_stay_and_lengths_too_whatever_the_target(joints, dynamics, seed):
    locked, lengths = map(np.array, zip(*joints))
    network = MMCNetwork(lengths, len(lengths) + 1, dynamics=dynamics)
    start = network.state_from_joint_angles(postures(seed, 4, len(lengths)))
    body = Embodiment(locked=locked, joint_angles=start.joint_angles)
    end = run_to(network, start, targets(seed, 4), body, 10)
    assert np.isfinite(end.values).all()
    turned = wrap_angle(end.joint_angles - start.joint_angles)
    np.testing.assert_allclose(turned[:, locked], 0.0, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(end.segments, axis=-1), [lengths] * 4)


def test_a_locked_arm_of_a_batch_does_not_touch_the_others_and_may_be_folded_to_nothing():
    network = MMCNetwork(damping=4.0, dynamics="paper")
    start = network.state_from_joint_angles([[0.5, np.pi, 0.4], [1.0, -2.0, 0.3]])
    target = targets(7, 2)
    locked = np.array([[False, True, False], [False, False, False]])
    body = Embodiment(locked=locked, joint_angles=start.joint_angles)
    free = network.run(start, network.inverse(target), 20)
    mixed = run_to(network, start, target, body, 20)
    np.testing.assert_allclose(mixed.values[..., 1], free.values[..., 1], atol=1e-9)
    assert np.isfinite(mixed.values).all()
    assert abs(mixed.joint_angles[0, 1]) == pytest.approx(np.pi, abs=1e-6)


def test_incomplete_knowledge_and_delayed_networks_are_refused():
    for schedule, knowledge, message in (
        ("synchronous", {"weight": -1.0}, r"weight must be from 0 to 1e\+09, got -1"),
        ("synchronous", {"weight": 1.0}, "sensed must be given if it has a weight"),
        ("synchronous", {"locked": np.ones(3, bool)}, "joint_angles must be given if joints are"),
        ("delayed", {}, "schedule must be 'synchronous', got 'delayed'"),
    ):
        network = MMCNetwork(schedule=schedule)
        start = network.state_from_joint_angles([0, 0, 0])
        with pytest.raises(UserError, match=message):
            run_to(network, start, [1, 1], Embodiment(**knowledge))
