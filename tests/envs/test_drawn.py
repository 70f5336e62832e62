"""Facts about perturbations that are drawn for each episode, single and vector."""

import json
from copy import deepcopy

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from scipy import stats
from scipy.stats import norm, uniform

import mmc_gym
from mmc_gym import UserError
from mmc_gym.envs.changes import Walk
from mmc_gym.envs.names import as_change, as_plain, parse_change
from mmc_gym.envs.perturbations import HandMass, JointNoise, OneOf, VisuomotorRotation
from mmc_gym.envs.scenarios import as_json, parse_scenario
from tests.conftest import by_night
from tests.envs.conftest import RANGES, random_actions, same


def test_every_joint_that_may_be_drawn_locks(engine):
    """Of five, more than there are ends and a middle of the range."""
    options = ["gravity-0..60", "locked-1..5", "longer-0..20", "delay-0..100", "rotation-0..60"]
    arguments = {"segment_lengths": (1.0,) * 6, "perturbations": OneOf(*options)}
    env = gym.make_vec("MMCReach-v0", 100, engine=engine, torque_limit=2e4, **arguments)
    _, info = env.reset(seed=0)
    locked = np.flatnonzero(info["context"]["choice"] == 1)
    joints = info["context"]["locked"][locked].astype(int) - 1
    assert set(joints) == {*range(5)}
    before = env.unwrapped.arms.joint_angles.copy()
    for _ in range(10):
        env.step(np.full((100, 6), 0.5, np.float32))
    turned = np.abs(env.unwrapped.arms.joint_angles - before)
    assert turned[locked, joints].max() < 0.01 < np.delete(turned, locked, 0).min()
    with pytest.raises(UserError, match="whole number from 1 to 5, got 6"):
        env.reset(options={"context": {"locked": 6}})
    env.unwrapped.perturbations = OneOf(options[0], "locked-2..3", *options[2:])
    with pytest.raises(UserError, match="only joints lock that could lock before"):
        env.unwrapped.perturbations = OneOf(options[0], "locked-2..6", *options[2:])


def test_strengths_are_drawn_as_their_distributions():
    noise, angle = stats.beta(2, 5, scale=0.1), norm(5, 20)
    perturbations = ["rotation--60..60", "hand-mass-0..3", "locks-1..3", JointNoise(noise)]
    perturbations += [VisuomotorRotation(angle)]
    perturbations += [OneOf("delay-0..160", "delay-40", None, weights=(1, 2, 3))]
    arguments = {"engine": "analytic", "perturbations": perturbations}
    context = gym.make_vec("MMCReach-v0", 1500, **arguments).reset(seed=0)[1]["context"]
    drawn = {"rotation": uniform(-60, 120), "hand-mass": uniform(0, 3)}
    drawn |= {"joint-noise": noise, "rotation#2": angle}
    for name, distribution in drawn.items():
        assert stats.kstest(context[name], distribution.cdf).pvalue > 0.01, name
    for name, shares in {"locks": np.ones(3), "choice": np.array([1, 2, 3])}.items():
        counts = np.unique(context[name], return_counts=True)[1]
        assert stats.chisquare(counts, shares / shares.sum() * 1500).pvalue > 0.01, name
    assert (np.isnan(context["delay"]) == (context["choice"] != 0)).all()
    values = np.array([context[name] for name in drawn])
    assert len(np.unique(values, axis=1).T) == 1500  # and independent of each other
    assert np.abs(np.corrcoef(values) - np.eye(4)).max() < 0.1


def test_a_context_given_as_an_option_repeats_an_episode(engine):
    name = "longer--30..35+rotation--60..60+force-field--20..20+delay-0..100"
    env = mmc_gym.make(name, engine=engine)
    env.reset(seed=1)
    _, info = env.reset()
    context = env.unwrapped.context
    assert info["context"] == context
    posture, target = env.unwrapped.arm.joint_angles, info["target"]
    actions = random_actions(env, 20)
    first = [env.step(action) for action in actions]
    env.reset(seed=5)
    env.reset(options={"context": context, "joint_angles": posture, "target": target})
    assert same(first, [env.step(action) for action in actions])
    for wrong in ({"rotatoin": 3.0}, {"rotation": np.inf}, {"longer": -200.0}, 3):
        with pytest.raises(UserError, match=r"options\['context'\]"):
            env.reset(options={"context": wrong})


