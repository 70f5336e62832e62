"""Training under perturbations that are drawn for each episode."""

import numpy as np
import pytest
from stable_baselines3.common.env_util import make_vec_env as common_make_vec_env

from mmc_gym._errors import UserError
from mmc_gym.training.training import make_vec_env
from mmc_gym.training.vec_env import RandomScenarios

ARMS = 8


def plain():
    return make_vec_env("MMCReach-v0", ARMS, {"engine": "analytic", "control": "joint_delta"})


def scenarios(seed=0, **arguments):
    env = RandomScenarios(plain(), **{"groups": 4, **arguments})
    env.seed(seed)
    return env


def played(seed=0, steps=230, **arguments):
    """Observations, rewards and ends of arms under random scenarios and random actions."""
    env = scenarios(seed, **arguments)
    first, actions = env.reset(), np.random.default_rng(0).uniform(-1, 1, (steps, ARMS, 3))
    parts = [env.step(action.astype(np.float32))[:3] for action in actions]
    env.close()
    observations, rewards, dones = map(np.array, zip(*parts))
    return np.array([first, *observations]), rewards, dones


MANY = {
    "names": ("pursuit", "locks-2", "obstacles-2", "via-points"),
    "ranges": {"rotation": (-60, 60), "delay": (0, 200), "longer": (0, 50)},
}


def test_the_same_seed_draws_the_same_and_another_seed_others():
    one, same, other = (played(seed, 30, **MANY) for seed in (0, 0, 1))
    for ours, theirs in zip(one, same, strict=True):
        np.testing.assert_array_equal(ours, theirs)
    assert not np.array_equal(one[0], other[0])


def test_groups_end_their_first_episodes_one_after_the_other_and_all_others_in_full():
    _, _, dones = played()
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
    made = drawn_env.unwrapped
    assert (made.engine, made.control, made.setup.task_name) == (*arguments.values(), "pursuit")


def test_every_scenario_is_met():
    env = scenarios(**MANY)
    found = [env.draw() for _ in range(200)]
    assert {one.task for one in found} == {"random", "pursuit", "via-points"}
    kinds = {type(change).__name__ for one in found for change in one.perturbations}
    assert kinds == {
        *("LockedJoint", "Obstacles", "VisuomotorRotation", "SensoryDelay", "SegmentLength")
    }
    turns = [one.strength for one in found if one.family == "rotation"]
    assert min(turns) < -30 and max(turns) > 30


@pytest.mark.parametrize("family", ["locked", "obstacles"])
def test_whole_strengths_are_drawn_whole(family):
    env = scenarios(names=(), ranges={family: [1, 3]})
    assert {env.draw().strength for _ in range(50)} == {1.0, 2.0, 3.0}
    assert env.reset().shape == (ARMS, 15)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"groups": 3}, "groups must be a divisor of the 8 environments, got 3"),
        ({"names": ["randon"]}, "scenario 'randon' is not accepted; did you mean 'random'"),
        ({"ranges": {"rotatio": [0, 1]}}, "did you mean 'rotation"),
        ({"ranges": {"rotation": [5, 1]}}, "must be the lowest and the highest strength"),
        ({"ranges": {"locked": [1, 4]}}, "joint"),
        ({"names": []}, "names must be one at least"),
    ],
)
def test_mistakes_are_named(arguments, message):
    with pytest.raises(UserError, match=message):
        RandomScenarios(plain(), **{"groups": 4, **arguments})
