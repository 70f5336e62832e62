"""What agents find out about their body: its lengths, its locked joints, and its delay."""

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mmc_gym.agents.closed_loop.agent import LOOPS, closed_loop_mmc
from mmc_gym.agents.closed_loop.identification import Delay, Lengths, Locks, expected_turn
from mmc_gym.envs.perturbations import LockedJoint, VisuomotorRotation
from mmc_gym.interface import ReachInterface
from mmc_gym.network.chain import segments_from_joint_angles

SEED = 70_000
EPISODES = 50


def last_memory(steps=60, episodes=EPISODES, **options):
    """What mmc-closed remembers after a while, of arms with the perturbations."""
    env = gym.make("MMCReach-v0", **options)
    agent = closed_loop_mmc(ReachInterface.of(env), LOOPS["closed"])
    envs = gym.make_vec("MMCReach-v0", num_envs=episodes, **options)
    (observations, _), state = envs.reset(seed=SEED), None
    for _ in range(steps):
        actions, state = agent.predict(observations, state)
        observations, *_ = envs.step(actions)
    return state.memory


@pytest.mark.parametrize(
    ("perturbation", "true"),
    [("longer-10", 1.1), ("longer-50", 1.5), ("shorter-20", 0.8), ("shorter-50", 0.5)],
)
def test_identified_lengths_converge_to_the_true_ones(perturbation, true):
    memory = last_memory(perturbations=perturbation)
    lengths = memory.lengths.best((1.0, 1.0, 1.0))
    errors = np.abs(lengths - [1.0, 1.0, true]).max(axis=-1)
    assert np.median(errors) < 0.005
    assert np.quantile(errors, 0.9) < 0.05


def test_a_few_control_steps_suffice():
    memory = last_memory(steps=10, perturbations="longer-50")
    lengths = memory.lengths.best((1.0, 1.0, 1.0))
    assert np.median(np.abs(lengths - [1.0, 1.0, 1.5]).max(axis=-1)) < 0.05


@pytest.mark.parametrize(
    ("perturbation", "at_least"),
    [
        *((name, 0.9) for name in ("joint-noise", "vision-noise", "delay-100", "locked")),
        (VisuomotorRotation(30.0, centre=(0.0, 1.5)), 0.9),
        ("rotation-30", 0.75),  # about the base
    ],
)
def test_other_troubles_are_seldom_taken_for_other_lengths(perturbation, at_least):
    memory = last_memory(perturbations=perturbation)
    lengths = memory.lengths.best((1.0, 1.0, 1.0))
    assert (np.abs(lengths - 1.0) < 0.02).all(axis=-1).mean() >= at_least


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
    memory = last_memory(perturbations=LockedJoint(joint=joint, time=time))
    found = (memory.locks.is_locked > 0).mean(axis=0)
    assert found[joint] >= 0.6  # elsewhere it is not asked for enough to matter
    assert np.delete(found, joint).max() <= 0.04


@pytest.mark.parametrize(
    "perturbation",
    [(), "joint-noise", "vision-noise", "longer-50", "rotation-30", "delay-100", "delay-200"],
)
def test_a_joint_that_is_free_is_seldom_taken_as_locked(perturbation):
    memory = last_memory(perturbations=perturbation)
    assert (memory.locks.is_locked > 0).any(axis=-1).mean() <= 0.04


def test_a_joint_told_to_lock_is_found_sooner():
    free, turned = np.zeros(3), np.array([0.2, 0.0, 0.0])
    untold = told = Locks.none(free)
    asked = np.array([0.1, 0.1, 0.0])
    steps_untold = steps_told = None
    for step in range(20):
        posture = (step + 1) * turned
        untold = untold.observed(posture, asked)
        told = told.observed(posture, asked, lockable=(1,))
        if steps_untold is None and untold.is_locked[1]:
            steps_untold = step
        if steps_told is None and told.is_locked[1]:
            steps_told = step
    assert steps_told < steps_untold
    np.testing.assert_array_equal(untold.is_locked, [0, 1, 0])


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
    memory = last_memory(perturbations=perturbation)
    found = memory.delay.steps
    assert np.median(found) == steps
    assert (np.abs(found - steps) <= 1).mean() >= 0.9


@pytest.mark.parametrize("control", ["joint_position", "joint_velocity"])
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


def test_an_old_posture_is_run_forward_with_the_commands_since():
    interface = ReachInterface((1.0, 1.0), "joint_position", 6.0, 12.0, 0.02)
    random = np.random.default_rng(0)
    posture = random.uniform(-1, 1, (3, 2))
    delay, path = Delay.unknown(posture), [posture]
    for _ in range(10):
        command = random.uniform(-1, 1, (3, 2))
        delay = delay.sent(command)
        path.append(path[-1] + expected_turn(interface, path[-1], command))
    steps = np.array([0, 4, 10])
    old = np.stack([path[10 - late][index] for index, late in enumerate(steps)])
    now = delay.run_forward(interface, old, steps)
    np.testing.assert_allclose(now, path[10], atol=1e-12)
