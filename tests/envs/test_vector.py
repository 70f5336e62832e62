"""The native vector environment plays what single environments play."""

import copy
import pickle
from collections.abc import Callable
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import data_equivalence
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.wrappers.vector import RecordEpisodeStatistics

import mmc_gym
from mmc_gym.envs.perturbations import VisuomotorRotation
from mmc_gym.envs.tasks import TASKS
from mmc_gym.envs.vector import MMCReachVectorEnv

same = partial(data_equivalence, exact=True)

COUNT = 5
LIMITS = ((-2.0, 2.5), (-2.5, 2.0), (0.1, 2.9))
AROUND_A_POINT = VisuomotorRotation(45.0, (0.0, 1.5))
VARIANTS: dict[str, dict[str, Any]] = {
    "default": {},
    "joint_delta": {"control": "joint_delta"},
    "joint_velocity": {"control": "joint_velocity"},
    "joint_torque": {"control": "joint_torque"},
    "smooth": {"smoothness_weight": 2.0},
    "sparse": {"reward_type": "sparse", "success_distance": 0.5},
    "joint limits, gravity": {"joint_limits": LIMITS, "gravity": (0.0, -9.81)},
    "one segment": {"segment_lengths": (1.5,)},
    "paper": {"task": "paper"},
    "centre-out": {"task": "centre-out"},
    "double step": {"task": "double-step-100"},
    "pursuit": {"task": TASKS["pursuit"]},
    "via points": {"task": TASKS["via-points"], "success_distance": 1.0, "reward_type": "sparse"},
    "force field": {"perturbations": "force-field"},
    "hand mass": {"perturbations": "hand-mass"},
    "rotation": {"perturbations": ("rotation-30",)},
    "off centre": {"perturbations": AROUND_A_POINT},
    "longer": {"perturbations": ("longer-50",)},
    "longer, told": {"perturbations": ("longer-50-told",)},
    "locked": {"perturbations": ("locked",)},
    "locks": {"perturbations": ("locks",)},
    "noise": {"perturbations": ("joint-noise-speed", "vision-noise-distance")},
    "late": {"perturbations": ("delay-40",)},
    "obstacles": {"perturbations": ("obstacles",)},
    "all at once": {
        "task": "double-step-200",
        "perturbations": ("force-field", AROUND_A_POINT, "locks", "vision-noise", "delay-100"),
    },
    "analytic": {"engine": "analytic"},
}
GOAL_VARIANTS = ("default", "joint_delta", "sparse", "pursuit", "off centre", "longer", "locked")


def make_native(env_id: str, count: int = COUNT, **arguments: Any) -> VectorEnv:
    vector = gym.make_vec(env_id, count, **arguments)
    assert isinstance(vector, MMCReachVectorEnv)
    return vector


def make_sync(env_id: str, mode: AutoresetMode, steps: int | None, **arguments: Any) -> VectorEnv:
    return gym.make_vec(
        env_id,
        COUNT,
        vectorization_mode="sync",
        max_episode_steps=steps,
        vector_kwargs={"autoreset_mode": mode},
        **arguments,
    )


def random_actions(vector: VectorEnv, steps: int, seed: int = 0) -> np.ndarray:
    assert vector.action_space.shape is not None
    random = np.random.default_rng(seed)
    return random.uniform(-1, 1, (steps, *vector.action_space.shape)).astype(np.float32)


def assert_same_play(native: VectorEnv, sync: VectorEnv, steps: int = 30) -> None:
    """Both return the same over some episodes, with partial resets on the way."""
    assert native.observation_space == sync.observation_space
    assert native.action_space == sync.action_space
    assert native.single_observation_space == sync.single_observation_space
    assert same(native.reset(seed=3), sync.reset(seed=3))
    some = np.arange(COUNT) % 2 == 0
    for index, action in enumerate(random_actions(native, steps)):
        step = native.step(action)
        assert same(step, sync.step(action))
        over = step[3]
        if native.metadata["autoreset_mode"] == AutoresetMode.DISABLED and over.any():
            first, second = (
                one.reset(options={"reset_mask": over.copy()}) for one in (native, sync)
            )
            assert same(first, second)
        if index == 7:
            first, second = (
                one.reset(seed=[1, 2, 3, 4, 5], options={"reset_mask": some.copy()})
                for one in (native, sync)
            )
            assert same(first, second)


