"""Training under random perturbations, and the memory of policies that are trained so."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch
from stable_baselines3.common.env_util import make_vec_env as common_make_vec_env

from mmc_gym._errors import UserError
from mmc_gym.agents.policy import PolicyAgent, load_policy
from mmc_gym.agents.views import History
from mmc_gym.interface import ObservationLayout, ReachInterface
from mmc_gym.measures.rollout import run_episodes
from mmc_gym.training.hyperparameters import read_recipe
from mmc_gym.training.randomised import Memory, RandomScenarios
from mmc_gym.training.taught import TaughtPolicy, TaughtPPO
from mmc_gym.training.training import Training, make_vec_env

ARMS = 8
BLOCKS = (1, 2, 3)
PLACE = "mmc_gym.training.randomised"
LAYOUT = ObservationLayout(3, 3.0)


def plain() -> Any:
    return make_vec_env("MMCReach-v0", ARMS, {"engine": "analytic", "control": "joint_delta"})


def drawn(seed: int = 0, steps: int = 230, **arguments: Any) -> tuple[Any, ...]:
    """Observations, rewards and ends of arms under random scenarios and random actions."""
    env = RandomScenarios(plain(), **{"groups": 4, **arguments})
    env.seed(seed)
    seen, actions = [env.reset()], np.random.default_rng(0).uniform(-1, 1, (steps, ARMS, 3))
    parts = [env.step(action.astype(np.float32))[:3] for action in actions]
    env.close()
    observations, rewards, dones = map(np.array, zip(*parts))
    return np.array([seen[0], *observations]), rewards, dones


MANY = {
    "names": ("pursuit", "locks-2", "obstacles-2", "via-points"),
    "ranges": {"rotation": (-60, 60), "delay": (0, 200), "longer": (0, 50)},
    "twice": 0.5,
}


def test_the_same_seed_draws_the_same_and_another_seed_others():
    one, same, other = drawn(**MANY), drawn(**MANY), drawn(1, **MANY)
    for ours, theirs in zip(one, same, strict=True):
        np.testing.assert_array_equal(ours, theirs)
    assert not np.array_equal(one[0], other[0])


def test_groups_end_their_first_episodes_one_after_the_other_and_all_others_in_full():
    _, _, dones = drawn()
    ends = [np.flatnonzero(dones[:, arm]) + 1 for arm in range(ARMS)]
    assert [each[0] for each in ends] == [25, 25, 50, 50, 75, 75, 100, 100]
    assert {int(step) for each in ends for step in np.diff(each)} == {100}


def test_the_vector_environments_of_others_are_replaced_too():
    """So rl_zoo3 trains by our files."""
    arguments = {"engine": "analytic", "control": "joint_velocity"}
    theirs = common_make_vec_env("MMCReach-v0", ARMS, env_kwargs=arguments)
    env = RandomScenarios(theirs, ["pursuit"], groups=4)
    assert env.reset().shape == (ARMS, 15)
    (drawn_env, *_) = env._groups
    assert drawn_env is not None
    made: Any = drawn_env.unwrapped
    assert (made.engine, made.control, made.setup.task_name) == (*arguments.values(), "pursuit")


def test_every_scenario_is_met_and_two_at_once():
    env = RandomScenarios(plain(), groups=4, **MANY)
    env.seed(0)
    found = [env._draw() for _ in range(200)]
    assert {one.task for one in found} == {"random", "pursuit", "via-points"}
    kinds = {type(change).__name__ for one in found for change in one.perturbations}
    assert kinds == {
        *("LockedJoint", "Obstacles", "VisuomotorRotation", "SensoryDelay", "SegmentLength"),
    }
    assert {len(one.perturbations) for one in found} == {0, 1, 2}
    turns = [one.strength for one in found if one.family == "rotation"]
    assert min(turns) < -30 and max(turns) > 30


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"groups": 3}, "groups must be a divisor of the 8 environments, got 3"),
        ({"twice": 2}, "twice must be a probability, got 2"),
        ({"names": ["randon"]}, "scenario 'randon' is not accepted; did you mean 'random'"),
        ({"names": ["locked-4"]}, "joint"),
        ({"ranges": {"rotatio": [0, 1]}}, "did you mean 'rotation"),
        ({"ranges": {"rotation": [5, 1]}}, "must be the lowest and the highest strength"),
        ({"names": []}, "names must be one at least"),
    ],
)
def test_mistakes_are_named(arguments, message):
    with pytest.raises(UserError, match=message):
        RandomScenarios(plain(), **{"groups": 4, **arguments})


@pytest.mark.parametrize("blocks", [(), (0,), (1.5,)])
def test_a_block_of_memory_has_a_step(blocks):
    with pytest.raises(UserError, match="blocks must be whole numbers of at least 1"):
        Memory(plain(), blocks)


TELLING = {"names": ["random"], "groups": 1, "truth": True}


def told(name: str, steps: int, action: float = 0.3, **arguments: Any) -> np.ndarray:
    """The truth that follows observations of equal arms under equal actions, (steps, arms, …)."""
    env = RandomScenarios(plain(), **{**TELLING, "names": [name], **arguments})
    env.seed(0)
    seen = [env.reset()]
    seen += [env.step(np.full((ARMS, 3), action, np.float32))[0] for _ in range(steps - 1)]
    assert all(env.observation_space.contains(one) for one in seen[-1])
    env.close()
    return np.array(seen)[..., 15:]


@pytest.mark.parametrize("name", ["delay-100", "vision-noise-0.1", "joint-noise-0.05"])
def test_the_truth_is_on_time_and_without_noise(name):
    np.testing.assert_allclose(told(name, 20), told("random", 20), atol=1e-6)


def test_the_truth_tells_of_the_body():
    """After the observation and the target's velocity: turn, forces, lengths, locks."""
    half = np.sqrt(0.5)
    for name, index, expected in (
        ("rotation-45", slice(0, 2), (half, half - 1)),
        ("force-field-90", 2, 0.9),
        ("hand-mass-3", 3, 0.3),
        ("gravity-60", 4, -0.6),
        ("longer-20", slice(5, 8), (0.0, 0.0, 0.2)),
        ("locked-2", slice(8, 11), (0.0, 1.0, 0.0)),
    ):
        (body,) = told(name, 1)[..., 17:]
        np.testing.assert_allclose(body[:, index], np.broadcast_to(expected, body[:, index].shape))
        rest = np.delete(body, np.r_[index], axis=-1)
        assert not rest.any()


