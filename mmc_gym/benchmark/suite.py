"""The benchmark's scenarios, how agents play them in their control modes, and the ideal hand."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, TypeAlias

import gymnasium as gym
import numpy as np

from mmc_gym._errors import require_arguments, warn_of_mismatch
from mmc_gym.agents.base import Agent, Predictor
from mmc_gym.agents.planners import (
    HandPlan,
    begin_movement,
    follow_target,
    minimum_jerk_step,
    one_step_later,
)
from mmc_gym.agents.resolved import ResolvedAgent
from mmc_gym.agents.sb3 import ModelAgent
from mmc_gym.envs.names import CHALLENGES, TASKS
from mmc_gym.envs.scenarios import (
    EnvLike,
    OwnEnvironment,
    Playable,
    Scenario,
    find_scenario,
    parse_scenario,
    refuse_interface,
)
from mmc_gym.envs.vector import MMCReachVectorEnv
from mmc_gym.interface import ControlError, read_attribute
from mmc_gym.measures.episode import Episode, Floats
from mmc_gym.measures.rollout import Options, check_environment, run_episodes

_PERTURBED = """
force-field-30 force-field-60 force-field-90
rotation-15 rotation-30 rotation-45 rotation-60
hand-mass-1 hand-mass-3 hand-mass-10
longer-10 longer-20 longer-50 longer-20-known longer-50-known
shorter-10 shorter-20 shorter-50 shorter-20-known shorter-50-known
locked-1 locked-2 locked-3 locked-1-known locked-2-known locked-3-known
locks-1 locks-2 locks-3 locks-2-known
joint-noise-0.01 joint-noise-0.02 joint-noise-0.05
joint-noise-speed-0.01 joint-noise-speed-0.03
vision-noise-0.01 vision-noise-0.03 vision-noise-0.1
vision-noise-distance-0.05 vision-noise-distance-0.15
delay-20 delay-40 delay-100 delay-200 delay-400
obstacles-1 obstacles-2 obstacles-4
gravity-10 gravity-60 gravity-120
"""
SCENARIOS: dict[str, Scenario] = {
    name: parse_scenario(name) for name in (*TASKS, *_PERTURBED.split())
}
"""The scenarios of the benchmark by name: every task, and perturbations in a few strengths."""

_FAULTS = """
random
motor-gain-0.7 motor-gain-0.4 motor-gain-0.2 motor-gain--1-of-3
motor-gain-0.4-of-1 motor-gain-0.4-of-2
motor-offset-0.1-of-2 motor-offset-0.2-of-2 motor-offset-0.3-of-2
dead-zone-0.05 dead-zone-0.1 dead-zone-0.3
backlash-0.05 backlash-0.1 backlash-0.3
action-noise-0.1 action-noise-0.3 action-noise-0.5
action-noise-size-0.1 action-noise-size-0.2 action-noise-size-0.5
action-delay-20 action-delay-60 action-delay-160
dropped-actions-0.1 dropped-actions-0.3 dropped-actions-0.5
held-actions-0.1 held-actions-0.3 held-actions-0.5
repeated-actions-0.3 repeated-actions-0.6 repeated-actions-0.9
stuck-motor-1 stuck-motor-2 stuck-motor-3
torque-limit-0.1 torque-limit-0.03 torque-limit-0.01
servo-gain-0.8 servo-gain-0.5 servo-gain-0.3
sensor-offset-0.05-of-2 sensor-offset-0.15-of-2 sensor-offset-0.3-of-2
sensor-drift-0.1-of-2 sensor-drift-0.2-of-2 sensor-drift-0.4-of-2
stuck-sensor-1 stuck-sensor-2 stuck-sensor-3
encoder-256 encoder-64 encoder-16
observation-noise-0.01 observation-noise-0.03 observation-noise-0.1
dropped-numbers-0.01 dropped-numbers-0.05 dropped-numbers-0.1
held-numbers-0.1 held-numbers-0.3 held-numbers-0.7
repeated-observations-0.3 repeated-observations-0.6 repeated-observations-0.9
cursor-shift-0.1 cursor-shift-0.2 cursor-shift-0.4
base-turn-10 base-turn-20 base-turn-40
segment-mass-2 segment-mass-4 segment-mass-8
joint-friction-0.3 joint-friction-0.6 joint-friction-0.9
joint-damping-0.3 joint-damping-0.6 joint-damping-0.9
"""
SUITES: dict[str, tuple[str, ...]] = {
    "standard": tuple(SCENARIOS),
    "faults": tuple(_FAULTS.split()),
    "realworld": ("random", *CHALLENGES),
}
"""Names of scenarios that are played together: `SCENARIOS`; motors and senses that fail, in a few
strengths each; and the combined challenges of the Real-World RL suite."""

SET_BY_SCENARIOS = ("task", "perturbations", "max_episode_steps")
"""Arguments of environments that scenarios and experiments set, so that users may not."""

TOGETHER = 1_000  # most episodes played at once, to bound memory

Environments: TypeAlias = "Iterable[str | Playable] | Mapping[str, EnvLike]"
"""Names of scenarios and of your own environments; or a mapping of names to environments."""


def find_scenarios(
    environments: Environments, env_kwargs: Mapping[str, Any] | None = None, interface: Any = None
) -> dict[str, Playable]:
    """Return the scenarios and environments to play, by name; all `SCENARIOS` if none are given.

    Args:
        environments: names, see `mmc_gym.envs.scenarios.find_scenario`; or a mapping of names to
            your own environments.
        env_kwargs: keyword arguments of all environments.
        interface: the interface of your own environments, see `InterfacedEnv`.
    """
    scenarios: list[Playable]
    if isinstance(environments, Mapping):
        scenarios = [OwnEnvironment(name, env) for name, env in environments.items()]
    else:
        names = [environments] if isinstance(environments, str) else environments
        scenarios = [find_scenario(name) for name in names]
    scenarios = scenarios or [*SCENARIOS.values()]
    refuse_interface(interface, *scenarios)
    arguments = require_arguments("env_kwargs", env_kwargs)
    by_name: dict[str, Playable] = {}
    for scenario in scenarios:
        if isinstance(scenario, OwnEnvironment):
            scenario = replace(scenario, interface=interface)
            scenario = scenario.with_arguments(**arguments).inspected()
        else:
            scenario.refuse(arguments, *SET_BY_SCENARIOS)
            scenario = scenario.with_arguments(**arguments)
        by_name[scenario.name] = scenario
    return by_name


def make_player(agent: ResolvedAgent, scenario: Playable) -> tuple[gym.Env[Any, Any], Predictor]:
    """Make the environment in an agent's control mode, and the agent for it.

    Issue a `MismatchWarning` if the control mode of a stable-baselines3 model is not known.
    `control` in `scenario.arguments` sets the mode of agents that support several control modes, or
    whose control mode is not known.

    Raises:
        CannotActError: if the agent cannot act in the environment.
    """
    control = agent.own_control or scenario.arguments.get("control")
    scenario = scenario.with_arguments(**agent.arguments)
    env = agent.wrapped(scenario.make(control or agent.control))
    check_environment(env)
    try:
        player = agent.factory(env)
    except ControlError as refusal:
        env.close()
        env = agent.wrapped(scenario.make(refusal.control))
        player = agent.factory(env)
    if not control and isinstance(player, ModelAgent) and player.control is None:
        warn_of_mismatch(
            f"{agent.label} does not declare the control mode that it was trained in, and acts by "
            f"{read_attribute(env, 'control')}, the environment's default; --env-kwargs "
            "control=... gives another (in Python: env_kwargs)"
        )
    return env, player


class Arms:
    """The vector environments of a scenario, made when needed and used by agents in turn."""

    def __init__(self, scenario: Playable) -> None:
        self._scenario = scenario
        self._vectors: dict[tuple[int, str | None, str], MMCReachVectorEnv] = {}

    def vector(self, count: int, control: str | None, context: Any) -> MMCReachVectorEnv | None:
        """Return this package's vector environment of `count` arms; None if it has none."""
        key = count, control, repr(context)
        if key not in self._vectors:
            more = {"observe_context": context} if context else {}
            vector = self._scenario.with_arguments(**more).make_vec(count, control)
            if isinstance(vector, MMCReachVectorEnv):
                self._vectors[key] = vector
            elif vector is not None:
                vector.close()
        return self._vectors.get(key)

    def close(self) -> None:
        """Close all vector environments."""
        while self._vectors:
            self._vectors.popitem()[1].close()


