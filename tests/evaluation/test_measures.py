from __future__ import annotations

import numpy as np
import pytest

from mmc_gym.evaluation.measures import MEASURES
from mmc_gym.evaluation.rollout import Episode


def test_measures_have_names_of_their_own():
    names = [measure.name for measure in MEASURES]
    assert len(set(names)) == len(names)
    assert not set(names) & {"agent", "episode", "seed"}


def test_every_measure_of_a_hand_that_moves_one_length_in_two_steps_and_stays():
    hands = np.array([[0.0, 0.0], [0.5, 0.0], [1.0, 0.0], [1.0, 0.0]])
    episode = Episode(
        seed=0,
        hands=hands,
        distances=1 - hands[:, 0],
        target=np.array([1.0, 0.0]),
        rewards=np.array([-0.5, 0.0, 0.0]),
        action_times=np.array([1e-5, 2e-5, 9e-5]),
        control_step=0.1,
        tolerance=0.05,
    )
    assert {measure.name: measure.of(episode) for measure in MEASURES} == pytest.approx(
        {
            "success": 1.0,
            "final_distance": 0.0,
            "time_to_target": 0.2,
            "path_ratio": 1.0,
            "peak_speed": 5.0,
            "velocity_peaks": 1.0,
            "episode_return": -0.5,
            "action_time": 20.0,
        }
    )
