"""Reading a store: who the agents are, and what is done where something is missing or damaged."""

from __future__ import annotations

from dataclasses import replace

import pytest

from mmc_gym._errors import UserError
from mmc_gym.agents import AGENTS
from mmc_gym.agents.registry import REFERENCE
from mmc_gym.benchmark.store import CellKey, NotPlayed, Policy, update_manifest
from mmc_gym.report import write_report
from mmc_gym.report.results import AgentIdentity, identify, read_results
from mmc_gym.report.tables import given_table, ranking_table


@pytest.fixture
def small(make_store, tmp_path):
    """A store of two agents in one environment."""
    make_store(tmp_path / "store", ["mmc", "ik-dls"], ("random",))
    return tmp_path / "store"


def change_manifest(store, **changes):
    update_manifest(store, lambda before: before.model_copy(update=changes))


def fail(store, agent):
    key = CellKey(agent, None, "random")
    failed = NotPlayed(**key._asdict(), status="failed", reason="ValueError: no")
    change_manifest(store, not_played=[failed])


def test_every_agent_of_the_package_is_known():
    assert "yours" not in {identify([name]).knowledge.kind for name in AGENTS}


@pytest.mark.parametrize(
    ("sources", "name", "kind", "lengths"),
    [
        (["ppo-1"], "ppo", "learned", "not given: had to learn"),
        (["ppo-0", "ppo-1"], "ppo", "learned", "not given: had to learn"),
        (["mmc"], "mmc", "network", "given"),
        ([REFERENCE], REFERENCE, "ideal", "has no arm"),
        (["mmc:make"], "", "yours", "unknown"),
        (["mine:ppo"], "", "yours", "unknown"),
        (["ppo-0", "mmc"], "", "yours", "unknown"),
        (["of another version"], "", "yours", "unknown"),
        ([], "", "yours", "unknown"),
    ],
)
def test_who_an_agent_is_follows_from_what_it_was_made_of(sources, name, kind, lengths):
    one = identify(sources)
    assert (one.name, one.knowledge.kind, one.knowledge.lengths) == (name, kind, lengths)
    assert [card.file_stem for card in one.cards] == (sources if name == "ppo" else [])


def test_a_policy_given_by_its_file_is_known_by_its_card(make_policy, tmp_path):
    one = identify(
        [make_policy(tmp_path, view="target", control="joint_position", training_steps=480_000)]
    )
    assert (one.name, one.knowledge.kind) == ("", "yours")
    assert one.knowledge.lengths.startswith("not given")
    assert one.knowledge.senses.startswith("all joint angles")
    assert [card.training_steps for card in one.cards] == [480_000]
    gone = identify([str(tmp_path / "gone.json")])
    assert gone == replace(AgentIdentity(), damaged=gone.damaged)
    assert "gone.json" in gone.damaged[0]


def test_another_name_changes_nothing_and_a_name_proves_nothing(make_store, movers, tmp_path):
    sources = {"twin": "mmc", "old": "ppo-0", "ppo-mine": "mine:make"}
    agents = {name: movers["ik-dls"]._replace(source=source) for name, source in sources.items()}
    make_store(tmp_path, agents, ("random",))
    results = read_results(tmp_path, 20)
    assert {name: results.kind(name) for name in sources} == {
        "twin": "network",
        "old": "learned",
        "ppo-mine": "yours",
    }
    assert set(sources) <= set(results.main_agents)
    rows = {row.name: row for row in given_table(results).rows}
    assert rows["twin"].note.startswith("mmc: dynamic MMC network")
    assert [cell.text for cell in rows["ppo-mine"].cells[1:]] == ["unknown"] * 4


def test_cards_are_of_the_seeds_that_took_part(results):
    assert [card.seed for card in results.cards["ppo"]] == [0, 1]  # of ten that ship
    learned = {row.name: row.cells[-1].text for row in given_table(results).rows}
    assert learned["ppo"].endswith("in each of 2 training seeds")


@pytest.mark.parametrize(
    ("curve", "said"),
    [([], None), ([{"reward": 1.0}], "mine does not hold a policy")],
    ids=["no curve", "a curve of another form"],
)
def test_a_report_without_a_learning_curve_says_why(
    curve, said, make_store, movers, make_policy, tmp_path
):
    mine = movers["mmc"]._replace(source=make_policy(tmp_path, learning_curve=curve))
    make_store(tmp_path / "store", {"mine": mine}, ("random",))
    results = read_results(tmp_path / "store", 20)
    assert results.curves == {}
    assert [said in line for line in results.damaged] == ([True] if said else [])
    text = write_report(tmp_path / "store", tmp_path / "report.html", 20).read_text()
    assert (said or "mine") in text
    assert "Learning curves" not in text


def test_a_damaged_file_of_paths_is_named(small):
    file = next((small / "paths").glob("mmc*"))
    file.write_bytes(file.read_bytes()[:-100])
    with pytest.raises(ValueError, match=file.name):
        read_results(small)


def test_a_store_without_paths_has_no_replay_and_an_agent_may_lack_in_the_manifest(small, tmp_path):
    change_manifest(small, agents={"mmc": [Policy(training_seed=None, source="mmc")]})
    assert read_results(small, resamples=20).kind("ik-dls") == "yours"
    for file in (small / "paths").iterdir():
        file.unlink()
    text = write_report(small, tmp_path / "report.html", 20).read_text()
    assert "replay-section" not in text
    assert "Hand paths" not in text


def test_where_nothing_could_be_played_the_reasons_are_named(small):
    for file in (small / "episodes").iterdir():
        file.unlink()
    fail(small, "mmc")
    with pytest.raises(UserError, match="mmc in random: ValueError: no"):
        read_results(small)


def test_an_agent_that_failed_everywhere_stands_beside_the_others(small, tmp_path):
    next((small / "episodes").glob("ik-dls*")).unlink()
    fail(small, "ik-dls")
    results = read_results(small, resamples=20)
    ranking = ranking_table(results)
    assert [(row.name, row.cells[1].text) for row in ranking.rows][1] == ("ik-dls", "0.0")
    assert results.main_agents == ("mmc",)
    text = write_report(small, tmp_path / "report.html", 20).read_text()
    assert "ik-dls in random: ValueError: no" in text


def test_the_base_is_an_environment_without_perturbation_if_there_is_one(make_store, tmp_path):
    make_store(tmp_path / "a", ["mmc"], ("rotation-15", "rotation-60"))
    make_store(tmp_path / "b", ["mmc"], ("rotation-15", "centre-out"))
    assert read_results(tmp_path / "a", 20).base == "rotation-15"
    assert read_results(tmp_path / "b", 20).base == "centre-out"
