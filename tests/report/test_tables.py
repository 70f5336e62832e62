"""What tables and figures say of a benchmark."""

import math
from dataclasses import replace

from mmc_gym.agents.registry import REFERENCE
from mmc_gym.benchmark.ranking import rank_agents
from mmc_gym.benchmark.statistics import Bootstrap
from mmc_gym.benchmark.store import read_episodes
from mmc_gym.report import replay, tables, write_report
from mmc_gym.report.results import read_results
from tests.report.conftest import AGENTS, write_store


def test_the_ranking_is_that_of_the_terminal(benchmark_store, results):
    expected = rank_agents(read_episodes(benchmark_store), resamples=200)
    table = tables.ranking_table(results)
    assert [row.name for row in table.rows] == expected["agent"].to_list()
    assert [row.cells[0].text for row in table.rows] == expected["rank"].astype(str).to_list()
    success, low, high = 100 * expected.loc[0, ["success", "success_low", "success_high"]]
    assert table.rows[0].cells[1][:2] == (f"{success:.1f}", (f"[{low:.1f}, {high:.1f}]",))
    assert [row.name for row in table.rows if row.look == "focus"] == list(results.focus)
    assert "success over 7 scenarios, each weighing the same" in table.caption
    assert "Trainings: ppo 2, ppo-smooth 2;" in table.caption
    labels = [heading.label for heading in table.headings]
    assert f"settled for longer than {results.focus[0]}" in labels


def test_each_scenario_has_the_difference_to_every_other_agent_on_the_same_episodes(results):
    (agent,) = results.focus
    table = tables.scenario_table(results, agent)
    names = [heading.label for heading in table.headings[2:]]
    assert REFERENCE not in names and len(names) == 5
    assert [row.name for row in table.rows] == ["all scenarios", *results.environments]
    cells = {row.name: dict(zip([agent, *names], row.cells)) for row in table.rows}
    rows = results.by_scenario["rotation-15"]
    expected = Bootstrap.of(rows[rows["agent"] != REFERENCE], "success", 200)
    less = expected.difference(agent, "ppo")
    cell = cells["rotation-15"]["ppo"]
    assert cell.text == f"{100 * expected.estimate('ppo', 'mean').estimate:.1f}"
    assert cell.notes[0].startswith(f"{100 * less.estimate:+.1f} [".replace("-", "−"))
    assert (cell.look, less.high < 0) == ("worse", True)
    assert cells["random"]["mmc"][:2] == ("100.0", ("0.0 [−21.5, +21.5]",))
    ranked = {row.name: row.cells[1].text for row in tables.ranking_table(results).rows}
    assert {name: cells["all scenarios"][name].text for name in ranked} == ranked


def test_where_it_fails_is_counted_and_replayed_first(results):
    (agent,) = results.focus
    rows = {row.name: row.cells for row in tables.failure_table(results).rows}
    here = results.by_scenario["rotation-15"]
    mine = here[(here["agent"] == agent) & (here["success"] == 0)]
    failed, links, possible, distance = rows[f"{agent} in rotation-15"]
    assert failed.text == f"{len(mine)} of 14" and possible.text == f"{len(mine)} of {len(mine)}"
    assert distance.text == f"{mine['final_distance'].median():.3f}"
    expected = sorted(instance + 1 for instance in mine["instance"] if instance < 12)[:6]
    assert list(links.links) == [("rotation-15", number) for number in expected]
    scenes = replay(results)["scenes"]
    assert [scene["instance"] for scene in scenes["rotation-15"]][: len(expected)] == expected
    assert scenes["rotation-15"][0]["failed"] == [agent]
    assert list(scenes)[:2] == ["rotation-15", "rotation-60"]  # where it fails most often
    assert f"{agent} in random" not in rows


def test_scores_are_those_of_the_bootstrap_and_the_best_is_marked(results):
    table = tables.score_table(results, "rotation-15")
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
    assert any(cell.best for cell in race.values())


def race(results, name, values):
    """Return each agent's cell of one measure in `rotation-15`, of these values."""
    episodes = results.episodes.assign(**{name: values})
    measures = tuple(measure for measure in results.measures if measure.name == name)
    changed = replace(results, episodes=episodes, measures=measures)
    return {row.name: row.cells[0] for row in tables.score_table(changed, "rotation-15").rows}


def test_one_lucky_success_and_a_value_that_is_not_finite_are_never_the_best(results):
    rows = results.episodes
    lucky = (rows["agent"] == "mmc") & (rows["instance"] == 0)
    times = race(results, "time_to_target", lucky.map({True: 0.1, False: math.nan}))
    assert times.pop("mmc")[:3] == ("0.10", ("7 %",), False)
    assert {cell[:3] for cell in times.values()} == {("–", (), False)}
    far = rows["final_distance"].astype(float).mask(rows["agent"] == "mmc", -math.inf)
    best = [cell.text for cell in race(results, "final_distance", far).values() if cell.best]
    assert best and "–" not in best


def test_one_episode_has_no_interval_and_makes_nothing_clearly_better(tmp_path):
    write_store(tmp_path, ["mmc", "mmc-body", "ik-dls"], ("rotation-60", "random"), instances=1)
    results = read_results(tmp_path, 50, ["mmc"])
    cells = [cell for row in tables.scenario_table(results, "mmc").rows for cell in row.cells]
    cells += [cell for row in tables.ranking_table(results).rows for cell in row.cells]
    assert not any("[" in note for cell in cells for note in cell.notes)
    assert not {"better", "worse"} & {cell.look for cell in cells}
    text = write_report(tmp_path, tmp_path / "report.html", 50, focus=["mmc"]).read_text()
    assert "in 50.0 % of its episodes, rank 1 of 3." in text and "nan" not in str(cells)


def test_regret_in_a_single_episode_has_no_interval(tmp_path):
    agents = {"mmc": AGENTS["mmc"], "ppo-drawn": AGENTS["ppo"]}
    write_store(tmp_path, agents, ("random", "rotation-60"), instances=1)
    table = tables.generalisation_table(read_results(tmp_path, 50, yardstick="ppo-drawn"))
    regrets = [cell.notes for row in table.rows if row.name == "mmc" for cell in row.cells]
    assert regrets == [("0.0",), ()]


def test_an_agent_without_all_seeds_everywhere_does_not_end_the_report(tmp_path):
    missing = [("ppo", 1, "rotation-15"), ("ppo", 1, "centre-out")]
    keys = ("random", "centre-out", "rotation-15", "rotation-60")
    write_store(tmp_path, ["mmc", "ik-dls", "ppo"], keys, missing)
    text = write_report(tmp_path, tmp_path / "report.html", 50).read_text()
    assert "Trainings: ppo 2;" in text
    assert "(2 more were not attempted by all)" in text
