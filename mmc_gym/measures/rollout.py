"""Let agents play episodes, and record each episode as arrays over its steps.

Episodes may differ in length: they are a tuple of `Episode`, without padding.
"""

from __future__ import annotations

import math
import time
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, closing
from operator import attrgetter
from typing import Any, TypeAlias

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode

from mmc_gym._errors import UserError, is_whole, require, require_whole
from mmc_gym._grid import one_torch_thread
from mmc_gym.agents.base import Agent, Predictor
from mmc_gym.envs.vector import MMCReachVectorEnv
from mmc_gym.interface import ReachInterface
from mmc_gym.measures.episode import Episode, Floats
from mmc_gym.measures.reaching import final_distance, success, time_to_target

MAX_STEPS = 100_000
MOST_EPISODES = 1_000_000

# Attributes of an `Episode` and the entries of info that they record; the last may be missing.
_SEEN = {"hands": "end_effector", "distances": "distance", "targets": "target", "cursors": "cursor"}
_SEEN |= {"channel_forces": "channel_force", "ideal_forces": "ideal_force"}
_REQUIRED = ("distance", "end_effector", "target")
_EFFORT = ("servo_impulses", "servo_work")

Env: TypeAlias = "gym.Env[Any, Any] | gym.vector.VectorEnv[Any, Any, Any]"
Options: TypeAlias = Mapping[str, Any]


def episode_seeds(seed: int, episodes: int) -> list[int]:
    """Return one seed per episode: the first words of `numpy.random.SeedSequence(seed)`.

    A larger number of episodes begins with the same seeds.
    """
    episodes = require_whole("episodes", episodes, most=MOST_EPISODES)
    seed = require_whole("seed", seed, least=0, most=math.inf)
    return [int(word) for word in np.random.SeedSequence(seed).generate_state(episodes)]


def check_environment(env: gym.Env[Any, Any]) -> None:
    """Raise a `UserError` unless `env`, wrapped or not, reports what the measures need."""
    _, info = env.reset(seed=0)
    missing = [f"info[{key!r}]" for key in _REQUIRED if key not in info]
    for name in ("parameters.control_step", "success_distance", "reach"):
        try:
            attrgetter(name)(env.unwrapped)
        except AttributeError:
            missing.append(f"env.unwrapped.{name}")
    if missing:
        raise UserError(
            "env must be a reaching environment such as 'MMCReach-v0', got "
            f"{env.spec.id if env.spec else env}, which lacks {', '.join(missing)}; "
            "to any other belongs an interface=..."
        )


def run_episodes(
    agent: Predictor,
    env: Env,
    seeds: Sequence[int],
    on_episode: Callable[[Episode], None] | None = None,
    options: Sequence[Options] | None = None,
    *,
    records_effort: bool = True,
) -> tuple[Episode, ...]:
    """Let `agent` play one episode per seed, without exploration.

    A single environment plays the episodes in turn, a vector environment all at once, with the same
    results, except that action times are NaN, and that agents may sample other actions.  Each
    episode depends on its own seed only.  PyTorch, if loaded, computes on one thread.

    Args:
        agent: chooses the actions; its memory is in the state that `predict` returns.
        env: a reaching environment with a time limit, wrapped or not; or a native vector
            environment with one arm per seed.
        seeds: one per episode, see `episode_seeds`.
        on_episode: called with each episode at its end, to show progress.
        options: given to the environment's reset, one mapping per episode, such as `{"trial": 3}`.
        records_effort: whether to record the effort of the servos; NaN otherwise.

    Raises:
        UserError: if the environment does not report what the measures need, or the number of
            options or arms differs from the number of seeds.
        RuntimeError: if an episode does not end.

    >>> from mmc_gym import make_agent
    >>> env = gym.make_vec("MMCReach-v0", num_envs=2)
    >>> first, second = run_episodes(make_agent("mmc", env), env, [5, 6])
    >>> first.seed, second.hands.shape
    (5, (101, 2))
    """
    acts = hasattr(agent, "predict") and not isinstance(agent, type)
    require(acts, "agent", agent, "an object with predict, such as make_agent('mmc', env)")
    is_env = isinstance(env, gym.Env | gym.vector.VectorEnv)
    require(is_env, "env", env, "an environment, such as gym.make('MMCReach-v0')")
    are_whole = np.iterable(seeds) and all(is_whole(seed) and seed >= 0 for seed in seeds)
    require(are_whole, "seeds", seeds, "whole numbers of at least 0, one per episode")
    seeds = [int(seed) for seed in seeds]
    options = [{}] * len(seeds) if options is None else options
    is_list = isinstance(options, Sequence) and len(options) == len(seeds)
    are_mappings = is_list and all(isinstance(option, Mapping) for option in options)
    require(are_mappings, "options", options, f"a list of {len(seeds)} mappings, one per seed")
    if isinstance(env, gym.vector.VectorEnv):
        arm: Any = _check_vector(env, len(seeds)).arms
        groups = [(seeds, options)]
    else:
        check_environment(env)
        arm = getattr(env.unwrapped, "arm", None)
        groups = [([seed], [option]) for seed, option in zip(seeds, options, strict=True)]
    episodes: list[Episode] = []
    with one_torch_thread(), ExitStack() as stack:
        if hasattr(arm, "records_effort"):
            stack.callback(setattr, arm, "records_effort", arm.records_effort)
            arm.records_effort = records_effort
        for group in groups:
            for episode in _play(agent, env, *group, arm)[0]:
                episodes.append(episode)
                if on_episode is not None:
                    on_episode(episode)
    return tuple(episodes)