BEYOND = {
    "longer-0..20+gain-0.8..1.4": {"longer": [10, 60, -40, 20], "gain": [1.0, 1.2, 0.4, 3.0]},
    "hand-mass-0..3+gravity-0..60": {"hand-mass": [0, 9, 3, 40], "gravity": [0, 90, -60, 30]},
    "delay-0..8+vision-delay-0..8": {"delay": [0, 100, 60, 0], "vision-delay": [80, 0, 60, 0]},
    "locks-1..3+rotation-0..0": {"locks": [1, 2, 3, np.nan], "rotation": [0, 60, 720, -30]},
}


@pytest.mark.parametrize("name", BEYOND)
def test_arms_with_a_context_beyond_their_ranges_are_single_arms(name, engine):
    context = {key: np.array(values, float) for key, values in BEYOND[name].items()}
    many = mmc_gym.make_vec(name, 4, engine=engine)
    many.reset(seed=3)
    many.step(np.zeros((4, 3), np.float32))
    native, actions = [many.reset(seed=7, options={"context": context})], random_actions(many, 12)
    native += [many.step(action) for action in actions]
    for arm in range(4):
        single = mmc_gym.make(name, engine=engine)
        row = {key: values[arm] for key, values in context.items()}
        steps = [single.reset(seed=7 + arm, options={"context": row})]
        steps += [single.step(action[arm]) for action in actions]
        for (seen, *_, info), (expected, *_, facts) in zip(native, steps, strict=True):
            assert same(seen[arm], expected)
            assert same(info["distance"][arm], facts["distance"])
            assert expected in single.observation_space


TWO = "longer-0..20+force-field-0..60"
CHOICE = ["rotation-0..60", OneOf("gain-1..2", None)]


@pytest.mark.parametrize(
    ("name", "context", "message"),
    [
        ("hand-mass-0..3", {"hand-mass": [0, -150]}, "strength of hand-mass must be at least 0"),
        ("longer-0..20", {"longer": [0, -100]}, "strength of longer must be at least -99.9"),
        ("force-field-0..60", {"force-field": [0, 500]}, "force_field must be at most 160"),
        ("gain-0.5..2", {"gain": [1, -3]}, "strength of gain must be at least 1e-09"),
        ("joint-noise-0..0.05", {"joint-noise": [0, -1]}, "strength of joint-noise must be from 0"),
        ("gravity-0..60", {"gravity": [0, 1e12]}, "gravity must be at most 1e\\+09"),
        ("hand-mass-0..3", {"hand-mass": [0, 1e4]}, "must make an arm that substeps can hold"),
        ("locks-1..3", {"locks": [1, 4]}, "locks must be a whole number from 1 to 3, got 4"),
        ("rotation-0..60", {"rotation": [0, np.inf]}, "rotation must be a finite number, got inf"),
        (TWO, {"longer": [9, 500], "force-field": 150}, "leave targets in reach"),
        (CHOICE, {"gain": -1, "choice": [1, 0]}, "gain must be"),
    ],
)
def test_a_vector_refuses_the_contexts_that_a_single_arm_refuses(name, context, message, engine):
    name, arguments = (name, {}) if isinstance(name, str) else ("random", {"perturbations": name})
    arguments["engine"] = engine
    single, whole = mmc_gym.make(name, **arguments), mmc_gym.make_vec(name, 2, **arguments)
    untouched, alone = mmc_gym.make_vec(name, 2, **arguments), mmc_gym.make(name, **arguments)
    last = {key: values if np.isscalar(values) else values[1] for key, values in context.items()}
    for env in (single, whole, untouched, alone):
        env.reset(seed=3)
    with pytest.raises(UserError, match=message):
        single.reset(seed=5, options={"context": last})
    for seeding in ({"seed": 5}, {}):
        with pytest.raises(UserError, match=f"(?s)(for arm 1.*{message}|{message}.* for arm 1)"):
            whole.reset(**seeding, options={"context": context})
    assert same(single.reset(), alone.reset())
    for action in random_actions(whole, 110):
        assert same(whole.step(action), untouched.step(action))
    mask = np.array([True, False])  # the arm whose context is impossible is not reset
    whole.reset(options={"reset_mask": mask, "context": context})


