"""The timed environments, of this package and of others, and how each plays an episode.

An episode is a reset and all its steps.  The arms of a vector environment begin and end their
episodes together; with autoreset one more call makes the reset, and is not counted as steps.
Actions are drawn beforehand, uniformly, and are the same in every episode.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np

import mmc_gym  # noqa: F401  (registers the environments)

OURS = "MMCReach-v0"
PEER = "Reacher-v5"


@dataclass(frozen=True)
class Player:
    """An environment to time, whose episodes all have the same number of steps.

    Attributes:
        play: plays one episode with every arm.
        steps: number of steps in a call of `play`, summed over the arms.
        close: closes the environment.
    """

    play: Callable[[], None]
    steps: int
    close: Callable[[], None]


def single(env_id: str, **arguments: Any) -> Player:
    """Return the player of one environment, made by `gym.make`."""
    env = gym.make(env_id, **arguments)
    env.reset(seed=0)
    env.action_space.seed(0)
    actions = [env.action_space.sample() for _ in range(env.spec.max_episode_steps)]

    def play() -> None:
        env.reset()
        for action in actions:
            env.step(action)

    return Player(play, len(actions), env.close)


def vector(env_id: str, num_envs: int, mode: str | None = None, **arguments: Any) -> Player:
    """Return the player of a vector environment, made by `gym.make_vec`.

    Args:
        env_id: the environment's id.
        num_envs: number of arms.
        mode: Gymnasium's `vectorization_mode`; None chooses the environment's own.
        arguments: keyword arguments of the environment.
    """
    env = gym.make_vec(env_id, num_envs=num_envs, vectorization_mode=mode, **arguments)
    return _vector(env, num_envs, env.spec.max_episode_steps or 0)


def envpool(env_id: str, num_envs: int, threads: int) -> Player:
    """Return the player of EnvPool's vector environment, which C++ threads step."""
    import envpool

    env = envpool.make_gymnasium(env_id, num_envs=num_envs, num_threads=threads, seed=0)
    return _vector(env, num_envs, env.spec.config.max_episode_steps)


def _vector(env: Any, num_envs: int, episode: int) -> Player:
    low, high = env.action_space.low, env.action_space.high
    shape = (episode + 1, num_envs, low.shape[-1])
    actions = np.random.default_rng(0).uniform(low, high, shape).astype(env.action_space.dtype)
    env.reset()

    def play() -> None:
        for action in actions[:-1]:
            _, _, _, truncations, _ = env.step(action)
        assert all(truncations), "the episodes did not end together"
        env.step(actions[-1])  # resets

    return Player(play, num_envs * episode, env.close)


def rebuilt(env_id: str, family: str, low: float, high: float) -> Player:
    """Return a player that makes a new environment, with another body, for each episode.

    Gymnasium's own tutorial draws bodies in this way.
    """
    drawn = np.random.default_rng(0)
    first = gym.make(env_id)
    actions = [first.action_space.sample() for _ in range(first.spec.max_episode_steps or 0)]

    def play() -> None:
        env = gym.make(env_id, perturbations=f"{family}-{drawn.uniform(low, high):.3f}")
        env.reset()
        for action in actions:
            env.step(action)
        env.close()

    return Player(play, len(actions), first.close)


def carl(feature: str, low: float, high: float) -> Player:
    """Return the player of CARL's pendulum, with another value of a feature in each episode."""
    from carl.envs import CARLPendulum

    values = np.random.default_rng(0).uniform(low, high, 1000)
    env = CARLPendulum(contexts={place: {feature: value} for place, value in enumerate(values)})
    actions = [env.action_space.sample() for _ in range(200)]

    def play() -> None:
        env.reset()
        for action in actions:
            env.step(action)

    return Player(play, len(actions), env.close)


def dm_control(domain: str, task: str) -> Player:
    """Return the player of one environment of dm_control's suite, with its own settings."""
    os.environ.setdefault("MUJOCO_GL", "disabled")  # nothing is drawn
    from dm_control import suite

    env = suite.load(domain, task, task_kwargs={"random": 0})
    spec = env.action_spec()
    env.reset()
    steps = 1
    while not env.step(np.zeros(spec.shape)).last():
        steps += 1
    shape = (steps, *spec.shape)
    actions = np.random.default_rng(0).uniform(spec.minimum, spec.maximum, shape)

    def play() -> None:
        env.reset()
        for action in actions:
            env.step(action)

    return Player(play, steps, env.close)


