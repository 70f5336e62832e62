"""The network in torch computes what it does in numpy."""

import numpy as np
import pytest

from mmc_gym.network import EuclideanNormalizer, LearnedNormalizer, MMCNetwork
from mmc_gym.network.model import NO_CLAMPS


def random_state(network, shape, seed=0, dtype=np.float64):
    """A state in which nothing is at rest."""
    random = np.random.default_rng(seed)
    angles = random.uniform(-np.pi, np.pi, (*shape, network.segment_count)).astype(dtype)
    state = network.run(network.state_from_joint_angles(angles), iterations=1)
    state.values[:] += random.normal(0, 0.1, state.values.shape)
    return state


def test_it_bends_the_arms_that_numpy_bends(kind, iterate):
    network = MMCNetwork((1.5, 1.0, 0.3), damping=4, **kind)
    straight, folded, nearly = [0, 0, 0], [0, np.pi, 0], [0, 1e-6, 0]
    postures = [[0.7, 0, 0], straight, straight, folded, nearly, straight, [1, 2, 3]]
    targets = [[0, 0], [2.0, 0], [2.0, 1e-6], [0.9, 0], [2.0, 0], [4.0, 0], [1.0, 1.0]]
    state, clamps = network.state_from_joint_angles(postures), network.inverse(targets)
    for iterations in (0, 40):
        found = iterate("torch", network, state, clamps, iterations)
        expected = network.run(state, clamps, iterations)
        np.testing.assert_allclose(found.values, expected.values, atol=1e-12)


@pytest.mark.parametrize(
    ("engine", "rule"),
    [
        ("numpy", EuclideanNormalizer()),
        ("numpy", LearnedNormalizer.shipped()),
        ("torch", EuclideanNormalizer()),
    ],
)
def test_single_precision_is_kept_and_close(engine, rule, iterate):
    network = MMCNetwork(schedule="delayed", dynamics="reference", normalizer=rule)
    single, double = (random_state(network, (6,), dtype=t) for t in (np.float32, np.float64))
    clamps = network.inverse(np.ones((6, 2), np.float32))
    found = iterate(engine, network, single, clamps, 30)
    assert found.values.dtype == found.segments.dtype == np.float32
    np.testing.assert_allclose(found.values, network.run(double, clamps, 30).values, atol=1e-4)


@pytest.mark.parametrize("engine", ["numpy", "torch"])
def test_vectors_of_no_length_get_a_direction_too_and_an_empty_batch_stays_empty(engine, iterate):
    network = MMCNetwork(segment_lengths=(1.0, 2.0, 0.5))
    state = network.state_from_segments(np.zeros((3, 2)))
    found = iterate(engine, network, state, NO_CLAMPS, 3)
    np.testing.assert_allclose(found.values, network.run(state, iterations=3).values, atol=1e-12)
    empty = network.state_from_joint_angles(np.empty((0, 3)))
    assert iterate(engine, network, empty, network.inverse([1.0, 1.0]), 3).batch_shape == (0,)