@pytest.mark.parametrize("wrong", [[30.0], [30.0] * 3, [[30.0, 30.0]], "30", None, [1j, 2]])
def test_a_context_has_a_number_for_each_arm(wrong):
    vector, single = mmc_gym.make_vec("rotation-0..60", 2), mmc_gym.make("rotation-0..60")
    with pytest.raises(UserError, match="must be a number, or 2 of them, got"):
        vector.reset(options={"context": {"rotation": wrong}})
    with pytest.raises(UserError, match="must be a number, got"):
        single.reset(options={"context": {"rotation": wrong}})


@pytest.mark.parametrize(
    ("drawn", "context", "fixed"),
    [
        ("longer-0..35+hand-mass-0..3", {"longer": 25, "hand-mass": 2}, "longer-25+hand-mass-2"),
        *((OneOf(name, None), {"choice": 1}, "random") for name in RANGES),
    ],
    ids=str,
)
def test_an_arm_moves_as_a_fixed_one_of_what_was_drawn(drawn, context, fixed, engine):
    """And one with an option that was not chosen as one without."""
    if isinstance(drawn, str):
        drawn = mmc_gym.make(drawn).unwrapped.perturbations
    elif engine == "analytic" and drawn.options[0].startswith("obstacles"):
        pytest.skip("the analytic engine has none")
    drawn = gym.make("MMCReach-v0", engine=engine, perturbations=drawn)
    fixed = mmc_gym.make(fixed, engine=engine)
    start = {"joint_angles": [0.1, 0.5, -0.3], "target": (1.0, 1.0)}
    fixed.reset(seed=0, options=start)
    drawn.reset(seed=0, options={**start, "context": context})
    for action in random_actions(fixed, 20):
        (*expected, facts), (*actual, info) = fixed.step(action), drawn.step(action)
        assert same([*expected, facts], [*actual, {name: info[name] for name in facts}])


def test_the_context_is_observed_within_one():
    env = mmc_gym.make("rotation--60..60+delay-0..160", observe_context=True)
    check_env(env.unwrapped, skip_render_check=True)
    observation, _ = env.reset(options={"context": {"rotation": -60, "delay": 120}})
    assert observation[-2:].tolist() == [-1.0, 0.5]
    goal = gym.make("MMCReachGoal-v0", perturbations="longer-0..20", observe_context=True)
    observation, _ = goal.reset(options={"context": {"longer": 20}})
    assert observation["observation"].shape == (10,)
    assert observation in goal.observation_space


SCALE = [
    OneOf("locks-1..3", HandMass(uniform(0, 3)), None),
    *("delay-0..160", "rotation--60..60", "longer--10..30"),
]
ONE = [{"one_of": [None, "rotation--60..-20", "rotation-20..60", "longer-0..20", "shorter-0..50"]}]


@pytest.mark.parametrize(
    ("scale", "name", "shown"),
    [
        # Which is chosen: locks or a mass; joint, mass, delay, rotation, longer.
        (SCALE, "random", [0, 0, 0, 0, -1, 0, -0.5]),
        (SCALE, "rotation-90", [0, 0, 0, 0, -1, 1.5, -0.5]),
        (SCALE, "shorter-10+locks-2-known", [1, 0, 0, 0, -1, 0, -1]),
        (SCALE, "delay-160+hand-mass-6+force-field-30", [0, 1, 0, 3, 1, 0, -0.5]),
        (SCALE, "rotation-15..15.1+locks-3", [1, 0, 1, 0, -1, 0.25, -0.5]),
        # Which of four is chosen, and its strength: the range that it is in or nearest to.
        (ONE, "rotation--40", [1, 0, 0, 0, 0, 0, 0, 0]),
        (ONE, "rotation-40", [0, 1, 0, 0, 0, 0, 0, 0]),
        (ONE, "rotation-10", [0, 1, 0, 0, 0, -1.5, 0, 0]),
        (ONE, "longer-20", [0, 0, 1, 0, 0, 0, 1, 0]),
        (ONE, "shorter-25", [0, 0, 0, 1, 0, 0, 0, 0]),
    ],
)
def test_a_context_is_observed_on_a_given_scale(scale, name, shown):
    single = mmc_gym.make(name, observe_context=scale)
    observation, _ = single.reset(seed=0)
    assert observation in single.observation_space
    many = mmc_gym.make_vec(name, 2, observe_context=scale)
    for observed in (observation, *many.reset(seed=0)[0]):
        np.testing.assert_allclose(observed[15:], shown, atol=2e-3)


