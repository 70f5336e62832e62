"""The accurate normalizer keeps what it promises, and the experiment measures it."""

import numpy as np
import pytest

from mmc_gym.network import EuclideanNormalizer, LearnedNormalizer
from mmc_gym.paper.experiment import Settings
from mmc_gym.paper.experiments.accurate import LENGTHS, measure, run


@pytest.fixture(scope="module")
def result():
    return run(Settings(quick=True), lambda done, total: None)


def row(result, quantity):
    (found,) = (row for row in result.rows if row.quantity == quantity)
    return found


def test_the_exact_normalizer_has_no_errors():
    exact = measure(EuclideanNormalizer(), directions=36)
    assert exact.near_error < 1e-12
    assert exact.worst_error.max() < 1e-12
    np.testing.assert_allclose(exact.output_length, 1)
    assert exact.final.mean() == pytest.approx(0.02264, abs=1e-5)
    assert exact.final.std() == pytest.approx(0.03198, abs=1e-5)


def test_the_accurate_normalizer_is_as_good_as_was_sought(result):
    assert row(result, "accurate: mean angle error at lengths 0.9 to 1.1").ours <= 0.01
    assert row(result, "accurate: the same, as a multiple of the Euclidean").ours <= 1.02
    assert row(result, "accurate: movements that end above 0.1").ours <= 7


def test_no_length_up_to_three_is_turned_the_wrong_way():
    assert LENGTHS.min() == 1e-6
    assert LENGTHS.max() == 3
    accurate = measure(LearnedNormalizer.shipped("accurate"), directions=720)
    assert accurate.worst_error.max() < 5
    assert 0.99 < accurate.output_length[0] < 1 < accurate.output_length[1] < 1.01


def test_the_result_has_a_row_for_each_measure_and_network_and_a_figure(result):
    assert len(result.rows) == 2 * 6
    assert row(result, "paper's recipe: the same, as a multiple of the Euclidean").data == 2.03
    assert set(result.figures) == set(result.captions) == {"accurate"}
    assert result.data["distance"]["accurate"].shape == (420, 100)
    assert len(result.data["angle_errors"]) == len(LENGTHS)
