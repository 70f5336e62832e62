"""The native vector environment plays what single environments play."""

import copy
import pickle
from functools import partial
from itertools import cycle

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import data_equivalence
from gymnasium.vector import AutoresetMode

import mmc_gym
from mmc_gym._errors import UserError
from mmc_gym.envs.names import TASKS
from mmc_gym.envs.perturbations import VisuomotorRotation
from mmc_gym.envs.vector import MMCReachVectorEnv

same = partial(data_equivalence, exact=True)
every_engine = pytest.mark.parametrize("engine", ["pymunk", "analytic"])

COUNT = 5
LIMITS = ((-2.0, 2.5), (-2.5, 2.0), (0.1, 2.9))
AROUND_A_POINT = {"perturbations": VisuomotorRotation(45.0, centre=(0.0, 1.5))}
SPARSE = {"reward_type": "sparse", "success_distance": 0.5}
TORQUE = {"control": "joint_torque"}
VARIANTS = [
    ("random", {}),
    ("random", {"control": "joint_velocity"}),
    ("random", TORQUE),
    ("random", {"smoothness_weight": 2.0}),
    ("random", SPARSE),
    ("random", {"joint_limits": LIMITS, "gravity": (0.0, -9.81)}),
    ("random", {"segment_lengths": (1.5,)}),
    ("random", AROUND_A_POINT),
    ("pursuit", {}),
    ("via-points", {**SPARSE, "success_distance": 1.0}),
    ("force-field", {}),
    ("rotation-30", {}),
    ("double-step-100+clamp-15", {}),
    ("centre-out+cursor-jump-10", {}),
    ("longer-50", {}),
    ("locked", {}),
    ("locks", {}),
    ("shorter-50+locked+gain-1.4", {}),
    ("locked-1+locked-2+locked-3", {}),
    ("joint-noise-speed+vision-noise-distance", {}),
    ("delay-40", {}),
    ("double-step-100+vision-delay-60", {}),
    ("vision-delay-60+vision-noise+delay-40+rotation-30", {}),
    ("obstacles", {}),
    ("pursuit+rotation-40+rotation--80-at-0.1+mirror-at-0.2+gain-2-over-0.2", {}),
    ("joint-noise-over-0.2+delay-60-at-0.06-over-0.1+vision-delay-40-at-0.1", {}),
    ("channel+force-field-30-at-0.1+endpoint-feedback", TORQUE),
    ("no-feedback-at-0.06+rotation-30+vision-delay-40", {}),
    ("endpoint-feedback+vision-noise+delay-40", {}),
    ("force-field-over-0.2+force-field--90-at-0.1+hand-mass-at-0.06", TORQUE),
    ("double-step-200+force-field+rotation-45+locks+vision-noise+delay-100", {}),
    ("MMCReachGoal-v0", {}),
    ("MMCReachGoal-v0", SPARSE),
    ("MMCReachGoal-v0", AROUND_A_POINT),
    ("MMCReachGoal-v0", {"task": TASKS["pursuit"].task}),
    ("MMCReachGoal-v0", {"perturbations": "longer-50"}),
    ("MMCReachGoal-v0", {"perturbations": "locked"}),
]
ENDING = [
    ("random", {"success_distance": 1.0}),
    ("via-points", {"success_distance": 2.5}),
    ("rotation--60..60+delay-40+longer-0..20", {"success_distance": 1.0, "observe_context": True}),
    ("MMCReachGoal-v0", {"success_distance": 1.0}),
]
ENDING = [(name, {**one, "terminate_on_success": True}) for name, one in ENDING]


def make_native(name="random", count=COUNT, **arguments):
    vector = mmc_gym.make_vec(name, count, **arguments)
    assert isinstance(vector, MMCReachVectorEnv)
    return vector


def random_actions(vector, steps, seed=0):
    assert vector.action_space.shape is not None
    random = np.random.default_rng(seed)
    return random.uniform(-1, 1, (steps, *vector.action_space.shape)).astype(np.float32)


def cases():
    """Each variant in every mode of autoreset; one of them every day."""
    return [
        pytest.param(*one, mode, marks=() if mode == daily else pytest.mark.slow)
        for one, daily in zip(VARIANTS, cycle(AutoresetMode))
        for mode in AutoresetMode
    ] + [pytest.param(*one, mode) for one in ENDING for mode in AutoresetMode]


