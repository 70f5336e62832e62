"""Facts about the names of scenarios, and about the environment of each task and perturbation.

The two plain environments are tried under every control mode, and each of the others under one.
A few are tried every day, all of them by `make test-all`.
"""

import copy
import inspect
import pickle
from dataclasses import fields
from functools import partial
from itertools import combinations, cycle, pairwise, product

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env
from scipy.stats import beta, randint, uniform
from stable_baselines3.common.env_checker import check_env as check_env_for_sb3

import mmc_gym
from mmc_gym import UserError
from mmc_gym.benchmark.runner import benchmark
from mmc_gym.benchmark.suite import SCENARIOS, SUITES, find_scenarios
from mmc_gym.body import ArmParameters
from mmc_gym.envs import perturbations as kinds
from mmc_gym.envs.names import TASKS, environment_id, parse_change
from mmc_gym.envs.perturbations import FAMILIES, OneOf, Timed, VisuomotorRotation
from mmc_gym.envs.reach import MMCReachEnv, MMCReachGoalEnv
from mmc_gym.envs.scenarios import parse_scenario
from mmc_gym.envs.tasks import DoubleStep, PointToPoint
from mmc_gym.envs.vector import MMCReachVectorEnv
from mmc_gym.interface import CONTROLS
from tests.envs.conftest import same

PLAIN = ["MMCReach-v0", "MMCReachGoal-v0"]
IDS = [spec.id for spec in gym.registry.values() if str(spec.entry_point).startswith("mmc_gym.")]
KNOWN = [f"{name}-known" for name, family in FAMILIES.items() if family.known]
DRAWN = "longer--30..35+joint-noise-0..0.05+rotation--60..60"
TOGETHER = [DRAWN, "centre-out+rotation-30+delay-40"]
OTHERS = [*sorted({*TASKS, *FAMILIES, *KNOWN} - {"random"}), *TOGETHER]
CASES = [*product(PLAIN, CONTROLS), *zip(OTHERS, cycle(CONTROLS), strict=False)]
DAILY = {
    ("MMCReach-v0", "joint_delta"),
    ("MMCReachGoal-v0", "joint_position"),
    *(case for case in CASES if case[0] in ("locked", "delay", "via-points", "joint-noise", DRAWN)),
}
every_case = pytest.mark.parametrize(
    ("name", "control"),
    [pytest.param(*case, marks=() if case in DAILY else pytest.mark.slow) for case in CASES],
)
DISC = (1.5, 1.0, 0.25)


@pytest.mark.parametrize(
    ("name", "full_name", "perturbation"),
    [
        ("delay-150", "delay-150", kinds.SensoryDelay(0.15)),
        ("longer-35-known", "longer-35-known", kinds.SegmentLength(1.35, known=True)),
        ("shorter", "shorter-20", kinds.shorter(20.0)),
        ("force-field--5.50", "force-field--5.5", kinds.ForceField(-5.5)),
        ("gravity", "gravity-60", kinds.Gravity(60.0)),
        ("locked", "locked-2", kinds.LockedJoint(1)),
        ("locks-3-known", "locks-3-known", kinds.locks(3, known=True)),
        ("joint-noise-speed-0.03", "joint-noise-speed-0.03", kinds.JointNoiseSpeed(0.03)),
        ("vision-noise-0.00001", "vision-noise-0.00001", kinds.VisionNoise(0.00001)),
        ("vision-noise-distance", "vision-noise-distance-0.05", kinds.VisionNoiseDistance(0.05)),
        ("obstacles-1", "obstacles-1", kinds.Obstacles((DISC,))),
        ("rotation-1000000", "rotation-1000000", kinds.VisuomotorRotation(1e6)),
        ("mirror", "mirror-90", kinds.CursorMirror(90.0)),
        ("no-feedback", "no-feedback", kinds.NoFeedback()),
        ("gain-over-2.50", "gain-1.4-over-2.5", kinds.Timed(kinds.CursorGain(1.4), over=2.5)),
        ("gain-2-at-1-over-2", "gain-2-at-1-over-2", kinds.Timed(kinds.CursorGain(2.0), 1.0, 2.0)),
    ],
)
def test_a_name_with_any_strength_makes_a_perturbation(name, full_name, perturbation):
    scenario = parse_scenario(name)
    assert scenario.name == full_name
    assert scenario == parse_scenario(full_name)
    (change,) = scenario.changes
    assert change == perturbation
    assert change.with_strength(change.strength) == change
    for perturbations in ([name], [change], [perturbation]):
        assert MMCReachEnv(perturbations=perturbations).setup.episodes.changes == (perturbation,)


