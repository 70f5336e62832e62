"""A time base makes every movement of the network bell-shaped."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mmc_gym._errors import UserError
from mmc_gym.network import MMCNetwork
from mmc_gym.network.time_base import minimum_jerk, share, timed_step

NETWORK = MMCNetwork()
POSTURE = [0.3, 0.6, 0.6]
START = NETWORK.state_from_joint_angles(POSTURE)


@given(duration=st.floats(1, 500))
def test_taking_each_share_of_what_remains_follows_the_time_base(duration):
    iterations = np.arange(1, int(np.ceil(duration)) + 1)
    remaining = np.cumprod(1 - share(iterations, duration))
    np.testing.assert_allclose(1 - remaining, minimum_jerk(iterations / duration), atol=1e-9)


@pytest.mark.parametrize("part", [1e-4, 0.01, 0.1, 0.3])
def test_the_hand_takes_the_share_of_its_distance(normalizer, part):
    network = MMCNetwork(normalizer=normalizer)
    before = network.run(START, iterations=5)
    target = np.array([-1.0, 1.5])
    after = timed_step(network, before, target, part)
    step = np.linalg.norm(after.end_effector - before.end_effector)
    distance = np.linalg.norm(target - before.end_effector)
    assert step == pytest.approx(part * distance, rel=1e-3)


def test_no_share_is_no_movement_and_the_gain_is_bounded_whatever_the_network_s_own_damping():
    rest = timed_step(NETWORK, START, [-1.0, 1.5], 0.0)
    np.testing.assert_allclose(rest.segments, START.segments, atol=1e-15)
    # With all of the share the damping is (N + 3)/2, the least there is.
    fastest = timed_step(NETWORK, START, [-1.0, 1.5], 1.0)
    damped = MMCNetwork(damping=3.0)
    expected = damped.step(START, damped.inverse([-1.0, 1.5]))
    np.testing.assert_allclose(fastest.values, expected.values, atol=1e-14)
    same = timed_step(MMCNetwork(damping=4.0), START, [-1.0, 1.5], 1.0)
    np.testing.assert_array_equal(same.values, fastest.values)


def test_other_networks_and_what_is_out_of_range_are_refused():
    for other in (MMCNetwork(dynamics="paper"), MMCNetwork(schedule="delayed")):
        with pytest.raises(ValueError, match="network must be kinematic and synchronous"):
            timed_step(other, other.state_from_joint_angles(POSTURE), [1.0, 1.0], 0.1)
    with pytest.raises(UserError, match="duration must be positive and finite, got"):
        share(1, np.inf)
    with pytest.raises(UserError, match="share must be between 0 and 1"):
        timed_step(NETWORK, START, [1.0, 1.0], 1.5)


def test_a_hand_that_does_not_get_anywhere_is_no_division_by_next_to_nothing():
    network = MMCNetwork((2.0, 0.5, 0.5))
    for angle in (0.0, 1e-160, 1e-20):
        state = network.state_from_joint_angles([0.0, angle, 0.0])
        for target in ([-3.0, 0.0], [2.0, 0.0], state.end_effector):
            with np.errstate(all="raise", under="ignore"):
                for _ in range(3):
                    state = timed_step(network, state, target, 1.0)
            assert np.isfinite(state.values).all()
