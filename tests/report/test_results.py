"""Reading a store: who the agents are, and what is done where something is missing or damaged."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import get_args

import pytest

from mmc_gym._errors import UserError
from mmc_gym.agents import AGENTS
from mmc_gym.agents.views import View
from mmc_gym.report import write_report
from mmc_gym.report.results import Identity, identify, main_agents, read_results
from mmc_gym.report.tables import cost_table, told_table

MMC, IK, PPO = ((0,), 20, 0.06, 0.02), ((0,), 30, 0.02, 0.02), ((0, 1), 28, 0.02, 0.0001)


@pytest.fixture
def small(make_store, tmp_path):
    """A store of two agents in one environment."""
    make_store(tmp_path / "store", {"mmc": MMC, "ik-dls": IK}, ("random",))
    return tmp_path / "store"


def change_manifest(store, **changes):
    manifest = json.loads((store / "manifest.json").read_text())
    (store / "manifest.json").write_text(json.dumps(manifest | changes))


def test_every_agent_of_the_package_is_in_the_table_of_what_they_are_told():
    assert {name for name in AGENTS if identify([name], {}).kind == "yours"} == set()


def test_who_an_agent_is_follows_from_what_it_was_made_of(make_card):
    shipped = {"ppo": [make_card("ppo", 0), make_card("ppo", 1)]}
    known = identify(["ppo-1"], shipped)
    assert (known.own, known.kind, [one.seed for one in known.cards]) == ("ppo", "learned", [1])
    assert identify(["mmc"], shipped).knowledge.lengths == "told"
    for sources in (["mmc:make"], ["mine:ppo"], ["ppo-0", "mmc"], []):
        unknown = identify(sources, shipped)
        assert (unknown.own, unknown.kind, unknown.cards) == ("", "yours", ())
        assert unknown.knowledge.lengths == "unknown"


def test_each_view_is_told_in_words(make_card):
    senses = {}
    for view in get_args(View):
        card = replace(make_card("ppo", 0), view=view)
        senses[view] = identify(["ppo-0"], {"ppo": [card]}).knowledge.senses
    assert "from the arm's first segment" in senses["arm"]
    assert "target lay straight ahead" in senses["target"]
    assert len(set(senses.values())) == 3


def test_a_policy_given_by_its_file_is_known_by_its_card(make_card, save_card, tmp_path):
    save_card(replace(make_card("ppo", 4), view="world"), tmp_path)
    one = identify([str(tmp_path / "ppo-4.safetensors")], {})
    assert (one.own, one.kind) == ("", "yours")
    assert one.knowledge.lengths.startswith("not told")
    assert one.knowledge.senses.startswith("all joint angles")
    assert [card.training_steps for card in one.cards] == [480_000]
    assert identify([str(tmp_path / "gone.json")], {}) == Identity()


def test_another_name_changes_nothing_and_a_name_proves_nothing(make_store, tmp_path):
    mover = ((0,), 20, 0.01, 0.01)
    sources = {"twin": {"0": "mmc"}, "old": {"0": "ppo-0"}, "ppo-mine": {"0": "mine:make"}}
    make_store(tmp_path, dict.fromkeys(sources, mover), ("random",), sources=sources)
    results = read_results(tmp_path, tmp_path)
    assert results.labelled("mmc") == "twin"
    assert {name: results.kind(name) for name in sources} == {
        "twin": "network",
        "old": "learned",
        "ppo-mine": "yours",
    }
    assert set(results.rivals("twin")) == {"old", "ppo-mine"}
    assert set(sources) <= set(main_agents(results.identities))
    rows = {row.name: row for row in told_table(results).rows}
    assert rows["twin"].note.startswith("mmc: dynamic MMC network")
    assert [cell.text for cell in rows["ppo-mine"].cells[1:]] == ["unknown"] * 4


def test_cards_are_of_the_seeds_that_took_part(benchmark_store):
    results = read_results(*benchmark_store)  # beside a card of seed 2, which did not
    assert [card.seed for card in results.cards["ppo"]] == [0, 1]
    assert cost_table(results).rows[0].cells[0].text == "2"


@pytest.mark.parametrize(
    ("curve", "said"),
    [([], None)],
    ids=["no curve"],
)
def test_a_report_without_a_learning_curve_says_why(
    curve, said, make_store, make_card, save_card, tmp_path
):
    save_card(replace(make_card("ppo", 0), learning_curve=curve), tmp_path)
    sources = {"mine": {"0": str(tmp_path / "ppo-0.json")}}
    make_store(tmp_path / "store", {"mine": ((0,), 20, 0.0, 0.0)}, ("random",), sources=sources)
    results = read_results(tmp_path / "store", tmp_path / "none")
    assert results.curves == {}
    assert [said in line for line in results.damaged] == ([True] if said else [])
    report = write_report(tmp_path / "store", tmp_path / "report.html", tmp_path, 20)
    assert (said or "mine") in report.read_text()
    assert "learning-steps" not in report.read_text()


def test_an_agent_that_the_manifest_lacks_is_still_reported(small, tmp_path):
    change_manifest(small, agents={"mmc": {"trained": False, "sources": {"0": "mmc"}}})
    results = read_results(small, tmp_path)
    assert results.kind("ik-dls") == "yours"
    assert write_report(small, tmp_path / "report.html", tmp_path, 20).exists()


def test_a_damaged_file_of_paths_is_named(small, tmp_path):
    file = next((small / "paths").glob("mmc*"))
    file.write_bytes(file.read_bytes()[:-100])
    with pytest.raises(ValueError, match=file.name):
        read_results(small, tmp_path)


def test_a_store_without_paths_has_no_replay(small, tmp_path):
    for file in (small / "paths").iterdir():
        file.unlink()
    text = write_report(small, tmp_path / "report.html", tmp_path, 20).read_text()
    assert 'id="replay-section"' not in text
    assert 'href="#replay-section"' not in text


def test_where_nothing_could_be_played_the_reasons_are_told(small, tmp_path):
    for file in (small / "episodes").iterdir():
        file.unlink()
    failed = [
        {"agent": "mmc", "training_seed": 0, "environment": "random", "reason": "ValueError: no"}
    ]
    change_manifest(small, failed=failed)
    with pytest.raises(UserError, match="mmc in random: ValueError: no"):
        read_results(small, tmp_path)


def test_the_base_is_an_environment_without_perturbation_if_there_is_one(make_store, tmp_path):
    make_store(tmp_path / "a", {"mmc": MMC}, ("rotation-15", "rotation-60"))
    make_store(tmp_path / "b", {"mmc": MMC}, ("rotation-15", "centre-out"))
    assert read_results(tmp_path / "a", tmp_path).base == "rotation-15"
    assert read_results(tmp_path / "b", tmp_path).base == "centre-out"