def test_a_strength_is_exact():
    change = parse_scenario("longer-20-known").changes[0].with_strength(1 / 3)
    assert change == kinds.longer(1 / 3, known=True)
    assert change == parse_scenario(change.name).changes[0]
    env = mmc_gym.make("random", perturbations=[change])
    assert env.spec.kwargs["perturbations"] == [change.name]  # a file can hold it


def test_help_lists_every_argument_with_its_default():
    single, vector = map(inspect.signature, (MMCReachEnv, MMCReachVectorEnv))
    arm = {field.name: field.default for field in fields(ArmParameters)}
    for signature in (single, vector):
        assert arm.items() <= {k: v.default for k, v in signature.parameters.items()}.items()
    assert list(single.parameters)[:3] == ["control", "reward_type", "control_weight"]
    assert next(iter(vector.parameters)) == "num_envs"
    assert inspect.signature(MMCReachGoalEnv).parameters["reward_type"].default == "sparse"
    with pytest.raises(TypeError, match="keyword argument 'engin'; did you mean 'engine'"):
        MMCReachEnv(engin="analytic")


@pytest.mark.parametrize(
    ("name", "mended", "hint"),
    [
        (
            "locked-7",
            "locked-3",
            "locked-7 is not possible .* from 1 to 3 .*, got 7",
        ),
        ("delay-5", "delay-20", "delay-5 would delay nothing: .* of 20 ms, such as delay-20"),
        ("pursuit+obstacles-2+longer-500", "longer-20", "must leave targets in reach"),
    ],
)
def test_what_an_arm_cannot_have_is_refused_by_its_name(name, mended, hint, tmp_path):
    play = partial(benchmark, ["random"], tmp_path / "out", episodes=1, jobs=1)
    for make in (mmc_gym.make, mmc_gym.make_vec, lambda name: play(environments=[name])):
        with pytest.raises(UserError, match=hint):
            make(name)
        make(mended)
    with pytest.raises(UserError, match=r"delay-5 would delay nothing: .* such as delay-20"):
        mmc_gym.make("random", perturbations=[kinds.SensoryDelay(0.005)])


@pytest.mark.parametrize(
    ("name", "full_name", "task", "family", "strength"),
    [
        ("centre-out+rotation", "centre-out+rotation-30", "centre-out", "centre-out+rotation", 30),
        ("random+delay-40", "delay-40", "random", "delay", 40),
        ("rotation-5+delay-40", "rotation-5+delay-40", "random", "rotation-5+delay", 40),
        ("MMCReachPursuit-v0", "pursuit", "pursuit", "", None),
    ],
)
def test_a_task_and_perturbations_together_have_one_name(name, full_name, task, family, strength):
    scenario = parse_scenario(name)
    assert (scenario.name, scenario.family, scenario.strength) == (full_name, family, strength)
    assert scenario.task is TASKS[task]
    assert scenario == parse_scenario(full_name)
    parts = map(parse_scenario, scenario.name.split("+"))
    assert scenario.description == "; ".join(part.description for part in parts)
    assert scenario.settings["baseline"] == (task if family else None)
    setup, vector = scenario.make().unwrapped.setup, scenario.make_vec(2).setup
    assert setup.task is TASKS[task].task
    perturbations = scenario.changes
    assert setup.episodes.changes == vector.episodes.changes == perturbations