@pytest.mark.parametrize("mode", AutoresetMode)
@pytest.mark.parametrize("variant", VARIANTS)
def test_it_returns_bit_for_bit_what_single_environments_return(
    variant: str, mode: AutoresetMode
) -> None:
    arguments = VARIANTS[variant]
    native = make_native("MMCReach-v0", autoreset_mode=mode, max_episode_steps=13, **arguments)
    sync = make_sync("MMCReach-v0", mode, 13, **arguments)
    assert_same_play(native, sync)


@pytest.mark.parametrize("variant", GOAL_VARIANTS)
def test_the_goal_environment_does_so_too(variant: str) -> None:
    arguments = VARIANTS[variant]
    for mode in AutoresetMode:
        native = make_native(
            "MMCReachGoal-v0", autoreset_mode=mode, max_episode_steps=13, **arguments
        )
        assert_same_play(native, make_sync("MMCReachGoal-v0", mode, 13, **arguments))


@pytest.mark.parametrize("engine", ["pymunk", "analytic"])
def test_an_arm_plays_the_same_in_any_number_of_arms_and_threads(engine: str) -> None:
    count, steps = 600, 25  # more than one Space of arms, and enough for two threads
    many = make_native("MMCReach-v0", count, engine=engine, threads=2, max_episode_steps=10)
    few = make_native("MMCReach-v0", 3, engine=engine, max_episode_steps=10)
    chosen = [0, 77, 599]
    first, second = many.reset(seed=0), few.reset(seed=chosen)
    for action in random_actions(many, steps):
        assert same(first[0][chosen], second[0])
        first, second = many.step(action), few.step(action[chosen])
        assert same(first[1][chosen], second[1])
    many.close()


def test_it_returns_new_arrays() -> None:
    vector = make_native("MMCReach-v0")
    kept = [vector.reset(seed=0)]
    kept += [vector.step(action) for action in random_actions(vector, 3)]
    before = copy.deepcopy(kept)
    for action in random_actions(vector, 3, seed=1):
        vector.step(action)
    vector.reset()
    assert same(kept, before)


def test_what_is_done_to_returned_arrays_does_not_matter() -> None:
    touched, untouched = make_native("MMCReach-v0"), make_native("MMCReach-v0")
    some = np.array([True, False, False, False, True])
    for vector in (touched, untouched):
        observation, info = vector.reset(seed=0)
        if vector is touched:
            observation[:] = 7.0
            for values in info.values():
                values[:] = False
    options = [{"reset_mask": some.copy()} for _ in range(2)]
    first, second = touched.reset(options=options[0]), untouched.reset(options=options[1])
    assert same(first, second)
    action = random_actions(touched, 1)[0]
    assert same(touched.step(action), untouched.step(action))


def test_without_a_time_limit_it_goes_on() -> None:
    vector = make_native("MMCReach-v0", 2, max_episode_steps=None)
    vector.reset(seed=0)
    ends = [vector.step(action)[3].any() for action in random_actions(vector, 150)]
    assert not any(ends)


def test_the_time_limit_is_that_of_the_registration() -> None:
    vector = make_native("MMCReach-v0", 2)
    vector.reset(seed=0)
    ends = [vector.step(action)[3].all() for action in random_actions(vector, 100)]
    assert ends == [False] * 99 + [True]


def test_agents_play_in_it() -> None:
    vector = make_native("MMCReach-v0", 40)
    agent = mmc_gym.make_agent("mmc", vector)  # type: ignore[arg-type]
    observation, info = vector.reset(seed=0)
    state, start = None, np.ones(40, dtype=bool)
    for _ in range(99):
        action, state = agent.predict(observation, state, start)
        observation, _, _, _, info = vector.step(action)
        start = np.zeros(40, dtype=bool)
    assert info["is_success"].mean() > 0.95


def test_gymnasium_wraps_it() -> None:
    vector = RecordEpisodeStatistics(make_native("MMCReach-v0"))
    vector.reset(seed=0)
    for action in random_actions(vector, 100):
        *_, info = vector.step(action)
    assert (info["episode"]["l"] == 100).all()


def test_pictures_show_every_arm() -> None:
    vector = make_native("MMCReach-v0", 3, render_mode="rgb_array")
    vector.reset(seed=0)
    frames = vector.render()
    assert frames is not None
    assert [frame.shape for frame in frames] == [(640, 640, 3)] * 3
    assert not same(frames[0], frames[1])


