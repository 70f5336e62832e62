"""The network of ball joints: vectors of three components."""

import numpy as np
import pytest

from mmc_gym.network import LearnedNormalizer, MMCNetwork
from mmc_gym.network.differentiable import TorchNetwork
from mmc_gym.network.time_base import timed_trajectory

LENGTHS = (1.5, 1.0, 0.7, 0.4)


def turn(seed=0):
    q, r = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    q *= np.sign(np.diag(r))
    return q * np.linalg.det(q)


def test_a_plane_in_space_is_the_plane(kind):
    """However it is turned, the network moves in it as the network in the plane does."""
    plane = MMCNetwork(LENGTHS, damping=6, **kind)
    space = MMCNetwork(LENGTHS, damping=6, dimensions=3, **kind)
    angles, target = np.random.default_rng(1).uniform(-1, 1, (5, 4)), np.array([0.5, -1.2])
    start = plane.state_from_joint_angles(angles)
    into = turn()[:2]  # the plane's axes in space
    turned = space.state_from_segments(start.segments @ into)
    _, expected = plane.trajectory(start, plane.inverse(target), 40)
    _, found = space.trajectory(turned, space.inverse(target @ into), 40)
    np.testing.assert_allclose(found, expected @ into, atol=1e-9)


def test_it_reaches_points_in_space_with_all_lengths_kept():
    network = MMCNetwork(LENGTHS, damping=5, dimensions=3)
    random = np.random.default_rng(2)
    target = random.uniform(-1.2, 1.2, (50, 3))
    start = network.state_from_segments(random.normal(size=(50, 4, 3)))
    end = network.run(start, network.inverse(target), 2000)
    np.testing.assert_allclose(end.end_effector, target, atol=1e-3)
    sizes = np.linalg.norm(end.segments, axis=-1)
    np.testing.assert_allclose(sizes, np.broadcast_to(LENGTHS, (50, 4)), atol=1e-12)


@pytest.mark.parametrize("direction", [[1, 0, 0], [0, 0, -1], [0.6, 0.0, 0.8]])
def test_a_stretched_arm_leaves_the_line_of_its_target(direction):
    network = MMCNetwork(LENGTHS, damping=5, dimensions=3)
    direction = np.array(direction, dtype=float)
    state = network.state_from_segments(np.array(LENGTHS)[:, None] * direction)
    end = network.run(state, network.inverse(1.5 * direction), 300)
    np.testing.assert_allclose(end.end_effector, 1.5 * direction, atol=1e-3)


def test_forward_and_mixed_tasks():
    network = MMCNetwork((1.0, 1.0, 1.0), damping=4, dimensions=3)
    start = network.state_from_segments(np.eye(3))
    segments = np.eye(3)[::-1]
    end = network.run(start, network.forward(segments), 200)
    np.testing.assert_allclose(end.vectors[-1], segments.sum(axis=0), atol=1e-6)
    clamps = network.clamp({(0, 3): [0.2, 1.0, 0.9], (0, 1): [0.0, 1.0, 0.0]})
    end = network.run(start, clamps, 500)
    np.testing.assert_allclose(end.end_effector, [0.2, 1.0, 0.9], atol=1e-3)
    np.testing.assert_allclose(end.segments[0], [0.0, 1.0, 0.0], atol=1e-12)


def test_what_needs_a_plane_refuses_space():
    space, plane = MMCNetwork(dimensions=3), MMCNetwork()
    for call in (
        lambda: MMCNetwork(dimensions=4),
        lambda: MMCNetwork(dimensions=3, normalizer=LearnedNormalizer.shipped()),
        lambda: MMCNetwork(dimensions=3, engine="numba"),
        lambda: space.state_from_joint_angles([0, 0, 0]),
        lambda: space.state_from_segments(np.eye(3)).joint_angles,
        lambda: space.inverse([1.0, 1.0]),
        lambda: plane.run(space.state_from_segments(np.eye(3))),
        lambda: TorchNetwork(space),
        lambda: timed_trajectory(space, space.state_from_segments(np.eye(3)), [1, 1, 1], 10),
    ):
        with pytest.raises(ValueError, match="must be"):
            call()
