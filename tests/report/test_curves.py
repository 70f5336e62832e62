"""Learning curves: of which policies, and what they show."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from mmc_gym import UserError
from mmc_gym.agents import AGENTS
from mmc_gym.agents.policy import load_policy, save_policy, shipped_file
from mmc_gym.report.curves import curve_rows, draw_learning_curves, mean_curves, read_cards
from studies.learners import trainings as study

RISE = (0.2, 0.5, 0.96, 0.94, 0.99)  # of success, at 1,000, 2,000, … steps
NETWORK, CARD = load_policy(shipped_file("ppo", 0))


def training(name="ppo", seed=0, success=RISE, seconds_per_leg=60.0, **changes):
    """A training that was evaluated every 1,000 steps; its wall time is twice its CPU time."""
    legs = np.arange(1, len(success) + 1)
    times = {"seconds": 2 * seconds_per_leg * legs, "cpu_seconds": seconds_per_leg * legs}
    curve = pd.DataFrame({"steps": 1_000 * legs, **times, "success": success})
    return replace(CARD, name=name, seed=seed, learning_curve=curve.to_dict("records"), **changes)


def test_cards_are_of_all_that_ship_or_of_agents_by_name_or_pattern(tmp_path):
    assert {name: len(cards) for name, cards in read_cards().items()} == {
        name: agent.training_seeds
        for name, agent in AGENTS.items()
        if agent.training_seeds and agent.is_ranked
    }
    for seed in (10, 2):
        save_policy(NETWORK, training("mine", seed=seed), tmp_path / f"mine-{seed}")
    cards_of = read_cards(["sac-1", str(tmp_path / "mine-*")])
    seeds = {name: [card.seed for card in cards] for name, cards in cards_of.items()}
    assert seeds == {"sac-1": [1], "mine": [2, 10]}
    with pytest.raises(UserError, match="agents must be trained policies with a card, got 'mmc'"):
        read_cards(["mmc"])


def test_the_curve_is_the_mean_over_the_seeds_and_lies_in_its_interval():
    rises = [(0.0, 0.4, 1.0), (0.2, 0.6, 1.0), (0.4, 0.5, 1.0)]
    cards = [training(seed=seed, success=rise) for seed, rise in enumerate(rises)]
    rows = curve_rows({"ppo": cards})
    assert list(rows["success"]) == [value for rise in rises for value in rise]
    last = {"agent": "ppo", "seed": 2, "steps": 3_000, "seconds": 360, "cpu_seconds": 180}
    assert dict(rows.iloc[-1, :5]) == last
    curve = mean_curves(rows, "steps")
    assert list(curve["steps"]) == [1_000, 2_000, 3_000]
    # With three seeds, 1 in 27 resamples holds nothing but the smallest.
    expected = [[0.2, 0.0, 0.4, 3], [0.5, 0.4, 0.6, 3], [1.0, 1.0, 1.0, 3]]
    intervals = curve[["success", "low", "high", "seeds"]]
    np.testing.assert_allclose(intervals, expected, atol=0.03)
    figure = draw_learning_curves(curve, mean_curves(rows, "cpu_seconds"))
    drawn = next(line for line in figure.axes[1].lines if len(line.get_xdata()) > 2)
    np.testing.assert_allclose(drawn.get_xydata(), [[1, 0.2], [2, 0.5], [3, 1]])
    with pytest.raises(UserError, match="learning_curve of ppo-0 must be of evaluations"):
        curve_rows({"ppo": [training(success=())]})


def test_against_time_a_seed_counts_with_what_was_last_known_of_it():
    fast = training(seed=0, success=(0.1, 0.2, 0.3, 0.4), seconds_per_leg=10.0)
    slow = training(seed=1, success=(0.5, 0.7, 0.9), seconds_per_leg=15.0)
    curve = mean_curves(curve_rows({"ppo": [fast, slow]}), "cpu_seconds")
    # The slow one is known from 15 s on, the fast one up to 40 s; at 45 s nothing is said.
    assert list(curve["cpu_seconds"]) == [15, 30, 40]
    expected = [(0.1 + 0.5) / 2, (0.3 + 0.7) / 2, (0.4 + 0.7) / 2]
    assert curve["success"].to_numpy() == pytest.approx(expected)


def table_of(*cards):
    """Return the rows of the study's table by measure."""
    summary = study.summarize(study.trainings({"ppo": cards}))
    return {row["measure"]: row for row in summary.to_dict("records")}


def test_steps_and_minutes_to_a_level_are_the_median_over_seeds_and_may_be_later():
    rises = [(1.0, 0.9, 1.0), (0.5, 1.0, 1.0), (0.5, 0.5, 1.0)]  # also where it is lost again
    table = table_of(*(training(seed=seed, success=rise) for seed, rise in enumerate(rises)))
    for measure in ("steps_to_95", "minutes_to_98"):
        row = table[measure]
        assert (row["estimate"], row["low"], row["high"]) == (2.0, 1.0, 3.0)
    never = [training(seed=seed, success=(0.5, 0.5, 0.5)) for seed in range(3, 6)]
    both = [training(seed=seed, success=rises[1]) for seed in range(2)]
    for few, estimate in ((never[:1], 2.0), (never, np.nan)):
        row = table_of(*both, *few)["steps_to_95"]
        assert row["estimate"] == pytest.approx(estimate, nan_ok=True)
        assert (row["count"], row["missing"]) == (2, len(few))
        assert np.isnan([row["low"], row["high"]]).all()
