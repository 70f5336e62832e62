"""Your own environments, rewards, tasks, perturbations and agents, wherever these are named."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

import mmc_gym
from mmc_gym import UserError, perturbation
from mmc_gym.benchmark.compare import compare
from mmc_gym.benchmark.runner import benchmark
from mmc_gym.benchmark.store import read_episodes, read_manifest
from mmc_gym.cli import main
from mmc_gym.envs import register_task
from mmc_gym.envs.perturbations import FAMILIES
from mmc_gym.envs.scenarios import parse_scenario
from mmc_gym.envs.tasks import RandomTarget, Trial
from mmc_gym.experiments.experiment import Block, Experiment
from mmc_gym.report import write_report
from tests.processes import run_python


@dataclass(frozen=True)
class Here(RandomTarget):
    """The target is where the hand is."""

    episode_steps = 4

    def draw(self, request):
        angles = np.cumsum(start := request.draw_posture())
        return Trial(start, [(float(np.cos(angles).sum()), float(np.sin(angles).sum()))])


def carry(arms, mass):
    arms.hand_mass[:] = mass


def push(arms, curl):
    arms.force_field[:, 0, 1] += curl


class Flat(gym.Wrapper):
    """A reward that is always 1, and a control mode that is never taken."""

    def __init__(self, **arguments):
        super().__init__(gym.make("MMCReach-v0", **arguments))

    def step(self, action):
        observation, _, *ends, info = self.env.step(action)
        return observation, 1.0, *ends, info


EXAMPLE = Path(__file__).parents[2] / "examples" / "bring_your_own.py"
MY_ARM = """
gym.register("MyArm-v0", "mmc_gym.envs.reach:MMCReachEnv", max_episode_steps=7,
             kwargs={"segment_lengths": (1, 1, 0.5), "control": "joint_velocity"})
"""
HEAVY = """
import mmc_gym
@mmc_gym.perturbation("heavy", unit="length / s²", default=2.0)
def heavy(arms, acceleration):
    arms.gravity[:, 1] -= acceleration
