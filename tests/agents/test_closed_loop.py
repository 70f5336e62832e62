"""Agents in closed loop: what they find out about their body, and how well they reach with it."""

from functools import cache

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mmc_gym import make_agent
from mmc_gym.agents.body_model.drive import command_of, commanded_turn, expected_turn
from mmc_gym.agents.closed_loop.agent import (
    LOOPS,
    ClosedLoopInverseKinematicsAgent,
    closed_loop_mmc,
)
from mmc_gym.agents.closed_loop.identification import Delay, Lengths, Locks
from mmc_gym.agents.closed_loop.observer import Loops
from mmc_gym.agents.ik.iterative import damped_least_squares
from mmc_gym.envs.perturbations import LockedJoint, VisuomotorRotation
from mmc_gym.envs.scenarios import environment_id
from mmc_gym.interface import ReachInterface
from mmc_gym.network.chain import segments_from_joint_angles

EPISODES = 300
CLOSED = (*(f"mmc-{name}" for name in LOOPS), "ik-dls-feedback")


def play(agent, env_id="MMCReach-v0", steps=100, episodes=EPISODES, seed=60_000, **options):
    """Whether the hand is at the target, (steps, episodes), and the agent's last state."""
    envs = gym.make_vec(env_id, num_envs=episodes, max_episode_steps=1000, **options)
    (observations, _), state = envs.reset(seed=seed), None
    successes = []
    for _ in range(steps):
        actions, state = agent.predict(observations, state)
        assert np.isfinite(actions).all()
        observations, _, _, _, infos = envs.step(actions)
        successes.append(infos["is_success"])
    return np.array(successes), state


@cache
def outcome(name, env_id="MMCReach-v0", **options):
    """The share of episodes that end at the target, and the median steps until it stays there."""
    successes = play(make_agent(name, gym.make(env_id, **options)), env_id, **options)[0]
    stays = np.logical_and.accumulate(successes[::-1])[::-1]
    times = (stays.argmax(axis=0) + 1)[stays[-1]]
    return len(times) / EPISODES, np.median(times) if len(times) else np.inf


def last_memory(perturbations, steps=60):
    """What mmc-closed remembers after a while, of arms with the perturbations."""
    options = {"perturbations": perturbations}
    agent = make_agent("mmc-closed", gym.make("MMCReach-v0", **options))
    return play(agent, steps=steps, episodes=50, seed=70_000, **options)[1].memory


def length_errors(memory, last):
    """By how much a length is wrong at most, where that of the last segment is `last`."""
    return np.abs(memory.lengths.best((1.0,) * 3) - [1.0, 1.0, last]).max(axis=-1)


def success(name, env_id="MMCReach-v0", **options):
    return outcome(name, env_id, **options)[0]


def median_time(name, **options):
    return outcome(name, **options)[1]


def open_loop(name):
    return "ik-dls" if name.startswith("ik") else "mmc"


@pytest.mark.parametrize("perturbations", [(), ("longer-20",), ("joint-noise", "delay-100")])
@pytest.mark.parametrize("control", ["joint_position", "joint_delta"])
def test_with_all_loops_open_it_is_mmc_bit_for_bit(perturbations, control):
    options = {"perturbations": perturbations, "control": control, "task": "double-step-100"}
    envs = gym.make_vec("MMCReach-v0", num_envs=20, max_episode_steps=30, **options)
    mmc, opened = make_agent("mmc", envs), closed_loop_mmc(ReachInterface.of(envs), Loops())
    (observations, _), state, same = envs.reset(seed=0), None, None
    over = np.zeros(20, dtype=bool)
    for _ in range(50):
        expected, state = mmc.predict(observations, state, over)
        actions, same = opened.predict(observations, same, over)
        np.testing.assert_array_equal(actions, expected)
        np.testing.assert_array_equal(same.model.values, state.values)
        observations, _, _, over, _ = envs.step(actions)


def test_inverse_kinematics_with_all_loops_open_is_ik_dls():
    env = gym.make("MMCReach-v0")
    opened = ClosedLoopInverseKinematicsAgent(ReachInterface.of(env), Loops(), damped_least_squares)
    solver, (observation, _) = make_agent("ik-dls", env), env.reset(seed=0)
    state = same = None
    for _ in range(30):
        expected, state = solver.predict(observation, state)
        action, same = opened.predict(observation, same)
        np.testing.assert_array_equal(action, expected)
        observation, *_ = env.step(action)


