"""Facts about the arms of the analytic engine."""

import copy
import pickle

import numpy as np
import pytest

from mmc_gym._errors import UserError
from mmc_gym.body import ArmParameters
from mmc_gym.body.analytic.arms import AnalyticArmBatch

# Many arms


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda arms: pickle.loads(pickle.dumps(arms))])
def test_a_copy_of_many_arms_has_the_same_future(copied):
    random = np.random.default_rng(0)
    arms = AnalyticArmBatch(None, 520, threads=2)
    arms.command(random.uniform(-3, 3, (520, 3)))
    arms.step()
    other = copied(arms)
    for each in (arms, other):
        each.step()
        each.close()
    assert not np.shares_memory(arms.joint_angles, other.joint_angles)
    np.testing.assert_array_equal(arms.segment_angles, other.segment_angles)
    np.testing.assert_array_equal(arms.end_effectors, other.end_effectors)


def test_angles_are_as_the_mathematical_library_has_them():
    angles = np.concatenate([np.linspace(-7, 7, 1001), np.linspace(-1e5, 1e5, 1001)])
    arms = AnalyticArmBatch(ArmParameters(segment_lengths=(1.0,)), len(angles))
    arms.reset(angles[:, None])
    np.testing.assert_allclose(arms.end_effectors[:, 0], np.cos(angles), atol=3e-16)
    np.testing.assert_allclose(arms.end_effectors[:, 1], np.sin(angles), atol=3e-16)


def test_obstacles_are_refused():
    with pytest.raises(UserError, match=r'obstacles must be empty .*engine="pymunk".* got \(\(1'):
        AnalyticArmBatch(ArmParameters(obstacles=((1.0, 1.0, 0.1),)))