def test_a_goal_reward_is_that_of_the_goals() -> None:
    vector = make_native("MMCReachGoal-v0", success_distance=1.0)
    vector.reset(seed=0)
    for action in random_actions(vector, 20):
        observation, rewards, *_ = vector.step(action)
        goals = observation["achieved_goal"], observation["desired_goal"]
        assert same(vector.compute_reward(*goals, {}), rewards)  # type: ignore[attr-defined]


# --- What is refused

REFUSED: dict[str, tuple[Callable[[VectorEnv], Any], str]] = {
    "shape of actions": (
        lambda env: env.step(np.zeros((COUNT, 2))),
        r"actions .*\(5, 3\).*\(5, 2\)",
    ),
    "range of actions": (lambda env: env.step(np.full((COUNT, 3), 1.01)), "within -1 and 1.*arm 0"),
    "actions that are no numbers": (
        lambda env: env.step(np.where(np.arange(COUNT) == 3, np.nan, 0)[:, None] * np.ones(3)),
        "within -1 and 1.*arm 3",
    ),
    "number of seeds": (lambda env: env.reset(seed=[1, 2]), "seed must be .*5 of them"),
    "negative seed": (lambda env: env.reset(seed=-1), "seed must be .*at least 0.*-1"),
    "mask of no bools": (
        lambda env: env.reset(options={"reset_mask": np.ones(COUNT)}),
        "reset_mask.*5 bools",
    ),
    "empty mask": (
        lambda env: env.reset(options={"reset_mask": np.zeros(COUNT, bool)}),
        "reset_mask.*not all False",
    ),
    "unknown option": (lambda env: env.reset(seed=1, options={"goal": 0}), r"options .*\['goal'\]"),
    "target": (lambda env: env.reset(seed=1, options={"target": (9, 9)}), r"options\['target'\]"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_bad_input_is_refused_and_leaves_no_trace(case: str) -> None:
    attempt, message = REFUSED[case]
    tried, untried = make_native("MMCReach-v0"), make_native("MMCReach-v0")
    for vector in (tried, untried):
        vector.reset(seed=0)
        vector.step(random_actions(vector, 1)[0])
    with pytest.raises(ValueError, match=message):
        attempt(tried)
    for action in random_actions(tried, 110, seed=1):
        assert same(tried.step(action), untried.step(action))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"num_envs": 0}, "num_envs must be .*got 0"),
        ({"max_episode_steps": 0}, "max_episode_steps must be .*got 0"),
        ({"autoreset_mode": "never"}, "never"),
        ({"render_mode": "human"}, "render_mode must be one of .*'human'"),
        ({"control": "thought"}, "control must be one of .*'thought'"),
        ({"threads": 0}, "threads must be .*got 0"),
    ],
)
def test_bad_arguments_are_refused(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        MMCReachVectorEnv(**{"num_envs": 2, **arguments})


def test_a_step_before_the_reset_is_refused() -> None:
    vector = make_native("MMCReach-v0")
    with pytest.raises(ResetNeeded, match=r"reset\(\)"):
        vector.step(random_actions(vector, 1)[0])


def test_without_autoreset_a_finished_episode_must_be_reset() -> None:
    vector = make_native("MMCReach-v0", autoreset_mode=AutoresetMode.DISABLED, max_episode_steps=1)
    vector.reset(seed=0)
    vector.step(random_actions(vector, 1)[0])
    with pytest.raises(ResetNeeded, match=r"\[0, 1, 2, 3, 4\]"):
        vector.step(random_actions(vector, 1)[0])


def test_copies_are_refused() -> None:
    vector = make_native("MMCReach-v0")
    vector.reset(seed=0)
    with pytest.raises(TypeError, match="cannot be pickled or copied"):
        pickle.dumps(vector)
    with pytest.raises(TypeError, match="cannot be pickled or copied"):
        copy.deepcopy(vector)


@pytest.mark.parametrize("context", ["fork", "spawn"])
def test_workers_play_the_same(context: str) -> None:
    """Single environments in forked and spawned processes, and native ones in this process."""
    native = make_native("MMCReach-v0", 2)
    workers = gym.make_vec(
        "MMCReach-v0", 2, vectorization_mode="async", vector_kwargs={"context": context}
    )
    try:
        assert same(native.reset(seed=0), workers.reset(seed=0))
        for action in random_actions(native, 5):
            assert same(native.step(action), workers.step(action))
    finally:
        workers.close()
