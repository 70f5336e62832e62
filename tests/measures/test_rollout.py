"""Rollouts: what is recorded, one by one and all at once."""

from dataclasses import asdict
from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.wrappers import TimeLimit

import mmc_gym
from mmc_gym import UserError, make_agent
from mmc_gym.envs.vector import MMCReachVectorEnv
from mmc_gym.measures import measure_all, rollout
from mmc_gym.measures.reaching import time_to_target
from mmc_gym.measures.rollout import episode_seeds, evaluate, run_episodes


def says(predicted):
    """Return an agent whose `predict` returns this."""
    return SimpleNamespace(predict=lambda *_, **__: predicted)


def test_seeds_are_all_different_and_more_episodes_only_add_to_them():
    seeds = episode_seeds(7, 500)
    assert len({*seeds, *episode_seeds(8, 500)}) == 1000
    assert episode_seeds(7, 20) == seeds[:20]
    for seed, episodes, wrong in ((0, 0, "episodes"), (-1, 5, "seed")):
        with pytest.raises(ValueError, match=wrong):
            episode_seeds(seed, episodes)


def test_an_episode_records_what_the_environment_reports_and_changes_nothing(oracle):
    env = mmc_gym.make("double-step-100+rotation-60")
    (episode,) = run_episodes(oracle, env, [4])
    assert not env.unwrapped.arm.records_effort
    observation, info = env.reset(seed=4)
    steps = [(observation, None, False, False, info)]
    while not steps[-1][3]:
        steps.append(env.step(oracle.predict(steps[-1][0])[0]))
    reported = {"hands": "end_effector", "cursors": "cursor", "seen_hands": "cursor"}
    reported |= {"targets": "target", "distances": "distance"}
    for name, key in reported.items():
        np.testing.assert_array_equal(getattr(episode, name), [step[4][key] for step in steps])
    np.testing.assert_array_equal(episode.rewards, [step[1] for step in steps[1:]])
    assert episode.action_times.shape == (100,) and (episode.action_times > 0).all()
    assert (episode.control_step, episode.tolerance, episode.reach) == (0.02, 0.05, 3.0)
    turned = np.exp(1j * np.cumsum(episode.joint_angles, axis=-1)).sum(axis=-1)
    assert episode.hands == pytest.approx(np.stack([turned.real, turned.imag], axis=-1))
    assert np.flatnonzero(np.diff(episode.targets[:, 0])).tolist() == [4]
    assert episode.servo_impulses.shape == episode.servo_work.shape == (100, 3)
    assert (episode.servo_impulses[:5] > 0).any() and (episode.servo_work >= 0).all()
    (without,) = run_episodes(oracle, env, [4], records_effort=False)
    assert np.isnan(without.servo_impulses).all() and np.isnan(without.servo_work).all()
    np.testing.assert_array_equal(without.hands, episode.hands)


def test_an_episode_depends_on_its_own_seed_only_even_if_actions_are_sampled(env):
    agent = SimpleNamespace(predict=lambda *_, **__: (env.action_space.sample(), None))
    first, second = run_episodes(agent, env, np.arange(1, 3))
    assert type(first.seed) is int
    (alone,) = run_episodes(agent, env, [2])
    assert np.array_equal(second.hands, alone.hands)
    # Seeded alike, action space and environment draw the same: the posture that the arm is in.
    assert np.linalg.norm(first.hands[1] - first.hands[0]) > 1e-3


def test_the_state_goes_round_within_an_episode_and_starts_anew_with_the_next(env):
    calls, shown = [], []

    def predict(observation, state=None, episode_start=None, deterministic=False):
        calls.append((state, bool(episode_start[0]), deterministic))
        return np.zeros(3, np.float32), len(calls)

    agent = SimpleNamespace(predict=predict)
    episodes = run_episodes(agent, TimeLimit(env.unwrapped, 3), [1, 2], shown.append)
    first = [(None, True, True), (1, False, True), (2, False, True)]
    assert calls == [*first, (None, True, True), (4, False, True), (5, False, True)]
    assert tuple(shown) == episodes


@pytest.mark.slow
def test_torch_computes_on_one_thread_during_the_rollout_and_as_before_after_it(env, frozen):
    import torch

    threads, seen = torch.get_num_threads(), []
    torch.set_num_threads(2)
    try:
        env = TimeLimit(env.unwrapped, 2)
        run_episodes(frozen, env, [1], lambda _: seen.append(torch.get_num_threads()))
        assert (seen, torch.get_num_threads()) == ([1], 2)
    finally:
        torch.set_num_threads(threads)


class Slider(gym.Env):
    """A hand without an arm: each action is its velocity."""

    action_space = gym.spaces.Box(-1, 1, (2,))
    parameters, success_distance, reach = SimpleNamespace(control_step=0.1), 0.05, 1.0

    def reset(self, *, seed=None, options=None):
        self.hand, self.target = np.zeros(2), np.array([0.5, 0.0])
        return self.hand, self.info()

    def step(self, action):
        self.hand = self.hand + 0.1 * action
        return self.hand, 0.0, False, False, self.info()

    def info(self):
        distance = np.linalg.norm(self.hand - self.target)
        return {"end_effector": self.hand, "target": self.target, "distance": distance}


