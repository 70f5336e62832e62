"""The ranking and the success in each environment, as the report has them."""

from __future__ import annotations

import os

import pytest

from mmc_gym.benchmark.ranking import summarize_battery
from mmc_gym.benchmark.reference import REFERENCE
from mmc_gym.benchmark.store import read_episodes
from mmc_gym.report.results import read_results
from mmc_gym.report.scores import Estimates
from mmc_gym.report.tables import heat_table, ranking_table, time_interval


@pytest.fixture(scope="module")
def estimates(benchmark_store):
    return Estimates(read_results(*benchmark_store), resamples=100)


@pytest.fixture(scope="module")
def ranking(estimates):
    return ranking_table(estimates)


def test_the_ranking_is_that_of_the_terminal(benchmark_store, ranking):
    untrained = ("mmc", "mmc-closed", "ik-dls", "<script>alert(1)</script>")
    expected = summarize_battery(read_episodes(benchmark_store[0]), [], untrained, resamples=100)
    assert [row[1] for row in ranking.rows] == expected["agent"].to_list()
    assert [row[0] for row in ranking.rows] == expected["rank"].astype(str).to_list()
    best = expected.iloc[0]
    low, high = 100 * best["success_low"], 100 * best["success_high"]
    assert ranking.rows[0][3][0] == (f"{100 * best['success']:.1f}", f"[{low:.1f}, {high:.1f}]")


def test_the_caption_and_the_lead_count_environments_and_training_seeds(ranking):
    assert "Over 7 environments, each weighing the same" in ranking.caption
    assert "Training seeds: ppo and ppo-smooth 2" in ranking.caption
    assert (
        "ppo (learned, 2 training seeds)" in ranking.lead or "ppo-smooth (learned" in ranking.lead
    )
    assert {row[1]: row[4] for row in ranking.rows}["ppo"] == "2"


def test_the_interval_of_a_time_contains_it(estimates, benchmark_store):
    expected = summarize_battery(read_episodes(benchmark_store[0]), resamples=5)
    times = dict(zip(expected["agent"], expected["time_to_target"]))
    keys = tuple(estimates.results.environments)
    for agent in ("mmc", "ppo"):
        low, high = time_interval(estimates, agent, keys)
        assert low <= times[agent] <= high


def test_a_ranking_that_is_older_than_its_store_is_made_anew(make_store, tmp_path):
    make_store(tmp_path, {"mmc": ((0,), 20, 0.06, 0.02)}, ("random",))
    file = tmp_path / "ranking.csv"
    file.write_text("rank,agent\n1,mmc\n")
    assert len(read_results(tmp_path, tmp_path).ranking) == 1
    os.utime(file, (0, 0))
    assert read_results(tmp_path, tmp_path).ranking.empty


def test_success_stands_for_each_agent_and_environment(estimates):
    heat = heat_table(estimates.results, estimates.results.agents)
    assert REFERENCE not in heat.agents
    assert [row[0] for row in heat.rows] == list(estimates.results.environments)
    cells = {row[0]: dict(zip(heat.agents, row[2])) for row in heat.rows}
    assert cells["random"]["mmc"] == ("100", "10", True)
    assert cells["rotation-60"]["mmc"] == ("0", "0", False)
    assert [row[0] for row in heat.rows if row[1]] == ["rotation-15", "delay-100", "locked-1"]
