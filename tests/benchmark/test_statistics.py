"""Intervals cover the truth as often as they say, for plain samples and for training seeds."""

import math

import numpy as np
import pandas as pd
import pytest
from scipy.stats import binomtest, norm

from mmc_gym.benchmark.statistics import (
    Bootstrap,
    Scores,
    arrange,
    percentile_interval,
    resampled_means,
    sample_interval,
    success_interval,
)


@pytest.mark.parametrize("shape", [(5, 1), (1, 50), (10, 40)])
@pytest.mark.parametrize("lacking", [0.0, 0.4, 1.0])
def test_the_median_of_one_environment_is_that_of_its_resamples(shape, lacking):
    random = np.random.default_rng(0)
    table = np.where(random.random(shape) < lacking, np.nan, random.normal(size=shape).round(1))
    bootstrap = Bootstrap(Scores((shape[1],), {"a": (table,)}, {"a": shape[0]}), 100)
    counts = bootstrap.policies["a"][:, :, None] * bootstrap.instances[0][:, None]
    times = counts.reshape(101, -1)[:, ~np.isnan(table.ravel())].astype(int)
    samples = [np.repeat(table[~np.isnan(table)], row) for row in times]
    expected = [np.median(sample) if sample.size else np.nan for sample in samples]
    np.testing.assert_array_equal(bootstrap.distribution("a", "median"), expected)


def test_missing_values_are_left_out_and_counted():
    values = np.random.default_rng(0).normal(size=40)
    holes = np.insert(values, [0, 7, 7, 40], np.nan)
    with_holes, without = sample_interval(holes, "median"), sample_interval(values, "median")
    assert (with_holes.count, with_holes.missing) == (40, 4)
    assert (with_holes.low, with_holes.high) == (without.low, without.high)
    nothing, single = sample_interval([np.nan] * 3, "mean"), sample_interval([2.0], "median")
    assert math.isnan(nothing.estimate) and (nothing.count, nothing.missing) == (0, 3)
    assert single.estimate == 2.0 and math.isnan(single.low) and math.isnan(single.high)
    equal = sample_interval(np.full(50, 0.1), "mean")  # rounding leaves no width
    assert (equal.low, equal.estimate, equal.high) == (0.1, 0.1, 0.1)


@pytest.mark.parametrize(
    ("tables", "has_interval"),
    [
        ([[[1.0]]], False),
        ([[[1.0, math.nan, math.nan]]], False),
        ([[[1.0]], [[0.0]]], False),  # both environments share the draw
        ([[[1.0], [math.nan]]], False),
        ([[[1.0], [0.0]]], True),
        ([[[1.0, 0.0]]], True),
        ([[[1.0, math.nan]], [[math.nan, 0.0]]], True),
    ],
)
def test_a_value_that_no_draw_can_change_has_no_interval(tables, has_interval):
    values = tuple(map(np.array, tables))
    agents = {name: values for name in "ab"}
    scores = Scores(tuple(table.shape[1] for table in values), agents, dict.fromkeys(agents, 0))
    bootstrap = Bootstrap(scores, 100)
    intervals = [bootstrap.estimate("a", "mean")]
    intervals += [bootstrap.difference("a", "b"), bootstrap.improvement("a", "b")]
    if len(tables) == 1:
        intervals += [bootstrap.estimate("a", "median"), sample_interval(tables[0], "median")]
    assert {math.isfinite(interval.low) for interval in intervals} == {has_interval}
    assert resampled_means([[1.0, 2.0]]).tolist() == [[1.0, 2.0]]


@pytest.mark.parametrize(("successes", "count"), [(0, 20), (20, 20), (7, 20), (1, 2)])
def test_a_share_of_one_policy_has_wilsons_interval(successes, count):
    values = np.arange(count) < successes
    interval = sample_interval([*values, math.nan], "mean")
    ends = binomtest(successes, count).proportion_ci(method="wilson")
    assert (interval.estimate, interval.missing) == (successes / count, 1)
    assert (interval.low, interval.high) == pytest.approx(tuple(ends))
    both = Bootstrap.of(pd.concat([rows("a", values, "E"), rows("a", values, "F")]))
    alike = successes in (0, count)  # then the bootstrap has no width
    assert (both.estimate("a", "mean").low == interval.low) == alike
    if alike:  # as many fail elsewhere
        half = Bootstrap.of(pd.concat([rows("a", values, "E"), rows("a", 1 - values, "F")]))
        low, high = half.estimate("a", "mean")[1:]
        assert (low, 1 - high) == pytest.approx([(ends.low + 1 - ends.high) / 2] * 2)
    several = sample_interval([values, values], "mean")
    ends = percentile_interval(both.distribution("a", "mean")[1:])
    assert (several.low, several.high) == pytest.approx(ends, abs=0.1)