@pytest.mark.parametrize("name", CLOSED)
def test_on_a_body_as_told_closing_the_loop_costs_next_to_nothing(name):
    assert success(name) >= success(open_loop(name)) - 0.01
    assert median_time(name) <= median_time(open_loop(name)) + 2  # control steps


@pytest.mark.parametrize(
    ("name", "perturbation", "at_least"),
    [
        *((name, "longer-50", 0.97) for name in ("mmc-feedback", "mmc-lengths", "mmc-closed")),
        *((name, "shorter-20", 0.97) for name in ("mmc-feedback", "mmc-lengths", "mmc-closed")),
        *((name, "rotation-30", 0.95) for name in ("mmc-feedback", "mmc-closed")),
        *(("mmc-feedback", "rotation-45", 0.88), ("mmc-closed", "rotation-45", 0.85)),
        *((name, "locked", 0.9) for name in ("mmc-lock", "mmc-closed")),
        *((name, "locks", 0.5) for name in ("mmc-lock", "mmc-closed")),
        ("mmc-feedback", "locked", 0.4),
        ("ik-dls-feedback", "longer-50", 0.97),
        ("ik-dls-feedback", "rotation-45", 0.95),
        ("ik-dls-feedback", "locked", 0.65),
    ],
)
def test_reaches_what_it_does_not_reach_in_open_loop(name, perturbation, at_least):
    assert success(open_loop(name), perturbations=perturbation) <= 0.25
    assert success(name, perturbations=perturbation) >= at_least


@pytest.mark.parametrize("name", ["mmc-feedback", "mmc-closed"])
def test_a_cursor_that_is_turned_far_only_takes_longer(name):
    options = {"perturbations": "rotation-45"}
    agent = make_agent(name, gym.make("MMCReach-v0", **options))
    assert play(agent, steps=150, **options)[0][-1].mean() >= 0.98


@pytest.mark.parametrize(
    "perturbation",
    ["force-field", "hand-mass", "joint-noise", "vision-noise", "delay-200", "longer-50-told"],
)
@pytest.mark.parametrize("name", CLOSED)
def test_what_is_reached_in_open_loop_is_reached_still(name, perturbation):
    at_least = success(open_loop(name), perturbations=perturbation) - 0.04
    assert success(name, perturbations=perturbation) >= at_least


def test_what_feedback_loses_in_time_to_a_delay_is_won_back_by_bridging_it():
    late = {"perturbations": "delay-200", "control": "joint_position"}
    assert median_time("mmc-feedback", **late) > 1.3 * median_time("mmc", **late)
    assert median_time("mmc-delay", **late) < 1.1 * median_time("mmc", **late)


@pytest.mark.parametrize(
    ("control", "delay"),
    [
        ("joint_velocity", "delay-100"),
        ("joint_velocity", "delay-200"),
        ("joint_delta", "delay-200"),
    ],
)
def test_control_relative_to_the_joints_needs_a_long_delay_bridged(control, delay):
    late = {"perturbations": delay, "control": control}
    assert success("mmc", **late) <= 0.2
    assert success("mmc-delay", **late) >= 0.95
    assert success("mmc-closed", **late) >= 0.95


def test_all_loops_together_bear_with_all_troubles_together():
    troubles = {"perturbations": ("longer-20", "locked", "delay-100", "joint-noise")}
    assert success("mmc-closed", **troubles) >= 0.93
    for name in ("mmc", "mmc-feedback", "mmc-lengths", "mmc-lock"):
        assert success(name, **troubles) <= 0.65


@pytest.mark.parametrize("lengths", [(1.0, 1.0), (2.0, 1.0, 0.5, 0.25), (0.5,) * 5])
@pytest.mark.parametrize("perturbation", ["longer-20", "locked", "rotation-30"])
def test_arms_of_other_segments(lengths, perturbation):
    options = {"segment_lengths": lengths, "success_distance": 0.1}
    assert success("mmc-closed", perturbations=perturbation, **options) >= 0.9


@pytest.mark.parametrize("name", CLOSED)
@pytest.mark.parametrize("task", ["double-step-200", "via-points"])
def test_targets_that_jump(name, task):
    agent = make_agent(name, gym.make(environment_id(task)))
    assert play(agent, steps=200, task=task)[0][-1].mean() >= 0.97


