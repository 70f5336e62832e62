"""Facts about the names of scenarios, and about what is registered with Gymnasium."""

import json
import subprocess
import sys
from typing import Any

import gymnasium as gym
import pytest

import mmc_gym  # noqa: F401  (registers the environments)
from mmc_gym._errors import UserError
from mmc_gym.envs.perturbations import (
    ForceField,
    Gravity,
    JointNoise,
    LockedJoint,
    Obstacles,
    Perturbation,
    SegmentLength,
    SensoryDelay,
    VisionNoise,
    VisuomotorRotation,
)
from mmc_gym.envs.reach import MMCReachEnv
from mmc_gym.envs.scenarios import (
    FAMILIES,
    PERTURBATION_NAMES,
    TASK_SCENARIOS,
    environment_id,
    find_perturbation,
    scenario,
)
from mmc_gym.envs.tasks import TASKS, outward_task
from mmc_gym.envs.vector import MMCReachVectorEnv

DISC = (1.5, 1.0, 0.25)


@pytest.mark.parametrize(
    ("name", "full_name", "perturbation"),
    [
        ("delay-150", "delay-150", SensoryDelay(0.15)),
        ("longer-35-told", "longer-35-told", SegmentLength(1.35, told=True)),
        ("shorter", "shorter-20", SegmentLength(0.8)),
        ("force-field", "force-field-60", ForceField(60.0)),
        ("force-field--5.50", "force-field--5.5", ForceField(-5.5)),
        ("rotation-30", "rotation-30", VisuomotorRotation(30.0)),
        ("gravity", "gravity-60", Gravity(60.0)),
        ("locked", "locked-2", LockedJoint(1)),
        ("locks-3-told", "locks-3-told", LockedJoint(2, time=0.2, told=True)),
        ("joint-noise-speed-0.03", "joint-noise-speed-0.03", JointNoise(0.0, speed_std=0.03)),
        ("vision-noise-0.00001", "vision-noise-0.00001", VisionNoise(0.00001)),
        ("vision-noise-distance", "vision-noise-distance-0.05", VisionNoise(0.0, 0.05)),
        ("obstacles-1", "obstacles-1", Obstacles((DISC,))),
        ("force-field-1000000", "force-field-1000000", ForceField(1e6)),
    ],
)
def test_a_name_with_any_strength_makes_a_perturbation(
    name: str, full_name: str, perturbation: Perturbation
) -> None:
    one = scenario(name)
    assert one.name == full_name
    assert one == scenario(full_name)
    assert one.perturbations == (perturbation,)
    assert MMCReachEnv(perturbations=[name]).setup.perturbations == one.perturbations


def test_a_family_without_strength_is_its_class_without_arguments() -> None:
    for name in set(FAMILIES) - {"shorter", "locks", "joint-noise-speed", "vision-noise-distance"}:
        perturbation = find_perturbation(name)
        assert perturbation == type(perturbation)()


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("longer-told-20", "did you mean 'longer-20-told'"),
        ("Delay-30", "did you mean 'delay-30'"),
        ("forcefield", "did you mean 'force-field'"),
        ("pursuits", "did you mean 'pursuit'"),
        ("gremlins", "one of random.*, or one of force-field.*got 'gremlins'$"),
        ("delay-40-told", "'-told' may follow longer, shorter, locked, locks only.*'delay'"),
        ("locked-0", "joint that locks must be a whole number from 1"),
        ("locks-1.5", "joint that locks must be a whole number from 1"),
        ("obstacles-5", "number of obstacles must be a whole number from 1 to 4"),
        ("delay--40", "seconds must be"),
        ("shorter-100", "factor must be"),
        ("delay-", "did you mean 'delay'"),
        (None, "got None"),
    ],
)
def test_a_wrong_name_is_refused_with_a_hint(name: Any, hint: str) -> None:
    with pytest.raises(UserError, match=hint):
        scenario(name)


def test_agents_are_told_of_gravity_as_when_it_is_a_parameter() -> None:
    env, twin = MMCReachEnv(perturbations="gravity-60"), MMCReachEnv(gravity=(0.0, -60.0))
    assert env.parameters == twin.parameters
    assert env.setup.body == twin.setup.body