def test_an_environment_of_your_own_needs_no_arm_but_an_end(env, frozen, monkeypatch):
    (episode,) = run_episodes(says((np.array([1.0, 0.0]), None)), TimeLimit(Slider(), 5), [1])
    measured = measure_all(episode)
    assert (measured["success"], measured["time_to_target"]) == (1, 0.5)
    assert np.isnan(measured["joint_work"]) and np.isnan(measured["joint_effort"])
    monkeypatch.setattr(rollout, "MAX_STEPS", 150)
    with pytest.raises(RuntimeError, match="did not end within 150 steps"):
        run_episodes(frozen, env.unwrapped, [1])


def assert_same(together, alone):
    for episode, other in zip(together, alone, strict=True):
        for name, values in asdict(other).items():
            if values is not None and name != "action_times":
                recorded = getattr(episode, name)
                np.testing.assert_allclose(recorded, values, rtol=0, atol=1e-9, err_msg=name)
        assert np.isnan(episode.action_times).all()
        assert (episode.cursors is None) == (other.cursors is None)


@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        ("force-field-90+locks-2", {}),
        ("via-points+rotation-30", {}),
        ("paper+joint-noise", {}),
        pytest.param("random", {"engine": "analytic"}, marks=pytest.mark.slow),
        pytest.param("obstacles", {"control": "joint_delta"}, marks=pytest.mark.slow),
        pytest.param("MMCReachGoal-v0", {}, marks=pytest.mark.slow),
        pytest.param("pursuit+delay-100", {}, marks=pytest.mark.slow),
    ],
)
def test_episodes_together_are_those_one_by_one(name, arguments):
    """Also with options for each, and of a vector environment that is used again."""
    if "engine" in arguments:
        pytest.importorskip("numba")
    seeds = episode_seeds(3, 4)
    options = [{"trial": trial} for trial in (5, 0, 5, 17)] if "paper" in name else None
    env = mmc_gym.make(name, **arguments)
    vector = mmc_gym.make_vec(name, num_envs=len(seeds), **arguments)
    agent = make_agent("mmc", vector)
    alone = run_episodes(make_agent("mmc", env), env, seeds, options=options)
    for _ in range(2):
        assert_same(run_episodes(agent, vector, seeds, options=options), alone)
    assert not vector.unwrapped.arms.records_effort
    assert (alone[0].hands[0] == alone[2].hands[0]).all() == (options is not None)
    assert all((episode.cursors is None) == ("rotation" not in name) for episode in alone)
    assert all(np.isnan(episode.servo_work).all() == ("engine" in arguments) for episode in alone)


def test_an_evaluation_is_a_summary_of_the_episodes_of_its_seeds():
    env = gym.make("MMCReach-v0", max_episode_steps=40)
    agent = make_agent("mmc", env)
    scores = evaluate(lambda _: agent, "MMCReach-v0", {"max_episode_steps": 40}, 20, seed=5)
    episodes = run_episodes(agent, env, range(5, 25))
    at_target = [episode.distances <= episode.tolerance for episode in episodes]
    assert scores == {
        "success": np.mean([inside[-1] for inside in at_target]),
        "final_distance": pytest.approx(np.mean([episode.distances[-1] for episode in episodes])),
        "episode_return": pytest.approx(np.mean([episode.rewards.sum() for episode in episodes])),
        "time_at_target": pytest.approx(np.mean([inside[1:].mean() for inside in at_target])),
        "time_to_target": pytest.approx(np.nanmedian([*map(time_to_target, episodes)])),
    }
    assert 0 < scores["success"] < 1


VECTOR = gym.make_vec("MMCReach-v0", num_envs=2)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"agent": "mmc"}, "agent must be .*'mmc'"),
        ({"agent": says(None)}, "what predict returns must be .* got None"),
        ({"env": "MMCReach-v0"}, "env must be .*'MMCReach-v0'"),
        ({"env": gym.make("CartPole-v1")}, r"CartPole-v1.*info\['distance'\].*control_step.*reach"),
        ({"seeds": [-1]}, r"seeds must be .*\[-1\]"),
        ({"options": [{}, {}]}, r"options must be .*\[{}, {}\]"),
        ({"env": VECTOR, "seeds": [0, 1]}, r"actions must have shape \(2, 3\)"),
        ({"env": VECTOR, "seeds": [0, 1, 2]}, "env must have 3 arms"),
        ({"env": MMCReachVectorEnv(1, max_episode_steps=None)}, "env must .*a time limit"),
        ({"env": MMCReachVectorEnv(1, autoreset_mode="SameStep")}, "env must .*SameStep"),
        ({"env": gym.make_vec("MMCReach-v0", 1, vectorization_mode="sync")}, "env must .*native"),
    ],
)
def test_wrong_arguments_are_refused(arguments, message):
    accepted = {"agent": says((np.zeros(3), None)), "env": gym.make("MMCReach-v0"), "seeds": [1]}
    with pytest.raises(UserError, match=message):
        run_episodes(**{**accepted, **arguments})