def test_a_joint_that_locks_on_the_way_does_so_in_truth_too():
    locked = told("locks-2", 12)[..., 17 + 9]
    np.testing.assert_array_equal(locked[:10], 0.0)
    np.testing.assert_array_equal(locked[10:], 1.0)


def test_the_velocity_of_a_target_is_true_and_a_jump_is_none():
    moving = told("pursuit", 30, action=0.0)  # the first segment, which looks at it, stays
    np.testing.assert_allclose(
        moving[1:, :, 15:17], np.diff(moving[..., 9:11], axis=0) / 0.02, atol=1e-4
    )
    assert moving[1:, :, 15:17].any()
    assert not told("double-step-100", 10)[..., 15:17].any()


def observed(count: int = 4) -> np.ndarray:
    """Observations of consecutive steps of one arm, (steps, 15)."""
    env = gym.make("MMCReach-v0", engine="analytic")
    seen = [env.reset(seed=1)[0]]
    for _ in range(count - 1):
        seen.append(env.step(np.full(3, 0.5, np.float32))[0])
    return np.array(seen)


def test_before_an_episode_nothing_has_moved():
    history, (first, *_) = History(LAYOUT, BLOCKS), observed()
    recalled = history.recall(history.observed(first), history.start(first))
    np.testing.assert_allclose(recalled, 0.0, atol=1e-6)


