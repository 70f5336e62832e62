"""The contract between environments and agents: observations, actions, and what is told."""

import pickle

import gymnasium as gym
import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from mmc_gym._errors import UserError
from mmc_gym.body import ArmParameters
from mmc_gym.interface import (
    CONTROLS,
    CannotActError,
    ControlError,
    ObservationLayout,
    ReachInterface,
    Sensed,
    action_meaning,
    relative_speeds,
)

LAYOUT = ObservationLayout(joint_count=3, reach=3.0)


def arms(seed, count=5, joints=3):
    """Joint angles, relative speeds, hands and targets, some of these beyond the reach."""
    random = np.random.default_rng(seed)
    return (
        random.uniform(-np.pi, np.pi, (count, joints)),
        random.uniform(-1, 1, (count, joints)),
        random.uniform(-2, 2, (count, 2)) * joints,
        random.uniform(-2, 2, (count, 2)) * joints,
    )


@given(st.integers(0, 2**31), st.integers(1, 5), st.booleans())
def test_one_arm_is_encoded_as_many_are(seed, joints, clip):
    layout = ObservationLayout(joints, float(joints))
    angles, speeds, hands, targets = arms(seed, joints=joints)
    many = layout.encode(angles, speeds, hand=hands, target=targets, clip=clip)
    goals = layout.encode_goals(angles, speeds, hand=hands, target=targets)
    assert many.shape == (5, layout.size)
    assert many.dtype == np.float32
    assert (np.abs(many).max() <= 1.0) or not clip
    for index, (angle, speed) in enumerate(zip(angles.tolist(), speeds.tolist())):
        place = {"hand": tuple(hands[index]), "target": tuple(targets[index])}
        one = layout.encode_one(angle, speed, clip=clip, **place)
        np.testing.assert_allclose(one, many[index], atol=1e-7)
        for name, value in layout.encode_goals_of_one(angle, speed, **place).items():
            np.testing.assert_allclose(value, goals[name][index], atol=1e-7)
            assert value.dtype == goals[name].dtype


@pytest.mark.parametrize("arrays", [np.asarray, torch.from_numpy])
def test_an_observation_of_either_kind_is_split_into_what_was_encoded(arrays):
    angles, speeds, hands, targets = arms(0)
    flat = LAYOUT.encode(angles, speeds, hand=hands, target=targets)
    longer = np.concatenate([flat, np.ones((5, 2), np.float32)], axis=-1)
    goals = LAYOUT.encode_goals(angles, speeds, hand=hands, target=targets)
    for observation, rest in (
        (arrays(longer), 2),
        ({name: arrays(value) for name, value in goals.items()}, 0),
    ):
        parts = LAYOUT.split(observation)
        expected = (np.cos(angles), np.sin(angles), speeds, targets / 3, (targets - hands) / 6)
        for part, values in zip(parts, expected):
            np.testing.assert_allclose(part, values, atol=1e-6)
        assert parts.rest.shape == (5, rest)


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


@pytest.mark.parametrize("env_id", ["MMCReach-v0", "MMCReachGoal-v0"])
def test_posture_target_and_hand_are_read_off_an_observation(env_id):
    env = gym.make(env_id, perturbations="longer-20")
    options = {"joint_angles": [0.3, 0.6, -0.6], "target": [-1.0, 1.5]}
    observation, info = env.reset(seed=0, options=options)
    interface = ReachInterface.of(env)
    sensed = interface.sense(observation)
    np.testing.assert_allclose(sensed.joint_angles, options["joint_angles"], atol=1e-6)
    np.testing.assert_allclose(sensed.target, options["target"], atol=1e-6)
    np.testing.assert_allclose(interface.seen_hand(observation), info["end_effector"], atol=1e-6)


def test_speeds_are_told_as_fractions_of_their_limit():
    found = relative_speeds(np.array([-9.0, -1.0, 0.5, 9.0]), 2.0)
    np.testing.assert_array_equal(found, [-1.0, -0.5, 0.25, 1.0])


@pytest.mark.parametrize("control", ["joint_position", "joint_delta"])
def test_an_action_means_to_the_servo_what_the_agent_meant(control):
    body = ArmParameters()
    meaning = action_meaning(control, body)
    interface = ReachInterface((1.0,) * 3, control, body.speed_limit, body.servo_gain, 0.02)
    now, wanted = np.array([0.1, -0.5, 3.0]), np.array([0.3, -0.6, 3.1])
    command = meaning.scale * interface.act(wanted, Sensed(now, np.zeros(2)))
    np.testing.assert_allclose(command + meaning.is_relative * now, wanted, atol=1e-6)
    assert meaning.servo == "position"


def test_every_control_mode_has_a_meaning():
    meanings = [action_meaning(control, ArmParameters()) for control in CONTROLS]
    assert len(set(meanings)) == len(CONTROLS)
    assert [one.servo for one in meanings] == ["position", "position", "velocity", "torque"]


def test_an_agent_that_cannot_act_says_so_by_an_error_of_the_user_in_any_process():
    error = pickle.loads(pickle.dumps(ControlError("control must be another", "joint_torque")))
    assert (str(error), error.control) == ("control must be another", "joint_torque")
    assert isinstance(error, CannotActError)
    assert isinstance(error, UserError)
