"""Estimates, and what tables, figures and sentences say of them."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from mmc_gym.benchmark.ranking import rank_agents
from mmc_gym.benchmark.reference import REFERENCE
from mmc_gym.benchmark.statistics import Bootstrap
from mmc_gym.benchmark.store import read_episodes
from mmc_gym.measures import MEASURES, SET_MEASURES
from mmc_gym.measures.episode import moving_part
from mmc_gym.measures.speed import (
    MINIMUM_JERK_SPAN,
    correlation_with_minimum_jerk,
    spectral_arc_length,
)
from mmc_gym.report import render, write_report
from mmc_gym.report.figures import degradation, movements
from mmc_gym.report.panels import looks, spread
from mmc_gym.report.results import read_results
from mmc_gym.report.scores import (
    MARGINS,
    SUCCESS,
    Comparison,
    EnvironmentScores,
    Estimates,
    Value,
    judge,
)
from mmc_gym.report.tables import (
    LAWS,
    heat_table,
    law_table,
    ranking_table,
    rivals_table,
    score_table,
)


@pytest.fixture(scope="module")
def estimates(benchmark_store):
    return Estimates(read_results(benchmark_store), resamples=200)


@pytest.fixture(scope="module")
def interrupted(make_store, tmp_path_factory):
    """A store in which ppo-1 has not come to the end."""
    folder = tmp_path_factory.mktemp("interrupted")
    missing = [("ppo", 1, "rotation-15"), ("ppo", 1, "centre-out")]
    keys = ("random", "centre-out", "rotation-15", "rotation-60")
    make_store(folder, ["mmc", "ik-dls", "ppo"], keys, missing)
    return folder


def between(low, high):
    return Value((low + high) / 2, low, high)


@pytest.mark.parametrize(
    ("measure", "margin", "ends", "outcome"),
    [
        ("success", None, (0.1, 0.3), "better"),
        ("time_to_target", None, (0.1, 0.3), "worse"),
        ("success", None, (-0.1, 0.3), "unclear"),
        ("success", None, (0.0, 0.0), "equal"),
        ("final_distance", None, (1e-7, 4e-4), "equal"),  # no table shows it
        ("final_distance", None, (1e-7, 6e-4), "worse"),
        ("sparc", 1.0, (-0.9, 0.9), "equal"),
        ("sparc", 1.0, (0.1, 0.9), "equal"),  # a difference, but a small one
        ("sparc", 1.0, (-0.1, 1.1), "unclear"),
        ("sparc", 1.0, (0.1, 1.1), "better"),
        ("sparc", 1.0, (-1.1, -0.1), "worse"),
    ],
)
def test_a_difference_is_clear_if_its_interval_excludes_none_and_is_not_within_the_margin(
    measure, margin, ends, outcome
):
    assert judge(between(*ends), MEASURES[measure], margin) == outcome


def test_the_margins_are_what_lies_between_minimum_jerk_and_minimum_acceleration():
    step, steps = 0.02, 40
    phases = np.linspace(0, 1, steps + 1)
    jerk = np.diff(phases**3 * (10 - 15 * phases + 6 * phases**2)) / step
    acceleration = np.diff(phases**2 * (3 - 2 * phases)) / step
    jerk, acceleration = (one[moving_part(one)] for one in (jerk, acceleration))
    correlation = correlation_with_minimum_jerk(acceleration, MINIMUM_JERK_SPAN)
    assert 1 - correlation == pytest.approx(MARGINS["minimum_jerk_correlation"], abs=0.002)
    smoothness = spectral_arc_length(jerk, step) - spectral_arc_length(acceleration, step)
    assert smoothness == pytest.approx(MARGINS["sparc"], abs=0.02)


def test_differences_are_those_of_the_paired_bootstrap(estimates):
    episodes = estimates.results.episodes
    rows = episodes[episodes["environment"].eq("random") & episodes["agent"].isin(["mmc", "ppo"])]
    mean = replace(MEASURES["episode_return"], statistic="mean")
    found = EnvironmentScores(rows, [mean], 200).difference("mmc", "ppo", mean)
    expected = Bootstrap.of(rows, mean.name, resamples=200).difference("mmc", "ppo")
    assert found.estimate == pytest.approx(expected.estimate)
    width = expected.high - expected.low  # other draws of training seeds
    assert found.low == pytest.approx(expected.low, abs=0.3 * width)
    assert found.high == pytest.approx(expected.high, abs=0.3 * width)


@pytest.mark.parametrize("statistic", ["mean", "median"])
@pytest.mark.parametrize(("agent", "instances"), [("mmc", 14), ("ppo", 14), ("ppo", 150)])
def test_intervals_are_those_of_the_benchmark(statistic, agent, instances):
    random = np.random.default_rng(0)
    seeds = [0.0, 1.0] if agent == "ppo" else [math.nan]
    rows = pd.MultiIndex.from_product(
        [seeds, range(instances)], names=["training_seed", "instance"]
    )
    frame = rows.to_frame(index=False).assign(agent=agent, environment="random")
    frame["sparc"] = np.where(
        random.random(len(frame)) < 0.3, np.nan, random.normal(size=len(frame))
    )
    measure = replace(MEASURES["sparc"], statistic=statistic)
    found = EnvironmentScores(frame, [measure], 200).distribution(agent, measure)
    expected = Bootstrap.of(frame, "sparc", 200).distribution(agent, statistic)
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_an_agent_that_hardly_ever_arrives_wins_no_race(estimates):
    assert estimates.compare("rotation-60", MEASURES["time_to_target"], "mmc", ["ppo"]) is None


@pytest.mark.parametrize("rivals", [["ik-dls", "ppo"], ["ppo", "ik-dls"]])
def test_of_equal_rivals_the_first_is_named(estimates, rivals):
    assert estimates.compare("random", SUCCESS, "mmc", rivals).rival == rivals[0]


def test_a_description_has_the_digits_of_the_tables(estimates):
    said = [panel.description for panel in degradation(estimates, looks(["mmc"])).panels]
    assert "Success at strengths 0, 15, 60 °: mmc 100.0 %, 0.0 %, 0.0 %" in said


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({}, "No policy was trained under these perturbations."),
        ({"env_id": "MMCReachRotated-v0"}, "Of the policies, only ppo met perturbations"),
        ({"hyperparameters": {"vec_env_wrapper": [{"x.RandomScenarios": {}}]}}, "only ppo met"),
    ],
)
def test_what_policies_met_in_training_is_said(estimates, changes, said):
    ppo = estimates.results.identities["ppo"]
    card = replace(ppo.cards[0], **changes)
    identities = {**estimates.results.identities, "ppo": replace(ppo, cards=(card,))}
    results = replace(estimates.results, identities=identities)
    figure = degradation(Estimates(results, resamples=50), looks(["mmc"]))
    assert said in figure.caption


def test_wins_and_losses_are_told_in_the_same_form(estimates):
    board = estimates.scoreboard("mmc")
    standing = render.standing(board, "mmc")
    assert standing.counts.total() == len(board)
    assert any(line.startswith("time to target") for line in standing.better)
    assert any("rotation-15 (0.0 against 100.0 % of ppo" in line for line in standing.worse)


def test_an_agent_is_counted_against_each_rival_in_every_environment(estimates):
    counts = estimates.against_each("mmc", [SUCCESS])
    environments = len(estimates.results.environments)
    assert set(counts) == set(estimates.results.agents) - {"mmc", "random", REFERENCE}
    assert all(found["success"].total() == environments for found in counts.values())
    turned = estimates.against_each("ppo", [SUCCESS])["mmc"]["success"]
    assert turned["better"] == counts["ppo"]["success"]["worse"] > 0
    table = rivals_table(estimates.results, "mmc", counts, [SUCCESS])
    shown = [sum(map(int, re.findall(r"\d+", row.cells[0].text))) for row in table.rows]
    assert shown == [environments] * len(counts)


def worse(measure, key, mine, theirs):
    values = [between(value, value) for value in (mine, theirs, mine - theirs)]
    return Comparison(key, measure, "ppo", *values, "worse")


def test_lines_name_the_largest_differences_first():
    board = [worse(SUCCESS, f"e{number}", number / 10, 1.0) for number in range(5, 0, -1)]
    (line,) = render.standing(board, "mmc").worse
    assert "in 5 of 5 environments: e1 (10.0 against 100.0 % of ppo), e2" in line
    assert line.endswith("and 2 more")


def test_values_have_as_many_decimals_as_it_takes_to_tell_them_apart():
    distance = MEASURES["final_distance"]
    pairs = [worse(distance, "random", 0.0101, other) for other in (0.0104, 0.02, 0.0101)]
    assert [pair.more_decimals for pair in pairs] == [1, 0, 0]


def test_the_verdict_counts_how_often_learning_is_more_human_like(estimates):
    board = estimates.likeness("ppo-smooth", "mmc")
    assert {entry.measure.name for entry in board} == set(MARGINS)
    assert "better" in {entry.outcome for entry in board}
    entries = [replace(board[0], outcome=one) for one in ("better", "worse", "equal", "unclear")]
    assert render.verdict(entries, "a", "b") == (
        "a, rewarded for smoothness, beside b: more human-like in 1, less human-like in 1, the "
        "same in 1 and not to be told apart in 1 of 4 measures"
    )


def test_the_reason_is_told_why_nothing_is_compared(make_store, tmp_path):
    make_store(tmp_path / "few", ["mmc", "ik-dls"], ("random",), instances=3)
    few = read_results(tmp_path / "few")
    assert Estimates(few, 50).scoreboard("mmc") == []
    assert "fewer than 5 instances" in render.nothing_compared(few, ["mmc"])
    make_store(tmp_path / "alone", ["mmc"], ("random",))
    alone = read_results(tmp_path / "alone")
    assert "has no rival" in render.nothing_compared(alone, ["mmc"])
    assert "did not take part" in render.nothing_compared(alone, [])


def test_the_ranking_is_that_of_the_terminal(benchmark_store, estimates):
    expected = rank_agents(read_episodes(benchmark_store), resamples=200)
    table = ranking_table(estimates)
    assert [row.name for row in table.rows] == expected["agent"].to_list()
    assert [row.cells[0].text for row in table.rows] == expected["rank"].astype(str).to_list()
    best = expected.iloc[0]
    low, high = 100 * best["success_low"], 100 * best["success_high"]
    success = table.rows[0].cells[1]
    assert (success.text, success.notes) == (
        f"{100 * best['success']:.1f}",
        (f"[{low:.1f}, {high:.1f}]",),
    )
    assert {row.name: row.cells[-1].text for row in table.rows}["ppo"] == "2"
    assert "success over 7 environments, each weighing the same" in table.caption
    assert "Training seeds: ppo and ppo-smooth 2" in table.caption
    assert f"{best['agent']} (learned, 2 training seeds)" in render.lead(estimates)


def test_the_interval_of_a_time_contains_it(estimates):
    times = dict(zip(estimates.ranking["agent"], estimates.ranking["time_to_target"]))
    for agent in ("mmc", "ppo"):
        low, high = estimates.time_interval(agent)
        assert low <= times[agent] <= high


def test_success_stands_for_each_agent_and_environment(estimates):
    heat = heat_table(estimates)
    agents = [heading.label for heading in heat.headings[1:]]
    assert REFERENCE not in agents
    assert [row.name for row in heat.rows] == list(estimates.results.environments)
    cells = {row.name: dict(zip(agents, row.cells)) for row in heat.rows}
    assert cells["random"]["mmc"][:4] == ("100", (), True, "s10")
    assert cells["rotation-60"]["mmc"][:4] == ("0", (), False, "s0")
    assert [row.name for row in heat.rows if row.look] == ["rotation-15", "delay-100", "locked-1"]


def test_agents_keep_the_laws_beside_people(benchmark_store):
    results = read_results(benchmark_store)
    assert law_table(results) is None
    rows = [
        ("mmc", math.nan, "speed_curvature_exponent", 0.25),
        ("mmc", math.nan, "speed_curvature_r_squared", 0.9),
        ("mmc", math.nan, "fitts_slope", math.nan),
        ("ppo", 0.0, "speed_curvature_exponent", 0.2),
        ("ppo", 1.0, "speed_curvature_exponent", 0.4),
    ]
    columns = ["agent", "training_seed", "measure", "value"]
    table = law_table(replace(results, sets=pd.DataFrame(rows, columns=columns)))
    assert table.headings[1:] == (("speed-curvature exponent", "", ""),)
    assert {row.name: row.cells[0][:2] for row in table.rows} == {
        "people": ("0.333", ("Lacquaniti et al. 1983",)),
        "mmc": ("0.250", ("R² 0.90",)),
        "ppo": ("0.300", ("0.200 to 0.400",)),
    }
    names = {name for law in LAWS for name in (law.measure, law.explained) if name}
    assert names <= SET_MEASURES.keys()


def test_an_agent_without_all_seeds_everywhere_does_not_end_the_report(interrupted, tmp_path):
    text = write_report(interrupted, tmp_path / "report.html", 50).read_text()
    assert "<h4>Unperturbed (random)</h4>" in text
    assert "<h4>1 perturbed environment</h4>" in text  # that every policy has met
    assert "Left out: 1 environment that not all" in text


def test_seeds_are_counted_where_the_figures_are(interrupted):
    results = read_results(interrupted)
    estimates = Estimates(results, resamples=50)
    assert "Training seeds: ppo 1." in score_table(estimates, "centre-out").caption
    assert "Training seeds: ppo 2." in score_table(estimates, "random").caption
    assert results.sample_sizes(["mmc"], ["random"]) == "Instances: 14. Not trained: all agents."
    assert "Training seeds: ppo 1 to 2." in results.sample_sizes(
        results.agents, results.environments
    )


def test_movements_are_of_one_training_seed_and_say_which(make_store, movers, tmp_path):
    agents = {"mmc": movers["mmc"], "ppo": movers["ppo"]._replace(seeds=(3,))}
    make_store(tmp_path, agents, ("random",))
    results = read_results(tmp_path)
    shown = movements(results, looks(results.agents))
    assert {panel.title for panel in shown.panels} >= {"mmc", "ppo"}
    assert "Training seeds: seed 3 of ppo." in shown.caption


def test_names_at_the_ends_of_lines_do_not_overlap():
    places = spread([0.5, 0.5, 0.51, 0.9], 0.07)
    assert np.diff(places).min() >= 0.07 - 1e-9