@pytest.mark.parametrize(
    ("task", "centre"),
    [("centre-out", (0.0, 1.5)), (outward_task([0.1, 0.3]), (0.0, 1.5)), ("random", (0.0, 0.0))],
)
def test_a_rotation_turns_about_the_start_of_all_movements_or_the_base(
    task: Any, centre: tuple[float, float]
) -> None:
    rotation = MMCReachEnv(task=task, perturbations="rotation-30").setup.rotation
    assert rotation == VisuomotorRotation(30.0, centre)


def test_a_scenario_makes_its_environments_and_counts_its_trials() -> None:
    for name in ("distances", "via-points", "locked-3-told"):
        one = scenario(name)
        env, vector = one.make("joint_delta"), one.make_vec(2, "joint_delta")
        assert env.unwrapped.setup.perturbations == vector.setup.perturbations == one.perturbations
        assert env.unwrapped.control == vector.control == "joint_delta"
        assert env.spec.max_episode_steps == vector.max_episode_steps
        assert json.loads(json.dumps(one.settings)) == one.settings
    assert scenario("random").instances(3) == [{}, {}, {}]
    assert scenario("distances").instances(3) == [{"trial": trial} for trial in range(32)]


def test_every_task_is_a_scenario() -> None:
    assert set(TASK_SCENARIOS) == {*TASKS, "distances"}


@pytest.mark.parametrize("name", TASKS)
def test_the_id_of_a_task_makes_it_and_has_its_time(name: str) -> None:
    env, task = gym.make(environment_id(name)), TASKS[name]
    assert env.unwrapped.setup.task is task
    assert env.unwrapped.setup.perturbations == ()
    assert gym.spec(environment_id(name)).max_episode_steps == task.episode_steps
    assert env.spec.max_episode_steps == task.episode_steps
    assert gym.make_vec(environment_id(name), 2).max_episode_steps == task.episode_steps
    assert MMCReachVectorEnv(2, task=name).max_episode_steps == task.episode_steps


@pytest.mark.parametrize("name", PERTURBATION_NAMES)
def test_the_id_of_a_perturbation_makes_it_in_the_task_random(name: str) -> None:
    setup = gym.make(environment_id(name)).unwrapped.setup
    assert setup.perturbations == scenario(name).perturbations
    assert setup.task is TASKS["random"]


def test_names_become_ids_in_camel_case() -> None:
    assert environment_id("longer-10-told") == "MMCReachLonger10Told-v0"
    assert environment_id("paper") == "MMCReachPaper-v0"
    assert environment_id("random") == "MMCReach-v0"


@pytest.mark.parametrize("mode", [None, "vector_entry_point", "sync"])
def test_a_task_of_another_length_than_the_ids_is_refused_by_name(mode: str | None) -> None:
    def make(env_id: str, **arguments: Any) -> Any:
        if mode is None:
            return gym.make(env_id, **arguments)
        return gym.make_vec(env_id, 2, vectorization_mode=mode, **arguments)

    for name, env_id in (("pursuit", "MMCReach-v0"), ("random", "MMCReachPursuit-v0")):
        with pytest.raises(UserError, match=f"got '{name}'.*make '{environment_id(name)}'"):
            make(env_id, task=name)
    make("MMCReachLocked-v0", task="centre-out").close()
    make("MMCReach-v0", task=TASKS["pursuit"], max_episode_steps=500).close()
    make("MMCReachPursuit-v0", perturbations=["delay-150"], max_episode_steps=7).close()


def test_an_explicit_time_limit_wins() -> None:
    assert gym.make("MMCReachPursuit-v0", max_episode_steps=7).spec.max_episode_steps == 7
    assert gym.make_vec("MMCReachPursuit-v0", 2, max_episode_steps=7).max_episode_steps == 7
    vector = gym.make_vec("MMCReach-v0", 2, task="pursuit", max_episode_steps=30)
    assert vector.max_episode_steps == 30


def test_a_pursuit_lasts_one_period_of_the_targets_path() -> None:
    assert MMCReachEnv(task="pursuit").setup.path_length == TASKS["pursuit"].episode_steps


def test_registering_imports_neither_physics_nor_drawing() -> None:
    code = "import mmc_gym, sys; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = {name.partition(".")[0] for name in done.stdout.split()}
    assert loaded.isdisjoint({"pymunk", "scipy", "pygame", "numba", "torch", "matplotlib"})