def test_distributions_may_change_between_episodes():
    wider, names = ["rotation-90..120", "delay-0..160"], "rotation--60..60+delay-0..40"
    env, sync = (mmc_gym.make_vec(names, 2, vectorization_mode=mode) for mode in (None, "sync"))
    for each in (env, sync):
        each.reset(seed=0)
    sync.set_attr("perturbations", [wider, wider])
    env.unwrapped.perturbations = wider
    assert list(env.unwrapped.perturbations) == wider
    rotations = []
    for step in range(203):
        actions = np.full((2, 3), 0.1 * np.cos(step), np.float32)
        expected, actual = sync.step(actions), env.step(actions)
        assert same(expected[0], actual[0])
        assert same(expected[4]["context"], actual[4]["context"])
        rotations.append(np.abs(actual[4]["context"]["rotation"]).max())
    assert max(rotations) > 60
    with pytest.raises(UserError, match="perturbations must be the same perturbations with other"):
        env.unwrapped.perturbations = "gain-0.8..1.4"


def test_an_observed_context_keeps_its_scale_when_the_ranges_change():
    """So that a policy sees the same numbers for the same body; what lies beyond is beyond ±1."""
    arguments = {"observe_context": True, "engine": "analytic"}
    single = mmc_gym.make("rotation--10..10", **arguments)
    native = mmc_gym.make_vec("rotation--10..10", 2, **arguments)
    sync = mmc_gym.make_vec("rotation--10..10", 2, vectorization_mode="sync", **arguments)
    for degrees, ranges in ((5, None), (45, "rotation--60..60"), (-5, ["rotation--20..20"])):
        if ranges is not None:
            single.unwrapped.set_perturbations(ranges)
            for each in (native, sync):
                each.set_attr("perturbations", [ranges] * 2)
        for seed, each in enumerate((single, native, sync)):
            observations, _ = each.reset(seed=seed, options={"context": {"rotation": degrees}})
            assert np.all(observations[..., -1] == np.float32(degrees / 10))
            space = single.observation_space if each is sync else each.observation_space
            assert np.all(observations <= space.high) and np.all(observations >= space.low)
        assert single.unwrapped.context_scale == ["rotation--10..10"]
    assert same(native.reset(seed=0)[1], sync.reset(seed=0)[1])


def test_a_curriculum_begins_at_no_change():
    env = mmc_gym.make("rotation-0..0", observe_context="rotation--60..60")
    assert env.reset(seed=0)[0][-1] == env.unwrapped.context["rotation"] == 0
    env.unwrapped.perturbations = "rotation-60..60"
    assert env.reset()[0][-1] == 1.0 and env.unwrapped.context["rotation"] == 60
    vector = mmc_gym.make_vec("longer-0..20", 2)
    for ranges in ("longer-0..0", "longer-20..20"):
        vector.unwrapped.perturbations = ranges
        hands = vector.reset(seed=0, options={"joint_angles": [0.0] * 3})[1]["end_effector"]
        assert hands[:, 0].tolist() == [3.0 if ranges == "longer-0..0" else 3.2] * 2


