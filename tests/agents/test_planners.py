"""The agents that plan or time a movement: minimum jerk, timed MMC."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mmc_gym.agents import AGENTS, planners
from mmc_gym.agents.inverse_kinematics import hand_position
from mmc_gym.interface import ReachInterface, Sensed
from mmc_gym.measures.speed import correlation_with_minimum_jerk, count_peaks, phase_of_peak
from mmc_gym.network.time_base import minimum_jerk

DT = 0.02
PLANNERS = ("minimum-jerk", "mmc-bell")
POSTURE = np.array([0.3, 0.9, 0.8])

points = st.tuples(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0)).map(np.array)


def internal_hands(name, posture, targets, lengths=(1.0, 1.0, 1.0)):
    """Hand positions of the internal model, as if the servos were perfect, (steps + 1, ..., 2)."""
    agent = AGENTS[name].build(ReachInterface(lengths, "joint_position", 6.28, 12.0, DT))
    state, hands = None, [hand_position(posture, lengths)]
    for target in targets:
        sensed = Sensed(posture, np.asarray(target))
        state = agent.start(sensed) if state is None else state
        joint_targets, state = agent.advance(state, sensed)
        hands.append(hand_position(joint_targets, lengths))
    return np.array(hands)


def planned(start, targets):
    """The plan in each control step, with the target in each, (steps + 1, 2)."""
    plans = [planners.HandPlan(start, np.zeros(2), np.zeros(2))]
    for done, target in enumerate(targets):
        remaining = np.array(float(len(targets) - done))
        plans.append(planners.minimum_jerk_step(plans[-1], target, remaining))
    return planners.HandPlan(*map(np.array, zip(*plans)))


@given(points, points, st.integers(2, 90))
def test_the_plan_is_the_formula_a_straight_line_with_minimum_jerk_in_time(start, target, duration):
    plan, way = planned(start, [target] * duration), target - start
    phase = np.arange(duration + 1)[:, None] / duration
    np.testing.assert_allclose(plan.position, start + way * minimum_jerk(phase), atol=1e-11)
    rate = 30 * phase**2 * (1 - phase) ** 2 / duration
    np.testing.assert_allclose(plan.velocity, way * rate, atol=1e-10)
    bend = (60 * phase - 180 * phase**2 + 120 * phase**3) / duration**2
    np.testing.assert_allclose(plan.acceleration[:-1], (way * bend)[:-1], atol=1e-9)


def test_a_plan_whose_target_moves_turns_without_a_jump_of_velocity():
    plan = planned(np.zeros(2), [np.array([2.0, 0.0])] * 10 + [np.array([1.5, 1.5])] * 30)
    np.testing.assert_allclose(plan.position[-1], [1.5, 1.5], atol=1e-12)
    velocity = np.diff(plan.position, axis=0) / DT
    assert np.linalg.norm(np.diff(velocity, axis=0), axis=-1).max() < 0.15 * np.abs(velocity).max()


@pytest.mark.parametrize("lengths", [(1.0, 1.0, 1.0), (0.5,) * 6])
@pytest.mark.parametrize(
    ("name", "correlation", "accuracy"), [("minimum-jerk", 0.999, 1e-4), ("mmc-bell", 0.96, 0.06)]
)
def test_speed_is_bell_shaped_and_the_hand_arrives_in_time(name, correlation, accuracy, lengths):
    # Bent, to a target well inside; nearly stretched or folded arms have less regular movements.
    random, count = np.random.default_rng(3), len(lengths)
    for _ in range(10):
        posture = random.uniform(0.4, 1.2, count)
        turn = random.uniform(0.3, 0.8, count) * [-1, *[1] * (count - 1)]
        target = hand_position(posture + turn, lengths)
        duration = int(planners.begin(hand_position(posture, lengths), target, DT).duration)
        hands = internal_hands(name, posture, [target] * duration, lengths)
        profile = np.linalg.norm(np.diff(hands, axis=0), axis=-1) / DT
        assert count_peaks(profile) == 1
        assert 0.45 < phase_of_peak(profile) < 0.65
        assert correlation_with_minimum_jerk(profile) > correlation
        assert np.linalg.norm(hands[-1] - target) < accuracy


@pytest.mark.parametrize("name", PLANNERS)
def test_a_target_that_jumps_or_moves_on_the_way_is_reached(name):
    jumps = [[2.0, 1.0]] * 12 + [[-0.5, 1.5]] * 80
    np.testing.assert_allclose(internal_hands(name, POSTURE, jumps)[-1], jumps[-1], atol=1e-3)
    angles = 0.5 + 0.01 * np.arange(200)  # 0.5 rad/s at radius 1.5: 0.75 lengths/s
    moves = 1.5 * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    behind = np.linalg.norm(internal_hands(name, POSTURE, moves)[1:] - moves, axis=-1)
    assert behind[100:].max() < 0.08


def test_a_movement_begins_anew_only_where_the_target_jumps():
    hand, target = np.zeros((3, 2)), np.array([[1.0, 0.0]] * 3)
    movement = planners.begin(hand, target, DT)
    for _ in range(5):
        movement = planners.step(planners.follow(movement, hand, target, DT))
    target = target + planners.NEW_TARGET_DISTANCE * np.array([[0.0, 0.0], [0.0, 0.9], [0.0, 1.1]])
    assert planners.follow(movement, hand, target, DT).elapsed.tolist() == [5, 5, 0]
