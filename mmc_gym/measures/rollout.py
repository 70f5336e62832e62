"""Rollouts: an agent plays episodes, and each is recorded as arrays over its steps.

Episodes may differ in length, so they are a tuple of `Episode`, and nothing is padded.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Protocol

import gymnasium as gym
import numpy as np
from numpy.typing import ArrayLike, NDArray

from mmc_gym._grid import one_torch_thread
from mmc_gym.agents.base import Agent
from mmc_gym.agents.policy import PolicyAgent, PolicyCard
from mmc_gym.agents.policy_network import PolicyNetwork
from mmc_gym.envs.vector import MMCReachVectorEnv
from mmc_gym.interface import ReachInterface

REQUIRED_INFO = ("distance", "end_effector", "target")
MAX_STEPS = 100_000


class Predictor(Protocol):
    """Whatever acts: has the `predict` of stable-baselines3, for a single observation."""

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[Any, Any]:
        """The action for `observation`, and the state to hand back at the next step."""


@dataclass(frozen=True, eq=False)
class Episode:
    """What an agent did in one episode of n steps, with an arm of N joints.

    A hand without an arm has N = 0; what an environment does not tell is NaN.

    Attributes:
        seed: that the environment was reset with.
        hands: positions of the end effector, segment lengths, (n + 1, 2); the first is the start.
        distances: from hand (or cursor) to target, segment lengths, (n + 1,).
        targets: positions of the target, segment lengths, (n + 1, 2).
        joint_angles: relative, not wrapped, radians, (n + 1, N).
        servo_impulses: ∫ |τ| dt of each step and joint, (n, N), see `mmc_gym.body.Arm`.
        servo_work: ∫ |τ q̇| dt of each step and joint, (n, N).
        rewards: of each step, (n,).
        action_times: that `predict` took in each step, seconds, (n,).
        control_step: duration of a step, seconds.
        tolerance: distance within which the environment counts the target as reached.
        reach: of the arm that agents are told of, segment lengths.
        cursors: positions of what stands for the hand under a visuomotor rotation, and what
            distances and success are about, (n + 1, 2); None where that is the hand itself.
    """

    seed: int
    hands: NDArray[np.float64]
    distances: NDArray[np.float64]
    targets: NDArray[np.float64]
    joint_angles: NDArray[np.float64]
    servo_impulses: NDArray[np.float64]
    servo_work: NDArray[np.float64]
    rewards: NDArray[np.float64]
    action_times: NDArray[np.float64]
    control_step: float
    tolerance: float
    reach: float
    cursors: NDArray[np.float64] | None = None

    @property
    def seen_hands(self) -> NDArray[np.float64]:
        """Positions of what is to reach the target, the cursor or the hand, (n + 1, 2).

        The hand's own path has the same length and shape; only beside the target is it elsewhere.
        """
        return self.hands if self.cursors is None else self.cursors

    @property
    def target(self) -> NDArray[np.float64]:
        """Position of the target at the start, segment lengths, (2,)."""
        first: NDArray[np.float64] = self.targets[0]
        return first


def episode_seeds(seed: int, episodes: int) -> list[int]:
    """One seed per episode: the first `episodes` words of `numpy.random.SeedSequence(seed)`.

    They depend on nothing else, so all agents get the same ones, and more episodes add to the
    former.  (With seed, seed + 1, …, evaluations under neighbouring seeds would share nearly all
    their episodes.)

    Raises:
        ValueError: if `episodes` is less than 1 or `seed` is negative.
    """
    if episodes < 1:
        raise ValueError(f"episodes must be at least 1, got {episodes}")
    if seed < 0:
        raise ValueError(f"seed must not be negative, got {seed}")
    return [int(word) for word in np.random.SeedSequence(seed).generate_state(episodes)]


def check_environment(env: gym.Env[Any, Any]) -> None:
    """Raise a `ValueError` unless `env`, wrapped or not, tells what the measures need."""
    _, info = env.reset(seed=0)
    unwrapped = env.unwrapped
    missing = [f"info[{key!r}]" for key in REQUIRED_INFO if key not in info]
    if not hasattr(getattr(unwrapped, "parameters", None), "control_step"):
        missing.append("env.unwrapped.parameters.control_step")
    missing += [
        f"env.unwrapped.{name}"
        for name in ("success_distance", "reach")
        if not hasattr(unwrapped, name)
    ]
    if missing:
        name = env.spec.id if env.spec else str(env)
        raise ValueError(
            f"env must be a reaching environment such as 'MMCReach-v0', got {name!r}, "
            f"which lacks {', '.join(missing)}"
        )


def run_episodes(
    agent: Predictor,
    env: gym.Env[Any, Any],
    seeds: Sequence[int],
    on_episode: Callable[[Episode], None] | None = None,
    options: Sequence[Mapping[str, Any]] | None = None,
) -> tuple[Episode, ...]:
    """Let `agent` play one episode per seed, without exploration.

    Each episode begins with `env.reset(seed=...)`, and with `env.action_space` seeded from the
    same number, so that an episode depends on its own seed only, also for agents that sample
    from that space.  PyTorch, if loaded, computes on one thread.  The arm's servos are watched
    meanwhile; it moves as ever.

    Args:
        agent: whose actions are taken; it sees single observations.
        env: a single reaching environment, wrapped or not, that ends its episodes.
        seeds: one per episode, see `episode_seeds`.
        on_episode: is handed each episode when it is over, to show progress.
        options: of the environment's reset, for each episode, such as `{"trial": 3}`.

    Raises:
        ValueError: if the environment does not tell what the measures need, or there are not as
            many options as seeds.
        RuntimeError: if an episode does not end.
    """
    check_environment(env)
    asked: Sequence[Mapping[str, Any]] = [{}] * len(seeds) if options is None else options
    if len(asked) != len(seeds):
        raise ValueError(f"options must be {len(seeds)}, one per seed, got {len(asked)}")
    episodes = []
    # Senses may be noisy and late, so the posture is the arm's own and not the observed one.
    arm: Any = getattr(env.unwrapped, "arm", None)
    with one_torch_thread(), _recorded_effort(arm):
        for seed, option in zip(seeds, asked, strict=True):
            episodes.append(_run_episode(agent, env, seed, dict(option), arm))
            if on_episode is not None:
                on_episode(episodes[-1])
    return tuple(episodes)


def _run_episode(
    agent: Predictor,
    env: gym.Env[Any, Any],
    seed: int,
    options: dict[str, Any],
    arm: Any,
) -> Episode:
    # Not `seed` itself: the space would draw the very numbers that the environment draws for its
    # starting state, and the first random action would be the posture the arm is in.
    env.action_space.seed(int(np.random.SeedSequence((seed, 1)).generate_state(1)[0]))
    observation, info = env.reset(seed=seed, options=options)
    hands, distances, targets = [info["end_effector"]], [info["distance"]], [info["target"]]
    cursors = [info["cursor"]] if "cursor" in info else []
    postures = [getattr(arm, "joint_angles", ())]
    untold = [math.nan] * len(postures[0])
    impulses, work = [], []
    rewards: list[float] = []
    times: list[int] = []
    state, episode_start, over = None, np.ones(1, dtype=bool), False
    while not over:
        if len(rewards) == MAX_STEPS:
            raise RuntimeError(f"the episode did not end within {MAX_STEPS} steps: no time limit?")
        begin = time.perf_counter_ns()
        action, state = agent.predict(observation, state, episode_start, deterministic=True)
        times.append(time.perf_counter_ns() - begin)
        observation, reward, terminated, truncated, info = env.step(action)
        hands.append(info["end_effector"])
        distances.append(info["distance"])
        targets.append(info["target"])
        if cursors:
            cursors.append(info["cursor"])
        postures.append(getattr(arm, "joint_angles", ()))
        impulses.append(getattr(arm, "servo_impulses", untold))
        work.append(getattr(arm, "servo_work", untold))
        rewards.append(float(reward))
        episode_start, over = np.zeros(1, dtype=bool), terminated or truncated
    unwrapped: Any = env.unwrapped
    return Episode(
        seed=seed,
        hands=_floats(hands),
        distances=_floats(distances),
        targets=_floats(targets),
        joint_angles=_floats(postures),
        servo_impulses=_floats(impulses),
        servo_work=_floats(work),
        rewards=_floats(rewards),
        action_times=_floats(times) * 1e-9,
        control_step=float(unwrapped.parameters.control_step),
        tolerance=float(unwrapped.success_distance),
        reach=float(unwrapped.reach),
        cursors=_floats(cursors) if cursors else None,
    )


@contextmanager
def _recorded_effort(arm: Any) -> Iterator[None]:
    """Let an arm, or many, record the effort of their servos; what is no arm stays as it is."""
    before = getattr(arm, "records_effort", None)
    if before is None:
        yield
        return
    arm.records_effort = True
    try:
        yield
    finally:
        arm.records_effort = before


def _floats(values: ArrayLike) -> NDArray[np.float64]:
    return np.array(values, dtype=np.float64)


Floats = NDArray[np.float64]


def run_episodes_together(
    agent: Predictor,
    env: gym.vector.VectorEnv[Any, Any, Any],
    seeds: Sequence[int],
    options: Sequence[Mapping[str, Any]] | None = None,
) -> tuple[Episode, ...]:
    """Let `agent` play one episode per seed, all at once, without exploration.

    Args:
        agent: whose `predict` takes a batch of observations, and keeps what it remembers in the
            state it returns.  One that draws random actions draws others than one by one.
        env: a native vector environment with an arm for each seed, and a time limit.
        seeds: one per episode, see `episode_seeds`.
        options: of the environment's reset, for each episode, such as `{"trial": 3}`.

    Returns:
        The episodes that `run_episodes` returns, with action times NaN.

    Raises:
        ValueError: if `env` is none such, there are not as many options as seeds, or the agent
            does not give an action for each episode.

    Example:
        >>> from mmc_gym import make_agent
        >>> env = gym.make_vec("MMCReach-v0", num_envs=2)
        >>> first, second = run_episodes_together(make_agent("mmc", env), env, [5, 6])
        >>> first.seed, second.hands.shape
        (5, (101, 2))
    """
    asked: Sequence[Mapping[str, Any]] = [{}] * len(seeds) if options is None else options
    native = _checked(env, len(seeds))
    if len(asked) != len(seeds):
        raise ValueError(f"options must be {len(seeds)}, one per seed, got {len(asked)}")
    arms = native.arms
    shape = (len(seeds), native.setup.joint_count)
    with one_torch_thread(), _recorded_effort(arms):
        observation, seen = _reset(native, seeds, asked)
        seen_at = {name: [values] for name, values in seen.items()}
        postures = [arms.joint_angles.copy()]
        impulses: list[Floats] = []
        work: list[Floats] = []
        rewards: list[Floats] = []
        state, episode_start = None, np.ones(len(seeds), dtype=bool)
        for _ in range(native.max_episode_steps or 0):
            action, state = agent.predict(observation, state, episode_start, deterministic=True)
            _check_actions(action, shape)
            observation, reward, _, _, info = native.step(action)
            for name, record in seen_at.items():
                record.append(info[name])
            postures.append(arms.joint_angles.copy())
            impulses.append(arms.servo_impulses.copy())
            work.append(arms.servo_work.copy())
            rewards.append(reward)
            episode_start = np.zeros(len(seeds), dtype=bool)
    records = {
        **{_SEEN[name]: _by_episode(record) for name, record in seen_at.items()},
        "joint_angles": _by_episode(postures),
        "servo_impulses": _by_episode(impulses),
        "servo_work": _by_episode(work),
        "rewards": _by_episode(rewards),
    }
    return tuple(
        Episode(
            seed=seed,
            **{name: values[number] for name, values in records.items()},
            action_times=np.full(len(rewards), np.nan),
            control_step=float(native.parameters.control_step),
            tolerance=float(native.success_distance),
            reach=float(native.reach),
        )
        for number, seed in enumerate(seeds)
    )


_SEEN = {
    "end_effector": "hands",
    "distance": "distances",
    "target": "targets",
    "cursor": "cursors",  # under a visuomotor rotation only
}


def _checked(env: gym.vector.VectorEnv[Any, Any, Any], episodes: int) -> MMCReachVectorEnv:
    native = env.unwrapped
    if not isinstance(native, MMCReachVectorEnv) or native.max_episode_steps is None:
        raise ValueError(
            "env must be a native vector environment with a time limit, such as "
            f"gym.make_vec('MMCReach-v0', num_envs={episodes}), got {env}"
        )
    if native.num_envs != episodes:
        raise ValueError(f"env must have {episodes} arms, one per seed, got {native.num_envs}")
    return native


def _reset(
    env: MMCReachVectorEnv, seeds: Sequence[int], options: Sequence[Mapping[str, Any]]
) -> tuple[Any, dict[str, Floats]]:
    """Start every episode with its own seed and options; observation, and what the infos tell."""
    observation: Any = None
    seen: dict[str, Floats] = {}
    for group in _alike(options):
        mask = np.zeros(len(seeds), dtype=bool)
        mask[group] = True
        asked = {**options[group[0]], "reset_mask": mask}
        observation, info = env.reset(seed=list(seeds), options=asked)
        for name in _SEEN.keys() & info.keys():
            values = seen.setdefault(name, np.zeros(info[name].shape))
            values[group] = info[name][group]
    return observation, seen


def _alike(options: Sequence[Mapping[str, Any]]) -> list[list[int]]:
    """Numbers of the episodes that have the same options, for they are reset together."""
    groups: dict[str, list[int]] = {}
    for number, option in enumerate(options):
        groups.setdefault(repr(sorted(option.items())), []).append(number)
    return list(groups.values())


def _check_actions(action: ArrayLike, shape: tuple[int, int]) -> None:
    if np.shape(action) != shape:
        raise ValueError(f"agent must give actions of shape {shape}, got {np.shape(action)}")


def _by_episode(values: Sequence[Floats]) -> Floats:
    """Arrays (episodes, …) of each step as one, (episodes, steps, …)."""
    return np.stack(values, axis=1)


EVALUATION_SEED = 1_000_000  # far from the seeds that a comparison starts from


def evaluate(network: PolicyNetwork, card: PolicyCard, episodes: int) -> dict[str, float]:
    """How the deterministic policy does over fixed episodes; see `evaluate_agent`."""

    def make(interface: ReachInterface) -> Agent[Any]:
        return PolicyAgent(network, card, interface)

    arguments = card.hyperparameters.get("env_kwargs", {})
    return evaluate_agent(make, card.env_id, arguments, episodes, EVALUATION_SEED)


def evaluate_agent(
    make: Callable[[ReachInterface], Agent[Any]],
    env_id: str,
    arguments: dict[str, Any],
    episodes: int,
    seed: int,
) -> dict[str, float]:
    """How an agent does over episodes that are played at once, each with an arm of its own.

    Args:
        make: makes the agent.
        env_id: environment that it acts in.
        arguments: of the environment.
        episodes: how many.
        seed: of the first episode; the others have the next ones.

    Returns:
        success: part of the episodes that end at the target.
        final_distance: mean, segment lengths.
        episode_return: mean.
        time_at_target: part of the time that is spent at the target.
        time_to_target: median over the successes, until the hand is there to stay, seconds; there
            is none without a success.
    """
    env = gym.make_vec(env_id, episodes, autoreset_mode="Disabled", **arguments)
    interface = ReachInterface.of(env)
    agent = make(interface)
    observations, infos = env.reset(seed=seed)
    state, over, step = None, np.zeros(episodes, dtype=bool), 0
    returns, at_target, last_away = (np.zeros(episodes) for _ in range(3))
    while not over.all():
        actions, state = agent.predict(observations, state, deterministic=True)
        observations, rewards, _, over, infos = env.step(actions)
        step += 1
        returns += rewards
        at_target += infos["is_success"]
        last_away[~infos["is_success"]] = step
    env.close()
    success = infos["is_success"]
    scores = {
        "success": float(success.mean()),
        "final_distance": float(infos["distance"].mean()),
        "episode_return": float(returns.mean()),
        "time_at_target": float(at_target.mean()) / step,
    }
    if success.any():
        steps = float(np.median(last_away[success])) + 1
        scores["time_to_target"] = round(steps * interface.control_step, 3)
    return scores
