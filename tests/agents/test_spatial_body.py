"""The body agents move an arm in space, though its links or joints are not as given."""

from dataclasses import replace

import numpy as np
import pytest

from mmc_gym import UserError
from mmc_gym.agents.body_model.agent import ik_body, mmc_body
from mmc_gym.agents.body_model.spatial import lengthened
from mmc_gym.interface import ReachInterface, Seen
from mmc_gym.robots import HingeArm

ARM = HingeArm.named("panda")
START = np.array([0.0, 0.4, 0.0, -1.8, 0.0, 2.2, 0.8])
TURN = 0.05  # radians per step


class SpaceInterface(ReachInterface):
    def see(self, observation):
        angles, hand, target = np.split(observation, [7, 10], axis=-1)
        return Seen(angles, target, joint_speeds=np.zeros_like(angles), hand=hand)

    def act(self, joint_targets, sensed):
        turn = (joint_targets - sensed.joint_angles) / TURN
        return np.clip(turn, -1.0, 1.0).astype(np.float32)


INTERFACE = SpaceInterface((), "joint_delta", 1.0, 20.0, TURN, success_distance=0.02, arm=ARM)


def observation(angles, target, shares=()):
    arm = lengthened(ARM, np.array(shares)) if len(shares) else ARM
    return np.concatenate([angles, arm.forward(angles)[:3, 3], target])


def target_of(seed):
    return np.random.default_rng(seed).uniform((0.3, -0.3, 0.2), (0.6, 0.3, 0.6))


def reached(seed, shares=(), locked=(), stuck=(), build=mmc_body):
    """Reach with a Panda that follows its commands, with links longer by shares, and locked joints.

    Some are felt where they were at first.  Return how far the hand is from its target at the end,
    and what the agent knows.
    """
    agent, state, angles, target = build(INTERFACE), None, START, target_of(seed)
    for _ in range(30):
        seen = observation(angles, target, shares)
        seen[list(stuck)] = START[list(stuck)]
        action, state = agent.predict(seen, state)
        turn = TURN * action
        turn[list(locked)] = 0.0
        angles = angles + turn
    hand = observation(angles, target, shares)[7:10]
    return np.linalg.norm(hand - target), state


def test_an_arm_with_a_slide_is_refused():
    arm = replace(ARM, is_slide=(True,) + (False,) * 6)
    with pytest.raises(UserError, match="interface must be of an arm of hinges, without slides"):
        mmc_body(replace(INTERFACE, segment_lengths=(), arm=arm))


LONGER = (0, 0, 0, 0, 0.2, 0, 0, 0.3)


@pytest.mark.parametrize("build", [mmc_body, ik_body])
@pytest.mark.parametrize(
    "body", [{}, {"shares": LONGER}, {"locked": (2, 3)}, {"stuck": (1,)}, {"stuck": (3,)}], ids=str
)
def test_the_hand_reaches_with_any_body(build, body):
    assert all(reached(seed, **body, build=build)[0] < 0.02 for seed in range(2))


def test_one_longer_link_is_identified_and_nothing_where_all_is_as_given():
    forearm = np.eye(8)[4] * 0.2
    np.testing.assert_allclose(reached(0, forearm)[1].shares[0], forearm, atol=0.01)
    assert not reached(0)[1].shares.any()


def test_locked_joints_are_held_in_the_goal_and_no_others():
    _, state = reached(1, locked=(3,))
    stays = state.goal[0, :6] == START[:6]  # the seventh only turns the hand about itself
    np.testing.assert_array_equal(np.flatnonzero(stays), [3])


@pytest.mark.parametrize("joint", [0, 1, 3, 5])
def test_a_sensor_is_stuck_whose_joint_moves_the_hand_and_no_other(joint):
    for seed in range(2):
        distance, state = reached(seed, stuck=(joint,))
        assert distance < 0.005 and np.flatnonzero(state.stuck.offset[0]).tolist() == [joint]


@pytest.mark.parametrize("body", [{}, {"shares": LONGER}, {"locked": (1, 3)}], ids=str)
def test_no_sensor_is_taken_as_stuck_where_none_is(body):
    assert not any(reached(seed, **body)[1].stuck.offset.any() for seed in range(4))


def test_many_arms_are_as_each_alone_and_start_anew_where_episodes_do():
    agent = mmc_body(INTERFACE)
    seen = np.stack([observation(START, target_of(seed), LONGER) for seed in range(3)])
    together, state = agent.predict(seen)
    np.testing.assert_array_equal(together, [agent.predict(observed)[0] for observed in seen])
    _, state = agent.predict(seen, state, [True, False, False])
    np.testing.assert_array_equal(state.looks, [1, 2, 2])
    with pytest.raises(UserError, match="state"):
        agent.predict(seen[:2], state)
