from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import trim_mean

from mmc_gym.benchmark.statistics import (
    weighted_iqm,
    weighted_mean,
    weighted_median,
)


def interquartile_mean(values):
    present = np.sort(np.array(values, dtype=float)[~np.isnan(values)])
    return float(weighted_iqm(present, np.ones((1, present.size)))[0])


def test_the_interquartile_mean_is_the_mean_trimmed_by_a_quarter_on_each_side():
    sample = np.random.default_rng(0).normal(size=400)
    assert interquartile_mean(sample) == pytest.approx(trim_mean(sample, 0.25))


def test_outliers_do_not_move_the_interquartile_mean():
    assert interquartile_mean([0, 1, 2, 3, 4, 5, 6, 1e9]) == 3.5
    assert math.isnan(interquartile_mean([math.nan]))
    assert interquartile_mean([7.0]) == 7.0


def test_the_interquartile_mean_is_within_the_values():
    values = np.array([0.0] * 40 + [0.1, 0.7])
    weights = np.random.default_rng(0).integers(0, 4, size=(500, 42)) / 3
    assert weighted_iqm(values, weights).min() >= 0


@pytest.mark.parametrize("count", range(1, 14))
@pytest.mark.parametrize(
    ("statistic", "plain"),
    [
        (weighted_mean, np.mean),
        (weighted_median, np.median),
        (weighted_iqm, interquartile_mean),
    ],
)
def test_a_whole_weight_counts_as_so_many_equal_values(statistic, plain, count):
    random = np.random.default_rng(count)
    values = np.sort(random.normal(size=count))
    weights = random.integers(0, 4, size=(20, count)).astype(float)
    weights[:, 0] += 1
    expected = [plain(np.repeat(values, row.astype(int))) for row in weights]
    assert statistic(values, weights) == pytest.approx(expected)
    assert statistic(values, weights / 7) == pytest.approx(expected)


@pytest.mark.parametrize("statistic", [weighted_mean, weighted_median, weighted_iqm])
def test_without_weight_there_is_no_statistic(statistic):
    assert np.isnan(statistic(np.array([1.0, 2.0]), np.zeros((3, 2)))).all()
    assert np.isnan(statistic(np.array([]), np.zeros((3, 0)))).all()
