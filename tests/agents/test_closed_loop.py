"""Agents in closed loop, on bodies that are not as they were told."""

from functools import cache

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mmc_gym import make_agent
from mmc_gym.agents.closed_loop.agent import (
    LOOPS,
    ClosedLoopInverseKinematicsAgent,
    closed_loop_mmc,
)
from mmc_gym.agents.closed_loop.observer import Loops
from mmc_gym.agents.ik.iterative import damped_least_squares
from mmc_gym.envs.scenarios import environment_id
from mmc_gym.interface import ReachInterface

EPISODES = 100
SEED = 60_000
CLOSED = (*(f"mmc-{name}" for name in LOOPS), "ik-dls-feedback")


def play(agent, env_id="MMCReach-v0", steps=100, episodes=EPISODES, **options):
    """Whether the hand is at the target, (steps, episodes), and the agent's last state."""
    envs = gym.make_vec(env_id, num_envs=episodes, max_episode_steps=1000, **options)
    (observations, _), state = envs.reset(seed=SEED), None
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


def success(name, env_id="MMCReach-v0", **options):
    return outcome(name, env_id, **options)[0]


def median_time(name, **options):
    return outcome(name, **options)[1]


@pytest.mark.parametrize("perturbations", [(), ("longer-20",), ("joint-noise", "delay-100")])
@pytest.mark.parametrize("control", ["joint_position", "joint_delta"])
def test_with_all_loops_open_it_is_mmc_bit_for_bit(perturbations, control):
    options = {"perturbations": perturbations, "control": control, "task": "double-step-100"}
    env = gym.make("MMCReach-v0", **options)
    mmc, opened = make_agent("mmc", env), closed_loop_mmc(ReachInterface.of(env), Loops())
    envs = gym.make_vec("MMCReach-v0", num_envs=20, max_episode_steps=30, **options)
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
    open_loop = "ik-dls" if name.startswith("ik") else "mmc"
    assert success(name) >= success(open_loop) - 0.01
    assert median_time(name) <= 1.05 * median_time(open_loop)


@pytest.mark.parametrize(
    ("name", "perturbation", "at_least"),
    [
        *((name, "longer-50", 0.97) for name in ("mmc-feedback", "mmc-lengths", "mmc-closed")),
        *((name, "shorter-20", 0.97) for name in ("mmc-feedback", "mmc-lengths", "mmc-closed")),
        *((name, "rotation-30", 0.95) for name in ("mmc-feedback", "mmc-closed")),
        *((name, "rotation-45", 0.88) for name in ("mmc-feedback", "mmc-closed")),
        *((name, "locked", 0.9) for name in ("mmc-lock", "mmc-closed")),
        *((name, "locks", 0.5) for name in ("mmc-lock", "mmc-closed")),
        ("mmc-feedback", "locked", 0.4),
        ("ik-dls-feedback", "longer-50", 0.97),
        ("ik-dls-feedback", "rotation-45", 0.95),
        ("ik-dls-feedback", "locked", 0.65),
    ],
)
def test_reaches_what_it_does_not_reach_in_open_loop(name, perturbation, at_least):
    open_loop = "ik-dls" if name.startswith("ik") else "mmc"
    assert success(open_loop, perturbations=perturbation) <= 0.25
    assert success(name, perturbations=perturbation) >= at_least


@pytest.mark.parametrize(
    "perturbation",
    ["force-field", "hand-mass", "joint-noise", "vision-noise", "delay-200", "longer-50-told"],
)
@pytest.mark.parametrize("name", CLOSED)
def test_what_is_reached_in_open_loop_is_reached_still(name, perturbation):
    open_loop = "ik-dls" if name.startswith("ik") else "mmc"
    lost = success(open_loop, perturbations=perturbation) - success(
        name, perturbations=perturbation
    )
    assert lost <= 0.04


def test_what_feedback_loses_in_time_to_a_delay_is_won_back_by_bridging_it():
    late = {"perturbations": "delay-200"}
    assert median_time("mmc-feedback", **late) > 1.3 * median_time("mmc", **late)
    assert median_time("mmc-delay", **late) < 1.1 * median_time("mmc", **late)


def test_velocity_control_under_delay_needs_the_delay_bridged():
    late = {"perturbations": "delay-100", "control": "joint_velocity"}
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
    options = {
        "segment_lengths": lengths,
        "success_distance": 0.1,
        "perturbations": perturbation,
    }
    assert success("mmc-closed", **options) >= 0.9


@pytest.mark.parametrize("name", CLOSED)
@pytest.mark.parametrize("task", ["double-step-200", "via-points"])
def test_targets_that_jump(name, task):
    agent = make_agent(name, gym.make(environment_id(task)))
    assert play(agent, steps=200, task=task)[0][-1].mean() >= 0.97


@pytest.mark.parametrize("name", ["mmc-feedback", "mmc-closed"])
def test_a_target_that_moves_is_pursued_as_closely_as_in_open_loop(name):
    near = {}
    for agent_name in ("mmc", name):
        agent = make_agent(agent_name, gym.make("MMCReachPursuit-v0"))
        near[agent_name] = play(
            agent, steps=300, episodes=50, task="pursuit", success_distance=0.3
        )[0][50:].mean()
    assert near[name] >= near["mmc"] - 0.05


@pytest.mark.parametrize("name", CLOSED)
def test_goal_observations_are_understood(name):
    options = {"perturbations": ("longer-20",)}
    at_least = 0.0 if name == "mmc-lock" else 0.97
    assert success(name, "MMCReachGoal-v0", **options) >= at_least


@settings(max_examples=30)
@given(st.integers(2, 5), st.integers(0, 2**31), st.sampled_from(CLOSED))
def test_actions_are_valid_whatever_is_observed(count, seed, name):
    env = gym.make("MMCReach-v0", segment_lengths=(1.0,) * count)
    agent, random, state = make_agent(name, env), np.random.default_rng(seed), None
    for _ in range(30):
        observation = random.uniform(-1, 1, 3 * count + 4).astype(np.float32)
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
    with pytest.raises(ValueError, match=r"posture_weight must be less than N \+ 1 = 4, got 4"):
        closed_loop_mmc(interface, Loops(posture_weight=4.0))
    with pytest.raises(ValueError, match="loops must be feedback and delay alone"):
        ClosedLoopInverseKinematicsAgent(interface, LOOPS["lock"], damped_least_squares)
