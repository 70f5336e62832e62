"""The native vector environment plays what single environments play."""

import copy
import pickle
import re
from functools import partial
from itertools import cycle

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode
from scipy.stats import norm, randint, uniform

import mmc_gym
from mmc_gym import UserError
from mmc_gym.envs import OneOf
from mmc_gym.envs.names import TASKS
from mmc_gym.envs.perturbations import HandMass, LockedJoint, SegmentLength, VisuomotorRotation
from mmc_gym.envs.reach import MMCReachEnv, MMCReachGoalEnv
from mmc_gym.envs.vector import MMCReachVectorEnv
from mmc_gym.geometry import reachable_radii
from tests.envs.conftest import LIMITS, RANGES, random_actions, same

COUNT = 5
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
MIXTURES = [
    ["longer--30..35", "hand-mass-0..3", "rotation--60..60", "delay-0..160", "joint-noise"],
    ["longer--30..35", "force-field--20..20-at-0.04", "hand-mass-0..3-over-0.1"],
    ["gravity-0..60", "force-field--20..20", "locks-1..3", "vision-noise-0..0.05", "delay-0..8"],
    [OneOf("rotation--60..60", VisuomotorRotation(30.0), None, weights=(1, 2, 3)), "shorter-20"],
    [OneOf("locked-1..2", HandMass(uniform(0, 3)), None), VisuomotorRotation(norm(0, 20))],
    [OneOf("locked-1..3", "locks-1..3", "gain-0.5..2", "force-field-0..60"), "longer--30..35"],
    [OneOf("joint-noise-0..0.1", "vision-noise-0.05", None), "vision-delay-0..80"],
    [SegmentLength(uniform(0.7, 0.6), segment=0), LockedJoint(randint(0, 3), uniform(0.1, 0.2))],
    [OneOf("no-feedback", "endpoint-feedback-at-0.1", None), "vision-delay-0..60"],
    [OneOf("obstacles-1..3", "longer-0..20", None), "force-field-0..40-at-0.04-over-0.04"],
    [VisuomotorRotation(uniform(-60, 120), at=uniform(0, 0.2)), "clamp--30..30"],
    ["motor-gain-0.3..1-of-2", "action-delay-0..60", "action-noise-0.1-at-0.04", "backlash"],
    ["longer-0..30-of-1", "stuck-sensor-1..3-at-0.04-until-0.1", "held-numbers-0.3-for-2"],
    [OneOf("locked-1..3-at-0.02-until-0.08", "dropped-actions-0..0.4", None), "encoder-16..64"],
    ["observation-noise-0..0.1", "repeated-actions-0.5", "delay-0..60", "cursor-shift--0.3..0.3"],
]
DRAWN = {"observe_context": True, "max_episode_steps": 7}
VARIANTS += [("random", {"perturbations": mixture, **DRAWN}) for mixture in MIXTURES]
ENDING = [
    ("random", {"success_distance": 1.0}),
    ("via-points", {"success_distance": 2.5}),
    ("rotation--60..60+delay-40+longer-0..20", {"success_distance": 1.0, "observe_context": True}),
    ("MMCReachGoal-v0", {"success_distance": 1.0}),
]


def make_native(name="random", count=COUNT, **arguments):
    vector = mmc_gym.make_vec(name, count, **arguments)
    assert isinstance(vector, MMCReachVectorEnv)
    return vector


def cases():
    """Each variant in every mode of autoreset, one of them every day; each range in two."""
    for (name, arguments), daily in zip(VARIANTS, cycle(AutoresetMode)):
        for mode in AutoresetMode:
            marks = () if mode == daily else pytest.mark.slow
            yield pytest.param(name, arguments, mode, marks=marks)
    for name, arguments in ENDING:
        for mode in AutoresetMode:
            yield name, {**arguments, "terminate_on_success": True}, mode
    for family in RANGES:
        other = "random" if family.startswith("locked") else "centre-out"
        for name, mode in (("random", "SameStep"), (other, "Disabled")):
            arguments = {"perturbations": [family], **DRAWN}
            yield pytest.param(name, arguments, AutoresetMode(mode), marks=pytest.mark.slow)


@pytest.mark.parametrize(("name", "arguments", "mode"), [*cases()])
def test_it_returns_what_single_environments_return(name, arguments, mode, engine):
    """Over some episodes, with partial resets on the way."""
    arguments = {"max_episode_steps": 13, "engine": engine, **arguments}
    if engine == "analytic" and re.search("obstacles|channel", f"{name} {arguments}"):
        with pytest.raises(UserError, match=r"obstacles must be empty|engine must be .pymunk"):
            make_native(name, **arguments)
        return
    native = make_native(name, autoreset_mode=mode, **arguments)
    arguments |= {"vectorization_mode": "sync", "vector_kwargs": {"autoreset_mode": mode}}
    sync = mmc_gym.make_vec(name, COUNT, **arguments)

    def reset_both(mask, seed=None):
        masks = {"reset_mask": mask.copy()}, {"reset_mask": mask.copy()}
        first = native.reset(seed=seed, options=masks[0])
        return same(first, sync.reset(seed=seed, options=masks[1]))

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
        assert same(step, other)
        if mode == AutoresetMode.DISABLED and over.any():
            assert reset_both(over)
        if index == 7:
            assert reset_both(np.arange(COUNT) % 2 == 0, seed=[1, 2, 3, 4, 5])
            rests &= np.arange(COUNT) % 2 == 1
    assert are_successes.any() == arguments.get("terminate_on_success", False)


