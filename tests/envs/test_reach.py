"""Facts about MMCReach-v0 and MMCReachGoal-v0."""

import math
from dataclasses import fields
from functools import partial
from itertools import product

import numpy as np
import pytest
import torch
from scipy import stats

import mmc_gym
from mmc_gym import UserError
from mmc_gym.body import ArmParameters
from mmc_gym.envs.perturbations import FAMILIES
from mmc_gym.envs.reach import MMCReachEnv, MMCReachGoalEnv, precision
from mmc_gym.envs.vector import MMCReachVectorEnv
from mmc_gym.geometry import segments_from_joint_angles
from mmc_gym.interface import CONTROLS, ObservationLayout, ReachInterface, relative_speeds
from tests.envs.conftest import LIMITS, random_actions, same

EXTREME = (1e308, 1e9, 1e-9, 1e-320, -1e308, -0.0, math.inf, math.nan)
SHAPES = {
    "gravity": lambda value: (0.0, value),
    "segment_lengths": lambda value: (1.0, value),
    "segment_masses": lambda value: (1.0, 1.0, value),
    "force_field": lambda value: ((value, 0.0), (0.0, value)),
}
NUMBERS = ["control_weight", "precision_weight", "smoothness_weight", "success_distance"]
NUMBERS += [field.name for field in fields(ArmParameters) if field.type == "float"]
NUMBERS += [*SHAPES]
STRENGTHS = [(name, "strength") for name in FAMILIES] + [("gain", "at"), ("gain", "over")]


def hand_of(joint_angles, lengths=(1.0,) * 3):
    return segments_from_joint_angles(np.array(joint_angles, float), lengths).sum(axis=-2)


def joint_angles(observation):
    return np.arctan2(observation[3:6], observation[:3])


def future(env, seed):
    """What some rough steps return, and what the next episodes start from."""
    actions = random_actions(env, 40, seed, hold=2)
    return [*map(env.step, actions), env.reset(), env.step(actions[0]), env.reset()]


@pytest.mark.parametrize("target", [(0.0, 0.0), (3 * math.cos(1.0), 3 * math.sin(1.0))])
@pytest.mark.parametrize("turns", [0, 1])  # whole ones do not matter
def test_options_set_posture_and_target(turns, target):
    env, posture = MMCReachEnv(joint_limits=LIMITS), np.array([0.5, 1.0, 2.0])
    angles = posture + turns * math.tau * np.array([1, -1, 0])
    observation, info = env.reset(options={"joint_angles": angles, "target": target})
    np.testing.assert_allclose(info["end_effector"], hand_of(posture), atol=1e-12)
    assert info["target"].tolist() == list(target)
    np.testing.assert_allclose(joint_angles(observation), posture, atol=1e-6)
    np.testing.assert_array_equal(observation[6:9], 0)
    assert env.observation_space.contains(env.step(np.zeros(3, np.float32))[0])
    with pytest.raises(UserError, match="within the joint limits"):
        env.reset(options={"joint_angles": [0.0] * 3})


@pytest.mark.parametrize(
    ("options", "other"),
    [
        ({"joint_angles": [0.1, 0.2, 0.3]}, "target"),
        ({"target": [1.0, 1.0], "joint_angles": None}, "end_effector"),
    ],
)
def test_an_option_for_one_does_not_change_the_draw_of_the_other(options, other):
    env = MMCReachEnv()
    drawn, following = env.reset(seed=5)[1], env.reset()[1]
    assert env.reset(seed=5, options=options)[1][other].tolist() == drawn[other].tolist()
    assert same(env.reset()[1], following)


@pytest.mark.parametrize("limits", [None, LIMITS])
def test_postures_are_drawn_uniformly(limits):
    env = MMCReachEnv(joint_limits=limits)
    env.reset(seed=0)
    observations = np.array([env.reset()[0] for _ in range(2000)])
    angles = np.arctan2(observations[:, 3:6], observations[:, :3])
    for joint, (low, high) in zip(angles.T, limits or ((-math.pi, math.pi),) * 3, strict=True):
        assert stats.kstest(joint, stats.uniform(low, high - low).cdf).pvalue > 0.01