def play_episodes(
    arms: Arms,
    env: gym.Env[Any, Any],
    player: Predictor,
    seeds: Sequence[int],
    options: Sequence[Options] = (),
    *,
    on_episode: Callable[[Episode], None] | None = None,
) -> tuple[Episode, ...]:
    """Let an agent play one episode per seed, all together or one by one; return the episodes.

    An `Agent` plays all together if `arms` has a vector environment; other objects with `predict`
    may not take batches, and play one by one.  For `env` and `player` see `make_player`, for the
    rest `run_episodes`.
    """
    options = options or [{}] * len(seeds)
    chunks = [slice(first, first + TOGETHER) for first in range(0, len(seeds), TOGETHER)]
    vectors: list[MMCReachVectorEnv | None] = [None]
    if isinstance(player, Agent) and not (env.spec and env.spec.additional_wrappers):
        facts = read_attribute(env, "control"), read_attribute(env, "context_scale")
        vectors = [arms.vector(len(seeds[chunk]), *facts) for chunk in chunks]
    if None in vectors:
        return run_episodes(player, env, seeds, on_episode, options)
    episodes: list[Episode] = []
    for chunk, vector in zip(chunks, vectors, strict=True):
        assert vector is not None
        episodes += run_episodes(player, vector, seeds[chunk], on_episode, options[chunk])
    return tuple(episodes)