@pytest.mark.parametrize(
    ("perturbations", "lengths"),
    [
        (["longer-15", "locked-3"], (1.0, 1.0, 1.0)),
        (["longer-15", "locked-2"], (1.0, 1.0, 1.0)),
        (["longer-50", "locked-3"], (1.0, 3.0, 1.0)),
    ],
)
def test_targets_stay_in_reach_of_the_given_arm_when_a_joint_is_locked(perturbations, lengths):
    """The rigid pieces of a longer arm may reach beyond the ring of the given arm."""
    arguments = {"perturbations": perturbations, "segment_lengths": lengths}
    native = make_native(count=50, **arguments)
    sync = mmc_gym.make_vec("random", 50, **arguments, vectorization_mode="sync")
    first = native.reset(seed=3)
    distances = np.hypot(*first[1]["target"].T)
    inner, outer = reachable_radii(lengths)
    assert inner <= distances.min() <= distances.max() <= outer
    assert same(first, sync.reset(seed=3))


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


def test_what_it_returns_becomes_tensors_without_a_copy(engine):
    arms = make_native(engine=engine)
    for *arrays, infos in (arms.reset(seed=0), arms.step(np.zeros((COUNT, 3), np.float32))):
        for array in (*arrays, *infos.values()):
            tensor = torch.from_dlpack(array)
            assert tensor.data_ptr() == array.ctypes.data and tensor.is_contiguous()


def test_an_arm_plays_the_same_in_any_number_of_arms_and_threads(engine):
    count, steps = 600, 25  # more than one Space of arms, and enough for two threads
    many = make_native("random", count, engine=engine, threads=2, max_episode_steps=10)
    few = make_native("random", 3, engine=engine, max_episode_steps=10)
    rows = [0, 77, 599]
    first, second = many.reset(seed=0), few.reset(seed=rows)
    for action in random_actions(many, steps):
        assert same(first[0][rows], second[0])
        first, second = many.step(action), few.step(action[rows])
        assert same(first[1][rows], second[1])
    many.close()


@pytest.mark.parametrize("limit", [{}, {"max_episode_steps": None}])
def test_it_has_the_time_limit_of_the_registration_or_none(limit):
    vector = make_native("random", 2, **limit)
    vector.reset(seed=0)
    ends = [vector.step(action)[3].all() for action in random_actions(vector, 150)]
    assert np.flatnonzero(ends).tolist() == ([] if limit else [99])


@pytest.mark.parametrize(
    "make",
    [
        *(MMCReachEnv, MMCReachGoalEnv),
        partial(make_native, autoreset_mode=AutoresetMode.DISABLED, max_episode_steps=1),
    ],
)
def test_a_step_before_the_reset_or_after_the_end_without_autoreset_is_refused(make):
    env = make()
    (action,) = random_actions(env, 1)
    with pytest.raises(ResetNeeded, match=r"reset\(\) before step|call reset\(\)"):
        env.step(action)
    env.reset(seed=0)
    env.step(action)
    if isinstance(env, MMCReachVectorEnv):
        with pytest.raises(ResetNeeded, match=r"\[0, 1, 2, 3, 4\]"):
            env.step(action)


def test_attributes_of_its_arms_are_those_of_single_environments(engine):
    """`get_attr`, `set_attr`, `call` and the seeds, as the vectors of Gymnasium have them."""
    arguments = {"engine": engine, "perturbations": "rotation--60..60"}
    native = mmc_gym.make_vec("random", 3, **arguments)
    sync = mmc_gym.make_vec("random", 3, vectorization_mode="sync", **arguments)
    for vector in (native, sync):
        vector.reset(seed=4)
    names = ["reach", "control", "engine", "success_distance", "context", "np_random_seed"]
    names += ["context_size", "perturbations", "parameters", "action_space", "observation_space"]
    for name in names:
        assert native.get_attr(name) == native.call(name) == sync.get_attr(name), name
    for first, second in zip(native.np_random, sync.np_random, strict=True):
        assert first.bit_generator.state == second.bit_generator.state
    assert native.np_random_seed == sync.np_random_seed == (4, 5, 6)
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
    for form in (mode, mode.name, mode.value):
        assert make_native(autoreset_mode=form).metadata["autoreset_mode"] is mode


def test_copies_are_refused():
    for make_copy in (pickle.dumps, copy.deepcopy):
        with pytest.raises(TypeError, match="cannot be pickled or copied"):
            make_copy(make_native())
