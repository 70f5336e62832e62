"""What tables and figures say of a benchmark."""

from __future__ import annotations

import math
from dataclasses import replace

import pandas as pd

from mmc_gym.agents.registry import REFERENCE
from mmc_gym.benchmark.ranking import rank_agents
from mmc_gym.benchmark.statistics import Bootstrap
from mmc_gym.benchmark.store import read_episodes
from mmc_gym.measures import SET_MEASURES
from mmc_gym.report import write_report
from mmc_gym.report.figures import movements
from mmc_gym.report.results import read_results
from mmc_gym.report.tables import LAWS, heat_table, law_table, ranking_table, score_table


def test_the_ranking_is_that_of_the_terminal(benchmark_store, results):
    expected = rank_agents(read_episodes(benchmark_store), resamples=200)
    table = ranking_table(results)
    assert [row.name for row in table.rows] == expected["agent"].to_list()
    assert [row.cells[0].text for row in table.rows] == expected["rank"].astype(str).to_list()
    best = expected.iloc[0]
    low, high = 100 * best["success_low"], 100 * best["success_high"]
    success = table.rows[0].cells[1]
    assert success.text == f"{100 * best['success']:.1f}"
    assert success.notes == (f"[{low:.1f}, {high:.1f}]",)
    assert {row.name: row.cells[-1].text for row in table.rows}["ppo"] == "2"
    assert "success over 7 environments, each weighing the same" in table.caption
    assert "Training seeds: ppo and ppo-smooth 2" in " ".join(table.caption.split())


def test_figures_show_yours_then_the_best_of_each_kind_then_the_next_best(results):
    first, *others = results.main_agents
    assert results.kind(first) == "yours"
    kinds = [results.kind(agent) for agent in others]
    assert sorted(kinds[:3]) == ["inverse kinematics", "learned", "network"]
    by_rank = results.ranking["agent"].to_list()
    for kind in set(kinds):
        of_kind = [agent for agent in others if results.kind(agent) == kind]
        assert of_kind == [agent for agent in by_rank if agent in of_kind]
    assert REFERENCE not in results.main_agents


def test_success_stands_for_each_agent_and_environment(results):
    heat = heat_table(results)
    agents = [heading.label for heading in heat.headings[1:]]
    assert REFERENCE not in agents
    assert [row.name for row in heat.rows] == list(results.environments)
    cells = {row.name: dict(zip(agents, row.cells)) for row in heat.rows}
    assert cells["random"]["mmc"] == ("100", (), True, "s10")
    assert cells["rotation-60"]["mmc"] == ("0", (), False, "s0")
    assert [row.name for row in heat.rows if row.look] == ["rotation-15", "delay-100", "locked-1"]


def test_scores_are_those_of_the_bootstrap_and_the_best_is_marked(results):
    table = score_table(results, "rotation-15", resamples=200)
    numbers = {heading.label: number for number, heading in enumerate(table.headings[1:])}
    distance = results.measures[numbers["final distance"]]
    rows = results.episodes[results.episodes["environment"] == "rotation-15"]
    expected = Bootstrap.of(rows, distance.name, 200).estimate("ppo", "median")
    by_agent = {row.name: row.cells for row in table.rows}
    cell = by_agent["ppo"][numbers["final distance"]]
    assert cell.text == distance.number(expected.estimate)
    assert cell.notes == (distance.interval(expected.low, expected.high),)
    # mmc hardly ever arrives there: it wins no race.
    race = {name: cells[numbers["time to target"]] for name, cells in by_agent.items()}
    assert not race["mmc"].best
    assert any(one.best for one in race.values())


def test_agents_keep_the_laws_beside_people(results):
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


def test_an_agent_without_all_seeds_everywhere_does_not_end_the_report(make_store, tmp_path):
    missing = [("ppo", 1, "rotation-15"), ("ppo", 1, "centre-out")]
    keys = ("random", "centre-out", "rotation-15", "rotation-60")
    make_store(tmp_path, ["mmc", "ik-dls", "ppo"], keys, missing)
    text = write_report(tmp_path, tmp_path / "report.html", 50).read_text()
    assert "Training seeds: ppo 1 to 2." in text
    assert "(2 more were not attempted by all)" in text


def test_the_movements_are_of_the_lowest_seed_that_took_part(make_store, movers, tmp_path):
    agents = {"mmc": movers["mmc"], "ppo": movers["ppo"]._replace(seeds=(3,))}
    make_store(tmp_path, agents, ("random",))
    shown = movements(read_results(tmp_path, resamples=20))
    assert {image.title for image in shown.images} == {"mmc", "ppo"}
    assert "Training seeds: seed 3 of ppo." in shown.caption