@pytest.mark.parametrize(
    ("lengths", "weight", "smoothness"),
    [((1.0,), 0.1, 0.0), ((2.0, 0.7), 0.7, 2.0), ((1.0, 0.8, 0.6, 0.4, 0.2), 0.1, 2.0)],
)
@pytest.mark.parametrize("control", CONTROLS)
def test_observation_and_info_tell_the_state(lengths, control, weight, smoothness):
    weights = {"control_weight": weight, "smoothness_weight": smoothness}
    env = MMCReachEnv(segment_lengths=lengths, control=control, **weights)
    rewards = {"reward_distance", "reward_precision", "reward_control"}
    rewards |= {"reward_smoothness"} if smoothness else set()
    count, before = len(lengths), 0.0
    assert env.reset(seed=0)[1].get("reward_smoothness", 0.0) == 0.0
    env.action_space.seed(0)
    for _ in range(60):
        observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
        assert (terminated, truncated) == (False, False)
        assert set(info) == {"distance", "is_success", "end_effector", "target"} | rewards
        places = {"hand": info["end_effector"], "target": info["target"]}
        angles = env.arm.joint_angles
        speeds = relative_speeds(np.array(env.arm.joint_velocities), math.tau)
        expected = ObservationLayout(count, sum(lengths)).encode(angles, speeds, **places)
        np.testing.assert_allclose(observation, expected, atol=1e-6)
        np.testing.assert_allclose(info["end_effector"], hand_of(angles, lengths), atol=1e-9)
        assert info["distance"] == pytest.approx(math.dist(*places.values()))
        assert info["is_success"] == (info["distance"] <= 0.05)
        assert info["reward_distance"] == -info["distance"]
        assert info["reward_control"] == pytest.approx(-weight * np.mean(speeds**2), abs=1e-6)
        assert info["reward_precision"] == precision(info["distance"], weight=1.0)
        if smoothness:
            cost = -smoothness * np.mean((speeds - before) ** 2)
            assert info["reward_smoothness"] == pytest.approx(cost, abs=1e-5)
        before = speeds
        assert reward == pytest.approx(sum(map(info.get, rewards)), rel=1e-12)


def test_joints_go_to_pi_times_the_action_and_standing_at_the_target_is_never_the_end():
    env = MMCReachEnv(control="joint_position", precision_weight=2.5)
    action = np.array([0.25, -0.5, 0.75], np.float32)
    env.reset(seed=0, options={"target": hand_of(math.pi * action.astype(float))})
    ends = [env.step(action) for _ in range(300)]
    np.testing.assert_allclose(joint_angles(ends[99][0]), math.pi * action, atol=1e-4)
    assert not any(terminated or truncated for _, _, terminated, truncated, _ in ends)
    assert all(info["is_success"] for *_, info in ends[100:])
    assert ends[-1][1] == pytest.approx(2.5, abs=0.1)
    # … and half of the weight is paid five hundredths away.
    assert [precision(distance, weight=2.5) for distance in (0.0, 0.05)] == [2.5, 1.25]


@pytest.mark.parametrize(("control", "fraction"), [("joint_delta", 0.85), ("joint_velocity", 1.0)])
@pytest.mark.parametrize("action", [1.0, -1.0, 0.5, 0.0])
def test_a_held_action_turns_the_joint_at_the_documented_speed(control, fraction, action):
    env = MMCReachEnv(control=control, segment_lengths=(1.0,))
    env.reset(seed=0)
    angles = []
    for _ in range(40):
        observation, *_ = env.step(np.array([action], np.float32))
        angles.append(math.atan2(observation[1], observation[0]))
    speed = math.remainder(angles[-1] - angles[-2], math.tau) / 0.02
    assert speed / math.tau == pytest.approx(fraction * action, abs=0.005)
    if control == "joint_velocity":  # the other slows down within each step
        assert observation[2] == pytest.approx(speed / math.tau, abs=0.005)


@pytest.mark.parametrize("cls", [MMCReachEnv, MMCReachGoalEnv])
def test_a_moved_target_is_seen_and_rewarded_at_the_next_step_and_nothing_else_changes(cls):
    moved, other = cls(), cls()
    for env in (moved, other):
        env.reset(seed=0)
    moved.set_target(np.array([1.0, -2.0]))
    for action in random_actions(other, 20):
        observation, _, _, _, info = moved.step(action)
        *_, same_arm = other.step(action)
        assert info["target"].tolist() == [1.0, -2.0]
        assert info["end_effector"].tolist() == same_arm["end_effector"].tolist()
        assert info["distance"] == pytest.approx(math.dist(info["end_effector"], (1.0, -2.0)))
        sensed = ReachInterface.of(moved).sense(observation)
        np.testing.assert_allclose(sensed.target, [1.0, -2.0], atol=1e-6)
    assert same(moved.reset(), other.reset())