def test_an_interval_of_success_covers_the_sampling_of_episodes_and_of_seeds():
    interval = success_interval([0.998] * 10, episodes=500)
    spread = math.sqrt(0.998 * 0.002 / 5_000)
    assert interval.estimate == pytest.approx(0.998) and interval.count == 10
    assert interval.low == pytest.approx(0.998 - 1.96 * spread, abs=0.4 * spread)
    assert interval.low <= 0.9968 < 0.998 < interval.high  # 15,000 fresh episodes found 0.9968
    fractions = np.random.default_rng(0).uniform(0.2, 0.8, size=20)
    interval = success_interval([*fractions, math.nan], episodes=100_000)
    plain = sample_interval(fractions, "mean")
    assert (interval.low, interval.high) == pytest.approx((plain.low, plain.high), abs=0.02)
    assert interval.missing == 1
    single = success_interval([0.5], episodes=100)
    assert (single.estimate, single.count) == (0.5, 1)
    assert math.isnan(single.low) and math.isnan(single.high)


def rows(agent, values, environment="E", seeds=None):
    """Tidy rows of values (policies, instances)."""
    values = np.atleast_2d(np.asarray(values, dtype=float))
    count, seeds = values.shape[1], range(len(values)) if seeds is None else seeds
    seeds, instances = np.repeat(list(seeds), count), np.tile(np.arange(count), len(values))
    where = {"agent": agent, "environment": environment, "instance": instances}
    return pd.DataFrame({**where, "training_seed": seeds, "value": values.ravel()})


def estimate(*frames, statistic="mean", **arguments):
    """The estimate of agent "a"."""
    return Bootstrap.of(pd.concat(frames), **arguments).estimate("a", statistic)


def both(a, b, **arguments):
    return Bootstrap.of(pd.concat([rows("a", a), rows("b", b)]), **arguments)


def width(interval):
    return interval.high - interval.low


def test_the_interval_of_a_mean_is_as_wide_as_seeds_and_instances_vary():
    random = np.random.default_rng(2)
    values = random.normal(size=(40, 1)) + 2.0 * random.normal(size=(1, 100))
    error = math.sqrt(values.mean(1).var() / 40 + values.mean(0).var() / 100)
    assert width(estimate(rows("a", values))) == pytest.approx(2 * 1.96 * error, rel=0.08)
    values = random.normal(size=(1, 400))
    untrained = estimate(rows("a", values, seeds=[None]))  # resampled over instances alone
    assert untrained.estimate == pytest.approx(values.mean())
    assert width(untrained) == pytest.approx(2 * 1.96 * values.std() / 20, rel=0.08)


def test_shares_that_differ_in_no_pair_may_differ_in_what_so_many_pairs_hide():
    ones, zeros, several = np.ones((1, 20)), np.zeros((1, 20)), np.ones((2, 20))
    values = {"a": (ones,), "b": (ones,), "c": (zeros,), "d": (several,)}
    bootstrap = Bootstrap(Scores((20,), values, dict.fromkeys(values, 0)), 100)
    hidden = binomtest(0, 20).proportion_ci(method="wilson").high
    assert bootstrap.difference("a", "b") == pytest.approx((0, -hidden, hidden))
    assert bootstrap.difference("c", "a") == pytest.approx((-1, -1, hidden - 1))
    assert bootstrap.difference("a", "d") == (0, 0, 0)  # trainings are resampled
    assert bootstrap.difference("a", "b", "median") == (0, 0, 0)


