"""Episodes played together are those played one by one."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest

import mmc_gym
from mmc_gym.envs.perturbations import ForceField, LockedJoint
from mmc_gym.envs.vector import MMCReachVectorEnv
from mmc_gym.measures.rollout import episode_seeds, run_episodes, run_episodes_together

RECORDS = (
    *("hands", "distances", "targets", "joint_angles"),
    *("servo_impulses", "servo_work", "rewards", "seen_hands"),
)
SETTINGS = {
    "random": ("MMCReach-v0", {}),
    "joint deltas": ("MMCReach-v0", {"control": "joint_delta"}),
    "field and lock": ("MMCReach-v0", {"perturbations": (ForceField(90.0), LockedJoint(time=0.2))}),
    "obstacles": ("MMCReachObstacles-v0", {}),
    "noise": ("MMCReachJointNoise-v0", {}),
    "delay": ("MMCReachDelay100-v0", {}),
    "rotation": ("MMCReachRotation30-v0", {}),
    "via points": ("MMCReachViaPoints-v0", {}),
    "double step": ("MMCReachDoubleStep100-v0", {}),
}


def assert_same(together, alone, tolerance=1e-9):
    assert len(together) == len(alone)
    for one, other in zip(together, alone, strict=True):
        for name in RECORDS:
            np.testing.assert_allclose(
                getattr(one, name), getattr(other, name), rtol=0, atol=tolerance, err_msg=name
            )
        for name in ("seed", "control_step", "tolerance", "reach"):
            assert getattr(one, name) == getattr(other, name)
        assert one.action_times.shape == other.action_times.shape
        assert np.isnan(one.action_times).all()


@pytest.mark.parametrize("setting", SETTINGS)
@pytest.mark.parametrize("name", ["mmc", "ik-dls"])
def test_episodes_together_are_those_one_by_one(setting, name):
    env_id, arguments = SETTINGS[setting]
    seeds = episode_seeds(3, 4)
    env = gym.make(env_id, **arguments)
    vector = gym.make_vec(env_id, num_envs=len(seeds), **arguments)
    alone = run_episodes(mmc_gym.make_agent(name, env), env, seeds)
    assert_same(run_episodes_together(mmc_gym.make_agent(name, vector), vector, seeds), alone)
    assert all((one.cursors is None) == (setting != "rotation") for one in alone)


def test_every_episode_has_its_own_options():
    options = [{"trial": trial} for trial in (5, 0, 5, 17)]
    seeds = episode_seeds(0, 4)
    env = gym.make("MMCReachPaper-v0")
    vector = gym.make_vec("MMCReachPaper-v0", num_envs=4)
    agent = mmc_gym.make_agent("mmc", env)
    alone = run_episodes(agent, env, seeds, options=options)
    together = run_episodes_together(agent, vector, seeds, options)
    assert_same(together, alone)
    np.testing.assert_array_equal(together[0].hands, together[2].hands)


def test_an_environment_can_be_used_again():
    seeds = episode_seeds(0, 3)
    vector = gym.make_vec("MMCReach-v0", num_envs=3)
    agent = mmc_gym.make_agent("mmc", vector)
    first, second = (run_episodes_together(agent, vector, seeds) for _ in range(2))
    for one, other in zip(first, second, strict=True):
        np.testing.assert_array_equal(one.hands, other.hands)
        np.testing.assert_array_equal(one.servo_work, other.servo_work)


def test_an_engine_that_tells_no_impulses_has_none():
    pytest.importorskip("numba")
    vector = gym.make_vec("MMCReach-v0", num_envs=2, engine="analytic")
    episode = run_episodes_together(mmc_gym.make_agent("mmc", vector), vector, [0, 1])[0]
    assert np.isnan(episode.servo_work).all()


class Single:
    """Gives one action, whatever it is shown."""

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        return np.zeros(3, np.float32), None


def test_what_cannot_be_played_together_is_refused():
    vector = gym.make_vec("MMCReach-v0", num_envs=2)
    agent = mmc_gym.make_agent("mmc", vector)
    with pytest.raises(ValueError, match=r"actions of shape \(2, 3\), got \(3,\)"):
        run_episodes_together(Single(), vector, [0, 1])
    with pytest.raises(ValueError, match="env must have 3 arms"):
        run_episodes_together(agent, vector, [0, 1, 2])
    with pytest.raises(ValueError, match="options must be 2"):
        run_episodes_together(agent, vector, [0, 1], [{}])
    for other in (
        gym.make_vec("MMCReach-v0", num_envs=2, vectorization_mode="sync"),
        MMCReachVectorEnv(2, max_episode_steps=None),
    ):
        with pytest.raises(ValueError, match="env must be a native vector environment"):
            run_episodes_together(agent, other, [0, 1])
