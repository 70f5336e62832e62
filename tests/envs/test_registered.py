"""What holds for every environment that mmc_gym registers.

The two plain ones are tried under every control mode; of the others, which differ from them in
task or perturbation, each is tried under one, in turn.
"""

import copy
import pickle
from collections.abc import Iterator
from functools import partial
from itertools import cycle, pairwise, product
from typing import Any, get_args

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env, data_equivalence
from stable_baselines3.common.env_checker import check_env as check_env_for_sb3

import mmc_gym  # noqa: F401  (registers the environments)
from mmc_gym.envs.perturbations import JointNoise
from mmc_gym.envs.tasks import TASKS
from mmc_gym.interface import Control

PLAIN = ["MMCReach-v0", "MMCReachGoal-v0"]
IDS = [spec.id for spec in gym.registry.values() if str(spec.entry_point).startswith("mmc_gym.")]
CONTROLS = get_args(Control)
same = partial(data_equivalence, exact=True)
Transition = tuple[Any, ...]

OTHERS = sorted(set(IDS) - set(PLAIN))
CASES = [*product(PLAIN, CONTROLS), *zip(OTHERS, cycle(CONTROLS), strict=False)]

pytestmark = pytest.mark.parametrize(("env_id", "control"), CASES)


@pytest.fixture
def env(env_id: str, control: str) -> Iterator[gym.Env]:
    env = gym.make(env_id, control=control)
    env.action_space.seed(0)
    yield env
    env.close()


def harsh_actions(env: gym.Env, steps: int, seed: int = 0) -> np.ndarray:
    """Random actions, among them many at the borders of the space, each held for a while."""
    random = np.random.default_rng(seed)
    assert isinstance(env.action_space, gym.spaces.Box)
    actions = random.uniform(-1.5, 1.5, (steps, *env.action_space.shape)).clip(-1, 1)
    holds = random.random(steps) < 0.3
    last = np.maximum.accumulate(np.where(holds, np.arange(steps), 0))
    return actions[last].astype(np.float32)


def rollout(env: gym.Env, actions: np.ndarray, seed: int = 7) -> list[Transition]:
    """All that reset and steps return, with a reset at every truncation."""
    return [env.reset(seed=seed), *continued(env, actions)]


def continued(env: gym.Env, actions: np.ndarray) -> list[Transition]:
    """All that steps return, with a reset at every truncation."""
    record: list[Transition] = []
    for action in actions:
        record.append(env.step(action))
        if record[-1][2] or record[-1][3]:
            record.append(env.reset())
    return record


def flat(observation: Any) -> np.ndarray:
    if isinstance(observation, dict):
        return np.concatenate([observation[key] for key in sorted(observation)])
    return np.asarray(observation)


def time_limit(env: gym.Env) -> int:
    assert env.spec is not None
    assert env.spec.max_episode_steps is not None
    return env.spec.max_episode_steps


def posture_elements(env: gym.Env, start: int, stop: int) -> np.ndarray:
    """Which elements of the flat observation are from `start` to `stop` of the posture's nine."""
    places = np.arange(len(flat(env.observation_space.sample())))
    if isinstance(env.observation_space, gym.spaces.Dict):  # the posture comes last
        places = places - len(places) + 9
    return (start <= places) & (places < stop)


def is_posture(env: gym.Env) -> np.ndarray:
    return posture_elements(env, 0, 6)


def is_speed(env: gym.Env) -> np.ndarray:
    return posture_elements(env, 6, 9)


def test_there_are_environments(env_id: str, control: str) -> None:
    assert set(PLAIN) < set(IDS)


def test_its_specification_is_data(env_id: str, control: str) -> None:
    spec = gym.spec(env_id)
    assert gym.envs.registration.EnvSpec.from_json(spec.to_json()) == spec
    assert spec.vector_entry_point is not None


def test_gymnasium_approves(env: gym.Env) -> None:
    check_env(env.unwrapped)  # pytest makes its warnings errors


def test_stable_baselines3_approves(env: gym.Env, capsys: pytest.CaptureFixture[str]) -> None:
    check_env_for_sb3(env.unwrapped, warn=True, skip_render_check=False)
    is_goal_env = isinstance(env.observation_space, gym.spaces.Dict)
    assert ("GoalEnv" in capsys.readouterr().out) == is_goal_env


