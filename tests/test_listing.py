"""What is listed, and what is said of a scenario."""

import re

import gymnasium as gym
import pytest
from PIL import Image

import mmc_gym
from mmc_gym import UserError
from mmc_gym.agents import AGENTS
from mmc_gym.benchmark.suite import SCENARIOS, SUITES
from mmc_gym.cli import main
from mmc_gym.envs.names import TASKS
from mmc_gym.envs.perturbations import FAMILIES
from mmc_gym.envs.scenarios import parse_scenario
from mmc_gym.experiments.experiment import EXPERIMENTS
from mmc_gym.listing import describe
from mmc_gym.measures import MEASURES
from mmc_gym.record import picture_draws

NAMES = {
    "agents": AGENTS,
    "tasks": TASKS,
    "perturbations": FAMILIES,
    "scenarios": SCENARIOS,
    "suites": (*SUITES, "generalisation", "kinds"),
    "experiments": EXPERIMENTS,
    "measures": MEASURES,
}


@pytest.mark.parametrize("what", NAMES)
def test_each_list_has_a_line_on_everything_and_fits_80_columns(what, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    main(["list", what])
    out = capsys.readouterr().out
    assert "\x1b" not in out
    heading, *lines = out.splitlines()
    assert heading.split()[0] == what[:-1]
    assert max(map(len, lines)) <= 80
    assert [line.split()[0] for line in lines if not line.startswith(" ")] == list(NAMES[what])
    listing = getattr(mmc_gym, f"list_{what}")()
    assert listing == list(NAMES[what])
    assert listing._repr_html_().count("<td>") == 2 * len(listing)


def test_too_few_columns_for_a_table_are_none_at_all(capsys, monkeypatch):
    main(["list", "measures"])
    expected = capsys.readouterr().out
    monkeypatch.setenv("COLUMNS", "39")
    main(["list", "measures"])
    assert capsys.readouterr().out == expected != ""


@pytest.mark.parametrize(
    "name",
    ["random", "pursuit", "paper", "rotation-30", "delay-150", "locked", "pursuit+longer-35-known"],
)
def test_what_it_says_makes_a_scenario_does_make_it(name):
    expected = parse_scenario(name).make().unwrapped.setup
    ways = re.findall(r"\w*gym\.make\(.*\)", dict(describe(name))["make it"])
    assert len(ways) == 2
    for way in ways:
        setup = eval(way, {"gym": gym, "mmc_gym": mmc_gym}).unwrapped.setup
        assert (setup.first.body, setup.given_body) == (expected.first.body, expected.given_body)
        assert setup.task == expected.task
        assert setup.episodes.changes == expected.episodes.changes


def test_it_says_what_agents_are_not_given_of_the_arm(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    main(["show", "longer-35"])
    out = capsys.readouterr().out
    assert max(map(len, out.splitlines())) <= 80
    assert "are not given the perturbation; with longer-35-known they are" in " ".join(out.split())
    assert "segment_lengths: (1, 1, 1.35), given (1, 1, 1)" in out
    assert dict(describe("gravity"))["agents"] == "are given the perturbation"
    both = dict(describe("longer-20-known+delay-150"))
    assert both["agents"].startswith("are given longer-20-known\nare not given delay-150")
    assert both["delay"] == "8 control steps, 160 ms"


def test_of_a_range_five_episodes_are_shown(tmp_path, capsys):
    rows = dict(describe("rotation--60..60+longer--30..35"))
    assert len(rows["for example"].splitlines()) == 5
    assert "longer" in rows["for example"]
    assert "-known they are" not in rows["agents"]
    file = tmp_path / "draws.png"
    main(["show", "rotation--60..60", "--out", str(file)])
    assert f"wrote {file}" in capsys.readouterr().out.replace("\n", "")
    with Image.open(file) as picture:
        assert picture.width == 5 * 320
    with pytest.raises(UserError, match=r"out must be a file that ends in \.png, got 'draws\.gif'"):
        picture_draws("rotation--60..60", "draws.gif")


def test_a_scenario_has_a_name_or_an_id_and_an_experiment_a_file(tmp_path):
    (tmp_path / "mine.yml").write_text("name: mine\nblocks: [{name: all, trials: 0}]\n")
    with pytest.raises(UserError, match="trials must be greater than 0"):
        list(describe(str(tmp_path / "mine.yml")))
    with pytest.raises(UserError, match="'mmc' is not accepted: it is an agent"):
        list(describe("mmc"))
    assert list(describe("MMCReachPursuit-v0")) == list(describe("pursuit"))  # an id is a name