@pytest.mark.parametrize("mode", by_night(["dummy", "subproc"], daily=["dummy"]))
def test_perturbations_change_through_the_vector_environments_of_stable_baselines3(mode):
    vec_env = pytest.importorskip("stable_baselines3.common.vec_env")
    from stable_baselines3.common.env_util import make_vec_env

    kinds = {"dummy": vec_env.DummyVecEnv, "subproc": vec_env.SubprocVecEnv}
    arguments = {"perturbations": "rotation--10..10"}
    envs = make_vec_env("mmc_gym:MMCReach-v0", 2, env_kwargs=arguments, vec_env_cls=kinds[mode])
    envs.env_method("set_perturbations", "rotation-50..60")
    envs.reset()
    drawn = [context["rotation"] for context in envs.get_attr("context")]
    assert min(drawn) >= 50 and envs.get_attr("perturbations") == ["rotation-50..60"] * 2
    envs.close()


def test_a_range_is_a_name():
    change = parse_change("rotation--60..60-at-1")
    assert (change.name, change.is_drawn, change.number) == ("rotation--60..60-at-1", True, None)
    assert "-60..60°, drawn for each episode" in change.description
    scenario = parse_scenario("random+longer--30..35+joint-noise-0..0.05")
    assert scenario == parse_scenario(scenario.name)
    assert scenario.settings != parse_scenario("longer--30..30+joint-noise-0..0.05").settings
    plain = as_json({"one": VisuomotorRotation(uniform(-60, 120))})
    assert plain["one"]["strength"] == {"name": "uniform", "args": [-60, 120]}


def strengths_of(env, episodes, **first):
    """Return the drawn rotations of so many episodes."""
    infos = [env.reset(**first)[1], *(env.reset()[1] for _ in range(episodes - 1))]
    return np.array([info["context"]["rotation"] for info in infos])


@pytest.mark.parametrize("kind", ["walk", "drift", "cycle", "saw"])
def test_a_strength_walks_from_episode_to_episode(kind, engine):
    made = {"perturbations": VisuomotorRotation(Walk(-60, 60, 8, kind)), "engine": engine}
    native = gym.make_vec("MMCReach-v0", num_envs=3, **made)
    sync = gym.make_vec("MMCReach-v0", vectorization_mode="sync", num_envs=3, **made)
    walked = strengths_of(native, 60, seed=4)
    np.testing.assert_array_equal(walked, strengths_of(sync, 60, seed=4))
    np.testing.assert_array_equal(walked[:2], strengths_of(native, 2, seed=4))  # a seed restarts
    changes = np.diff(walked, axis=0)
    is_inside = np.abs(walked[1:]) < 60
    if kind == "walk":
        assert 5 < changes[is_inside].std() < 11
    elif kind == "saw":  # it turns at the ends, and only there
        turns = changes[1:] * changes[:-1] < 0
        assert np.all(np.abs(walked[1:-1][turns]) == 60)
        assert turns.sum(axis=0).min() >= 2
    else:
        backward = changes < 0
        assert backward.any() == (kind == "cycle")
        assert np.all(walked[1:][backward] == -60)  # and only from the end


def test_a_walk_is_copied_restarts_and_survives_a_file():
    walk = VisuomotorRotation(Walk(-60.0, 60.0, 5.0))
    env = gym.make("MMCReach-v0", perturbations=walk)
    strengths_of(env, 5, seed=1)
    copied = deepcopy(env)
    np.testing.assert_array_equal(strengths_of(env, 5), strengths_of(copied, 5))
    assert as_change(json.loads(json.dumps(as_plain(walk)))) == walk
    saw = {"rotation": 10.0, "rotation.direction": -1.0}  # where it is, and where it is heading
    env.unwrapped.set_perturbations([VisuomotorRotation(Walk(0.0, 90.0, 1.0, "saw"))])
    _, info = env.reset(options={"context": saw})
    assert info["context"] == saw
    assert strengths_of(env, 1)[0] < 10
    env.unwrapped.set_perturbations([VisuomotorRotation(Walk(0.0, 90.0, 1.0))])
    assert np.all(strengths_of(env, 3) >= 0)
    _, info = env.reset(options={"context": {"rotation": 45.0}})
    assert info["context"]["rotation"] == 45
    assert abs(strengths_of(env, 1)[0] - 45) < 6  # it goes on from there
    for step, low, kind in ((np.inf, 0, "walk"), (1, 2, "walk"), (1, 0, "jump")):
        with pytest.raises(UserError, match=r"must be|is not"):
            Walk(low, 1, step, kind)
