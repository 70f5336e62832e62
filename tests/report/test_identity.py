"""Who an agent is follows from what it was made of; what it is called is no proof."""

from __future__ import annotations

from dataclasses import replace
from typing import get_args

from mmc_gym.agents import AGENTS
from mmc_gym.agents.views import View
from mmc_gym.report import sentences as words
from mmc_gym.report.figures import learning
from mmc_gym.report.panels import looks
from mmc_gym.report.results import Identity, identify, main_agents, read_results
from mmc_gym.report.scores import Estimates, rivals_of
from mmc_gym.report.tables import told_rows


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


def test_another_name_changes_nothing_and_a_name_proves_nothing(make_store, make_card, tmp_path):
    mover = ((0,), 20, 0.01, 0.01)
    sources = {"twin": {"0": "mmc"}, "old": {"0": "ppo-0"}, "ppo-mine": {"0": "mine:make"}}
    agents = dict.fromkeys(sources, mover)
    make_store(tmp_path / "store", agents, ("random",), sources=sources)
    results = read_results(tmp_path / "store", tmp_path)
    assert results.labelled("mmc") == "twin"
    assert {name: results.kind(name) for name in sources} == {
        "twin": "network",
        "old": "learned",
        "ppo-mine": "yours",
    }
    assert set(rivals_of(results, "twin")) == {"old", "ppo-mine"}
    assert set(sources) <= set(main_agents(results.identities))
    rows = {row[0]: row for row in told_rows(results)}
    assert rows["twin"][2].startswith("mmc: dynamic MMC network")
    assert rows["ppo-mine"][3:] == ("unknown",) * 4


def test_cards_are_of_the_seeds_that_took_part(benchmark_store):
    results = read_results(*benchmark_store)  # beside a card of seed 2, which did not
    assert [card.seed for card in results.cards["ppo"]] == [0, 1]
    assert "median of 2 training seeds" in words.sample_cost(results)[0]


def test_a_policy_without_a_learning_curve_has_none_in_the_report(
    make_store, make_card, save_card, tmp_path
):
    save_card(replace(make_card("ppo", 0), learning_curve=[]), tmp_path)
    sources = {"mine": {"0": str(tmp_path / "ppo-0.json")}}
    make_store(tmp_path / "store", {"mine": ((0,), 20, 0.0, 0.0)}, ("random",), sources=sources)
    results = read_results(tmp_path / "store", tmp_path / "none")
    assert [card.training_steps for card in results.cards["mine"]] == [480_000]
    assert words.sample_cost(results) == []
    assert learning(Estimates(results, 20), looks(results.agents)).panels == ()
