"""What is the compiled network's own; `test_engines` has what it shares with the others."""

import subprocess
import sys

import numpy as np
import pytest

from mmc_gym._errors import UserError
from mmc_gym.network import LearnedNormalizer, MMCNetwork

pytest.importorskip("numba", reason='it takes the extra "fast"')
from mmc_gym.network.compiled import LANES


@pytest.mark.parametrize("schedule", ["synchronous", "delayed"])
def test_an_arm_moves_in_any_batch_as_it_does_alone(schedule):
    network = MMCNetwork(dynamics="paper", schedule=schedule, engine="numba")
    random = np.random.default_rng(0)
    state = network.state_from_joint_angles(random.uniform(-np.pi, np.pi, (3 * LANES + 5, 3)))
    targets = random.uniform(-2, 2, (*state.batch_shape, 2))
    together = network.run(state, network.inverse(targets), 40)
    for arm in (0, LANES - 1, 3 * LANES + 4):
        start = network.state_from_joint_angles(np.zeros(3))
        start.values[:] = state.values[..., arm]
        alone = network.run(start, network.inverse(targets[arm]), 40)
        np.testing.assert_array_equal(together.values[..., arm], alone.values)


def test_a_learned_normalizer_is_refused():
    with pytest.raises(UserError, match="normalizer must be Euclidean for the engine 'numba', got"):
        MMCNetwork(normalizer=LearnedNormalizer.shipped(), engine="numba")


def test_clamps_of_another_schedule_are_refused():
    state = MMCNetwork(engine="numba").state_from_joint_angles([0.1, 0.2, 0.3])
    clamps = MMCNetwork(schedule="delayed").clamp({(0, 1): [1.0, 0.0]})
    with pytest.raises(UserError, match="clamps must come from a network of schedule 'sync"):
        MMCNetwork(engine="numba").run(state, clamps)


def test_without_numba_the_plain_network_works_and_the_other_says_what_is_missing():
    program = """
import sys
sys.modules["numba"] = None
from mmc_gym.network import MMCNetwork
network = MMCNetwork()
network.run(network.state_from_joint_angles([0.1, 0.2, 0.3]))
try:
    MMCNetwork(engine="numba")
except ImportError as error:
    print(error)
"""
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert run.stdout.strip().endswith('pip install "mmc-gym[fast]"'), run.stderr
