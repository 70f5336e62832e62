from __future__ import annotations

import math

import numpy as np
import pytest

from mmc_gym.benchmark.suite import ENVIRONMENTS
from mmc_gym.measures.rollout import run_episodes
from mmc_gym.measures.sets import (
    FITTS_WIDTHS,
    SET_MEASURES,
    fitts_line,
    power_line,
    set_measures_in,
    variability_at_targets,
)


def test_measures_have_names_of_their_own_and_environments_that_exist():
    names = [measure.name for measure in SET_MEASURES]
    assert len(set(names)) == len(names)
    assert {measure.environment for measure in SET_MEASURES} <= set(ENVIRONMENTS)
    assert not set_measures_in("random")


def test_the_environments_are_what_the_measures_need(frozen):
    def few(name, trials):
        env = ENVIRONMENTS[name].make()
        return run_episodes(frozen, env, list(trials), options=[{"trial": k} for k in trials])

    postures = few("paper", range(0, 420, 20))  # one from each of the 21 starts
    assert len({tuple(episode.hands[0].round(6)) for episode in postures}) == 21
    assert len(ENVIRONMENTS["paper"].instances(1)) == 420
    targets = few("distances", range(32))
    assert len(ENVIRONMENTS["distances"].instances(1)) == 32
    assert np.unique([e.distances[0].round(6) for e in targets]) == pytest.approx(
        [0.3, 0.6, 0.9, 1.2]
    )
    assert len({tuple(episode.hands[0].round(6)) for episode in targets}) == 1


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
