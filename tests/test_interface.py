"""The contract between environments and agents: observations, actions, and what is given."""

import pickle
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from mmc_gym import UserError, make_agent
from mmc_gym.body import ArmParameters
from mmc_gym.interface import (
    OFFSET_SCALE,
    ControlError,
    ObservationLayout,
    ReachInterface,
    Sensed,
    action_meaning,
)

LAYOUT = ObservationLayout(joint_count=3, reach=3.0)
GOALS = ObservationLayout(joint_count=3, reach=3.0, has_goals=True)
INTERFACE = ReachInterface((1.0,) * 3, "joint_delta", 6.0, 12.0, 0.02)


def arms(seed, count=5, joints=3):
    """Joint angles, relative speeds, hands and targets, some of these beyond the reach."""
    random = np.random.default_rng(seed)
    return (
        random.uniform(-np.pi, np.pi, (count, joints)),
        random.uniform(-1, 1, (count, joints)),
        random.uniform(-2, 2, (count, 2)) * joints,
        random.uniform(-2, 2, (count, 2)) * joints,
    )


def test_a_hand_that_is_seen_beyond_the_limits_is_recovered_from_its_bounded_offset():
    layout = replace(LAYOUT, is_clipped=True)
    angles, speeds, _, targets = arms(3)
    hands = np.array([[9.0, 1.0], [0.5, -11.0], [-8.0, -8.0], [1.0, 0.5], [0.0, 7.5]])
    seen = layout.encode(angles, speeds, hand=hands, target=targets / 3)
    assert (np.abs(seen[:, -4:-2]) == 6.0).any(axis=1).tolist() == [True, True, True, False, True]
    np.testing.assert_allclose(INTERFACE.see(seen).hand, hands, atol=1e-3)


def test_numbers_that_are_lost_are_told_from_those_that_are_not():
    seen = LAYOUT.encode(*arms(3)[:2], hand=arms(3)[2], target=arms(3)[3])
    assert INTERFACE.see(seen).lost is None
    before = INTERFACE.see(seen)
    seen[0, 1] = seen[1, 5] = seen[2, 7] = seen[3, -6] = seen[4, -4] = 0.0
    view, lost = INTERFACE.see(seen), np.zeros((5, 7), bool)
    lost[0, 1] = lost[1, 2] = lost[2, 4] = lost[3, 6] = True
    assert (view.lost == lost).all()  # a lost offset follows from the bounded one
    np.testing.assert_allclose(view.hand[4], before.hand[4], atol=1e-4)
    seen = LAYOUT.encode(
        np.zeros((1, 3)), np.zeros((1, 3)), hand=np.eye(2)[:1], target=np.ones((1, 2))
    )
    assert INTERFACE.see(seen).lost[0].tolist() == [*[False] * 3, *[True] * 3, False]


@given(st.integers(0, 2**31), st.integers(1, 5), st.booleans(), st.booleans())
def test_one_arm_is_encoded_as_many_are_and_the_world_recovered(
    seed, joints, is_clipped, has_goals
):
    layout = ObservationLayout(joints, float(joints), is_clipped and not has_goals, has_goals)
    angles, speeds, hands, targets = arms(seed, joints=joints)
    many = layout.encode(angles, speeds, hand=hands, target=targets)
    if not has_goals:
        assert (many.shape, many.dtype) == ((5, layout.size), np.float32)
        assert (np.abs(many) <= layout.limits).all() or not is_clipped
    for index, (angle, speed) in enumerate(zip(angles.tolist(), speeds.tolist())):
        single = layout.encode(angle, speed, hand=tuple(hands[index]), target=tuple(targets[index]))
        for name in single if has_goals else [...]:
            np.testing.assert_allclose(single[name], many[name][index], atol=1e-7)
            assert single[name].dtype == many[name].dtype
    if not layout.is_clipped:
        interface = replace(INTERFACE, segment_lengths=(1.0,) * joints)
        sensed = interface.sense(many)
        np.testing.assert_allclose(sensed.joint_angles, angles, atol=1e-6)
        np.testing.assert_allclose(sensed.target, targets, atol=1e-5)
        np.testing.assert_allclose(interface.see(many).hand, hands, atol=1e-5)