def test_same_seed_and_actions_give_the_same_episodes(env: gym.Env, control: str) -> None:
    assert env.spec is not None
    other = gym.make(env.spec.id, control=control)
    actions = harsh_actions(env, 250)
    first = rollout(env, actions)
    assert same(first, rollout(other, actions))
    assert same(first, rollout(env, actions))  # after episodes of its own, too
    assert not same(first, rollout(other, actions, seed=8))


def test_a_copy_of_a_running_environment_has_the_same_future(env: gym.Env) -> None:
    actions = harsh_actions(env, 250)
    env.reset(seed=3)
    for action in actions[:30]:
        env.step(action)
    copies = [pickle.loads(pickle.dumps(env)), copy.deepcopy(env)]
    future = continued(env, actions[30:])
    for other in copies:
        assert same(future, continued(other, actions[30:]))


def test_observations_stay_inside_their_space(env: gym.Env) -> None:
    seen = []
    for transition in rollout(env, harsh_actions(env, 500)):
        observation = transition[0]
        assert env.observation_space.contains(observation)
        assert np.isfinite(flat(observation)).all()
        seen.append(flat(observation))
    assert (np.ptp(seen, axis=0) > 0.1).all()  # every element tells something


def test_observations_share_no_memory(env: gym.Env) -> None:
    record = rollout(env, harsh_actions(env, 5))
    for earlier, later in pairwise(record):
        for key in ("end_effector", "target"):
            assert not np.shares_memory(earlier[-1][key], later[-1][key])
        if isinstance(later[0], dict):
            for key in later[0]:
                assert not np.shares_memory(earlier[0][key], later[0][key])
                assert not np.shares_memory(later[0][key], later[-1]["target"])
                assert not np.shares_memory(later[0][key], later[-1]["end_effector"])
        else:
            assert not np.shares_memory(earlier[0], later[0])


def test_rewards_are_finite_floats(env: gym.Env) -> None:
    for _, reward, *_ in (step for step in rollout(env, harsh_actions(env, 100)) if len(step) == 5):
        assert isinstance(reward, float)
        assert np.isfinite(reward)


def test_an_episode_ends_by_the_time_limit_alone(env: gym.Env) -> None:
    env.reset(seed=0)
    limit = time_limit(env)
    ends = [env.step(env.action_space.sample())[2:4] for _ in range(limit)]
    assert ends == [(False, False)] * (limit - 1) + [(False, True)]


def test_initial_states_differ(env: gym.Env) -> None:
    env.reset(seed=0)
    starts = np.array([flat(env.reset()[0]) for _ in range(5)])
    is_constant = np.ptp(starts, axis=0) == 0
    setup, speeds = env.unwrapped.setup, starts[:, is_constant & is_speed(env)]
    assert (speeds == 0).all()
    senses_rest = not any(isinstance(noise, JointNoise) and noise.std for noise in setup.noises)
    assert speeds.shape[1] == (3 if senses_rest else 0)
    if setup.task == TASKS["centre-out"]:  # one place to start from
        is_constant &= ~is_posture(env)
    assert is_constant.sum() == speeds.shape[1]  # all else is drawn anew


def test_a_vector_of_them_plays_like_single_ones(env: gym.Env, control: str) -> None:
    assert env.spec is not None
    count = 3
    vector = gym.make_vec(env.spec.id, count, vectorization_mode="sync", control=control)
    single = [gym.make(env.spec.id, control=control) for _ in range(count)]
    observations, _ = vector.reset(seed=20)
    alone = [one.reset(seed=20 + index)[0] for index, one in enumerate(single)]
    steps = time_limit(env)
    actions = np.stack([harsh_actions(env, steps, seed) for seed in range(count)], axis=1)
    for action in actions:
        assert same(observations, stack(alone))
        observations, rewards, _, truncated, infos = vector.step(action)
        returned = [one.step(act) for one, act in zip(single, action, strict=True)]
        alone = [one[0] for one in returned]
        assert rewards.tolist() == [one[1] for one in returned]
        assert infos["distance"].tolist() == [one[4]["distance"] for one in returned]
    assert truncated.all()
    assert same(observations, stack(alone))
    vector.close()


def stack(observations: list[Any]) -> Any:
    if isinstance(observations[0], dict):
        return {key: np.stack([one[key] for one in observations]) for key in observations[0]}
    return np.stack(observations)
