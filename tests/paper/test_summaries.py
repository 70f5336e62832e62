"""What is said about the 420 movements is what was published about them."""

import numpy as np
import pytest

from mmc_gym.network import EuclideanNormalizer, MMCNetwork
from mmc_gym.paper.experiments import dynamic, kinematic
from mmc_gym.paper.experiments.dynamic import catching_up
from mmc_gym.paper.protocol import (
    EUCLIDEAN,
    INNER,
    PAIRS,
    TARGETS,
    Recording,
    over_runs,
    pooled,
    record_movements,
    shapes,
    summarize,
    summarize_networks,
)
from mmc_gym.paper.published import CLASSICAL_PUBLISHED, DYNAMIC_EUCLIDEAN, KINEMATIC_COURSE


def movement_along_a_line(distances):
    """A recording of one movement from (1, 0) to the origin with the given distances."""
    segments = np.zeros((1, len(distances), 3, 2))
    segments[0, :, 0, 0] = distances
    start = np.array([[[1.0, 0.0], [0.0, 0.0], [0.0, 0.0]]])
    return Recording(start, segments, np.array([[1.0, 0.0]]), np.zeros((1, 2)))


@pytest.mark.parametrize(
    ("distances", "overshoots", "second_peaks", "far"),
    [
        ([0.9, 0.5, 0.1, 0.0], 0, 0, 0),
        ([0.9, 0.5, 0.2, 0.22], 1, 0, 1),
        ([0.9, 0.5, 0.1, 0.109], 0, 0, 1),
        ([0.9, 0.5, 0.49, 0.2], 0, 1, 1),
    ],
)
def test_a_movement_is_summarized_by_the_published_definitions(
    distances, overshoots, second_peaks, far
):
    summary = summarize(movement_along_a_line(distances))
    assert summary["overshoots"] == overshoots
    assert summary["second_peaks"] == second_peaks
    assert summary["far"] == far
    assert summary["final"] == pytest.approx(distances[-1])
    assert summary["peak_velocity"] == pytest.approx(0.4)
    assert summary["peak_iteration"] == 2


def test_the_classical_network_has_the_published_peaks():
    found = summarize(record_movements(MMCNetwork(schedule="delayed"), 40, 40))
    published = CLASSICAL_PUBLISHED
    assert found["overshoots"] == published.overshoots
    assert found["second_peaks"] == published.second_peaks
    assert found["deviation"] == pytest.approx(published.deviation, abs=5e-5)
    assert f"{found['peak_velocity']:.4f} at {found['peak_iteration']:.0f}" == published.peak
    for iteration, distance in published.distances.items():
        assert found[f"distance_{iteration}"] == pytest.approx(distance, abs=5e-4)


def test_the_rows_without_learned_weights_are_the_published_ones():
    normalizers = {EUCLIDEAN: (EuclideanNormalizer(),)}
    done = []
    table = summarize_networks(
        dynamic.NETWORKS, normalizers, 40, lambda part, total: done.append((part, total))
    )
    assert done == [(part, 9) for part in range(10)]
    assert (table["normalizer"] == EUCLIDEAN).all()
    table = table.set_index(["dynamics", "decay", "schedule"]).sort_index()
    for network, published in DYNAMIC_EUCLIDEAN.items():
        for iteration, distance in published.items():
            found = table.loc[network, f"distance_{iteration}"]
            assert found.item() == pytest.approx(distance, abs=1e-5)


def test_running_longer_brings_the_classical_network_nearer():
    course = kinematic.longer_course([EuclideanNormalizer()])
    for iteration, published in KINEMATIC_COURSE.items():
        assert course[iteration - 1] == pytest.approx(published, abs=1e-5)
    assert course[-1] == pytest.approx(0.0028, abs=5e-5)
    assert (np.diff(course) < 0).all()


def test_without_decay_the_dynamic_network_catches_up_at_iteration_29():
    # Published for the learned normalizer; the exact one catches up earlier.
    exact = [EuclideanNormalizer()]
    classical = pooled(dynamic.CLASSICAL, exact, 40, 40)[0].mean(axis=0)
    undecayed = pooled(dynamic.UNDECAYED, exact, 40, 40)[0].mean(axis=0)
    decayed = pooled(dynamic.DYNAMIC, exact, 40, 40)[0].mean(axis=0)
    assert catching_up(classical, decayed) is None
    found = catching_up(classical, undecayed)
    assert found is not None and found <= 29


def test_inner_movements_are_those_that_need_no_stretched_arm():
    radii = np.linalg.norm(TARGETS, axis=-1)[PAIRS]
    np.testing.assert_array_equal(INNER, (radii < 2.5).all(axis=1))
    assert INNER.sum() == 14 * 13


def test_shapes_have_a_value_per_movement():
    found = shapes(record_movements(MMCNetwork(), 40, 40))
    assert {len(values) for values in found.values()} == {420}
    assert (found["peak_to_mean"] >= 1).all()


def test_runs_are_given_with_their_range():
    assert over_runs([3, 5], ".0f") == "4 (3 to 5)"
