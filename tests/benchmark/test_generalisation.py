"""The protocol that judges agents at strengths that a training had, and at others."""

import pytest

from mmc_gym import UserError
from mmc_gym.agents import resolve
from mmc_gym.benchmark.generalisation import Judged, place_of, protocol, trained_ranges
from mmc_gym.benchmark.runner import benchmark
from mmc_gym.report import write_report
from mmc_gym.report.results import read_results
from mmc_gym.report.tables import generalisation_table

DRAWN = resolve("ppo-drawn-0").card


@pytest.mark.parametrize(
    ("scenario", "expected"),
    [
        ("rotation-40", Judged("inside", "rotation", 40.0)),
        ("rotation--60", Judged("inside", "rotation", -60.0)),
        ("rotation-10", Judged("between", "rotation", 10.0)),
        ("rotation--75", Judged("beyond", "rotation", -75.0)),
        ("locked-2", Judged("inside", "locked", 2.0)),
        ("rotation-40+delay-100", Judged("combined")),
        ("random", None),
        ("rotation-40+obstacles-2", None),
        ("Pendulum-v1", None),
    ],
)
def test_a_scenario_is_judged_by_the_ranges_of_a_training(scenario, expected):
    assert place_of(scenario, trained_ranges([None, DRAWN])) == expected


def test_the_protocol_has_scenarios_in_all_places_and_every_family():
    ranges, names = trained_ranges([DRAWN]), protocol([DRAWN])
    judged = [place_of(name, ranges) for name in names]
    assert names[0] == "random"
    assert len(set(names)) == len(names)
    assert {place.place for place in judged[1:]} == {"inside", "between", "beyond", "combined"}
    assert {place.family for place in judged[1:]} == {"", *ranges}
    with pytest.raises(UserError, match="trained on ranges of strengths, such as ppo-drawn"):
        protocol([None, resolve("ppo-0").card])


def test_the_report_says_where_an_agent_loses_against_the_yardstick(tmp_path):
    scenarios = ["random", "rotation-40", "rotation-10", "rotation-75", "rotation-40+delay-100"]
    benchmark(["ppo-drawn-0", "mmc"], tmp_path, scenarios, episodes=4, jobs=1)
    table = generalisation_table(read_results(tmp_path, 50, yardstick="ppo-drawn-0"))
    assert [heading.label for heading in table.headings[1:-1]] == [
        *("inside", "between", "beyond", "combined")
    ]
    learned, network = sorted(table.rows, key=lambda row: row.name != "ppo-drawn-0")
    assert (learned.name, learned.cells[-1].text) == ("ppo-drawn-0", "nowhere")
    assert "rotation-40 +" in network.cells[-1].text
    page = write_report(tmp_path, tmp_path / "report.html", 50).read_text()
    assert 'id="generalisation"' in page
    with pytest.raises(UserError, match="yardstick"):
        read_results(tmp_path, 50, yardstick="nobody")


def test_a_report_of_one_strength_of_each_family_draws_no_curve_of_strengths(tmp_path):
    benchmark(["ppo-drawn-0"], tmp_path, ["random", "rotation-40"], episodes=2, jobs=1)
    page = write_report(tmp_path, tmp_path / "report.html", 50).read_text()
    assert "Strengths that a training never had" in page
    assert "Success against strength" not in page
