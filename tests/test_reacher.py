"""Gymnasium's Reacher-v5 through the interface of `examples/reacher.py`."""

import gymnasium as gym
import numpy as np
import pytest
from scipy.linalg import solve_continuous_are

from examples.reacher import GEAR, INTERFACE, METRES, root
from mmc_gym import make_agent
from mmc_gym.interface import Seen
from mmc_gym.network.chain import segments_from_joint_angles
from studies.other_bodies.reacher import BODIES, optimal_torques, play


def played(name, body, folder):
    """Success, and mean return, of an agent in the same episodes."""
    envs = [BODIES[body].make(folder) for _ in range(12)]
    found = play(make_agent(name, envs[0], interface=INTERFACE), envs, list(range(12)))
    starts, targets = found.to_numpy()[:, 2:4], found.to_numpy()[:, 4:]
    missed = found["distance"] - BODIES[body].nearest(starts, targets)
    return (missed < 0.01).mean(), found["return"].mean()


def test_mmc_body_earns_what_the_environment_asks_for_without_training(tmp_path):
    success, mean_return = played("mmc-body", "as given", tmp_path)
    assert success == 1.0
    assert mean_return > gym.spec("Reacher-v5").reward_threshold


@pytest.mark.parametrize("body", ["second link 20 % longer", "first joint held"])
def test_a_changed_body_is_identified(body, tmp_path):
    success, mean_return = played("mmc-body", body, tmp_path)
    assert success > 0.9
    assert mean_return > played("ik-closed-form", body, tmp_path)[1] + 0.3


def test_the_servo_is_the_solution_of_the_riccati_equation():
    goal, left, speeds = np.array([0.4, -1.2]), np.array([0.7, -0.5]), np.array([1.0, -2.0])
    lengths = np.array(INTERFACE.segment_lengths)
    base, elbow = np.cumsum(segments_from_joint_angles(goal, lengths)[::-1], axis=0)[::-1]
    jacobian = METRES * np.array([[-base[1], -elbow[1]], [base[0], elbow[0]]])
    weight = jacobian.T @ jacobian / np.linalg.norm(jacobian @ left)
    still, one = np.zeros((2, 2)), np.eye(2)
    system = np.block([[still, one], [still, -one]]), np.vstack([still, GEAR * one])
    cost = np.block([[weight, still], [still, still]])
    gains = system[1].T @ solve_continuous_are(*system, cost, one)
    seen = Seen(goal - left, np.zeros(2), joint_speeds=speeds, hand=np.zeros(2))
    expected = -gains @ np.concatenate([-left, speeds])
    np.testing.assert_allclose(INTERFACE.act(goal, seen), expected, atol=1e-5)
    np.testing.assert_allclose(root(weight) @ root(weight), weight)


@pytest.mark.slow
def test_no_torques_cost_less_than_the_optimum():
    env = gym.make("Reacher-v5")
    returns = {"optimum": play(None, [env], [3])["return"][0]}
    observation, _ = env.reset(seed=3)
    torques = optimal_torques(
        np.arctan2(observation[2:4], observation[:2]), observation[6:8], observation[4:6]
    )
    random = np.random.default_rng(0)
    for number in range(5):
        env.reset(seed=3)
        others = np.clip(torques + random.normal(0, 0.01, torques.shape), -1, 1)
        returns[number] = sum(env.step(one)[1] for one in others.astype(np.float32))
    assert max(returns, key=returns.get) == "optimum"
