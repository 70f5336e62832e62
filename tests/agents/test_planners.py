"""Agents that plan, time or control a movement: minimum jerk, timed MMC, optimal control."""

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import solve_discrete_lyapunov

from mmc_gym import UserError
from mmc_gym.agents import AGENTS, planners
from mmc_gym.agents import optimal_control as oc
from mmc_gym.agents.inverse_kinematics import hand_position
from mmc_gym.interface import ReachInterface, Sensed
from mmc_gym.measures.rollout import run_episodes
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
        hand = hand_position(posture, lengths)
        duration = int(planners.begin_movement(hand, target, DT).duration)
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
    movement = planners.begin_movement(hand, target, DT)
    for _ in range(5):
        movement = planners.one_step_later(planners.follow_target(movement, hand, target, DT))
    target = target + planners.NEW_TARGET_DISTANCE * np.array([[0.0, 0.0], [0.0, 0.9], [0.0, 1.1]])
    assert planners.follow_target(movement, hand, target, DT).elapsed.tolist() == [5, 5, 0]


def expected_cost(gain):
    """P with cost xᵀPx of u = −L x for ever under noise that grows with the command, by iteration.

    P = Q + LᵀrL + (A − BL)ᵀP(A − BL) + c² LᵀBᵀPBL
    """
    (a, b), q = oc.plant(oc.DEFAULT, DT), oc.staying_cost(oc.DEFAULT, 1.0)
    row, p = gain[None], np.zeros((3, 3))
    closed = a - b @ row
    for _ in range(2000):
        noisy = oc.DEFAULT.motor_noise**2 * row.T @ (b.T @ p @ b) @ row
        p = q + oc.DEFAULT.effort_cost**2 * row.T @ row + closed.T @ p @ closed + noisy
    return p


def best():
    return oc.optimal_gain(oc.DEFAULT, DT, oc.staying_value(oc.DEFAULT, DT, 1.0))


@pytest.mark.parametrize("seed", range(2))
def test_the_cost_to_go_is_what_the_noisy_controller_pays_and_no_other_gain_costs_less(seed):
    least = oc.staying_value(oc.DEFAULT, DT, 1.0)
    np.testing.assert_allclose(expected_cost(best()), least, rtol=1e-6)
    more = expected_cost(best() * np.random.default_rng(seed).uniform(0.7, 1.4, 3)) - least
    assert np.linalg.eigvalsh(more).min() > -1e-9 * np.abs(more).max()
    assert np.trace(more) > 0


@pytest.mark.parametrize("kind", ["any", "one column", "one direction", "none"])
def test_the_jacobian_is_taken_apart_as_by_the_singular_value_decomposition(kind):
    effects = np.random.default_rng(0).normal(size=(20, 2, 4))
    effects[:, :, 1:] *= kind != "one column"
    effects[:, 1] *= kind in ("any", "one column")
    effects *= kind != "none"
    (x, y), moves, rows = (np.moveaxis(part, 1, 0) for part in oc.turned_joints(effects))
    columns = np.array([[x, -y], [y, x]])
    product = np.einsum("ijn,jn,jnk->nik", columns, moves, rows)
    np.testing.assert_allclose(product, effects, atol=1e-12)
    expected = np.linalg.svd(effects, compute_uv=False)
    np.testing.assert_allclose(np.sort(moves, axis=0)[::-1].T, expected, atol=1e-9)


def test_a_long_reach_begins_gently_and_ends_as_staying_does():
    assumed = oc.Assumptions(longest=40.0)
    of_error = oc.reaching_gains(assumed, DT, oc.staying_value(assumed, DT, 1.0))[:, 0]
    assert np.all(np.diff(of_error[50:]) < 0)
    assert of_error[-1] < 1e-3 * best()[0]


def test_the_kalman_gain_is_the_one_of_least_error():
    a, c = np.array([[1.0, DT], [0.0, 1.0]]), np.eye(1, 2)
    disturbance, noise = 0.01 * np.eye(2), np.eye(1)

    def error(k):
        """Trace of the covariance of x after readings, for any constant gain."""
        keep = np.eye(2) - k @ c
        spread = keep @ disturbance @ keep.T + k @ noise @ k.T
        return float(np.trace(solve_discrete_lyapunov(keep @ a, spread)))

    k = oc.kalman_gain(a, c, disturbance, noise)
    assert all(error(k * (1 + change)) > error(k) for change in (-0.2, -0.05, 0.05, 0.2))


def test_speeds_are_bell_shaped_from_the_centre_to_targets_around_it():
    env, likeness = gym.make_vec("MMCReachCentreOut-v0", 8, control="joint_velocity"), []
    agent, trials = oc.OptimalControlAgent(ReachInterface.of(env)), [{"trial": k} for k in range(8)]
    for movement in run_episodes(agent, env, range(8), options=trials):
        speeds = np.linalg.norm(np.diff(movement.hands, axis=0), axis=-1) / DT
        assert movement.distances[-1] < 0.01
        assert count_peaks(speeds) == 1
        likeness.append(correlation_with_minimum_jerk(speeds[speeds > 0.05 * speeds.max()]))
    assert np.mean(likeness) > 0.8


def success(perturbation, delay=0.0):
    env = gym.make_vec("MMCReach-v0", 50, control="joint_velocity", perturbations=perturbation)
    agent = oc.OptimalControlAgent(ReachInterface.of(env), oc.Assumptions(delay=delay))
    episodes = run_episodes(agent, env, range(50), records_effort=False)
    return np.mean([episode.distances[-1] < episode.tolerance for episode in episodes])


def test_locked_joints_and_senses_that_are_known_to_be_late_do_little_harm():
    assert success("locked-2") > 0.7
    assert success("locked-2-known") > 0.9
    assert success("delay-200") < 0.5
    assert success("delay-200", delay=0.2) > 0.9


@pytest.mark.parametrize(
    ("name", "value"),
    [("lag", 0), ("delay", -0.1), ("drift", np.nan), ("speed", "fast"), ("longest", 0.001)],
)
def test_impossible_assumptions_are_refused(name, value):
    interface = ReachInterface.of(gym.make("MMCReach-v0"))
    with pytest.raises(UserError, match=f"^{name} must be .*, got {value!r}"):
        oc.OptimalControlAgent(interface, oc.Assumptions(**{name: value}))