def run_trial(
    agent: Predictor, env: Env, seeds: Sequence[int], options: Sequence[Options], state: Any = None
) -> tuple[list[Episode], Any]:
    """Let `agent` play one episode with each arm, from a state that it kept.

    Arguments are those of `run_episodes`, which checks them; `state` is None at the start of all.
    Return the episodes, in the order of the seeds, and the state that `predict` returned last.
    """
    arm: Any = getattr(env.unwrapped, "arms", None) or getattr(env.unwrapped, "arm", None)
    return _play(agent, env, seeds, options, arm, state)


def _play(
    agent: Predictor,
    env: Env,
    seeds: Sequence[int],
    options: Sequence[Options],
    arm: Any,
    state: Any = None,
) -> tuple[list[Episode], Any]:
    """Play one episode with each arm from reset to end; return them and the agent's state there."""
    together = isinstance(env, gym.vector.VectorEnv)
    observation, info = (_reset_together if together else _reset)(env, seeds, options)
    values: defaultdict[str, list[Any]] = defaultdict(list)
    _look(values, arm, info)
    times: list[int] = []
    episode_start, over = np.full(len(seeds), state is None), False
    while not over:
        if len(times) == MAX_STEPS:
            raise RuntimeError(f"the episode did not end within {MAX_STEPS} steps: no time limit?")
        begin = time.perf_counter_ns()
        predicted = agent.predict(observation, state, episode_start, deterministic=True)
        times.append(time.perf_counter_ns() - begin)
        is_pair = isinstance(predicted, tuple) and len(predicted) == 2
        require(is_pair, "what predict returns", predicted, "a pair (action, state)")
        action, state = predicted
        observation, reward, terminated, truncated, info = env.step(action)
        _look(values, arm, info)
        values["rewards"].append(reward)
        if getattr(arm, "records_effort", False):
            for name in _EFFORT:
                values[name].append(np.array(getattr(arm, name)))
        episode_start = np.zeros(len(seeds), dtype=bool)
        over = bool(np.all(np.logical_or(terminated, truncated)))
    world: Any = env.unwrapped
    is_success = None
    if math.isnan(world.success_distance):
        accepted = "with is_success, or interface with success_distance"
        require("is_success" in info, "info", sorted(info), accepted)
        is_success = bool(info["is_success"])
    arrays = _arrays(values, together)
    episodes = [
        Episode(
            seed=seed,
            **{name: array[number] for name, array in arrays.items()},
            # One `predict` for many arms does not show how long it takes for one arm.
            action_times=np.where(together, math.nan, np.array(times, dtype=np.float64) * 1e-9),
            control_step=float(world.parameters.control_step),
            tolerance=float(world.success_distance),
            reach=float(world.reach),
            is_success=is_success,
        )
        for number, seed in enumerate(seeds)
    ]
    return episodes, state


def _look(values: Mapping[str, list[Any]], arm: Any, info: Mapping[str, Any]) -> None:
    """Add where hand, target and joints are to the values of the steps before, by name."""
    for name, key in _SEEN.items():
        if key in info:
            values[name].append(info[key])
    # The arm's own posture, because the observed one may be noisy and late.
    posture = getattr(arm, "joint_angles", info.get("joint_angles", ()))
    values["joint_angles"].append(np.array(posture))


