"""The published figures that involve no learned weights are reproduced to the digits shown."""

import numpy as np
import pytest

from mmc_gym.network import LearnedNormalizer, MMCNetwork
from mmc_gym.paper.protocol import (
    EXAMPLE_TARGET,
    PAIRS,
    STARTING_SEGMENTS,
    TARGETS,
    record_example,
    record_movements,
)

PUBLISHED = [
    # dynamics, decay, schedule, mean normalized distance by iteration
    ("kinematic", 0.92, "delayed", {10: 0.42478, 20: 0.22386, 40: 0.09712, 100: 0.02264}),
    ("kinematic", 0.92, "synchronous", {10: 0.39447, 20: 0.20629, 40: 0.08648, 100: 0.01945}),
    ("reference", 0.92, "delayed", {10: 0.59338, 20: 0.26474, 40: 0.12478}),
    ("reference", 1.0, "delayed", {10: 0.51373, 20: 0.22146, 40: 0.07740}),
    ("paper", 0.92, "delayed", {10: 0.52885, 20: 0.23581, 40: 0.10964}),
    ("paper", 1.0, "delayed", {10: 0.47481, 20: 0.20799, 40: 0.07741}),
    ("paper", 0.92, "synchronous", {10: 0.48200, 20: 0.22089, 40: 0.09736}),
    ("reference", 0.92, "synchronous", {10: 0.54623, 20: 0.24937, 40: 0.11499}),
]


def test_there_are_21_targets_and_every_ordered_pair_of_them():
    assert TARGETS.shape == (21, 2)
    np.testing.assert_allclose(
        TARGETS[[0, 6, 7, 10, 20]], [[1, 0], [-1, 0], [2, 0], [0, 2], [-3, 0]], atol=1e-15
    )
    expected = [(start, end) for start in range(21) for end in range(21) if start != end]
    assert [tuple(pair) for pair in PAIRS] == expected


@pytest.mark.parametrize(("dynamics", "decay", "schedule", "distances"), PUBLISHED)
def test_the_mean_distance_is_the_published_one(dynamics, decay, schedule, distances):
    network = MMCNetwork(dynamics=dynamics, velocity_decay=decay, schedule=schedule)
    distance = record_movements(network, iterations=max(distances)).distance
    assert distance.shape == (420, max(distances))
    for iteration, published in distances.items():
        assert distance[:, iteration - 1].mean() == pytest.approx(published, abs=1e-5)


@pytest.mark.parametrize(
    ("schedule", "published"), [("delayed", 0.03198), ("synchronous", 0.02585)]
)
def test_the_spread_of_the_final_distance_is_the_published_one(schedule, published):
    distance = record_movements(MMCNetwork(schedule=schedule)).distance
    assert distance[:, -1].std() == pytest.approx(published, abs=1e-5)


def test_the_classical_network_is_fastest_in_its_second_iteration():
    # The velocity figure is one of the dynamic experiments, with their warm movement.
    recording = record_movements(MMCNetwork(schedule="delayed"), 40, warm_iterations=40)
    velocity = recording.velocity.mean(axis=0)
    assert velocity.argmax() + 1 == 2
    assert velocity.max() == pytest.approx(0.1082, abs=5e-5)


def test_seven_classical_movements_end_above_a_tenth():
    distance = record_movements(MMCNetwork(schedule="delayed")).distance
    assert (distance[:, -1] > 0.1).sum() == 7


def test_the_example_movement_ends_where_it_was_published_to():
    recording = record_example(MMCNetwork(schedule="delayed"))
    assert recording.distance.shape == recording.velocity.shape == (40,)
    assert recording.distance[-1] == pytest.approx(0.00977, abs=1e-5)
    np.testing.assert_allclose(recording.start_segments, STARTING_SEGMENTS)
    np.testing.assert_array_equal(recording.target, EXAMPLE_TARGET)


def test_the_accurate_normalizer_moves_the_arm_as_the_exact_one_does():
    normalizer = LearnedNormalizer.shipped("accurate")
    learned = record_movements(MMCNetwork(schedule="delayed", normalizer=normalizer)).distance
    exact = record_movements(MMCNetwork(schedule="delayed")).distance
    assert learned[:, -1].mean() <= 1.02 * exact[:, -1].mean()
    assert (learned[:, -1] > 0.1).sum() <= 7


def test_a_recording_measures_the_arm_that_moved():
    network = MMCNetwork(dynamics="paper")
    recording = record_movements(network, iterations=5, warm_iterations=7)
    start, target = TARGETS[PAIRS[123]]
    state = network.run(network.state_from_segments(STARTING_SEGMENTS), network.inverse(start), 7)
    np.testing.assert_allclose(recording.start_segments[123], state.segments, atol=1e-13)
    before = state.end_effector
    for iteration in range(5):
        state = network.step(state, network.inverse(target))
        np.testing.assert_allclose(recording.segments[123, iteration], state.segments, atol=1e-13)
        path = np.linalg.norm(target - start)
        distance = np.linalg.norm(state.end_effector - target) / path
        assert recording.distance[123, iteration] == pytest.approx(distance)
        velocity = np.linalg.norm(state.end_effector - before) / path
        assert recording.velocity[123, iteration] == pytest.approx(velocity)
        before = state.end_effector


def test_the_protocol_is_for_three_segments():
    with pytest.raises(ValueError, match=r"segments must have shape \(\.\.\., 4, 2\)"):
        record_movements(MMCNetwork(segment_lengths=(1.0,) * 4))


def test_the_protocol_cannot_be_changed_by_accident():
    with pytest.raises(ValueError, match="read-only"):
        TARGETS[0] = 0