@pytest.mark.parametrize(("module", "arrays"), [(np, np.asarray), (torch, torch.from_numpy)])
def test_an_observation_of_either_kind_is_split_into_what_was_encoded(module, arrays):
    angles, speeds, hands, targets = arms(0)
    flat = LAYOUT.encode(angles, speeds, hand=hands, target=targets)
    longer = arrays(np.concatenate([flat, np.ones((5, 2), np.float32)], axis=-1))
    goals = GOALS.encode(angles, speeds, hand=hands, target=targets)
    goals = {name: arrays(value) for name, value in goals.items()}
    offsets = targets - hands
    large = offsets / (OFFSET_SCALE + np.linalg.norm(offsets, axis=-1, keepdims=True))
    from_first = np.exp(-1j * angles[:, :1])  # vectors are seen from the first segment
    seen = ((vectors @ [[1], [1j]]) * from_first for vectors in (targets, offsets, large))
    seen = (np.hstack([vectors.real, vectors.imag]) for vectors in seen)
    expected = (np.cos(angles), np.sin(angles), speeds, *seen)
    for observation in (longer, goals):
        parts = LAYOUT.split(observation, module)
        for part, values in zip(parts, expected, strict=True):
            np.testing.assert_allclose(part, values, atol=2e-6)
    np.testing.assert_allclose(LAYOUT.flatten(goals, module), flat, atol=2e-6)
    assert LAYOUT.flatten(longer, module) is longer


@pytest.mark.parametrize("env_id", ["MMCReach-v0", "MMCReachGoal-v0"])
def test_the_layout_knows_the_spaces_of_the_environments(env_id):
    space = gym.make(env_id).observation_space
    is_dict = isinstance(space, gym.spaces.Dict)
    high = space["desired_goal"].high[0] if is_dict else LAYOUT.reach
    assert high == pytest.approx(LAYOUT.reach, rel=1e-6)
    assert space == (LAYOUT.goal_space(high) if is_dict else LAYOUT.space())
    assert LAYOUT.additions(space) == 0
    assert ObservationLayout(2, 2.0).additions(space) == 3
    with pytest.raises(UserError, match="must be that of a reaching environment with 4 joints"):
        ObservationLayout(4, 4.0).additions(space)


FLAT = np.zeros(15)
GOAL = {"observation": np.zeros(9), "achieved_goal": np.zeros(2), "desired_goal": np.zeros(2)}


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (np.append(FLAT, 0), r"observation must be of shape \(..., 15\), got \(16,\)"),
        ("far", "observation must be .* numbers, got 'far'"),
        (np.append(FLAT[1:], np.nan), r"observation must be finite, got array"),
        ({"observation": np.zeros(9)}, "mapping with observation, achieved_goal"),
        (GOAL | {"desired_goal": np.zeros((2, 2))}, "arrays with the same batch axes, got {'obse"),
        (GOAL | {"achieved_goal": [0, 0, 0]}, r"\['achieved_goal'\] must be of shape"),
    ],
)
@pytest.mark.parametrize("name", ["mmc", "mmc-body", "optimal-control", "ppo", "random"])
def test_every_agent_refuses_what_is_no_observation(name, wrong, message, env):
    with pytest.raises(UserError, match=message):
        make_agent(name, env).predict(wrong)


@pytest.mark.parametrize("control", ["joint_position", "joint_delta"])
def test_an_action_means_to_the_servo_what_the_agent_meant(control):
    body = ArmParameters()
    meaning = action_meaning(control, body)
    interface = ReachInterface((1.0,) * 3, control, body.speed_limit, body.servo_gain, 0.02)
    now, goal = np.array([0.1, -0.5, 3.0]), np.array([0.3, -0.6, 3.1])
    command = meaning.scale * interface.act(goal, Sensed(now, np.zeros(2)))
    np.testing.assert_allclose(command + meaning.is_relative * now, goal, atol=1e-6)
    assert meaning.servo == "position"


def test_an_agent_that_cannot_act_says_so_in_any_process():
    error = pickle.loads(pickle.dumps(ControlError("control must be another", "joint_torque")))
    assert (str(error), error.control) == ("control must be another", "joint_torque")
