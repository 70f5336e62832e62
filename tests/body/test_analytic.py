"""Facts about the arms of the analytic engine."""

import copy
import pickle
import subprocess
import sys

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
    for _ in range(3):
        arms.step()
    other = copied(arms)
    assert isinstance(other, AnalyticArmBatch)
    for _ in range(10):
        for each in (arms, other):
            each.step()
    assert not np.shares_memory(arms.joint_angles, other.joint_angles)
    np.testing.assert_array_equal(arms.segment_angles, other.segment_angles)
    np.testing.assert_array_equal(arms.end_effectors, other.end_effectors)
    arms.close()
    other.close()


def test_angles_are_as_the_mathematical_library_has_them():
    angles = np.concatenate([np.linspace(-7, 7, 1001), np.linspace(-1e5, 1e5, 1001)])
    arms = AnalyticArmBatch(ArmParameters(segment_lengths=(1.0,)), len(angles))
    arms.reset(angles[:, None])
    np.testing.assert_allclose(arms.end_effectors[:, 0], np.cos(angles), atol=3e-16)
    np.testing.assert_allclose(arms.end_effectors[:, 1], np.sin(angles), atol=3e-16)


# What is refused


def test_obstacles_are_refused():
    with pytest.raises(UserError, match=r'obstacles must be empty .*engine="pymunk".* got \(\(1'):
        AnalyticArmBatch(ArmParameters(obstacles=((1.0, 1.0, 0.1),)))


def test_numba_is_imported_only_for_this_engine_and_its_absence_is_explained():
    program = """
import sys
import mmc_gym.body
assert "numba" not in sys.modules
sys.modules["numba"] = None
try:
    import mmc_gym.body.analytic.arms
except ImportError as error:
    print(error)
"""
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert run.stdout.strip().endswith('pip install "mmc-gym[fast]"'), run.stderr
