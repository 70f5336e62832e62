"""The wrapper of the studies that draws a scenario for every episode."""

import numpy as np
import pytest
from stable_baselines3.common.env_util import make_vec_env as dummy

from mmc_gym import UserError
from mmc_gym.training.training import make_vec_env
from studies.learners.random_scenarios import RandomScenarios

ARMS = 8


def scenarios(**arguments):
    plain = make_vec_env("MMCReach-v0", ARMS, {"engine": "analytic", "control": "joint_delta"})
    return RandomScenarios(plain, **{"groups": 4, **arguments})


def played(seed=0, steps=230, **arguments):
    """Observations, rewards and ends of arms under random scenarios and random actions."""
    env = scenarios(**arguments)
    env.seed(seed)
    first, actions = env.reset(), np.random.default_rng(0).uniform(-1, 1, (steps, ARMS, 3))
    parts = [env.step(action.astype(np.float32))[:3] for action in actions]
    env.close()
    observations, rewards, dones = map(np.array, zip(*parts))
    return np.array([first, *observations]), rewards, dones


MANY = {
    "names": ("pursuit", "locks-2", "obstacles-2", "via-points"),
    "ranges": {"rotation": (-60, 60), "delay": (0, 200), "longer": (0, 50)},
}


def test_groups_end_their_first_episodes_one_after_the_other_and_all_others_in_full():
    _, _, dones = played()
    ends = [np.flatnonzero(dones[:, arm]) + 1 for arm in range(ARMS)]
    assert [each[0] for each in ends] == [25, 25, 50, 50, 75, 75, 100, 100]
    assert {int(step) for each in ends for step in np.diff(each)} == {100}


def test_the_vector_environments_of_others_are_replaced_too():
    """So rl_zoo3 trains by our files."""
    arguments = {"engine": "analytic", "control": "joint_velocity"}
    theirs = dummy("MMCReach-v0", ARMS, env_kwargs=arguments)
    env = RandomScenarios(theirs, ["pursuit"], groups=4)
    assert env.reset().shape == (ARMS, 15)
    made = env._groups[0].unwrapped
    assert (made.engine, made.control, made.setup.task_name) == (*arguments.values(), "pursuit")


def test_every_scenario_is_met_and_the_seed_draws_them():
    env = scenarios(**MANY)
    env.seed(0)
    found = [env.draw() for _ in range(200)]
    assert {one.task.name for one in found} == {"random", "pursuit", "via-points"}
    kinds = {type(change.perturbation).__name__ for one in found for change in one.changes}
    assert kinds == {
        *("LockedJoint", "Obstacles", "VisuomotorRotation", "SensoryDelay", "SegmentLength")
    }
    turns = [one.strength for one in found if one.family == "rotation"]
    assert min(turns) < -30 and max(turns) > 30
    one, same, other = (played(seed, 30, **MANY)[0] for seed in (0, 0, 1))
    np.testing.assert_array_equal(one, same)
    assert not np.array_equal(one, other)


@pytest.mark.parametrize("family", ["locked", "obstacles"])
def test_whole_strengths_are_drawn_whole(family):
    env = scenarios(names=(), ranges={family: [1, 3]})
    env.seed(0)
    assert {env.draw().strength for _ in range(50)} == {1.0, 2.0, 3.0}
    assert env.reset().shape == (ARMS, 15)


def test_mistakes_in_scenarios_are_named():
    for arguments, message in (
        ({"groups": 3}, "groups must be a divisor of the 8 environments, got 3"),
        ({"names": ["randon"]}, "scenario 'randon' is not accepted; did you mean 'random'"),
        ({"ranges": {"rotatio": [0, 1]}}, "did you mean 'rotation"),
        ({"ranges": {"rotation": [5, 1]}}, "must be the lowest and the highest strength"),
        ({"ranges": {"locked": [1, 4]}}, "joint"),
        ({"names": []}, "names must be one at least"),
    ):
        with pytest.raises(UserError, match=message):
            scenarios(**arguments)