"""


pytestmark = pytest.mark.usefixtures("forget_what_is_registered")


def test_an_own_task_has_a_name_an_id_and_a_scenario(tmp_path):
    register_task("here", Here(), "the hand is there already")
    for env in (gym.make("MMCReachHere-v0"), gym.make("MMCReach-v0", task=Here())):
        assert env.reset(seed=0)[1]["distance"] < 1e-9
    assert mmc_gym.list_tasks().rows[-1].needs == "4 steps, drawn"
    assert compare(["mmc"], "MMCReachHere-v0", 1).recorded["mmc"][0].rewards.shape == (4,)
    benchmark(["mmc"], tmp_path, ["here"], 2, jobs=1)
    assert read_episodes(tmp_path)["final_distance"].max() < 1e-3
    assert parse_scenario("here").make_vec(1).max_episode_steps == 4
    assert read_manifest(tmp_path).environments["here"]["kwargs"]["task"]["name"] == "Here"
    register_task("here", Here())  # a cell of a notebook that is run again


def test_an_own_perturbation_takes_any_strength():
    texts = {"unit": "segment masses", "description": "{} masses at the hand"}
    heavy = perturbation("heavy", **texts, default=2.0, neutral=0.0)(carry)
    env = gym.make("MMCReach-v0", perturbations=["heavy-7"]).unwrapped
    assert (env.episode.body.hand_mass, env.parameters.hand_mass) == (7.0, 0.0)
    assert mmc_gym.make("pursuit+heavy").unwrapped.episode.body.hand_mass == 2.0
    assert gym.make("MMCReach-v0", perturbations=heavy(3)).unwrapped.episode.body.hand_mass == 3.0
    assert parse_scenario("heavy-0.5").description == "0.5 masses at the hand"


@pytest.mark.parametrize("name", ["random", "delay", "Two words", "", "heavy-known-"])
def test_names_that_are_taken_or_none_are_refused(name):
    with pytest.raises(UserError, match="name must be words"):
        register_task(name, Here())
    with pytest.raises(UserError, match="name must be words"):
        perturbation(name)(carry)


def test_an_own_perturbation_is_drawn_timed_native_and_shown():
    @perturbation("heavy-middle", unit="times", default=2, neutral=1)
    def heavy_middle(arms, factor):
        arms.segment_masses[:, 1] *= factor

    arguments = {"num_envs": 3, "perturbations": "heavy-middle-1..3", "observe_context": True}
    sync = gym.make_vec("MMCReach-v0", vectorization_mode="sync", **arguments)
    native = gym.make_vec("MMCReach-v0", **arguments)
    for env in (sync, native):
        env.reset(seed=0)
    for action in np.random.default_rng(0).uniform(-1, 1, (20, 3, 3)).astype(np.float32):
        seen, known = sync.step(action), native.step(action)
        np.testing.assert_array_equal(seen[0], known[0])
    assert (np.abs(known[0][:, -1]) <= 1).all()
    masses = native.unwrapped.setup.episodes.arms(native.unwrapped._numbers).segment_masses
    np.testing.assert_array_equal(masses[:, 1], known[4]["context"]["heavy-middle"])
    perturbation("pushed-hand", default=1.0, neutral=0.0)(push)
    env = mmc_gym.make("pushed-hand-1-over-0.4").unwrapped
    env.reset(seed=0)
    for steps in range(1, 11):
        env.step(np.zeros(3, np.float32))
        (_, right), _ = env.setup.episodes.arms(env.episode.numbers[None], steps).force_field[0]
        assert right == pytest.approx(steps / 20)


def test_a_perturbation_that_changes_nothing_or_too_much_is_refused():
    perturbation("idle")(lambda arms, strength: None)
    with pytest.raises(UserError, match="idle-1 must be one that overwrites columns of the arms"):
        mmc_gym.make("idle")
    perturbation("swollen", neutral=0.0)(
        lambda arms, mass: np.add(arms.segment_masses, mass[:, None], out=arms.segment_masses)
    )
    with pytest.raises(UserError, match="within an episode by hand_mass and force_field only"):
        mmc_gym.make("swollen-at-1")
    for wrong in (None, lambda arms: None, lambda arms, strength, more: None):
        with pytest.raises(UserError, match=r"must be a function of \(arms, strength\)"):
            perturbation("nothing")(wrong)


@pytest.mark.parametrize(
    ("assignment", "message"),
    [
        ("sevo_gain = x", "the function of mine fails for an arm: AttributeError: .*sevo_gain"),
        ("servo_gain = 6.0", r"column servo_gain must be an array of shape \(1,\), got 6.0"),
        ("shift[:, 0] += x[0]", "changes each arm by its own strength alone, got .'shift'"),
        (
            "segment_masses *= x",
            "changes each arm by its own strength alone, got .'segment_masses'",
        ),
    ],
)
def test_a_function_that_does_not_change_each_arm_is_refused_in_a_line(assignment, message):
    def change(arms, x):
        exec(f"arms.{assignment}")

    perturbation("mine", neutral=1.0, default=3.0)(change)
    with pytest.raises(UserError, match=message):
        mmc_gym.make("mine-0..2", segment_lengths=(1.0,) * 3)


def test_an_own_environment_is_a_function_and_its_reward_is_measured(tmp_path):
    comparison = compare({"mmc": "mmc", "still": lambda observation: np.zeros(3)}, Flat, 2)
    assert comparison.to_frame()["episode_return"].to_list()[:2] == [100.0, 100.0]
    assert (comparison.env, comparison.controls["mmc"]) == ("Flat", "joint_delta")
    of_speeds = compare(["mmc"], lambda: Flat(control="joint_velocity"), 1)  # it takes no control
    assert of_speeds.controls["mmc"] == "joint_velocity"
    benchmark(["mmc", "random"], tmp_path, {"flat": Flat}, 2, jobs=1)
    assert read_episodes(tmp_path)["episode_return"].eq(100).all()
    write_report(tmp_path, tmp_path / "report.html")


def test_arguments_of_the_environment_reach_it(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    arguments = ["--agents", "mmc", "--episodes", "1", "--env-kwargs", "gravity=[0, -9]"]
    main(["compare", *arguments, "control=joint_velocity"])
    assert (tmp_path / "runs/compare/summary.json").read_text().count("joint_velocity") == 4
    main(["benchmark", *arguments, "--scenarios", "random", "--jobs", "1"])
    (environment,) = read_manifest(tmp_path / "runs/benchmark").environments.values()
    assert environment["kwargs"] == {"gravity": [0, -9]}
    with pytest.raises(UserError, match="max_episode_steps must be a whole number of at least 1"):
        compare(["mmc"], episodes=1, env_kwargs={"max_episode_steps": 2.5})


def test_functions_and_objects_take_part_in_a_benchmark(tmp_path, frozen):
    agents = {"function": lambda observation: np.zeros(3), "object": [frozen, frozen]}
    assert [benchmark(agents, tmp_path, ["random"], 2, jobs=1).reused for _ in "12"] == [0, 3]
    of_agents = read_episodes(tmp_path).groupby("agent")
    assert of_agents["training_seed"].nunique().to_dict() == {"function": 0, "object": 2}
    assert of_agents["final_distance"].mean().nunique() == 1


class Plain:
    control = "joint_torque"

    def predict(self, observation):
        return np.zeros(3)


def test_predict_may_take_an_observation_alone():
    comparison = compare({"plain": Plain(), "class": lambda env: Plain()}, episodes=1)
    assert comparison.controls == {"plain": "joint_torque", "class": "joint_delta"}


@pytest.mark.parametrize(
    ("agent", "error", "message"),
    [
        (Plain, UserError, "agent 'x' must be .*, called with the environment alone, or an object"),
        (dict, UserError, "agent 'x' must be a class with predict"),
        (lambda env: 3, UserError, "agent 'x' must return an object with predict"),
        (lambda env: 1 / 0, ZeroDivisionError, "division"),
        (lambda seen: seen["x"], UserError, r"it raised IndexError: .*test_own\.py:\d+"),
        (lambda seen: seen[:2], UserError, r"it returned float32 of shape \(2,\)"),
    ],
)
def test_what_makes_no_agent_of_an_environment_is_refused(agent, error, message):
    with pytest.raises(error, match=message):
        compare({"x": agent}, episodes=1)


@pytest.mark.slow
def test_the_command_line_imports_modules_of_the_working_directory(tmp_path):
    (tmp_path / "my_things.py").write_text(EXAMPLE.read_text() + MY_ARM)

    run = partial(run_python, "-m", "mmc_gym.cli", folder=tmp_path)
    mine = ("--import", "my_things")
    agents = ("--agents", "mmc", "still=my_things:still", "--episodes", "3")
    names = ("--scenarios", "ahead", "weak-30", "my_things:Squared", "my_things:MyArm-v0")
    run("benchmark", *mine, *agents, *names, "--jobs", "2")
    frame = read_episodes(tmp_path / "runs/benchmark")
    assert frame.groupby(["agent", "environment"])["half_way_time"].size().to_list() == [3] * 8
    assert frame.groupby("environment")["duration"].first()["my_things:MyArm-v0"] == 0.14
    run("record", *mine, "--agents", "my_things:still", "--scenarios", "MMCReachAhead-v0")
    assert "targets straight ahead" in run("list", "tasks", *mine)
    assert "7 % of their torque" in run("show", "weak-7", *mine)


def test_a_report_of_your_own_perturbation_imports_what_defines_it(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    Path("heavy.py").write_text(HEAVY)
    exec(HEAVY)
    mine = Experiment("mine", [Block("base", 8)], noise=["heavy-3"])
    mmc_gym.run_experiment(mine, "ik-dls", 1, out="store", jobs=1)
    del FAMILIES["heavy"]
    with pytest.raises(SystemExit):
        main(["report", "store"])
    assert main(["report", "store", "--import", "heavy"]) is None
    assert Path("store/report.html").is_file()