def test_a_history_has_what_was_seen_and_done_less_what_is_seen_now():
    history, seen = History(LAYOUT, BLOCKS), observed()
    memory, action = history.start(seen[0]), np.full(3, 0.5, np.float32)
    for one in seen[:-1]:
        memory = history.extended(history.observed(one, memory), action, memory)
    recalled = history.recall(history.observed(seen[-1], memory), memory).reshape(3, 10)
    angles = np.arctan2(seen[:, 3:6], seen[:, :3])
    angles = np.unwrap(angles, axis=0)
    np.testing.assert_allclose(recalled[0, :3], angles[-2] - angles[-1], atol=1e-5)
    np.testing.assert_allclose(recalled[1, :3], angles[[0, 1]].mean(0) - angles[-1], atol=1e-5)
    np.testing.assert_allclose(recalled[:, 5:7], 0.0, atol=1e-5)  # the target stays
    np.testing.assert_allclose(recalled[:2, 7:], 0.5)
    np.testing.assert_allclose(recalled[2, 7:], 0.0)  # nothing was done before the episode


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """A policy with a memory after next to no training, and the model that was trained."""
    folder, models = tmp_path_factory.mktemp("memory"), []
    changes = {"n_timesteps": 1, "n_envs": 32, "n_steps": 8, "batch_size": 64}
    changes |= {"policy": "mmc_gym.training.taught.TaughtPolicy"}
    changes |= {"policy_kwargs": {"net_arch": [8], "teacher": [8]}}
    changes |= {"vec_env_wrapper": [{f"{PLACE}.RandomScenarios": TELLING}, f"{PLACE}.Memory"]}
    one = Training(read_recipe("ppo-memory").with_changes(**changes), 0, folder, evaluations=1)
    one.save = lambda model: (models.append(model), Training.save(one, model))  # type: ignore[method-assign, assignment]
    one.run()
    return *load_policy(folder / "ppo-memory-0.json"), models[-1]


def agent_in(env: Any, trained: Any) -> PolicyAgent:
    return PolicyAgent(*trained[:2], ReachInterface.of(env))


def test_the_policy_that_is_kept_acts_and_remembers_as_the_model_that_was_trained(trained):
    env = Memory(RandomScenarios(plain(), **TELLING), trained[1].blocks)
    agent, model = agent_in(env, trained), trained[2]
    shown, state, started = env.reset(), None, np.ones(ARMS, dtype=bool)
    for _ in range(120):  # over the end of episodes
        expected, _ = model.predict(shown, deterministic=True)
        actions, state = agent.predict(shown[:, :15], state, started, deterministic=True)
        np.testing.assert_allclose(actions, expected, atol=1e-5)
        shown, _, started, infos = env.step(actions)
        if started.any():
            assert {len(info["terminal_observation"]) for info in infos} == {shown.shape[1]}


def test_a_student_comes_to_do_what_its_teacher_would():
    """And no lesson changes the teacher."""
    env = Memory(RandomScenarios(plain(), **TELLING), BLOCKS)
    model = TaughtPPO(TaughtPolicy, env, lessons=1.0, n_steps=50, batch_size=50, seed=0)
    observations = torch.as_tensor(env.reset())

    def off() -> tuple[float, np.ndarray]:
        with torch.no_grad():
            right, done = model.policy.taught(observations), model.policy.studied(observations)
        return float((right - done).square().mean()), right.numpy()

    before, taught = off()
    model.learn(20 * 50 * ARMS)
    after, same = off()
    assert after < 0.1 * before
    np.testing.assert_array_equal(taught, same)


def test_one_arm_acts_as_in_a_batch(trained):
    seeds = [5, 6]
    one, many = gym.make("MMCReach-v0"), gym.make_vec("MMCReach-v0", 2)
    alone = run_episodes(agent_in(one, trained), one, seeds)
    together = run_episodes(agent_in(many, trained), many, seeds)
    for each, same in zip(alone, together, strict=True):
        np.testing.assert_allclose(each.hands, same.hands, atol=1e-4)


def test_a_state_of_other_arms_is_refused(trained):
    env = gym.make_vec("MMCReach-v0", 2)
    agent, (observations, _) = agent_in(env, trained), env.reset(seed=0)
    _, state = agent.predict(observations)
    with pytest.raises(UserError, match=r"state must be what predict returned.* \(3, 30, 10\)"):
        agent.predict(observations[[0, 1, 1]], state)


def test_a_new_episode_knows_nothing_of_the_last_and_changes_no_other(trained):
    env = gym.make_vec("MMCReach-v0", 2)
    agent, (first, _), state = agent_in(env, trained), env.reset(seed=0), None
    observations = first
    for _ in range(5):
        actions, state = agent.predict(observations, state, deterministic=True)
        observations, *_ = env.step(actions)
    _, fresh = agent.predict(first, None, deterministic=True)
    _, going_on = agent.predict(first, state, deterministic=True)
    _, restarted = agent.predict(first, state, np.array([True, False]), deterministic=True)
    np.testing.assert_array_equal(restarted[0], fresh[0])
    np.testing.assert_array_equal(restarted[1], going_on[1])
    assert not np.array_equal(fresh, going_on)
