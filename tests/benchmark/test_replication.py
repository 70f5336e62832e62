from __future__ import annotations

import math

import numpy as np
import pandas as pd
import pytest
from scipy.stats import norm, trim_mean

from mmc_gym.benchmark.statistics import (
    arrange,
    draw,
    paired_difference,
    performance_profile,
    probability_of_improvement,
    stratified_bootstrap,
    weighted_iqm,
    weighted_mean,
)


def rows(agent, values, environment="E", seeds=None):
    """Tidy rows of values (policies, instances)."""
    values = np.atleast_2d(np.asarray(values, dtype=float))
    seeds = range(len(values)) if seeds is None else seeds
    return pd.DataFrame(
        {
            "agent": agent,
            "training_seed": np.repeat(list(seeds), values.shape[1]),
            "environment": environment,
            "instance": np.tile(np.arange(values.shape[1]), len(values)),
            "value": values.ravel(),
        }
    )


def simulated(random, seeds, instances, between_seeds, between_instances, noise=0.5):
    return (
        between_seeds * random.normal(size=(seeds, 1))
        + between_instances * random.normal(size=(1, instances))
        + noise * random.normal(size=(seeds, instances))
    )


def width(estimate):
    return estimate.high - estimate.low


def test_estimates_are_those_of_the_data_and_tell_what_they_are_over():
    values = np.random.default_rng(0).normal(size=(3, 40))
    found = stratified_bootstrap(rows("a", values), resamples=200)["a"]
    assert found.estimate == pytest.approx(trim_mean(values.ravel(), 0.25))
    assert (found.seeds, found.instances, found.environments) == ((3,), 40, 1)


def test_many_episodes_of_few_seeds_do_not_make_the_interval_narrow():
    random = np.random.default_rng(1)
    few = stratified_bootstrap(rows("a", simulated(random, 10, 50, 1.0, 0.0)), weighted_mean)["a"]
    many = stratified_bootstrap(rows("a", simulated(random, 10, 800, 1.0, 0.0)), weighted_mean)["a"]
    assert width(many) == pytest.approx(width(few), rel=0.6)
    one_seed = rows("a", simulated(random, 10, 800, 1.0, 0.0).reshape(1, -1))
    assert width(stratified_bootstrap(one_seed, weighted_mean)["a"]) < 0.3 * width(many)


def test_the_interval_of_a_mean_is_as_wide_as_seeds_and_instances_vary():
    values = simulated(np.random.default_rng(2), 40, 100, 1.0, 2.0, noise=0.0)
    found = stratified_bootstrap(rows("a", values), weighted_mean)["a"]
    variance = values.mean(1).var() / 40 + values.mean(0).var() / 100
    assert width(found) == pytest.approx(2 * 1.96 * math.sqrt(variance), rel=0.08)


def test_about_95_percent_of_the_intervals_cover_the_truth():
    covered = 0
    for number in range(150):
        values = simulated(np.random.default_rng(number), 20, 30, 1.0, 1.0)
        found = stratified_bootstrap(rows("a", values), weighted_mean, resamples=300)["a"]
        covered += found.low <= 0 <= found.high
    assert 0.86 <= covered / 150 <= 0.99


def test_intervals_cover_the_truth_where_the_same_instances_are_hard_in_all_environments():
    covered = 0
    for number in range(150):
        random = np.random.default_rng(number)
        hard = random.normal(size=(1, 25))
        met = [rows("a", hard + 0.5 * random.normal(size=(1, 25)), env) for env in "EFGHIJ"]
        own = rows("a", random.normal(size=(1, 8)), "numbered")
        found = stratified_bootstrap(pd.concat([*met, own]), weighted_mean, resamples=300)["a"]
        covered += found.low <= 0 <= found.high
    assert 0.86 <= covered / 150 <= 0.99