@pytest.mark.parametrize("name", ["mmc-feedback", "mmc-closed"])
def test_a_target_that_moves_is_pursued_as_closely_as_in_open_loop(name):
    options = {"steps": 300, "episodes": 50, "task": "pursuit", "success_distance": 0.3}
    env = gym.make("MMCReachPursuit-v0")
    open_, closed = (play(make_agent(one, env), **options)[0][50:] for one in ("mmc", name))
    assert closed.mean() >= open_.mean() - 0.05


@pytest.mark.parametrize("name", CLOSED)
def test_goal_observations_are_understood(name):
    at_least = 0.0 if name == "mmc-lock" else 0.97
    assert success(name, "MMCReachGoal-v0", perturbations="longer-20") >= at_least


@settings(max_examples=30)
@given(st.integers(2, 5), st.integers(0, 2**31), st.sampled_from(CLOSED))
def test_actions_are_valid_whatever_is_observed(count, seed, name):
    env = gym.make("MMCReach-v0", segment_lengths=(1.0,) * count)
    agent, random, state = make_agent(name, env), np.random.default_rng(seed), None
    for _ in range(30):
        observation = random.uniform(-1, 1, 3 * count + 6).astype(np.float32)
        if random.random() < 0.2:
            observation[:] = 0.0
        action, state = agent.predict(observation, state)
        assert env.action_space.contains(action)


def test_what_is_accepted():
    interface = ReachInterface.of(gym.make("MMCReach-v0"))
    with pytest.raises(ValueError, match="posture_weight must be finite and not negative"):
        Loops(posture_weight=-1.0)
    with pytest.raises(ValueError, match="hand_rate must be between 0 and 1, got 2"):
        Loops(hand_rate=2.0)
    with pytest.raises(ValueError, match=r"posture_weight must be less than .* = 2, got 4"):
        closed_loop_mmc(interface, Loops(posture_weight=4.0))
    with pytest.raises(ValueError, match="loops must be feedback and delay alone"):
        ClosedLoopInverseKinematicsAgent(interface, LOOPS["lock"], damped_least_squares)


@pytest.mark.parametrize(
    ("perturbation", "true"),
    [("longer-10", 1.1), ("longer-50", 1.5), ("shorter-20", 0.8), ("shorter-50", 0.5)],
)
def test_identified_lengths_converge_to_the_true_ones(perturbation, true):
    errors = length_errors(last_memory(perturbation), true)
    assert np.median(errors) < 0.005
    assert np.quantile(errors, 0.9) < 0.05


def test_a_few_control_steps_suffice():
    assert np.median(length_errors(last_memory("longer-50", steps=10), 1.5)) < 0.05


@pytest.mark.parametrize(
    ("perturbation", "at_least"),
    [
        *((name, 0.9) for name in ("joint-noise", "vision-noise", "delay-100", "locked")),
        (VisuomotorRotation(30.0, centre=(0.0, 1.5)), 0.9),
        ("rotation-30", 0.75),  # about the base
    ],
)
def test_other_troubles_are_seldom_taken_for_other_lengths(perturbation, at_least):
    assert (length_errors(last_memory(perturbation), 1.0) < 0.02).mean() >= at_least


@given(st.integers(2, 5), st.integers(0, 2**31))
def test_any_lengths_are_found_from_random_postures(count, seed):
    random = np.random.default_rng(seed)
    true = random.uniform(0.5, 1.6, count)
    told = (1.0,) * count
    lengths = Lengths.told(told, ())
    for _ in range(60):
        posture = random.uniform(-np.pi, np.pi, count)
        hand = segments_from_joint_angles(posture, true).sum(axis=-2)
        lengths = lengths.observed(posture, hand, told)
    np.testing.assert_allclose(lengths.best(told), true, atol=0.005)


def test_an_arm_at_rest_tells_its_lengths_once():
    lengths = Lengths.told((1.0, 1.0), ())
    posture, hand = np.array([0.2, 0.3]), np.array([1.9, 0.9])
    once = lengths.observed(posture, hand, (1.0, 1.0))
    twice = once.observed(posture, hand, (1.0, 1.0))
    np.testing.assert_array_equal(once.mean, twice.mean)
    np.testing.assert_array_equal(once.covariance, twice.covariance)
    assert not np.array_equal(once.mean, lengths.mean)


