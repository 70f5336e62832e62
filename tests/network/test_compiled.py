"""The compiled network does what the one of numpy does."""

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mmc_gym._errors import UserError
from mmc_gym.network import LearnedNormalizer, MMCNetwork, chain

pytest.importorskip("numba", reason='it takes the extra "fast"')
from mmc_gym.network.compiled import LANES


def both(**arguments):
    return MMCNetwork(**arguments), MMCNetwork(**arguments, engine="numba")


def random_state(network, shape, seed=0, dtype=np.float64):
    """A state in which nothing is at rest."""
    random = np.random.default_rng(seed)
    angles = random.uniform(-np.pi, np.pi, (*shape, network.segment_count)).astype(dtype)
    state = network.run(network.state_from_joint_angles(angles), iterations=1)
    state.values[:] += random.normal(0, 0.1, state.values.shape)
    return state


@pytest.mark.slow  # it compiles anew for each number of segments
@given(
    count=st.integers(2, 5),
    dynamics=st.sampled_from(["kinematic", "paper", "reference"]),
    schedule=st.sampled_from(["synchronous", "delayed"]),
    excess=st.floats(0.5, 20),
    velocity_damping=st.floats(1, 10),
    velocity_decay=st.floats(0, 1),
    iterations=st.integers(0, 12),
    batch=st.sampled_from([(), (3,), (2, 1, 2), (LANES + 1,)]),
    data=st.data(),
)
@settings(max_examples=150, deadline=None)
def test_it_computes_what_numpy_does(
    count, dynamics, schedule, excess, velocity_damping, velocity_decay, iterations, batch, data
):
    """Whatever the number of segments, the rules and what is clamped."""
    lengths = data.draw(st.lists(st.floats(0.3, 3), min_size=count, max_size=count))
    plain, compiled = both(
        segment_lengths=tuple(lengths),
        damping=(count + 1) / 2 + excess,
        dynamics=dynamics,
        schedule=schedule,
        velocity_damping=velocity_damping,
        velocity_decay=velocity_decay,
    )
    random = np.random.default_rng(data.draw(st.integers(0, 999)))
    pairs = data.draw(st.lists(st.sampled_from(chain.vector_pairs(count)), unique=True))
    shape = data.draw(st.sampled_from([(), batch]))
    clamps = plain.clamp({pair: random.uniform(-2, 2, (*shape, 2)) for pair in pairs})
    state = random_state(plain, batch, seed=int(random.integers(999)))
    expected = plain.run(state, clamps, iterations)
    found = compiled.run(state, clamps, iterations)
    np.testing.assert_allclose(found.values, expected.values, rtol=0, atol=1e-12)


@pytest.mark.parametrize("schedule", ["synchronous", "delayed"])
def test_an_arm_moves_in_any_batch_as_it_does_alone(schedule):
    _, network = both(dynamics="paper", schedule=schedule)
    state = random_state(network, (3 * LANES + 5,))
    targets = np.random.default_rng(1).uniform(-2, 2, (*state.batch_shape, 2))
    together = network.run(state, network.inverse(targets), 40)
    for arm in (0, LANES - 1, 3 * LANES + 4):
        start = network.state_from_joint_angles(np.zeros(3))
        start.values[:] = state.values[..., arm]
        alone = network.run(start, network.inverse(targets[arm]), 40)
        np.testing.assert_array_equal(together.values[..., arm], alone.values)


def test_single_precision_is_kept_and_close():
    plain, compiled = both(schedule="delayed", dynamics="reference")
    state = random_state(plain, (6,), dtype=np.float32)
    clamps = plain.inverse(np.ones((6, 2)))
    found, expected = (network.run(state, clamps, 30).values for network in (compiled, plain))
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, expected, atol=1e-4)


def test_an_empty_batch_and_the_zero_vector_do_no_harm():
    _, network = both()
    empty = network.state_from_joint_angles(np.empty((0, 3)))
    assert network.run(empty, network.inverse([1.0, 1.0]), 3).batch_shape == (0,)
    zero = network.run(network.state_from_segments(np.zeros((3, 2))), iterations=5)
    assert np.isfinite(zero.values).all()


def test_a_learned_normalizer_is_refused():
    with pytest.raises(UserError, match="normalizer must be Euclidean for the engine 'numba', got"):
        MMCNetwork(normalizer=LearnedNormalizer.shipped(), engine="numba")
    with pytest.raises(UserError, match="engine 'jax' is not accepted"):
        MMCNetwork(engine="jax")


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


def test_vectors_of_no_length_get_a_direction_too():
    """All at once: their lengths are divided by together."""
    plain, compiled = both(segment_lengths=(1.0, 2.0, 0.5, 1.0))
    state = plain.state_from_segments(np.zeros((4, 2)))
    found = compiled.run(state, iterations=3)
    np.testing.assert_allclose(found.values, plain.run(state, iterations=3).values, atol=1e-12)
