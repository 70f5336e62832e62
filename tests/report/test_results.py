"""Reading a store: who the agents are, and what is done where something is missing or damaged."""

import zipfile
from dataclasses import replace

import pytest

from mmc_gym import UserError
from mmc_gym.agents import resolve
from mmc_gym.agents.policy import PRETRAINED, load_policy, save_policy
from mmc_gym.agents.registry import REFERENCE
from mmc_gym.benchmark.store import CellKey, NotPlayed, Policy, update_manifest
from mmc_gym.report import write_report
from mmc_gym.report.results import identify, read_results
from mmc_gym.report.tables import given_table, ranking_table
from tests.report.conftest import AGENTS, write_store


@pytest.fixture
def small(tmp_path):
    """A store of two agents in one environment."""
    write_store(tmp_path / "store", ["mmc", "ik-dls"], ("random",))
    return tmp_path / "store"


def change_manifest(store, **changes):
    update_manifest(store, lambda before: before.model_copy(update=changes))


def policies(*sources, steps=None):
    """Return trainings as the benchmark writes them into the manifest."""
    known = [(source, resolve(source)) for source in sources]
    facts = {"training_seed": None, "training_steps": steps}
    return [
        Policy(source=source, name=agent.name, knowledge=agent.knowledge, **facts)
        for source, agent in known
    ]


@pytest.mark.parametrize(
    ("sources", "name", "kind", "lengths"),
    [
        (["ppo-0", "ppo-1"], "ppo", "learned", "not given: had to learn"),
        (["mmc"], "mmc", "network", "given"),
        ([REFERENCE], REFERENCE, "ideal", "has no arm"),
        (["ppo-0", "mmc"], "", "yours", "unknown"),
        ([], "", "yours", "unknown"),
    ],
)
def test_the_kind_of_an_agent_follows_from_its_sources(sources, name, kind, lengths):
    identity = identify(policies(*sources))
    assert (identity.name, identity.knowledge.kind) == (name, kind)
    assert identity.knowledge.lengths == lengths
    assert [card.file_stem for card in identity.cards] == (sources if name == "ppo" else [])


@pytest.mark.parametrize(
    ("sources", "steps", "said"),
    [
        (["mine.zip"], 114_688, "114,688 environment steps"),
        (["mine.zip"], None, "unknown"),
        (["ppo-0", "ppo-1"], 500_000, "500,000 environment steps, each of 2 trainings"),
        (["mmc"], None, "not trained"),
    ],
)
def test_how_an_agent_was_trained(sources, steps, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with zipfile.ZipFile("mine.zip", "w") as archive:
        archive.writestr("data", '{"policy_class": "", "action_space": ""}')
    assert identify(policies(*sources, steps=steps)).training == said


def test_a_policy_given_by_its_file_is_known_by_its_card(tmp_path):
    network, card = load_policy(PRETRAINED / "ppo-0.json")
    save_policy(network, replace(card, name="mine"), tmp_path)
    path = tmp_path / "mine-0.json"
    identity = identify(policies(str(path)))
    assert (identity.name, identity.knowledge.kind) == ("", "yours")
    assert identity.knowledge.lengths.startswith("not given")
    assert identity.knowledge.senses.startswith("posture, joint speeds")
    assert len(identity.cards) == 1
    path.unlink()  # what it was is in the store
    assert (identity.knowledge.kind, identity.cards) == ("yours", ())


def test_another_name_changes_nothing_and_a_name_proves_nothing(tmp_path):
    sources = {"twin": "mmc", "old": "ppo-0", "ppo-mine": "json:loads"}
    agents = {name: AGENTS["ik-dls"]._replace(source=source) for name, source in sources.items()}
    write_store(tmp_path, agents, ("random",))
    results = read_results(tmp_path, 20)
    assert [results.kind(name) for name in sources] == ["network", "learned", "yours"]
    assert results.focus == ("ppo-mine",)
    rows = {row.name: row for row in given_table(results).rows}
    assert rows["twin"].note.startswith("mmc: dynamic MMC network")
    assert [cell.text for cell in rows["ppo-mine"].cells] == ["unknown"] * 4


def test_a_store_without_paths_has_no_replay_and_an_agent_may_lack_in_the_manifest(small, tmp_path):
    change_manifest(small, agents={"mmc": [Policy(training_seed=None, source="mmc")]})
    assert read_results(small, resamples=20).kind("ik-dls") == "yours"
    damaged = next((small / "paths").glob("mmc*"))
    damaged.write_bytes(damaged.read_bytes()[:-100])
    with pytest.raises(UserError, match=damaged.name):
        write_report(small, small / "report.html")
    for file in (small / "paths").iterdir():
        file.unlink()
    text = write_report(small, tmp_path / "report.html", 20).read_text()
    assert 'id="replay-section"' not in text and "Where it fails" in text


def test_an_agent_that_failed_everywhere_is_ranked(small, tmp_path):
    next((small / "episodes").glob("ik-dls*")).unlink()
    key = CellKey("ik-dls", None, "random")
    failed = NotPlayed(**key._asdict(), status="failed", reason="ValueError: no")
    change_manifest(small, not_played=[failed])
    results = read_results(small, resamples=20)
    ranking = ranking_table(results)
    assert [(row.name, row.cells[1].text) for row in ranking.rows][1] == ("ik-dls", "0.0")
    assert results.replayed == ("mmc",)
    text = write_report(small, tmp_path / "report.html", 20).read_text()
    assert "ik-dls in random: ValueError: no" in text
    for file in (small / "episodes").iterdir():
        file.unlink()
    with pytest.raises(UserError, match="ik-dls in random: ValueError: no"):
        read_results(small)


def test_the_focus_is_as_given_or_your_own_agents_or_the_first(small, tmp_path):
    assert read_results(small, 20).focus == ("mmc",)
    assert read_results(small, 20, ["ik-dls"]).focus == ("ik-dls",)
    mine = AGENTS["mmc"]._replace(lost=1, source="json:loads")
    write_store(tmp_path / "own", {"mmc": AGENTS["mmc"], "mine": mine}, ("random",))
    results = read_results(tmp_path / "own", 20)
    assert results.focus == ("mine",) and results.agents[0] == "mine"
    assert results.agents[-1] == REFERENCE


def test_settings_name_the_scenarios_where_they_differ(tmp_path):
    other = {"tolerance": 3.0, "segment_lengths": [1, 2], "kwargs": {"gravity": [0, -9]}}
    write_store(tmp_path, ["mmc"], ("random", "centre-out", "delay-100"), worlds={"random": other})
    assert read_results(tmp_path, 20).settings == [
        "Success: distance to the target at the end of at most: 0.05; 3 in random.",
        "Control step: 0.02 s.",
        "Segment lengths that agents are given: 1, 1, 1; 1, 2 in random.",
        "Other arguments of the environment: none; gravity=[0, -9] in random.",
    ]


@pytest.mark.parametrize(
    ("names", "base"),
    [
        (("rotation-15", "rotation-60"), "rotation-15"),
        (("rotation-15", "centre-out"), "centre-out"),
    ],
)
def test_the_base_is_without_perturbation_if_there_is_such(names, base, tmp_path):
    write_store(tmp_path, ["mmc"], names)
    assert read_results(tmp_path, 20).base == base