# The ideal hand: a reference for all movements that follows minimum jerk, without an arm.
#
#     x(t) = x₀ + (g − x₀) (10 τ³ − 15 τ⁴ + 6 τ⁵),     τ = t/T,     T = T₀ + d/v̄
#
# from the start x₀ to the target g at the distance d, and then rest.  T is that of the agents that
# plan (`mmc_gym.agents.planners`: 0.2 s and a second for each 4 segment lengths), so that they
# differ from it in shape alone.  If the target moves, the hand continues from its present state
# with the rest of a minimum-jerk movement, as they do.  Measures that need an arm are NaN.


def has_reference(env: gym.Env[Any, Any]) -> bool:
    """Return whether the ideal hand can play in `env`: with timed targets and a success distance.

    Via points advance when they are reached, at other times for each hand.  If the success distance
    is NaN, only the environment knows what success is.
    """
    if math.isnan(getattr(env.unwrapped, "success_distance", 0.0)):
        return False
    setup = getattr(env.unwrapped, "setup", None)
    return getattr(getattr(setup, "task", None), "advance", "time") == "time"


def minimum_jerk_episodes(episodes: Sequence[Episode]) -> tuple[Episode, ...]:
    """Return the ideal hand's episodes for the starts and targets of any agent's `episodes`.

    Each is as long as the given one, with N = 0 joints, and NaN as rewards and action times.
    """
    if not episodes:
        return ()
    longest = max(len(episode.targets) for episode in episodes)
    padded = [
        np.pad(episode.targets, ((0, longest - len(episode.targets)), (0, 0)), mode="edge")
        for episode in episodes
    ]
    targets = np.stack(padded, axis=1)
    starts = np.stack([episode.seen_hands[0] for episode in episodes])
    plan = HandPlan(starts, np.zeros_like(starts), np.zeros_like(starts))
    control_step = episodes[0].control_step
    movement = begin_movement(starts, targets[0], control_step)
    positions: list[Floats] = [starts]  # one array per time, (episodes, 2)
    for target in targets[:-1]:
        movement = follow_target(movement, plan.position, target, control_step)
        plan = minimum_jerk_step(plan, movement.target, movement.remaining)
        movement = one_step_later(movement)
        positions.append(np.asarray(plan.position, dtype=np.float64))
    ideal = []
    for episode, path in zip(episodes, np.stack(positions, axis=1), strict=True):
        hands, no_joints = path[: len(episode.hands)], np.zeros((len(episode.hands), 0))
        unknown = np.full(len(episode.rewards), np.nan)
        ideal.append(
            replace(
                episode,
                hands=hands,
                cursors=None,
                distances=np.linalg.norm(hands - episode.targets, axis=-1),
                joint_angles=no_joints,
                servo_impulses=no_joints[1:],
                servo_work=no_joints[1:],
                rewards=unknown,
                action_times=unknown,
            )
        )
    return tuple(ideal)
