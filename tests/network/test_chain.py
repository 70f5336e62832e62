"""The planar chain: its vectors close triangles, and postures are read back as they were made."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from mmc_gym.network import chain

angles = st.floats(-10, 10)


@pytest.mark.parametrize("count", range(2, 9))
def test_a_chain_has_one_vector_for_every_two_nodes_and_a_triangle_for_every_three(count):
    pairs = chain.vector_pairs(count)
    assert len(set(pairs)) == len(pairs) == count * (count + 1) // 2
    assert pairs[:count] == [(i, i + 1) for i in range(count)]
    assert pairs[-1] == (0, count)
    triangles = (count + 1) * count * (count - 1) // 6
    incidence = chain.triangle_incidence(count)
    assert incidence.shape == (len(pairs), triangles)
    assert (np.abs(incidence).sum(axis=1) == count - 1).all()  # each vector's triangles
    # Eigenvalues are zero for every segment, and otherwise the number of nodes.
    eigenvalues = np.linalg.eigvalsh(incidence @ incidence.T)
    expected = [0.0] * count + [count + 1.0] * (len(incidence) - count)
    np.testing.assert_allclose(eigenvalues, expected, atol=1e-12)


@given(count=st.integers(2, 8), data=st.data())
def test_the_vectors_of_a_posture_close_every_triangle(count, data):
    segments = data.draw(arrays(float, (count, 2), elements=st.floats(-100, 100)))
    vectors = chain.chain_vectors(segments)
    assert np.abs(chain.triangle_incidence(count).T @ vectors).max() < 1e-12 * 100 * count
    np.testing.assert_array_equal(vectors[:count], np.diff(chain.node_positions(segments), axis=0))
    np.testing.assert_allclose(vectors[-1], segments.sum(axis=0), atol=1e-11)


@given(data=st.data(), count=st.integers(1, 8))
def test_joint_angles_are_read_back_from_segments(data, count):
    joint_angles = data.draw(arrays(float, (2, count), elements=angles))
    lengths = data.draw(st.lists(st.floats(1e-3, 1e3), min_size=count, max_size=count))
    segments = chain.segments_from_joint_angles(joint_angles, lengths)
    np.testing.assert_allclose(np.linalg.norm(segments, axis=-1), [lengths] * 2, rtol=1e-12)
    difference = chain.joint_angles_from_segments(segments) - joint_angles
    np.testing.assert_allclose(chain.wrap_angle(difference), 0, atol=1e-12)


@given(angle=st.floats(-1e3, 1e3))
def test_a_wrapped_angle_points_the_same_way_and_lies_within_a_half_turn(angle):
    wrapped = float(chain.wrap_angle(np.float64(angle)))
    assert -np.pi < wrapped <= np.pi
    assert np.cos(wrapped - angle) == pytest.approx(1)


@given(
    lengths=st.lists(st.floats(0.1, 5), min_size=1, max_size=6),
    joint_angles=arrays(float, 6, elements=angles),
)
def test_every_posture_lies_between_the_reachable_radii(lengths, joint_angles):
    inner, outer = chain.reachable_radii(lengths)
    segments = chain.segments_from_joint_angles(joint_angles[: len(lengths)], lengths)
    radius = np.linalg.norm(segments.sum(axis=0))
    assert inner - 1e-9 <= radius <= outer + 1e-9
