"""The planar chain, whose vectors close triangles, and normalizers, which give them lengths."""

import pickle

import numpy as np
import pytest
import safetensors.numpy
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from mmc_gym import UserError
from mmc_gym.geometry import (
    joint_angles_from_segments,
    node_positions,
    reachable_radii,
    segments_from_joint_angles,
    wrap_angle,
)
from mmc_gym.network import EuclideanNormalizer, LearnedNormalizer, chain
from studies.network.fitting import angle_errors, mean_squared_error

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
    np.testing.assert_array_equal(vectors[:count], np.diff(node_positions(segments), axis=0))
    np.testing.assert_allclose(vectors[-1], segments.sum(axis=0), atol=1e-11)


@given(data=st.data(), count=st.integers(1, 8))
def test_joint_angles_are_read_back_from_segments(data, count):
    joint_angles = data.draw(arrays(float, (2, count), elements=angles))
    lengths = data.draw(st.lists(st.floats(1e-3, 1e3), min_size=count, max_size=count))
    segments = segments_from_joint_angles(joint_angles, lengths)
    np.testing.assert_allclose(np.linalg.norm(segments, axis=-1), [lengths] * 2, rtol=1e-12)
    difference = joint_angles_from_segments(segments) - joint_angles
    np.testing.assert_allclose(wrap_angle(difference), 0, atol=1e-12)


@given(angle=st.floats(-1e3, 1e3))
def test_a_wrapped_angle_points_the_same_way_and_lies_within_a_half_turn(angle):
    wrapped = float(wrap_angle(np.float64(angle)))
    assert -np.pi < wrapped <= np.pi
    assert np.cos(wrapped - angle) == pytest.approx(1)


@given(
    lengths=st.lists(st.floats(0.1, 5), min_size=1, max_size=6),
    joint_angles=arrays(float, 6, elements=angles),
)
def test_every_posture_lies_between_the_reachable_radii(lengths, joint_angles):
    inner, outer = reachable_radii(lengths)
    segments = segments_from_joint_angles(joint_angles[: len(lengths)], lengths)
    radius = np.linalg.norm(segments.sum(axis=0))
    assert inner - 1e-9 <= radius <= outer + 1e-9


lengths = st.floats(1e-6, 1e6)


@pytest.fixture
def small():
    """A learned normalizer of three and four hidden units."""
    random, shapes = np.random.default_rng(0), [(3, 2), (4, 3), (2, 4)]
    weights = [random.normal(size=shape) for shape in shapes]
    biases = [random.normal(size=shape[0]) for shape in shapes]
    return LearnedNormalizer(weights, biases, {"recipe": "paper", "seed": "0"})


@given(angle=st.floats(-np.pi, np.pi), before=lengths, after=lengths)
def test_the_euclidean_normalizer_keeps_direction_and_gives_length(angle, before, after):
    direction = np.array([np.cos(angle), np.sin(angle)])
    result = EuclideanNormalizer()(before * direction, after)
    np.testing.assert_allclose(result, after * direction, rtol=1e-12, atol=1e-12 * after)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_the_zero_vector_becomes_the_x_axis_and_inputs_stay(dtype):
    zeros = np.zeros((2, 2), dtype=dtype)
    result = EuclideanNormalizer()(zeros, [[1.0], [3.0], [2.0]])
    np.testing.assert_array_equal(result[:, 0], [[1.0, 0.0], [3.0, 0.0], [2.0, 0.0]])
    assert result.dtype == dtype and not zeros.any()


def test_a_learned_normalizer_is_its_layers_and_is_saved_and_pickled_as_it_is(small, tmp_path):
    vectors = np.random.default_rng(1).normal(size=(5, 6, 2))
    values = vectors / 0.7
    outputs = small.activations(values)
    for weight, bias, output in zip(small.weights, small.biases, outputs, strict=True):
        values = np.tanh(values @ weight.T + bias)
        np.testing.assert_allclose(output, values, atol=1e-14)
    np.testing.assert_allclose(small(vectors, 0.7), 0.7 * values, atol=1e-14)
    small.save(tmp_path / "new folder" / "normalizer.safetensors")
    loaded = LearnedNormalizer.load(tmp_path / "new folder" / "normalizer.safetensors")
    for same in (loaded, pickle.loads(pickle.dumps(small))):
        assert (same.card, same.hidden_units) == (small.card, (3, 4))
        np.testing.assert_array_equal(same(vectors), small(vectors))


@pytest.mark.parametrize(
    ("name", "near", "shortest", "largest"),
    [("accurate", 0.001, 1e-9, 4.2), ("paper", 0.5, 0.1, 5)],
)
def test_a_shipped_normalizer_turns_no_vector_much(name, near, shortest, largest):
    normalizer, lengths = LearnedNormalizer.shipped(name), np.geomspace(shortest, 3.0, 50)
    assert normalizer.hidden_units == (16, 16)
    errors = np.degrees(angle_errors(normalizer, np.linspace(0.9, 1.1, 21), directions=720))
    assert errors.mean() < near
    assert f"name='{name}'" in normalizer.card["recipe"] and normalizer.card["seed"] == "0, run 0"
    written = float(normalizer.card["mean_angle_error_deg"].split()[0])
    assert written == pytest.approx(errors.mean(), rel=1e-2)
    assert np.degrees(angle_errors(normalizer, lengths, directions=720).max()) < largest
    assert mean_squared_error(normalizer, directions=360) < 0.00053  # that of the published one


@pytest.mark.parametrize(
    ("low", "high", "allowed"), [(0.7, 1.3, 6e-4), (0.1, 3.0, 0.01), (0.03, 0.1, 0.02)]
)
def test_the_accurate_normalizer_gives_the_length(low, high, allowed):
    angles, lengths = np.linspace(0, 2 * np.pi, 1000), np.linspace(low, high, 30)[:, None, None]
    directions = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    result = LearnedNormalizer.shipped("accurate")(lengths * directions)
    assert np.abs(np.linalg.norm(result, axis=-1) - 1).max() < allowed


@pytest.mark.parametrize(
    ("weight", "bias", "message"),
    [
        (np.eye(2), np.eye(2), "layers must"),
        (np.ones((2, 3)), np.zeros(2), "from 2 inputs"),
        (np.ones((3, 2)), np.zeros(3), "to 2 outputs"),
        (np.full((2, 2), np.nan), np.zeros(2), "finite"),
    ],
)
def test_what_is_no_normalizer_is_refused_and_so_is_a_file_of_something_else(
    tmp_path, weight, bias, message
):
    with pytest.raises(UserError, match=message):
        LearnedNormalizer([weight], [bias])
    safetensors.numpy.save_file({"weight": weight}, tmp_path / "broken.safetensors")
    with pytest.raises(UserError, match=r"broken\.safetensors does not hold a normalizer"):
        LearnedNormalizer.load(tmp_path / "broken.safetensors")