def test_environments_share_the_draw_of_as_many_instances_and_count_equally():
    values = np.random.default_rng(8).normal(size=(1, 30))
    e, f, g = rows("a", values, "E"), rows("a", values[:, :8], "F"), rows("a", values, "G")[::-1]
    scores = arrange(pd.concat([e, f, g]), ["value"])["value"]
    assert np.array_equal(scores.values["a"][0], scores.values["a"][2])
    first, other, shared = Bootstrap(scores, 20, 3).instances
    assert np.array_equal(first, shared)
    assert other.shape == (21, 8)
    small, large = rows("a", np.zeros((2, 10)), "small"), rows("a", np.ones((2, 1000)), "large")
    interval = estimate(small, large, resamples=50)  # and environments count equally
    assert interval.estimate == pytest.approx(0.5)


def test_what_makes_an_instance_hard_for_all_drops_out_of_a_paired_difference():
    random = np.random.default_rng(4)
    hard = 5 * random.normal(size=(1, 200))
    a, b = (hard + more + 0.1 * random.normal(size=(5, 200)) for more in (0.5, 0.0))
    bootstrap = both(a, b)
    difference = bootstrap.difference("a", "b")
    first, second = (bootstrap.estimate(agent, "mean") for agent in "ab")
    assert difference.estimate == pytest.approx(first.estimate - second.estimate, abs=1e-9)
    assert difference.low > 0.45 and width(difference) < 0.05 * width(first)
    assert bootstrap.difference("b", "a").estimate == pytest.approx(-difference.estimate)


@pytest.mark.parametrize("seeds", [1, 2, 10])
def test_a_copy_of_an_agent_is_better_in_exactly_half_of_all_cases(seeds):
    values = np.random.default_rng(5).normal(size=(seeds, 60)).round(1)
    improvement = both(values, values).improvement("a", "b")
    assert improvement.low <= improvement.estimate == 0.5 <= improvement.high


def test_the_probability_of_improvement_of_shifted_normal_scores_is_that_of_the_integral():
    # Paired by instance: of the difference only the noise of both is left.
    random = np.random.default_rng(6)
    hard = 10 * random.normal(size=(1, 4000))
    a, b = (hard + more + random.normal(size=(4, 4000)) for more in (0.7, 0.0))
    improvement = both(a, b, resamples=50).improvement("a", "b")
    assert improvement.estimate == pytest.approx(norm.cdf(0.7 / math.sqrt(2)), abs=0.01)
    assert improvement.low < improvement.estimate < improvement.high


def test_missing_scores_are_left_out_of_comparisons():
    bootstrap = both([2.0, math.nan, 2.0], [1.0, 1.0, math.nan])
    assert bootstrap.improvement("a", "b").estimate == 1.0
    assert bootstrap.estimate("a").estimate == pytest.approx(2.0)
    equal = both([1.0, 1.0, 2.0, 3.0], [1.0] * 4)
    assert equal.improvement("a", "b").estimate == 0.75  # equal scores count half


def test_the_draw_depends_on_the_seed_and_not_on_the_other_agents():
    values = np.random.default_rng(9).normal(size=(3, 20))
    first, same, other = (estimate(rows("a", values), seed=seed) for seed in (1, 1, 2))
    assert first == same != other
    assert both(values, values, seed=1).estimate("a", "mean") == first


def test_means_of_resamples_begin_with_the_mean():
    samples = np.array([[1.0, 2.0], [3.0, np.nan], [5.0, 4.0]])
    means = resampled_means(samples, 200)
    assert means.shape == (201, 2)
    assert means[0] == pytest.approx([3.0, 3.0])
    assert np.nanmin(means) >= 1.0 and np.nanmax(means) <= 5.0
    assert means[1:, 0].std() == pytest.approx(np.sqrt(8 / 3 / 3), rel=0.2)


TWO = rows("a", [[1.0, 2.0]])


@pytest.mark.parametrize(
    ("frame", "message"),
    [
        (TWO.drop(columns="instance"), "frame must .*'instance'"),
        (pd.concat([TWO, TWO]), "frame must have each episode once"),
        (pd.concat([TWO, rows("b", [[1.0]])]), "frame must .*of 'b'"),
        (TWO.iloc[:0], "frame must have rows"),
    ],
)
def test_a_frame_without_the_same_episodes_for_all_is_refused(frame, message):
    with pytest.raises(ValueError, match=message):
        Bootstrap.of(frame)
