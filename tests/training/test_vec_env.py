"""Vector environments as in stable-baselines3; residual learning."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.classic_control import CartPoleEnv
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers import TimeLimit
from stable_baselines3.common.env_util import make_vec_env

from mmc_gym import UserError, make_agent
from mmc_gym.training.vec_env import GymnasiumVecEnv
from studies.learners.ppo_residual import Residual

IDS = ("MMCReach-v0", "MMCReachGoal-v0")
COUNT = 3


def native(env_id=IDS[0], count=COUNT, **arguments):
    return GymnasiumVecEnv(gym.make_vec(env_id, count, autoreset_mode="SameStep", **arguments))


def of_single_ones(env_id=IDS[0], count=COUNT, **arguments):
    """Around Gymnasium's own vector environment."""
    make = lambda: gym.make(env_id, **arguments)  # noqa: E731
    envs = SyncVectorEnv([make] * count, autoreset_mode=AutoresetMode.SAME_STEP)
    return GymnasiumVecEnv(envs)


def dummy(env_id=IDS[0], count=COUNT, **arguments):
    return make_vec_env(env_id, count, env_kwargs=arguments)


MAKERS = pytest.mark.parametrize("make", [native, of_single_ones])


@MAKERS
@pytest.mark.parametrize("env_id", IDS)
def test_plays_what_dummy_vec_env_plays(make, env_id):
    env, reference = make(env_id), dummy(env_id)
    assert env.observation_space == reference.observation_space
    assert env.action_space == reference.action_space
    assert env.seed(7) == reference.seed(7)
    np.testing.assert_equal(env.reset(), reference.reset())
    ends = 0
    for actions in np.random.default_rng(0).uniform(-1, 1, (210, COUNT, 3)).astype(np.float32):
        *actual, infos = env.step(actions)
        *expected, expected_infos = reference.step(actions)
        np.testing.assert_equal(actual, expected)
        assert [array.dtype for array in actual[1:]] == [array.dtype for array in expected[1:]]
        for done, info, expected_info in zip(actual[-1], infos, expected_infos):
            expected_info.pop("episode", None)  # of the Monitor around each environment
            ends += done
            np.testing.assert_equal(info, expected_info if done else {})
        np.testing.assert_equal(env.reset_infos, reference.reset_infos)
    assert ends == 2 * COUNT


def test_a_terminated_episode_is_not_a_truncated_one():
    makers = [lambda limit=limit: TimeLimit(CartPoleEnv(), limit) for limit in (2, 500)]
    env = GymnasiumVecEnv(SyncVectorEnv(makers, autoreset_mode=AutoresetMode.SAME_STEP))
    env.seed(0)
    env.reset()
    ended = set()
    for _ in range(30):
        _, _, dones, infos = env.step(np.ones(2, dtype=np.int64))
        ended |= {(index, infos[index]["TimeLimit.truncated"]) for index in np.flatnonzero(dones)}
    assert ended == {(0, True), (1, False)}


@MAKERS
def test_options_are_those_of_the_next_reset_only(make):
    env, reference = make(), dummy()
    for options in ({"target": (1.0, 0.1)}, {}):
        for each in (env, reference):
            each.seed(3)
            each.set_options(options)
        np.testing.assert_equal(env.reset(), reference.reset())
        np.testing.assert_equal(env.reset_infos, reference.reset_infos)
    seen = env.reset()
    assert not np.array_equal(env.reset(), seen)
    env.set_options([{"target": (1.0, 0.1 * index)} for index in range(COUNT)])
    with pytest.raises(UserError, match="options must be the same for all environments"):
        env.reset()


def test_attributes_and_methods_of_chosen_environments():
    env, reference = native(IDS[1]), dummy(IDS[1])
    for name in ("reach", "control", "action_space", "observation_space"):
        assert env.get_attr(name) == reference.get_attr(name)
    assert env.get_attr("reach", indices=[0, 2]) == [3.0, 3.0]
    assert not env.has_attr("unheard_of")
    goals = np.zeros((4, 2)), np.ones((4, 2))
    (rewards,) = env.env_method("compute_reward", *goals, [{}] * 4, indices=[1])
    np.testing.assert_array_equal(rewards, [-1.0] * 4)
    assert len(env.env_method("compute_reward", *goals, {})) == COUNT
    env.set_attr("remark", "hello")
    assert env.get_attr("remark") == ["hello"] * COUNT
    with pytest.raises(UserError, match="indices must be None, to set 'remark' of all, got 1"):
        env.set_attr("remark", 2, indices=1)
    assert env.env_is_wrapped(TimeLimit, indices=[0, 1]) == [False, False]
    env.close()
    assert env.vector_env.closed


ARMS = 8


def test_without_a_correction_it_is_the_base_agent():
    residual, envs = Residual(native(count=ARMS)), native(count=ARMS).vector_env
    residual.seed(3)
    agent, state, started = make_agent("mmc", envs), None, np.ones(ARMS, dtype=bool)
    seen, (observed, _) = residual.reset(), envs.reset(seed=3)
    assert residual.observation_space.contains(seen[0])
    for step in range(205):  # over two ends of episodes
        np.testing.assert_array_equal(seen[:, :15], observed)
        action, state = agent.predict(observed, state, started)
        np.testing.assert_array_equal(seen[:, 15:], action)
        seen, _, dones, infos = residual.step(np.zeros((ARMS, 3), np.float32))
        observed, _, _, started, vector_infos = envs.step(action)
        np.testing.assert_array_equal(dones, started)
        if step % 100 == 99:
            final = np.stack(vector_infos["final_obs"])
            # The proposal at the end is that of the agent that continues, not of one that starts.
            proposal, _ = agent.predict(final, state)
            ends = np.stack([info["terminal_observation"] for info in infos])
            np.testing.assert_array_equal(ends, np.hstack([final, proposal]))


def test_other_autoreset_modes_goal_environments_and_unknown_agents_are_refused():
    env = gym.make_vec("MMCReach-v0", 2, autoreset_mode=AutoresetMode.NEXT_STEP)
    with pytest.raises(UserError, match=r"autoreset_mode='SameStep'\), got .*NEXT_STEP"):
        GymnasiumVecEnv(env)
    with pytest.raises(UserError, match="venv must have Box observations"):
        Residual(native(IDS[1]))
    with pytest.raises(UserError, match=r"base_agent must be one of \['mmc'\], got 'ik'"):
        Residual(native(), "ik")