def test_a_name_makes_what_gymnasium_makes_of_the_id_and_arguments():
    name, arguments = "pursuit+rotation-45", {"control": "joint_velocity", "max_episode_steps": 9}
    env = mmc_gym.make(name, render_mode="rgb_array", **arguments)
    assert env.spec.id == "MMCReachPursuit-v0"
    assert (env.spec.max_episode_steps, env.unwrapped.render_mode) == (9, "rgb_array")
    assert mmc_gym.make(name).spec.max_episode_steps == 500
    assert env.unwrapped.setup.episodes.changes == (kinds.VisuomotorRotation(45.0),)
    assert env.unwrapped.setup.caption == "pursuit, rotation-45"
    native, sync = (mmc_gym.make_vec(name, 3, vectorization_mode=m) for m in (None, "sync"))
    assert isinstance(native, MMCReachVectorEnv)
    assert isinstance(sync, gym.vector.SyncVectorEnv)
    assert same(native.reset(seed=1), sync.reset(seed=1))
    assert mmc_gym.make_vec("MMCReachGoal-v0", 2, **arguments).max_episode_steps == 9
    assert mmc_gym.make("pursuit", perturbations=["locked"]).unwrapped.episode.lock_step == 0


def test_what_a_name_sets_is_no_argument():
    for name, value in {"task": "paper", "perturbations": [], "max_episode_steps": 7}.items():
        message = f"{name} must be left out.*'delay-400' sets"
        with pytest.raises(UserError, match=message):
            find_scenarios(["delay-400"], {name: value})
        if name != "max_episode_steps":  # which is Gymnasium's
            for make in (mmc_gym.make, mmc_gym.make_vec):
                with pytest.raises(UserError, match=message):
                    make("delay-400", **{name: value})
    assert find_scenarios(["delay-400"], {"substeps": 2})["delay-400"].arguments == {"substeps": 2}


def test_every_task_has_an_id_and_all_of_the_benchmark_have_names_of_the_grammar():
    assert {*IDS} == {"MMCReachGoal-v0", *map(environment_id, TASKS)}  # perturbations have none
    assert all(parse_scenario(name) == scenario for name, scenario in SCENARIOS.items())
    assert find_scenarios([]) == SCENARIOS
    assert list(find_scenarios(["locked", "delay-150", "locked-2"])) == ["locked-2", "delay-150"]
    for names in SUITES.values():
        assert tuple(find_scenarios(names)) == names
    motors = {name for name, family in FAMILIES.items() if family.group == "motors"}
    new_families = {*motors, "stuck-sensor", "encoder", "dropped-numbers"}
    assert new_families <= {parse_scenario(name).family for name in SUITES["faults"]}


@pytest.mark.parametrize("name", TASKS)
def test_the_id_of_a_task_makes_it_and_has_its_time(name):
    env, task = gym.make(environment_id(name)), TASKS[name].task
    assert env.unwrapped.setup.task is task
    assert env.unwrapped.setup.episodes.changes == ()
    assert env.spec.max_episode_steps == task.episode_steps
    assert gym.make_vec(environment_id(name), 2).max_episode_steps == task.episode_steps
    assert MMCReachVectorEnv(2, task=name).max_episode_steps == task.episode_steps


@pytest.mark.parametrize(
    "make", [gym.make, gym.make_vec, partial(gym.make_vec, vectorization_mode="sync")]
)
def test_a_task_of_another_length_than_the_ids_is_refused_by_name(make):
    for name, env_id in (("pursuit", "MMCReach-v0"), ("random", "MMCReachPursuit-v0")):
        with pytest.raises(UserError, match=f"got '{name}'.*make '{environment_id(name)}'"):
            make(env_id, task=name)
    make("MMCReach-v0", task="centre-out", perturbations=["locked"]).close()
    make("MMCReach-v0", task=TASKS["pursuit"].task, max_episode_steps=500).close()
    make("MMCReachPursuit-v0", perturbations=["delay-150"], max_episode_steps=7).close()
    assert gym.make_vec("MMCReach-v0", task="pursuit", max_episode_steps=7).max_episode_steps == 7


@pytest.fixture
def env(name, control):
    env = mmc_gym.make(name, control=control)
    yield env
    env.close()


def harsh_actions(env, steps):
    """Random actions, among them many at the borders of the space, each held for a while."""
    random = np.random.default_rng(0)
    actions = random.uniform(-1.5, 1.5, (steps, *env.action_space.shape)).clip(-1, 1)
    holds = random.random(steps) < 0.3
    last = np.maximum.accumulate(np.where(holds, np.arange(steps), 0))
    return actions[last].astype(np.float32)