def gymnax(name: str, num_envs: int) -> Player:
    """Return the player of gymnax's arms, stepped together by XLA, which chooses its threads."""
    import gymnax
    import jax

    env, parameters = gymnax.make(name)
    reset = jax.jit(jax.vmap(env.reset, in_axes=(0, None)))
    step = jax.jit(jax.vmap(env.step, in_axes=(0, 0, 0, None)))
    keys = jax.random.split(jax.random.PRNGKey(0), num_envs)
    space, steps = env.action_space(parameters), parameters.max_steps_in_episode
    drawn = np.random.default_rng(0).uniform(-1.0, 1.0, (steps, num_envs, *space.shape))
    actions = [jax.numpy.asarray(step_actions, dtype=space.dtype) for step_actions in drawn]

    def play() -> None:
        _, state = reset(keys, parameters)
        for action in actions:
            _, state, reward, _, _ = step(keys, state, action, parameters)
            reward.block_until_ready()

    return Player(play, num_envs * steps, lambda: None)


@dataclass(frozen=True)
class Entry:
    """One row of a table.

    Attributes:
        environment: name of the environment.
        variant: its particular settings, in words.
        make: makes its player.
        arms: number of arms.
        threads: number of threads, or processes, that step the arms.
    """

    environment: str
    variant: str
    make: Callable[[], Player]
    arms: int = 1
    threads: int = 1


def _vector_entry(environment: str, variant: str, arms: int, mode: str) -> Entry:
    threads = arms if mode == "async" else 1
    return Entry(environment, variant, partial(vector, environment, arms, mode), arms, threads)


def _envpool_entry(arms: int, threads: int) -> Entry:
    return Entry(PEER, "EnvPool", partial(envpool, PEER, arms, threads), arms, threads)


def _native_entry(variant: str, arms: int, threads: int, **arguments: Any) -> Entry:
    make = partial(vector, OURS, arms, threads=threads, **arguments)
    return Entry(OURS, variant, make, arms, threads)


REFERENCE = Entry(PEER, "", partial(single, PEER))

SINGLE = (
    REFERENCE,
    Entry("dm_control reacher", "hard", partial(dm_control, "reacher", "hard")),
    Entry(OURS, "", partial(single, OURS)),
    *(
        Entry(OURS, control, partial(single, OURS, control=control))
        for control in ("joint_delta", "joint_velocity", "joint_torque")
    ),
    Entry(OURS, "analytic", partial(single, OURS, engine="analytic")),
    Entry("MMCReachGoal-v0", "", partial(single, "MMCReachGoal-v0")),
    Entry("CARL's pendulum", "drawn lengths", partial(carl, "l", 0.7, 1.35)),
    Entry(OURS, "drawn lengths", partial(single, OURS, perturbations="longer--30..35")),
    Entry(OURS, "a new one each episode", partial(rebuilt, OURS, "longer", -30.0, 35.0)),
)

VECTOR = (
    _vector_entry(PEER, "sync", 64, "sync"),
    _vector_entry(PEER, "async", 64, "async"),
    _envpool_entry(64, 1),
    _envpool_entry(64, 2),
    Entry("gymnax Reacher-misc", "jax", partial(gymnax, "Reacher-misc", 4096), 4096, 2),
    _vector_entry(OURS, "sync", 64, "sync"),
    _vector_entry(OURS, "async", 64, "async"),
    *(_native_entry("native", arms, threads) for arms in (64, 256) for threads in (1, 2)),
    *(_native_entry("native, joint_torque", 256, n, control="joint_torque") for n in (1, 2)),
    *(
        _native_entry("native, analytic", arms, threads, engine="analytic")
        for arms in (256, 4096)
        for threads in (1, 2)
    ),
)

ENGINES = ("pymunk", "analytic")

