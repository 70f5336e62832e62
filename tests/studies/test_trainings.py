"""The table of trainings: steps and minutes to a level, and what happens if none reaches it."""

import math
from dataclasses import replace

import pandas as pd

from mmc_gym.agents.policy import load_policy, shipped_file
from studies.learners.trainings import main, summarize, trainings

_, CARD = load_policy(shipped_file("ppo", 0))


def training(seed, curve, **scores):
    """A training that was evaluated every 1,000 steps, which take a minute."""
    legs = range(1, len(curve) + 1)
    seconds = [60.0 * leg for leg in legs]
    times = {"steps": [1_000 * leg for leg in legs], "seconds": seconds, "cpu_seconds": seconds}
    evaluations = pd.DataFrame({**times, "success": curve}).to_dict("records")
    whole = {"training_steps": 1_000 * len(curve), "training_cpu_seconds": 60.0 * len(curve)}
    return replace(CARD, seed=seed, scores=scores, learning_curve=evaluations, **whole)


def summary_of(*cards):
    """Rows of the summary by measure."""
    summary = summarize(trainings({"ppo": cards}))
    return {row["measure"]: row for row in summary.to_dict("records")}


def interval(row):
    return row["estimate"], row["low"], row["high"]


def test_steps_and_minutes_to_a_level_are_the_median_over_seeds():
    rises = [(1.0, 0.9, 1.0), (0.5, 1.0, 1.0), (0.5, 0.5, 1.0)]  # also where it is lost again
    found = summary_of(*(training(seed, rise) for seed, rise in enumerate(rises)))
    assert interval(found["steps_to_95"]) == (2.0, 1.0, 3.0)
    assert interval(found["minutes_to_98"]) == (2.0, 1.0, 3.0)
    assert found["training_minutes"]["estimate"] == found["training_steps"]["estimate"] == 3.0


def test_seeds_that_never_reach_a_level_are_later_than_the_others():
    most = [training(seed, (0.5, 1.0, 1.0)) for seed in range(2)]
    few = [training(seed, (0.5, 0.5, 0.5)) for seed in range(2, 5)]
    row = summary_of(*most, few[0])["steps_to_95"]
    assert (row["estimate"], row["count"], row["missing"]) == (2.0, 2, 1)
    assert math.isnan(row["low"]) and math.isnan(row["high"])
    row = summary_of(*most, *few)["steps_to_95"]
    assert math.isnan(row["estimate"]) and (row["count"], row["missing"]) == (2, 3)


def test_the_table_is_printed_and_written(tmp_path, capsys, monkeypatch):
    few = [training(seed, (0.5, 1.0) if seed else (0.5, 0.5)) for seed in range(3)]
    cards = {"ppo": few, "sac": [training(0, (0.5, 0.96), success=0.96)]}
    monkeypatch.setattr("studies.learners.trainings.read_cards", lambda folder: cards)
    main(out=tmp_path)
    assert len(pd.read_csv(tmp_path / "trainings.csv")) == 4
    table = pd.read_csv(tmp_path / "table.csv").set_index(["agent", "measure"])
    assert table.loc[("sac", "steps_to_95"), "estimate"] == 2.0
    printed = capsys.readouterr().out
    assert "2 of 3" in printed and "0 of 1" in printed and "0.960" in printed