@pytest.mark.parametrize(("joint", "time"), [(0, 0.0), (1, 0.0), (2, 0.0), (1, 0.2)])
def test_the_joint_that_is_locked_is_found_and_no_other(joint, time):
    locks = last_memory(LockedJoint(joint=joint, time=time)).locks
    found = (locks.is_locked > 0).mean(axis=0)
    assert found[joint] >= 0.6  # elsewhere it is not asked for enough to matter
    assert np.delete(found, joint).max() <= 0.04


@pytest.mark.parametrize(
    "perturbation",
    [(), "joint-noise", "vision-noise", "longer-50", "rotation-30", "delay-100", "delay-200"],
)
def test_a_joint_that_is_free_is_seldom_taken_as_locked(perturbation):
    assert (last_memory(perturbation).locks.is_locked > 0).any(axis=-1).mean() <= 0.04


def test_a_joint_told_to_lock_is_found_sooner():
    steps = []
    for lockable in ((1,), ()):
        locks, step = Locks.none(np.zeros(3)), 0
        while not locks.is_locked.any():
            step += 1
            posture, asked = np.array([0.2 * step, 0.0, 0.0]), np.array([0.1, 0.1, 0.0])
            locks = locks.observed(posture, asked, lockable)
        np.testing.assert_array_equal(locks.is_locked, [0, 1, 0])
        steps.append(step)
    assert steps[0] < steps[1] < 20


def test_a_locked_joint_that_is_seen_elsewhere_is_free_again():
    locks = Locks.none(np.zeros(2))
    for step in range(20):
        posture = np.array([0.2 * step, 0.0])
        locks = locks.observed(posture, np.array([0.2, 0.1]))
    assert locks.is_locked.tolist() == [0, 1]
    locks = locks.observed(np.array([4.0, 0.2]), np.array([0.2, 0.1]))
    assert locks.is_locked.tolist() == [0, 0]


@pytest.mark.parametrize(
    ("perturbation", "steps"), [((), 0), ("delay-40", 2), ("delay-100", 5), ("delay-200", 10)]
)
def test_the_delay_is_found(perturbation, steps):
    found = last_memory(perturbation).delay.steps
    assert np.median(found) == steps
    assert (np.abs(found - steps) <= 1).mean() >= 0.9


@pytest.mark.parametrize("control", ["joint_position", "joint_delta", "joint_velocity"])
def test_the_servo_model_foretells_where_the_joints_are(control):
    env = gym.make("MMCReach-v0", control=control)
    interface = ReachInterface.of(env)
    observation, _ = env.reset(seed=3, options={"joint_angles": [0.3, 0.6, 0.6]})
    goal = np.array([0.8, 0.1, 1.0])
    foretold = np.array([0.3, 0.6, 0.6])
    for _ in range(40):
        sensed = interface.sense(observation)
        foretold = foretold + expected_turn(interface, foretold, goal)
        observation, *_ = env.step(interface.act(goal, sensed))
    now = interface.sense(observation).joint_angles
    np.testing.assert_allclose(now, foretold, atol=0.02)


@pytest.mark.parametrize("control", ["joint_delta", "joint_velocity"])
def test_a_relative_command_turns_a_joint_alike_wherever_it_is(control):
    interface = ReachInterface((1.0, 1.0), control, 6.0, 12.0, 0.02)
    believed, goal = np.array([0.1, -0.4]), np.array([0.3, -1.5])
    command = command_of(interface, believed, goal)
    turns = [commanded_turn(interface, believed + error, command) for error in (0.0, 0.2)]
    np.testing.assert_array_equal(*turns)
    np.testing.assert_allclose(turns[0], expected_turn(interface, believed, goal))


@pytest.mark.parametrize("control", ["joint_position", "joint_delta", "joint_velocity"])
def test_an_old_posture_is_run_forward_with_the_commands_since(control):
    interface = ReachInterface((1.0, 1.0), control, 6.0, 12.0, 0.02)
    random = np.random.default_rng(0)
    posture = random.uniform(-1, 1, (3, 2))
    delay, path = Delay.unknown(interface, posture), [posture]
    for _ in range(10):
        command = command_of(interface, path[-1], random.uniform(-1, 1, (3, 2)))
        delay = delay.sent(command)
        path.append(path[-1] + commanded_turn(interface, path[-1], command))
    steps = np.array([0, 4, 10])
    old = np.stack([path[10 - late][index] for index, late in enumerate(steps)])
    now = delay.run_forward(interface, old, steps)
    np.testing.assert_allclose(now, path[10], atol=1e-12)
