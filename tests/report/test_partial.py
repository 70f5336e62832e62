"""Stores that lack something: a report says what is there, and over how many."""

from __future__ import annotations

import pytest

from mmc_gym.report import sentences as words
from mmc_gym.report import write_report
from mmc_gym.report.figures import movements, profiles
from mmc_gym.report.numbers import seeds_of
from mmc_gym.report.panels import looks
from mmc_gym.report.results import read_results
from mmc_gym.report.scores import Estimates, scoreboard
from mmc_gym.report.tables import score_table

MMC, IK = ((0,), 20, 0.06, 0.02), ((0,), 30, 0.02, 0.02)
PPO = ((0, 1), 28, 0.02, 0.0001)


@pytest.fixture(scope="module")
def interrupted(make_store, tmp_path_factory):
    """ppo-1 has not come to the end of the battery."""
    folder = tmp_path_factory.mktemp("interrupted")
    missing = [("ppo", 1, "rotation-15"), ("ppo", 1, "centre-out")]
    keys = ("random", "centre-out", "rotation-15", "rotation-60")
    make_store(folder, {"mmc": MMC, "ik-dls": IK, "ppo": PPO}, keys, missing)
    return folder


def test_an_agent_that_has_not_all_seeds_everywhere_does_not_end_the_report(interrupted, tmp_path):
    text = write_report(interrupted, tmp_path / "report.html", tmp_path, 50).read_text()
    assert "1 perturbed environments" not in text
    assert "Left out: 1 environment that not all" in text


def test_profiles_are_over_what_every_policy_has_met(interrupted, tmp_path):
    estimates = Estimates(read_results(interrupted, tmp_path), resamples=50)
    block = profiles(estimates, looks(estimates.results.agents))
    assert [panel.title for panel in block.panels] == [
        "Without perturbation (random)",
        "1 perturbed environment",
    ]


def test_seeds_are_counted_where_the_figures_are(interrupted, tmp_path):
    results = read_results(interrupted, tmp_path)
    estimates = Estimates(results, resamples=50)
    assert "Training seeds: ppo 1;" in score_table(estimates, "centre-out").caption
    assert "Training seeds: ppo 2;" in score_table(estimates, "random").caption
    assert "ppo 1 to 2;" in seeds_of(results, results.agents)
    assert "ppo (learned, 2 training seeds)" in words.overview(estimates)[0]
    (sentence,) = words.robustness(estimates, "mmc")
    hardest = words.hardest(estimates, ["rotation-15", "rotation-60"])
    seeds = {"rotation-15": "1 training seed", "rotation-60": "2 training seeds"}[hardest]
    assert sentence.startswith(f"{hardest} (cursor turned by")
    assert f"; ppo ({seeds}), the most of all, in" in sentence


def test_movements_are_of_one_training_seed_and_say_which(make_store, tmp_path):
    make_store(tmp_path, {"mmc": MMC, "ppo": ((3,), 28, 0.02, 0.0005)}, ("random",))
    results = read_results(tmp_path, tmp_path)
    block = movements(results, "random", looks(results.agents))
    assert {panel.title for panel in block.panels} >= {"mmc", "ppo"}
    assert "of trained agents, one training: ppo seed 3" in block.caption


def test_a_perturbed_environment_is_not_called_unperturbed(make_store, tmp_path):
    make_store(tmp_path, {"mmc": MMC, "ik-dls": IK}, ("rotation-15", "rotation-60"))
    assert words.base_title(read_results(tmp_path, tmp_path)) == "Only rotation-15"


def test_another_task_without_perturbation_stands_in_for_random_targets(make_store, tmp_path):
    make_store(tmp_path, {"mmc": MMC}, ("rotation-15", "centre-out"))
    assert words.base_of(read_results(tmp_path, tmp_path)) == "centre-out"


def test_the_reason_is_told_why_nothing_is_compared(make_store, tmp_path):
    make_store(tmp_path / "few", {"mmc": MMC, "ik-dls": IK}, ("random",), instances=3)
    few = read_results(tmp_path / "few", tmp_path)
    assert scoreboard(Estimates(few, 50), "mmc") == []
    assert "fewer than 5 instances" in words.nothing_compared(few, ["mmc"])
    make_store(tmp_path / "alone", {"mmc": MMC}, ("random",))
    alone = read_results(tmp_path / "alone", tmp_path)
    assert "has no rival" in words.nothing_compared(alone, ["mmc"])
    assert "did not take part" in words.nothing_compared(alone, [])