LONG = partial(MMCReachEnv, segment_lengths=(3.0, 1.0, 0.5))
PAPER = partial(MMCReachEnv, task="paper")
FIVE = partial(MMCReachVectorEnv, 5)
NOT_A_NUMBER = np.where(np.arange(5) == 3, np.nan, 0)[:, None] * np.ones(3)


@pytest.mark.parametrize(
    ("make", "call", "message"),
    [
        (LONG, lambda env: env.step([0.0, math.nan, 0.0]), "action must lie within -1 and 1"),
        (LONG, lambda env: env.step([0.0, 0.0]), "action must have shape"),
        (LONG, lambda env: env.step("abc"), "action must be numbers"),
        (LONG, lambda env: env.set_target((1.0, 0.0)), r"between 1\.5 and 4\.5 from the base"),
        (FIVE, lambda env: env.step(np.zeros((5, 2))), "actions must have shape"),
        (FIVE, lambda env: env.step(NOT_A_NUMBER), "within -1 and 1.*arm 3"),
        (FIVE, lambda env: env.step(torch.zeros(5, 3, requires_grad=True)), "detach"),
        (FIVE, lambda env: env.reset(seed=[1, 2]), "seed must be .*5 of them"),
        *(
            (make, lambda env, options=options: env.reset(seed=7, options=options), message)
            for make, options, message in [
                (LONG, {"goal": (0, 0)}, "'goal' is not accepted"),
                (LONG, {"target": "there"}, r"options\['target'\] must be 2 finite"),
                (LONG, {"joint_angles": (0, 0)}, r"options\['joint_angles'\] must be 3 finite"),
                (LONG, {"joint_angles": (0, 0, 0), "target": (9, 9)}, r"options\['target'\]"),
                (MMCReachEnv, {"trial": 0}, r"options\['trial'\] must"),
                (PAPER, {"trial": 420}, r"options\['trial'\] must"),
                (PAPER, {"trial": 1.5}, r"options\['trial'\] must"),
                (FIVE, {"reset_mask": np.ones(5)}, "reset_mask.*5 bools"),
                (FIVE, {"goal": 0}, "options 'goal'"),
                (FIVE, 5, "options must be a mapping.*got 5"),
            ]
        ),
    ],
)
def test_bad_input_is_refused_and_leaves_no_trace(make, call, message):
    tried, untried = make(), make()
    for env in (tried, untried):
        env.reset(seed=0)
        future(env, seed=1)
        env.step(np.full(env.action_space.shape, 0.7, np.float32))  # in full swing
    with pytest.raises((ValueError, RuntimeError), match=message):
        call(tried)
    assert same(future(tried, seed=2), future(untried, seed=2))


def with_number(name, value):
    """The arguments of an environment with this value of a number or of a perturbation's."""
    if isinstance(name, str):
        return {name: SHAPES.get(name, float)(value)}
    family, field = name
    return {"perturbations": [FAMILIES[family](**{field: value})]}


@pytest.mark.parametrize("name", [*NUMBERS, *STRENGTHS], ids=str)
def test_extreme_numbers_are_refused_or_leave_everything_finite(engine, name):
    for value, control in product(EXTREME, ("joint_delta", "joint_torque")):
        try:
            env = MMCReachEnv(**with_number(name, value), engine=engine, control=control)
        except UserError:
            continue
        env.reset(seed=0)
        for turn in (1.0, 1.0, -1.0, 1.0):
            action = np.full(env.action_space.shape, turn, np.float32)
            try:
                observation, reward, *_ = env.step(action)
            except UserError as error:
                assert "joint velocities must stay below" in str(error)
                break
            assert np.isfinite([*observation, reward]).all(), (value, control)


