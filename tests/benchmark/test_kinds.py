"""The protocol that judges agents at kinds of perturbations that their trainings never met."""

import pytest

from mmc_gym.benchmark.kinds import group_of, name_without, protocol, trained_without
from mmc_gym.benchmark.runner import benchmark
from mmc_gym.benchmark.suite import SUITES
from mmc_gym.envs.perturbations import GROUPS
from mmc_gym.report import write_report
from mmc_gym.report.results import read_results
from mmc_gym.report.tables import kinds_table


@pytest.mark.parametrize(
    ("scenario", "group"),
    [
        ("motor-gain-0.4", "motors"),
        ("pursuit+locks-2", "locks"),
        ("rotation-30+gain-1.4", "cursor"),
        ("rotation-30+delay-100", ""),
        ("random", ""),
        ("Pendulum-v1", ""),
    ],
)
def test_a_scenario_belongs_to_the_group_of_all_its_perturbations(scenario, group):
    assert group_of(scenario) == group


def test_the_protocol_has_every_group_and_nothing_that_is_of_none():
    names = protocol()
    assert names[0] == "random"
    assert len(set(names)) == len(names)
    assert {group_of(name) for name in names[1:]} == {*GROUPS}
    assert {*names} <= {*SUITES["standard"], *SUITES["faults"]}


def test_the_report_judges_each_training_on_the_group_that_it_lacks(tmp_path):
    scenarios = [
        "rotation-60",
        "longer-50",
        "locked-2",
        "delay-40",
        "hand-mass-10",
        "servo-gain-0.5",
    ]
    lacking = {name_without("net", group): "mmc" for group in GROUPS if group != "senses"}
    lacking[name_without("net", "locks")] = "random"
    benchmark({"net": "mmc", "other": "ik-dls", **lacking}, tmp_path, scenarios, episodes=4, jobs=1)
    results = read_results(tmp_path, 50, yardstick="net")
    assert [*trained_without("net", results.agents).values()] == [*lacking]
    assert trained_without("other", results.agents) == {}
    table = kinds_table(results)
    assert [heading.label for heading in table.headings] == ["agent", *GROUPS]
    rows = {row.name: row.cells for row in table.rows}
    assert {*rows} == {"net", "net, never met", "other"}
    locks = GROUPS.index("locks")
    for group, met, never_met in zip(GROUPS, rows["net"], rows["net, never met"], strict=True):
        assert never_met.text == {"locks": "0.0", "senses": "–"}.get(group, met.text)
    assert "+" in rows["net, never met"][locks].notes[0]  # regret
    assert 'id="kinds"' in write_report(tmp_path, tmp_path / "report.html", 50).read_text()


def test_without_such_trainings_there_is_no_table(tmp_path):
    benchmark(["mmc"], tmp_path, ["rotation-60", "locked-2"], episodes=2, jobs=1)
    assert kinds_table(read_results(tmp_path, 50)) is None


def test_a_training_without_a_group_has_a_row_where_that_on_all_groups_was_not_played(tmp_path):
    agents = {"net-without-locks-0": "mmc", "other": "ik-dls"}
    benchmark(agents, tmp_path, ["rotation-60", "locked-2"], episodes=2, jobs=1)
    table = kinds_table(read_results(tmp_path, 50, yardstick="other"))
    assert [row.name for row in table.rows] == [*agents]
    assert all(len(row.cells) == 2 for row in table.rows)