def test_environments_of_equally_many_instances_share_their_draw():
    values = np.random.default_rng(8).normal(size=(1, 30))
    frames = [rows("a", values, "E"), rows("a", values[:, :8], "F"), rows("a", values, "G")[::-1]]
    scores = arrange(pd.concat(frames))
    assert np.array_equal(scores.values["a"][0], scores.values["a"][2])
    first, other, shared = draw(scores, 20, 3).instances
    assert np.array_equal(first, shared)
    assert other.shape == (21, 8)


def test_an_agent_without_training_is_resampled_over_instances_alone():
    values = np.random.default_rng(3).normal(size=(1, 400))
    untrained = rows("a", values, seeds=[None])
    found = stratified_bootstrap(untrained, weighted_mean)["a"]
    assert found.seeds == (0,) and found.instances == 400
    assert width(found) == pytest.approx(2 * 1.96 * values.std() / 20, rel=0.08)
    (policies,) = draw(arrange(untrained), 50, 0).policies.values()
    assert (policies == 1).all()


def test_what_makes_an_instance_hard_for_all_drops_out_of_a_paired_difference():
    random = np.random.default_rng(4)
    hard = 5 * random.normal(size=(1, 200))
    frame = pd.concat(
        [
            rows("a", hard + 0.5 + 0.1 * random.normal(size=(5, 200))),
            rows("b", hard + 0.1 * random.normal(size=(5, 200))),
        ]
    )
    difference = paired_difference(frame, "a", "b")
    alone = stratified_bootstrap(frame, weighted_mean)
    assert difference.estimate == pytest.approx(alone["a"].estimate - alone["b"].estimate, abs=1e-9)
    assert difference.low > 0.45 and width(difference) < 0.05 * width(alone["a"])
    assert difference.seeds == (5, 5)
    other_way = paired_difference(frame, "b", "a")
    assert other_way.estimate == pytest.approx(-difference.estimate)
    assert paired_difference(frame, "a", "a", weighted_iqm).estimate == 0


@pytest.mark.parametrize("better", ["high", "low"])
@pytest.mark.parametrize("seeds", [1, 2, 10])
def test_a_copy_of_an_agent_is_better_in_exactly_half_of_all_cases(seeds, better):
    values = simulated(np.random.default_rng(5), seeds, 60, 0.5, 1.0).round(1)
    frame = pd.concat([rows("a", values), rows("copy", values)])
    found = probability_of_improvement(frame, "a", "copy", better)
    assert found.estimate == 0.5
    assert found.low <= 0.5 <= found.high


def test_equal_scores_count_half():
    frame = pd.concat([rows("a", [[1.0, 1.0, 2.0, 0.0]]), rows("b", [[1.0, 1.0, 1.0, 1.0]])])
    assert probability_of_improvement(frame, "a", "b").estimate == 0.5
    frame = pd.concat([rows("a", [[1.0, 1.0, 2.0, 3.0]]), rows("b", [[1.0, 1.0, 1.0, 1.0]])])
    assert probability_of_improvement(frame, "a", "b").estimate == 0.75
    assert probability_of_improvement(frame, "a", "b", "low").estimate == 0.25


def test_the_probability_of_improvement_of_shifted_normal_scores_is_that_of_the_integral():
    # Paired by instance: of the difference only the noise of both is left.
    random = np.random.default_rng(6)
    hard = 10 * random.normal(size=(1, 4000))
    frame = pd.concat(
        [
            rows("a", hard + 0.7 + random.normal(size=(4, 4000))),
            rows("b", hard + random.normal(size=(4, 4000))),
        ]
    )
    found = probability_of_improvement(frame, "a", "b", resamples=200)
    assert found.estimate == pytest.approx(norm.cdf(0.7 / math.sqrt(2)), abs=0.01)
    assert found.low < found.estimate < found.high