@pytest.mark.parametrize("make", [MMCReachEnv, partial(MMCReachVectorEnv, 2)])
def test_a_movement_out_of_control_raises_an_error_and_a_reset_mends_it(engine, make):
    env = make(engine=engine, control="joint_velocity", drive_inertia=0.0, gravity=(0.0, -1e6))
    action = np.zeros(env.action_space.shape, np.float32)
    start = env.reset(seed=0)
    with pytest.raises(UserError, match=r"joint velocities must stay below 628\.3 rad/s"):
        for _ in range(100):
            env.step(action)
    assert same(env.reset(seed=0), start)


@pytest.mark.parametrize("name", ["random", "endpoint-feedback+vision-noise", "channel"])
def test_infos_have_a_dtype(name):
    """As those of Gymnasium's MuJoCo environments; TorchRL reads it (`auto_register_info_dict`)."""
    env = mmc_gym.make(name, smoothness_weight=1.0)
    for info in (env.reset(seed=0)[1], env.step(np.zeros(3, np.float32))[-1]):
        kinds = {key: value.dtype for key, value in info.items()}
        bools = {"is_success", "is_hand_seen"}
        assert kinds == {key: bool if key in bools else float for key in kinds}


def test_torchrl_registers_the_infos():
    gym_wrapper = pytest.importorskip("torchrl.envs").GymWrapper
    env = gym_wrapper(mmc_gym.make("random")).auto_register_info_dict()
    steps = env.rollout(3)["next"]
    assert steps["distance"].shape == steps["is_success"].shape == (3,)
    assert steps["is_success"].dtype == torch.bool


@pytest.mark.parametrize("make", [MMCReachEnv, MMCReachGoalEnv])
def test_success_ends_an_episode_if_asked_to_and_changes_nothing_before(make):
    plain, ending = (make(success_distance=0.5, terminate_on_success=b) for b in (False, True))
    posture = {"joint_angles": [0.0, 0.5, 0.5]}
    assert same(plain.reset(seed=3, options=posture), ending.reset(seed=3, options=posture))
    action, ends = np.array([1.0, 0.1, -0.1], np.float32), []
    for _ in range(60):
        *_, info = expected = plain.step(action)
        observation, reward, terminated, truncated, _ = actual = ending.step(action)
        assert same((*expected[:2], *expected[3:]), (observation, reward, *actual[3:]))
        assert (type(terminated), truncated, expected[2]) == (bool, False, False)
        assert terminated == info["is_success"]
        ends.append(terminated)
        if make is MMCReachGoalEnv:
            goals = observation["achieved_goal"], observation["desired_goal"]
            assert ending.compute_terminated(*goals, info) == terminated
            many = [np.stack([goal] * 4).reshape(2, 2, 2) for goal in goals]
            assert ending.compute_terminated(*many, {}).tolist() == [[terminated] * 2] * 2
            assert not plain.compute_terminated(*goals, info)
            assert not ending.compute_truncated(*goals, info)
    assert any(ends) and not all(ends)
    with pytest.raises(UserError, match="terminate_on_success must be True or False, got 'yes'"):
        make(terminate_on_success="yes")


@pytest.mark.parametrize("reward_type", ["sparse", "dense"])
def test_relabelled_transitions_have_the_reward_of_the_step_and_no_end(reward_type):
    env = MMCReachGoalEnv(reward_type=reward_type, success_distance=1.0)
    env.action_space.seed(0)
    goals, rewards = [], []
    for step in range(200):
        if step % 50 == 0:
            env.reset(seed=step)
        observation, reward, _, _, info = env.step(env.action_space.sample())
        goals.append((observation["achieved_goal"], observation["desired_goal"]))
        rewards.append(reward)
        assert env.compute_reward(*goals[-1], info) == reward
        if reward_type == "sparse":
            assert reward == (0.0 if info["distance"] <= 1.0 else -1.0) == info["is_success"] - 1
        np.testing.assert_array_equal(goals[-1], [info["end_effector"], info["target"]])
    achieved, desired = np.moveaxis(goals, 1, 0)
    assert env.compute_reward(achieved, desired, [{}] * 200).tolist() == rewards
    assert env.compute_reward(achieved.reshape(4, 50, 2), desired[0], {}).shape == (4, 50)
    assert len(set(rewards)) > 1
    for ends in (env.compute_terminated, env.compute_truncated):  # as GoalEnv has them
        assert not ends(*goals[-1], {})
        assert ends(achieved, desired, {}).tolist() == [False] * 200
