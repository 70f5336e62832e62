"""Facts about what is registered."""

import subprocess
import sys

import gymnasium as gym
import pytest

import mmc_gym  # noqa: F401  (registers the environments)
from mmc_gym.envs.perturbations import PERTURBATIONS
from mmc_gym.envs.scenarios import PERTURBATION_TASKS, TASK_STEPS, camel_case
from mmc_gym.envs.tasks import TASKS


def test_every_task_has_an_id() -> None:
    assert {"random", *TASK_STEPS} == set(TASKS)


def test_every_perturbation_has_an_id_and_a_task() -> None:
    assert set(PERTURBATION_TASKS) == set(PERTURBATIONS)
    assert set(PERTURBATION_TASKS.values()) <= set(TASKS)


@pytest.mark.parametrize("name", TASK_STEPS)
def test_the_id_of_a_task_makes_it(name: str) -> None:
    env = gym.make(f"MMCReach{camel_case(name)}-v0")
    assert env.unwrapped.setup.task is TASKS[name]
    assert env.unwrapped.setup.perturbations == ()


@pytest.mark.parametrize("name", PERTURBATIONS)
def test_the_id_of_a_perturbation_makes_it(name: str) -> None:
    env = gym.make(f"MMCReach{camel_case(name)}-v0")
    assert env.unwrapped.setup.perturbations == (PERTURBATIONS[name],)


@pytest.mark.parametrize(
    ("env_id", "steps"),
    [("MMCReach-v0", 100), ("MMCReachPursuit-v0", 500), ("MMCReachViaPoints-v0", 200)],
)
def test_an_id_has_the_time_that_its_task_takes(env_id: str, steps: int) -> None:
    assert gym.spec(env_id).max_episode_steps == steps
    assert gym.make_vec(env_id, 2).max_episode_steps == steps


def test_a_pursuit_lasts_one_period_of_the_targets_path() -> None:
    setup = gym.make("MMCReachPursuit-v0").unwrapped.setup
    assert setup.path_length == TASK_STEPS["pursuit"]


def test_names_become_ids_in_camel_case() -> None:
    assert camel_case("longer-10-told") == "Longer10Told"
    assert camel_case("paper") == "Paper"


def test_an_argument_replaces_that_of_the_id() -> None:
    setup = gym.make("MMCReachForceField-v0", task="random").unwrapped.setup
    assert setup.task is TASKS["random"]
    assert setup.perturbations == (PERTURBATIONS["force-field"],)


def test_registering_imports_neither_physics_nor_drawing() -> None:
    code = "import mmc_gym, sys; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = {name.partition(".")[0] for name in done.stdout.split()}
    assert loaded.isdisjoint({"pymunk", "scipy", "pygame", "numba", "torch", "matplotlib"})
