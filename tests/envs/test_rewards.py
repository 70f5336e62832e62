"""Facts about rewards."""

import numpy as np
import pytest

from mmc_gym.envs.rewards import control_cost, dense_reward, sparse_reward


def test_rewards_are_what_they_are_called() -> None:
    distances = np.array([0.0, 0.05, 0.0501, 2.0])
    assert dense_reward(distances).tolist() == (-distances).tolist()
    assert sparse_reward(distances <= 0.05).tolist() == [0.0, 0.0, -1.0, -1.0]
    assert (sparse_reward(True), sparse_reward(False)) == (0.0, -1.0)
    assert control_cost([1.0, -1.0, 0.0], 0.3) == pytest.approx(-0.2)
    assert control_cost([0.0], 0.3) == 0.0