def agree(first, second, engine):
    """Whether a native and a sync environment returned the same.

    The analytic engine has its own cosines: observations are then the same to a rounding.
    """
    if engine == "pymunk":
        return same(first, second)
    (seen, *rest), (expected, *others) = first, second
    for name in seen if isinstance(seen, dict) else [...]:
        np.testing.assert_allclose(seen[name], expected[name], rtol=2e-7, atol=1e-9)
    for each in (rest, others):
        each[-1].pop("final_obs", None)
    return same(rest, others)


@every_engine
@pytest.mark.parametrize(("name", "arguments", "mode"), cases())
def test_it_returns_what_single_environments_return(name, arguments, mode, engine):
    """Over some episodes, with partial resets on the way."""
    if engine == "analytic" and name.startswith(("obstacles", "channel")):
        pytest.skip("the analytic engine has none")
    arguments = {"max_episode_steps": 13, "engine": engine, **arguments}
    native = make_native(name, autoreset_mode=mode, **arguments)
    arguments |= {"vectorization_mode": "sync", "vector_kwargs": {"autoreset_mode": mode}}
    sync = mmc_gym.make_vec(name, COUNT, **arguments)

    def reset_both(mask, seed=None):
        first, second = (
            one.reset(seed=seed, options={"reset_mask": mask.copy()}) for one in (native, sync)
        )
        return agree(first, second, engine)

    assert native.observation_space == sync.observation_space
    assert native.action_space == sync.action_space
    assert reset_both(np.ones(COUNT, bool), seed=3)
    are_successes, rests = np.zeros(COUNT, bool), np.zeros(COUNT, bool)
    for index, action in enumerate(random_actions(native, 30)):
        step, other = native.step(action), sync.step(action)
        over = step[2] | step[3]
        final = step[4].get("final_info", {}).get("is_success", step[4]["is_success"])
        at_end = np.where(over, final, step[4]["is_success"]) & ~rests
        assert (step[2] == (at_end & arguments.get("terminate_on_success", False))).all()
        are_successes |= step[2]
        rests = over & (mode == AutoresetMode.NEXT_STEP)
        assert agree(step, other, engine)
        if mode == AutoresetMode.DISABLED and over.any():
            assert reset_both(over)
        if index == 7:
            assert reset_both(np.arange(COUNT) % 2 == 0, seed=[1, 2, 3, 4, 5])
            rests &= np.arange(COUNT) % 2 == 1
    assert are_successes.any() == arguments.get("terminate_on_success", False)


@pytest.mark.parametrize("arguments", [{}, {"engine": "analytic"}, {"perturbations": "delay-40"}])
def test_without_copies_the_next_step_may_overwrite_observations(arguments):
    fresh, reused = (
        make_native(copy=copies, max_episode_steps=7, **arguments) for copies in (True, False)
    )
    first = reused.reset(seed=0)
    assert same(fresh.reset(seed=0), first)
    tensor = torch.from_dlpack(first[0])
    for action in random_actions(fresh, 20):
        now = reused.step(torch.from_dlpack(action))  # a tensor is an action like an array
        assert same(fresh.step(action), now)
        if reused.engine == "analytic":  # which writes into one array
            np.testing.assert_array_equal(tensor, now[0])


@every_engine
def test_what_it_returns_becomes_tensors_without_a_copy(engine):
    arms = make_native(engine=engine)
    for *arrays, infos in (arms.reset(seed=0), arms.step(np.zeros((COUNT, 3), np.float32))):
        for array in (*arrays, *infos.values()):
            tensor = torch.from_dlpack(array)
            assert tensor.data_ptr() == array.ctypes.data and tensor.is_contiguous()


@every_engine
def test_an_arm_plays_the_same_in_any_number_of_arms_and_threads(engine):
    count, steps = 600, 25  # more than one Space of arms, and enough for two threads
    many = make_native("random", count, engine=engine, threads=2, max_episode_steps=10)
    few = make_native("random", 3, engine=engine, max_episode_steps=10)
    chosen = [0, 77, 599]
    first, second = many.reset(seed=0), few.reset(seed=chosen)
    for action in random_actions(many, steps):
        assert same(first[0][chosen], second[0])
        first, second = many.step(action), few.step(action[chosen])
        assert same(first[1][chosen], second[1])
    many.close()


@pytest.mark.parametrize("limit", [{}, {"max_episode_steps": None}])
def test_it_has_the_time_limit_of_the_registration_or_none(limit):
    vector = make_native("random", 2, **limit)
    vector.reset(seed=0)
    ends = [vector.step(action)[3].all() for action in random_actions(vector, 150)]
    assert np.flatnonzero(ends).tolist() == ([] if limit else [99])


