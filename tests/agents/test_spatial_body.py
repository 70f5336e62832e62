"""The body agents move an arm in space, though its links or joints are not as given."""

import gymnasium as gym
import numpy as np
import pytest

from mmc_gym import make_agent
from mmc_gym._errors import UserError
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


LENGTHS = (0.33, 0.39, 0.23)
INTERFACE = SpaceInterface(LENGTHS, "joint_delta", 1.0, 20.0, TURN, success_distance=0.02, arm=ARM)
LONGER = np.array([0, 0, 0, 0, 0.2, 0, 0, 0.3])


class Kinematic(gym.Env):
    """A Panda that follows its commands, with links longer by shares, and locked joints."""

    observation_space = gym.spaces.Box(-np.inf, np.inf, (13,), np.float64)
    action_space = gym.spaces.Box(-1.0, 1.0, (7,), np.float32)

    def __init__(self, shares=(), locked=()):
        self.arm = lengthened(ARM, np.array(shares)) if len(shares) else ARM
        self.locked = list(locked)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.angles = START.copy()
        self.target = self.np_random.uniform((0.3, -0.3, 0.2), (0.6, 0.3, 0.6))
        return self.observation(), {}

    def observation(self):
        return np.concatenate([self.angles, self.arm.forward(self.angles)[:3, 3], self.target])

    def step(self, action):
        turn = TURN * action
        turn[self.locked] = 0.0
        self.angles = self.angles + turn
        return self.observation(), 0.0, False, False, {}


def distance_after(agent, env, seed, steps=30):
    observation, _ = env.reset(seed=seed)
    state = None
    for _ in range(steps):
        action, state = agent.predict(observation, state)
        observation = env.step(action)[0]
    hand, target = np.split(observation[7:], 2)
    return np.linalg.norm(hand - target), state


BODIES = {"as given": {}, "longer": {"shares": LONGER}, "locked": {"locked": (2, 3)}}


@pytest.mark.parametrize("name", ["mmc-body", "ik-body"])
@pytest.mark.parametrize("body", BODIES)
def test_the_hand_reaches_with_any_body(name, body):
    env = Kinematic(**BODIES[body])
    agent = make_agent(name, env, interface=INTERFACE)
    assert all(distance_after(agent, env, seed)[0] < 0.02 for seed in range(2))


def test_one_longer_link_is_identified_and_nothing_where_all_is_as_given():
    agent = make_agent("mmc-body", Kinematic(), interface=INTERFACE)
    forearm = np.eye(8)[4] * 0.2
    _, state = distance_after(agent, Kinematic(forearm), 0)
    np.testing.assert_allclose(state.shares[0], forearm, atol=0.01)
    assert not distance_after(agent, Kinematic(), 0)[1].shares.any()


def test_locked_joints_are_held_in_the_goal_and_no_others():
    agent = make_agent("mmc-body", Kinematic(), interface=INTERFACE)
    _, state = distance_after(agent, Kinematic(locked=(3,)), 1)
    stays = state.goal[0, :6] == START[:6]  # the seventh only turns the hand about itself
    np.testing.assert_array_equal(np.flatnonzero(stays), [3])


def test_many_arms_are_as_each_alone_and_start_anew_where_episodes_do():
    agent = make_agent("mmc-body", Kinematic(), interface=INTERFACE)
    seen = np.stack([Kinematic(LONGER).reset(seed=seed)[0] for seed in range(3)])
    together, state = agent.predict(seen)
    np.testing.assert_array_equal(together, [agent.predict(one)[0] for one in seen])
    _, state = agent.predict(seen, state, [True, False, False])
    np.testing.assert_array_equal(state.looks, [1, 2, 2])
    with pytest.raises(UserError, match="state"):
        agent.predict(seen[:2], state)