def rollout(env, actions, seed=None):
    """All that steps return, with a reset at every truncation, and first if there is a seed."""
    record = [] if seed is None else [env.reset(seed=seed)]
    for action in actions:
        record.append(env.step(action))
        if record[-1][3]:
            record.append(env.reset())
    return record


@every_case
def test_gymnasium_and_stable_baselines3_approve(env, capsys):
    check_env(env.unwrapped)  # pytest makes its warnings errors
    assert gym.envs.registration.EnvSpec.from_json(env.spec.to_json()) == env.spec
    check_env_for_sb3(env.unwrapped, warn=True, skip_render_check=False)
    is_goal_env = isinstance(env.observation_space, gym.spaces.Dict)
    assert ("GoalEnv" in capsys.readouterr().out) == is_goal_env


@every_case
def test_same_seed_and_actions_give_the_same_episodes_in_copies_too(env):
    other, actions = gym.make(env.spec), harsh_actions(env, 250)
    first = rollout(env, actions, seed=7)
    assert same(first, rollout(other, actions, seed=7))
    assert not same(first, rollout(other, actions, seed=8))
    begun = rollout(env, actions[:30], seed=7)  # after episodes of its own, too
    for copied in (pickle.loads(pickle.dumps(env)), copy.deepcopy(env), env):
        assert same(first, [*begun, *rollout(copied, actions[30:])])


@every_case
def test_what_is_returned_shares_no_memory(env):
    def arrays(transition):
        observation, info = transition[0], transition[-1]
        parts = observation.values() if isinstance(observation, dict) else [observation]
        return [*parts, info["end_effector"], info["target"]]

    for earlier, later in pairwise(rollout(env, harsh_actions(env, 5), seed=7)):
        both = [*arrays(earlier), *arrays(later)]
        assert not any(np.shares_memory(*pair) for pair in combinations(both, 2))


@every_case
def test_an_episode_stays_in_its_space_and_ends_by_the_time_limit_alone(env):
    assert env.observation_space.contains(env.reset(seed=0)[0])
    limit = env.spec.max_episode_steps
    steps = [env.step(action) for action in harsh_actions(env, limit)]
    assert all(env.observation_space.contains(step[0]) for step in steps)
    assert all(isinstance(step[1], float) and np.isfinite(step[1]) for step in steps)
    assert [step[2:4] for step in steps] == [(False, False)] * (limit - 1) + [(False, True)]


ONE_OF = OneOf(VisuomotorRotation(uniform(-60, 120), centre=(0.0, 1.0)), "gain-2", None)
RECOVERED = [
    {"perturbations": VisuomotorRotation(30.0)},
    {"perturbations": ["delay-40", Timed(kinds.HandMass(2.0), at=0.1), "obstacles"]},
    {
        "perturbations": [ONE_OF, kinds.JointNoise(beta(2, 5, 0, 0.1))],
        "observe_context": True,
    },
    {"perturbations": kinds.LockedJoint(randint(0, 3), uniform(0.1, 0.2))},
    {"perturbations": [Timed(VisuomotorRotation(20.0), at=uniform(0, 0.2))]},
    {"perturbations": parse_change("rotation--60..60"), "observe_context": [ONE_OF]},
    {"task": DoubleStep(delay=0.1), "perturbations": "longer--10..20"},
    {"task": PointToPoint(((0.0, 0.5), (0.5, 0.0)), ((0, 1),))},
]


@pytest.mark.parametrize("arguments", RECOVERED)
def test_an_environment_is_recovered_from_its_spec(arguments):
    """As Minari does, from JSON, or as `gym.make(env.spec)`."""
    env = gym.make("MMCReach-v0", **arguments)
    first = env.reset(seed=3), env.step(np.ones(3, np.float32))
    for spec in (EnvSpec.from_json(env.spec.to_json()), env.spec):
        again = gym.make(spec)
        assert again.spec.to_json() == env.spec.to_json()
        np.testing.assert_equal((again.reset(seed=3), again.step(np.ones(3, np.float32))), first)