NOT_A_NUMBER = np.where(np.arange(COUNT) == 3, np.nan, 0)[:, None] * np.ones(3)


@pytest.mark.parametrize(
    ("method", "given", "message"),
    [
        ("step", {"actions": np.zeros((COUNT, 2))}, "actions must have shape"),
        ("step", {"actions": NOT_A_NUMBER}, "within -1 and 1.*arm 3"),
        ("step", {"actions": torch.zeros(COUNT, 3, requires_grad=True)}, "detach"),
        ("reset", {"seed": [1, 2]}, "seed must be .*5 of them"),
        ("reset", {"options": {"reset_mask": np.ones(COUNT)}}, "reset_mask.*5 bools"),
        ("reset", {"options": 5}, "options must be a mapping.*got 5"),
        ("reset", {"seed": 1, "options": {"goal": 0}}, "options 'goal'"),
    ],
)
def test_bad_input_is_refused_and_leaves_no_trace(method, given, message):
    tried, untried = make_native(), make_native()
    for vector in (tried, untried):
        vector.reset(seed=0)
        vector.step(random_actions(vector, 1)[0])
    with pytest.raises((ValueError, RuntimeError), match=message):
        getattr(tried, method)(**given)
    for action in random_actions(tried, 110, seed=1):
        assert same(tried.step(action), untried.step(action))


@pytest.mark.parametrize(
    "name", ["num_envs", "max_episode_steps", "autoreset_mode", "render_mode", "thread"]
)
def test_bad_arguments_are_refused(name):
    with pytest.raises(UserError, match=name):
        MMCReachVectorEnv(**{"num_envs": 2, name: 0})


def test_a_step_before_the_reset_or_after_the_end_without_autoreset_is_refused():
    vector = make_native(autoreset_mode=AutoresetMode.DISABLED, max_episode_steps=1)
    (action,) = random_actions(vector, 1)
    with pytest.raises(ResetNeeded, match=r"reset\(\)"):
        vector.step(action)
    vector.reset(seed=0)
    vector.step(action)
    with pytest.raises(ResetNeeded, match=r"\[0, 1, 2, 3, 4\]"):
        vector.step(action)


@every_engine
def test_attributes_of_its_arms_are_those_of_single_environments(engine):
    """`get_attr`, `set_attr`, `call` and the seeds, as the vectors of Gymnasium have them."""
    made = {"engine": engine, "perturbations": "rotation--60..60"}
    native = mmc_gym.make_vec("random", 3, **made)
    sync = mmc_gym.make_vec("random", 3, vectorization_mode="sync", **made)
    for vector in (native, sync):
        vector.reset(seed=4)
    names = ["reach", "control", "engine", "success_distance", "context", "np_random_seed"]
    names += ["context_size", "perturbations", "parameters", "action_space", "observation_space"]
    for name in names:
        assert native.get_attr(name) == native.call(name) == sync.get_attr(name), name
    states = [[one.bit_generator.state for one in each.np_random] for each in (native, sync)]
    assert native.np_random_seed == sync.np_random_seed == (4, 5, 6) and states[0] == states[1]
    native.reset(seed=[None, 9, None])
    assert native.np_random_seed == (4, 9, 6)
    for vector in (native, sync):
        vector.set_attr("perturbations", "rotation-0..5")
        assert vector.call("set_perturbations", "rotation-0..9") == (None,) * 3
        assert vector.get_attr("perturbations") == ("rotation-0..9",) * 3
    with pytest.raises(UserError, match="perturbations must be one value, or a list of 3 equal"):
        native.set_attr("perturbations", ["rotation-0..5"] * 2)
    assert len(set(make_native(count=3).np_random_seed)) == 3


def test_its_spec_has_its_number_of_steps():
    assert make_native().spec.max_episode_steps == 100
    short = make_native(max_episode_steps=7)
    assert short.spec.max_episode_steps == 7
    assert gym.make_vec(short.spec).spec.max_episode_steps == 7
    assert gym.make_vec("MMCReach-v0", max_episode_steps=None).spec.max_episode_steps is None


@pytest.mark.parametrize("mode", [*AutoresetMode])
def test_a_mode_of_autoreset_is_given_by_member_name_or_value(mode):
    for given in (mode, mode.name, mode.value):
        assert make_native(autoreset_mode=given).metadata["autoreset_mode"] is mode


def test_copies_are_refused():
    for make_copy in (pickle.dumps, copy.deepcopy):
        with pytest.raises(TypeError, match="cannot be pickled or copied"):
            make_copy(make_native())
