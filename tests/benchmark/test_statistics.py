from __future__ import annotations

import math

import numpy as np
import pandas as pd
import pytest

from mmc_gym.benchmark import statistics
from mmc_gym.benchmark.statistics import bootstrap_interval, summarize
from mmc_gym.measures.catalogue import MEASURES


def test_the_interval_of_a_mean_is_the_normal_one_for_a_large_sample():
    sample = np.random.default_rng(0).normal(3.0, 2.0, size=2_000)
    interval = bootstrap_interval(sample, "mean")
    half = 1.96 * sample.std() / math.sqrt(sample.size)
    assert interval.estimate == pytest.approx(sample.mean())
    assert interval.low == pytest.approx(sample.mean() - half, abs=0.05 * half)
    assert interval.high == pytest.approx(sample.mean() + half, abs=0.05 * half)


@pytest.mark.parametrize(
    ("statistic", "truth"), [("mean", 1.0), ("median", math.log(2))], ids=["mean", "median"]
)
def test_about_95_percent_of_the_intervals_cover_the_truth(statistic, truth, monkeypatch):
    monkeypatch.setattr(statistics, "RESAMPLES", 999)
    samples = np.random.default_rng(5).exponential(size=(200, 100))
    intervals = [bootstrap_interval(sample, statistic, seed) for seed, sample in enumerate(samples)]
    covered = sum(interval.low <= truth <= interval.high for interval in intervals)
    assert 0.89 <= covered / 200 <= 0.985


def test_the_interval_narrows_with_the_root_of_the_sample_size():
    sample = np.random.default_rng(0).normal(size=6_400)
    few, many = bootstrap_interval(sample[:400], "mean"), bootstrap_interval(sample, "mean")
    assert (few.high - few.low) / (many.high - many.low) == pytest.approx(4, rel=0.15)


@pytest.mark.parametrize("statistic", ["mean", "median"])
def test_equal_values_have_an_interval_without_width(statistic):
    interval = bootstrap_interval(np.full(50, 0.1), statistic)
    assert (interval.low, interval.estimate, interval.high) == (0.1, 0.1, 0.1)


def test_missing_values_are_left_out_and_counted():
    values = np.random.default_rng(0).normal(size=40)
    holes = np.insert(values, [0, 7, 7, 40], np.nan)
    with_holes, without = bootstrap_interval(holes, "median"), bootstrap_interval(values, "median")
    assert (with_holes.count, with_holes.missing) == (40, 4)
    assert (with_holes.low, with_holes.high) == (without.low, without.high)


def test_without_values_there_is_no_estimate_and_from_one_no_interval():
    nothing, one = bootstrap_interval([np.nan] * 3, "mean"), bootstrap_interval([2.0], "median")
    assert math.isnan(nothing.estimate) and (nothing.count, nothing.missing) == (0, 3)
    assert one.estimate == 2.0 and math.isnan(one.low) and math.isnan(one.high)


def test_the_same_seed_gives_the_same_interval_and_another_gives_another():
    sample = np.random.default_rng(0).normal(size=50)
    assert bootstrap_interval(sample, "mean", 3) == bootstrap_interval(sample, "mean", 3)
    assert bootstrap_interval(sample, "mean", 3) != bootstrap_interval(sample, "mean", 4)


def test_a_summary_has_a_row_for_each_agent_and_measure_in_the_order_given():
    success, distance = (
        measure for measure in MEASURES if measure.name in ("success", "final_distance")
    )
    episodes = pd.DataFrame(
        {
            "agent": ["b", "b", "a", "a"],
            "success": [1.0, 0.0, 1.0, 1.0],
            "final_distance": [0.01, 0.5, 0.02, np.nan],
        }
    )
    summary = summarize(episodes, [success, distance])
    assert list(summary["agent"]) == ["b", "b", "a", "a"]
    assert list(summary["measure"]) == ["success", "final_distance"] * 2
    assert list(summary["estimate"]) == [0.5, pytest.approx(0.255), 1.0, 0.02]
    assert list(summary["missing"]) == [0, 0, 0, 1]