# Families of perturbations, the range to draw from, and fixed strengths to compare with.
DRAWN = (
    ("longer", "-30..35", (-20, 0, 20)),
    ("hand-mass", "0..10", (2, 5, 8)),
    ("force-field", "0..60", (10, 30, 50)),
    ("gravity", "0..120", (20, 60, 100)),
    ("locked", "1..3", (1, 2, 3)),
    ("locks", "1..3", (1, 2, 3)),
    ("rotation", "-60..60", (-40, 5, 40)),
    ("gain", "0.7..1.4", (0.8, 1.05, 1.3)),
    ("delay", "0..160", (20, 80, 140)),
    ("base-turn", "-20..20", (-15, 5, 15)),
    ("base-shift", "-0.2..0.2", (-0.15, 0.05, 0.15)),
    ("joint-friction", "0..0.3", (0.05, 0.15, 0.25)),
    ("joint-damping", "0..0.3", (0.05, 0.15, 0.25)),
    ("segment-mass", "1..3", (1.3, 2, 2.7)),
    ("torque-limit", "0.1..1", (0.2, 0.5, 0.9)),
    ("servo-gain", "0.5..1", (0.6, 0.75, 0.9)),
    ("motor-gain", "0.3..1", (0.4, 0.65, 0.9)),
    ("motor-offset", "0..0.2", (0.05, 0.1, 0.15)),
    ("dead-zone", "0..0.2", (0.05, 0.1, 0.15)),
    ("backlash", "0..0.2", (0.05, 0.1, 0.15)),
    ("stuck-motor", "1..3", (1, 2, 3)),
    ("action-noise", "0..0.2", (0.05, 0.1, 0.15)),
    ("action-delay", "0..160", (20, 80, 140)),
    ("dropped-actions", "0..0.3", (0.05, 0.15, 0.25)),
    ("held-actions", "0..0.3", (0.05, 0.15, 0.25)),
    ("repeated-actions", "0..0.3", (0.05, 0.15, 0.25)),
    ("joint-noise", "0..0.05", (0.01, 0.025, 0.04)),
    ("vision-noise", "0..0.05", (0.01, 0.025, 0.04)),
    ("observation-noise", "0..0.1", (0.02, 0.05, 0.08)),
    ("sensor-offset", "0..0.2", (0.05, 0.1, 0.15)),
    ("sensor-drift", "0..0.2", (0.05, 0.1, 0.15)),
    ("stuck-sensor", "1..3", (1, 2, 3)),
    ("encoder", "16..64", (20, 40, 60)),
    ("dropped-numbers", "0..0.1", (0.02, 0.05, 0.08)),
    ("held-numbers", "0..0.3", (0.05, 0.15, 0.25)),
    ("repeated-observations", "0..0.5", (0.1, 0.25, 0.4)),
)


def drawn_entries(engine: str, arms: int) -> dict[str, Entry]:
    """Return entries by perturbation: none (""), then each of `DRAWN`, drawn or fixed."""
    names = [f"{name}-{strength}" for name, drawn, fixed in DRAWN for strength in (drawn, *fixed)]
    return {
        name: _native_entry(name, arms, 1, engine=engine, perturbations=name or ())
        for name in ("", *names)
    }


GROWTH = tuple(
    _native_entry(engine, arms, threads, engine=engine)
    for engine in ENGINES
    for arms in (1, 16, 64, 256, 1024, 4096, *((16_384, 65_536) if engine == "analytic" else ()))
    for threads in (1, 2)
)

WHAT_THEY_SIMULATE = f"""\
Steps are those of all arms; resets are in the time.  What is simulated in a step of 0.02 s:
{PEER}, EnvPool: 2 joints, MuJoCo, 2 substeps of Runge-Kutta, 4th order; reset after 50 steps.
CARL: 1 joint, Euler, in Python, where observations are mappings; reset after 200 steps.
gymnax: 2 joints without dynamics: they turn as the action says, at once; reset after 100 steps.
dm_control: 2 joints, MuJoCo, 1 substep of Euler, no contacts; reset after 1000 steps.
{OURS}: 3 joints with servos, 4 substeps of pymunk or of the analytic engine; reset after 100 steps.
MuJoCo works on the thread that calls it.  EnvPool and {OURS} have their own threads."""