def test_missing_scores_are_left_out_of_comparisons_and_beat_no_threshold():
    frame = pd.concat([rows("a", [[2.0, math.nan, 2.0]]), rows("b", [[1.0, 1.0, math.nan]])])
    assert probability_of_improvement(frame, "a", "b").estimate == 1.0
    profile = performance_profile(frame, [0.0]).set_index("agent")["estimate"]
    assert profile.to_dict() == pytest.approx({"a": 2 / 3, "b": 2 / 3})
    found = stratified_bootstrap(frame)["a"]
    assert (found.estimate, found.missing) == (pytest.approx(2.0), 1)
    assert paired_difference(frame, "a", "b").missing == 2


def test_a_profile_is_the_share_of_episodes_beyond_each_threshold():
    values = np.random.default_rng(7).normal(size=(4, 50))
    levels = np.linspace(-2, 2, 9)
    found = performance_profile(rows("a", values), levels, resamples=300)
    assert found["estimate"].to_numpy() == pytest.approx([(values > t).mean() for t in levels])
    assert (found["low"] <= found["estimate"]).all() and (found["estimate"] <= found["high"]).all()
    assert set(found["seeds"]) == {4} and set(found["instances"]) == {50}
    below = performance_profile(rows("a", values), levels, "low", resamples=10)
    assert below["estimate"].to_numpy() == pytest.approx([(values < t).mean() for t in levels])


def test_environments_count_equally_however_many_instances_they_have():
    frame = pd.concat(
        [rows("a", np.zeros((2, 10)), "small"), rows("a", np.ones((2, 1000)), "large")]
    )
    found = stratified_bootstrap(frame, weighted_mean, resamples=50)["a"]
    assert (found.estimate, found.environments, found.instances) == (pytest.approx(0.5), 2, 1010)
    assert performance_profile(frame, [0.5], resamples=10)["estimate"].item() == pytest.approx(0.5)


def test_the_instances_drawn_do_not_depend_on_the_agents():
    values = np.random.default_rng(8).normal(size=(1, 30))
    alone = draw(arrange(rows("a", values)), 20, 3)
    among = draw(arrange(pd.concat([rows("b", values), rows("a", values)])), 20, 3)
    assert np.array_equal(alone.instances[0], among.instances[0])
    assert (alone.instances[0].sum(axis=1) == 30).all() and (alone.instances[0][0] == 1).all()


def test_the_same_seed_gives_the_same_interval():
    frame = rows("a", np.random.default_rng(9).normal(size=(3, 20)))
    assert stratified_bootstrap(frame, seed=1) == stratified_bootstrap(frame, seed=1)
    assert stratified_bootstrap(frame, seed=1) != stratified_bootstrap(frame, seed=2)


def test_the_order_of_the_rows_of_an_agent_does_not_matter():
    frame = rows("a", np.random.default_rng(9).normal(size=(3, 20)))
    table = arrange(frame).values["a"][0]
    turned = arrange(frame.iloc[::-1]).values["a"][0]
    assert np.array_equal(table, turned[::-1])


@pytest.mark.parametrize(
    ("frame", "message"),
    [
        (rows("a", [[1.0, 2.0]]).drop(columns="instance"), "it lacks .'instance'"),
        (pd.concat([rows("a", [[1.0, 2.0]])] * 2), "'instance': 0.* repeatedly"),
        (
            pd.concat([rows("a", [[1.0, 2.0]]), rows("b", [[1.0]])]),
            "training seeds of 'b', 1 × 2 episodes, got 1",
        ),
        (rows("a", [[1.0], [2.0]]).iloc[:0], "must have rows"),
    ],
)
def test_agents_that_have_not_met_the_same_are_not_compared(frame, message):
    with pytest.raises(ValueError, match=message):
        stratified_bootstrap(frame)


def test_unknown_agents_are_told():
    with pytest.raises(ValueError, match=r"agent must be one of \['a'\], got 'b'"):
        paired_difference(rows("a", [[1.0, 2.0]]), "a", "b")