def _arrays(values: Mapping[str, list[Any]], together: bool) -> dict[str, Floats]:
    """Return what was recorded, (episodes, steps, …) by name; effort that was not is NaN."""
    arrays = {}
    for name, steps in values.items():
        array = np.array(steps, dtype=np.float64)  # (steps, …) or (steps, episodes, …)
        array = array.swapaxes(0, 1) if together else array[None]
        arrays[name] = np.ascontiguousarray(array)
    unreported = np.full_like(arrays["joint_angles"][:, 1:], math.nan)
    return {**dict.fromkeys(_EFFORT, unreported), **arrays}


def _reset(env: Any, seeds: Sequence[int], options: Sequence[Options]) -> Any:
    (seed,), (option,) = seeds, options
    # Not `seed` itself: the action space would draw the same numbers as the environment does for
    # its starting state, and the first random action would be the posture of the arm.
    env.action_space.seed(int(np.random.SeedSequence((seed, 1)).generate_state(1)[0]))
    return env.reset(seed=seed, options=dict(option))


def _reset_together(env: Any, seeds: Sequence[int], options: Sequence[Options]) -> tuple[Any, Any]:
    """Reset each arm with its own seed and options, all arms with equal options in one call."""
    groups: dict[str, list[int]] = {}
    for number, option in enumerate(options):
        groups.setdefault(repr(sorted(option.items())), []).append(number)
    observation: Any = None
    seen: dict[str, Any] = {}
    for group in groups.values():
        mask = np.zeros(len(seeds), dtype=bool)
        mask[group] = True
        of_group = [seed if is_reset else None for seed, is_reset in zip(seeds, mask)]
        masked = {**options[group[0]], "reset_mask": mask}
        observation, info = env.reset(seed=of_group, options=masked)
        for key in info.keys() & {*_SEEN.values()}:
            values = seen.setdefault(key, np.zeros(info[key].shape))
            values[group] = info[key][group]
    return observation, seen


def _check_vector(env: gym.vector.VectorEnv[Any, Any, Any], episodes: int) -> MMCReachVectorEnv:
    """Return the native vector environment; raise a `UserError` if `env` cannot be played."""
    native = env.unwrapped
    if not isinstance(native, MMCReachVectorEnv) or native.max_episode_steps is None:
        raise UserError(
            "env must be a native vector environment with a time limit, such as "
            f"gym.make_vec('MMCReach-v0', num_envs={episodes}), got {env}"
        )
    if native.autoreset_mode == AutoresetMode.SAME_STEP:
        raise UserError("env must not reset in the step that ends an episode, got SameStep")
    accepted = "False for arms that are played together, which end together"
    require(not native.setup.terminates, "terminate_on_success", True, accepted)
    if native.num_envs != episodes:
        raise UserError(f"env must have {episodes} arms, one per seed, got {native.num_envs}")
    return native


def evaluate(
    make: Callable[[ReachInterface], Agent[Any]],
    env_id: str,
    arguments: Mapping[str, Any],
    episodes: int,
    seed: int = 1_000_000,  # far from the seeds of comparisons
) -> dict[str, float]:
    """Return the scores of an agent over episodes of the seeds `seed`, `seed` + 1, …, all at once.

    They are means of success, final_distance and episode_return; time_at_target, the share of the
    time within the tolerance; and time_to_target, the median over the successes, if any.  Episodes
    last to their time limit, whatever `terminate_on_success` is.
    """
    whole = {**arguments, "terminate_on_success": False, "autoreset_mode": "Disabled"}
    with closing(gym.make_vec(env_id, episodes, **whole)) as env:
        agent, seeds = make(ReachInterface.of(env)), range(seed, seed + episodes)
        episodes_played = run_episodes(agent, env, seeds, records_effort=False)
    # Summed step by step, as trainings always have: the last bit of a mean depends on the order.
    returns = np.cumsum([episode.rewards for episode in episodes_played], axis=-1)[:, -1]
    inside = [episode.distances[1:] <= episode.tolerance for episode in episodes_played]
    scores = {
        "success": float(np.mean([*map(success, episodes_played)])),
        "final_distance": float(np.mean([*map(final_distance, episodes_played)])),
        "episode_return": float(returns.mean()),
        "time_at_target": float(np.sum(inside, axis=-1, dtype=np.float64).mean()) / len(inside[0]),
    }
    if scores["success"] > 0.0:
        times = [time_to_target(episode) for episode in episodes_played]
        scores["time_to_target"] = round(float(np.nanmedian(times)), 3)
    return scores
