"""Optimal feedback control: what its literature says of it."""

import gymnasium as gym
import numpy as np
import pytest
from scipy.linalg import solve_discrete_lyapunov

from mmc_gym._errors import UserError
from mmc_gym.agents import optimal_control as oc
from mmc_gym.interface import ReachInterface
from mmc_gym.measures.rollout import run_episodes
from mmc_gym.measures.speed import correlation_with_minimum_jerk, count_peaks

STEP = 0.02


def expected_cost(gain):
    """P with cost xᵀPx of u = −L x for ever under noise that grows with the command, by iteration.

    P = Q + LᵀrL + (A − BL)ᵀP(A − BL) + c² LᵀBᵀPBL
    """
    (a, b), q = oc.plant(oc.DEFAULT, STEP), oc.staying_cost(oc.DEFAULT, 1.0)
    row, p = gain[None], np.zeros((3, 3))
    closed = a - b @ row
    for _ in range(2000):
        noisy = oc.DEFAULT.motor_noise**2 * row.T @ (b.T @ p @ b) @ row
        p = q + oc.DEFAULT.effort_cost**2 * row.T @ row + closed.T @ p @ closed + noisy
    return p


def best():
    return oc.optimal_gain(oc.DEFAULT, STEP, oc.staying_value(oc.DEFAULT, STEP, 1.0))


@pytest.mark.parametrize("seed", range(2))
def test_the_cost_to_go_is_what_the_noisy_controller_pays_and_no_other_gain_costs_less(seed):
    least = oc.staying_value(oc.DEFAULT, STEP, 1.0)
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
    found = np.einsum("ijn,jn,jnk->nik", columns, moves, rows)
    np.testing.assert_allclose(found, effects, atol=1e-12)
    expected = np.linalg.svd(effects, compute_uv=False)
    np.testing.assert_allclose(np.sort(moves, axis=0)[::-1].T, expected, atol=1e-9)


def test_a_long_reach_begins_gently_and_ends_as_staying_does():
    assumed = oc.Assumptions(longest=40.0)
    of_error = oc.reaching_gains(assumed, STEP, oc.staying_value(assumed, STEP, 1.0))[:, 0]
    assert np.all(np.diff(of_error[50:]) < 0)
    assert of_error[-1] < 1e-3 * best()[0]


def test_the_kalman_gain_is_the_one_of_least_error():
    a, c = np.array([[1.0, STEP], [0.0, 1.0]]), np.eye(1, 2)
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
        speeds = np.linalg.norm(np.diff(movement.hands, axis=0), axis=-1) / STEP
        assert movement.distances[-1] < 0.01
        assert count_peaks(speeds) == 1
        likeness.append(correlation_with_minimum_jerk(speeds[speeds > 0.05 * speeds.max()]))
    assert np.mean(likeness) > 0.8


def success(perturbation, delay=0.0):
    env = gym.make_vec("MMCReach-v0", 50, control="joint_velocity", perturbations=perturbation)
    agent = oc.OptimalControlAgent(ReachInterface.of(env), oc.Assumptions(delay=delay))
    episodes = run_episodes(agent, env, range(50), records_effort=False)
    return np.mean([one.distances[-1] < one.tolerance for one in episodes])


def test_locked_joints_and_senses_that_are_known_to_be_late_do_little_harm():
    assert success("locked-2") > 0.7
    assert success("locked-2-known") > 0.9
    assert success("delay-200") < 0.5
    assert success("delay-200", delay=0.2) > 0.9


def test_impossible_assumptions_are_refused():
    for name, value in (("lag", 0), ("delay", -0.1), ("drift", np.nan), ("speed", "fast")):
        with pytest.raises(UserError, match=f"^{name} must be .*, got {value!r}"):
            oc.Assumptions(**{name: value})
    interface = ReachInterface.of(gym.make("MMCReach-v0"))
    with pytest.raises(UserError, match=r"longest must be at least a control step, 0\.02 s, got"):
        oc.OptimalControlAgent(interface, oc.Assumptions(longest=0.001))
