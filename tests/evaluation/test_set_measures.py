from __future__ import annotations

import math

import numpy as np
import pytest

from mmc_gym.evaluation import set_measures
from mmc_gym.evaluation.entrants import entrants
from mmc_gym.evaluation.reference import REFERENCE
from mmc_gym.evaluation.set_measures import (
    EPISODE_SETS,
    FITTS_WIDTHS,
    SET_MEASURES,
    EpisodeSet,
    fitts_line,
    measure_sets,
    power_line,
    variability_at_targets,
)


def test_measures_have_names_of_their_own_and_sets_that_exist():
    names = [measure.name for measure in SET_MEASURES]
    assert len(set(names)) == len(names)
    assert {measure.episodes for measure in SET_MEASURES} == set(EPISODE_SETS)


def test_the_sets_are_what_they_are_said_to_be(frozen):
    def few(name, trials):
        chosen = EPISODE_SETS[name]
        short = EpisodeSet(chosen.env, chosen.arguments, trials)
        return short.play(lambda env: frozen)

    postures = few("postures", range(0, 420, 20))  # one from each of the 21 starts
    assert len({tuple(episode.hands[0].round(6)) for episode in postures}) == 21
    targets = few("targets", range(32))
    distances = [np.linalg.norm(episode.target - episode.hands[0]) for episode in targets]
    assert np.unique(np.round(distances, 6)) == pytest.approx([0.3, 0.6, 0.9, 1.2])
    assert len({tuple(episode.hands[0].round(6)) for episode in targets}) == 1


def test_a_set_is_the_same_for_all_agents_and_another_with_another_seed(frozen, oracle):
    pursuit = EpisodeSet("MMCReachPursuit-v0", episodes=2)
    one, other = pursuit.play(lambda env: frozen), pursuit.play(lambda env: oracle)
    assert all(np.array_equal(a.targets, b.targets) for a, b in zip(one, other, strict=True))
    assert not np.array_equal(one[0].targets, pursuit.play(lambda env: frozen, 1)[0].targets)


def test_posture_variability_is_that_at_each_target_and_of_hands_that_are_there(make_episode):
    def ending(posture, target, hand=None):
        hands = np.tile(target if hand is None else hand, (5, 1))
        return make_episode(hands, target, joint_angles=np.tile(posture, (5, 1)))

    here, there = [1.0, 0.0], [0.0, 2.0]
    found = variability_at_targets(
        [
            ending([0.0], here),
            ending([math.pi / 2], here),
            ending([1.0], there),
            ending([1.0], there),
            ending([3.0], there, hand=[0.0, 1.0]),  # missed
            ending([3.0], [5.0, 5.0]),  # alone
        ]
    )
    assert found == pytest.approx(math.sqrt(2 * (1 - math.sqrt(0.5))) / 2)
    assert math.isnan(variability_at_targets([ending([0.0], here)]))


def test_fitts_law_of_a_hand_that_halves_its_distance_again_and_again(make_episode):
    # d = D 2^{−t/τ} is within W/2 after τ log2(2 D / W): a slope of τ, and no intercept.
    halving, step = 0.07, 0.001
    time = np.arange(3000) * step
    episodes = [
        make_episode(
            (distance * (1 - 2 ** (-time / halving)))[:, None] * [1.0, 0.0], [distance, 0.0], step
        )
        for distance in (0.3, 0.6, 0.9, 1.2)
    ]
    line = fitts_line(episodes)
    assert line.slope == pytest.approx(halving, rel=0.01)
    assert line.intercept == pytest.approx(0, abs=2 * step)
    assert line.r_squared == pytest.approx(1, abs=1e-4)


def test_a_condition_in_which_some_hand_does_not_settle_is_left_out(make_episode):
    still = make_episode(np.zeros((50, 2)), [0.3, 0.0])
    assert math.isnan(fitts_line([still]).slope)
    assert math.isnan(fitts_line([]).slope)
    assert len(FITTS_WIDTHS) >= 3


def test_the_power_law_is_that_of_the_path_after_the_warm_up(make_episode):
    phase = 1.5 * 0.02 * np.arange(500)
    hands = np.stack([np.cos(phase), 0.4 * np.sin(phase)], axis=-1)
    hands[:50] = np.random.default_rng(0).normal(size=(50, 2))
    episode = make_episode(hands, hands)
    assert power_line([episode, episode]).slope == pytest.approx(-1 / 3, abs=1e-3)
    assert math.isnan(power_line([]).slope)
    assert math.isnan(power_line([make_episode(np.zeros((500, 2)), [1.0, 0.0])]).slope)


def test_a_row_for_each_agent_and_measure_and_the_reference_among_them(oracle, monkeypatch):
    few = {
        "postures": EpisodeSet("MMCReachPaper-v0", trials=[0, 21, 40]),
        "targets": EpisodeSet("MMCReach-v0", EPISODE_SETS["targets"].arguments, [0, 8, 16, 24]),
        "pursuit": EpisodeSet("MMCReachPursuit-v0", episodes=1),
    }
    monkeypatch.setattr(set_measures, "EPISODE_SETS", few)
    found = measure_sets(entrants({"oracle": oracle}))
    assert list(found.columns) == ["agent", "measure", "unit", "episodes", "value"]
    assert len(found) == 2 * len(SET_MEASURES)
    values = found.set_index(["agent", "measure"])["value"]
    assert 0 < values["oracle", "fitts_slope"] < 1
    assert 0.2 < values[REFERENCE, "speed_curvature_exponent"] < 0.5
    assert math.isnan(values[REFERENCE, "posture_variability"])
    assert len(measure_sets(entrants({"oracle": oracle}), names=["fitts_slope"])) == 2


def test_a_measure_that_is_none_is_told(oracle):
    with pytest.raises(ValueError, match=r"names must be among .*fitts_slope.*'speed'"):
        measure_sets(entrants({"oracle": oracle}), names=["speed"])
