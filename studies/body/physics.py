"""Measure whether success depends on the solver, and whether a curl force field does work.

    python -m studies.body.physics                       # all agents, 1,000 episodes a cell
    python -m studies.body.physics --agents mmc ppo sac

It prints three tables:

- The success of each agent in `MMCReach-v0` (training seed 0 of trained ones): by default; with a
  lock that never locks; on the exact engine; with physics steps half as long; and with twice as
  many solver sweeps.  The last rows give the time of a step, for one arm and for each of 256.
- The error of pymunk's joint angles after 2 s of random commands, compared with the exact engine,
  by inertia of the drives and number of sweeps.
- The energy of slack arms in a curl field, at several times.
"""

from __future__ import annotations

import timeit
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any
from unittest import mock

import gymnasium as gym
import numpy as np
import tyro
from rich.console import Console

from mmc_gym.agents.registry import AGENTS
from mmc_gym.body import make_arms
from mmc_gym.body.parameters import ArmParameters
from mmc_gym.body.pymunk import linkage
from mmc_gym.envs.perturbations import LockedJoint
from mmc_gym.measures.rollout import evaluate
from studies.tables import table_of

ENV = "MMCReach-v0"
SETTINGS: dict[str, dict[str, Any]] = {
    "default": {},
    "idle lock": {"perturbations": LockedJoint(1, time=1e3)},
    "exact engine": {"engine": "analytic"},
    "half the substep": {"substep": 0.0025, "substeps": 8},
    "twice the sweeps": {},
}
ARMS, SPREAD = 64, 0.5  # rad


@dataclass(frozen=True)
class Arguments:
    """Print the tables."""

    # names of agents; by default all but `random`
    agents: tuple[str, ...] = tuple(name for name in AGENTS if name != "random")
    episodes: int = 1000  # episodes of each agent in each setting
    steps: int = 4000  # timed steps of one arm, five times; 256 arms take a hundredth of them


@contextmanager
def sweeps(count: Callable[[int], int]) -> Any:
    """Make new arms use `count(n)` solver sweeps in place of n."""
    default = linkage.solver_iterations
    with mock.patch.object(linkage, "solver_iterations", lambda p: count(default(p))):
        yield


def solved(setting: str) -> Any:
    """Return the context in which environments of a setting are made."""
    return sweeps(lambda count: 2 * count if setting == "twice the sweeps" else count)


def success(name: str, setting: str, episodes: int) -> str:
    """Return the success of an agent in a setting, in per cent."""
    entry = AGENTS[name]
    with solved(setting):
        arguments = {**SETTINGS[setting], "control": entry.control or "joint_delta"}
        scores = evaluate(entry.build, ENV, arguments, episodes)
    return f"{100 * scores['success']:.1f}"


def step_times(setting: str, count: int) -> tuple[str, str]:
    """Return the time of a step in µs, for one arm and for each of 256."""
    with solved(setting):
        single = gym.make(ENV, max_episode_steps=10**9, **SETTINGS[setting])
        vector = gym.make_vec(ENV, 256, **SETTINGS[setting])
    times = []
    for env, arms, steps in ((single, 1, count), (vector, 256, max(count // 100, 1))):
        env.reset(seed=0)
        action = env.action_space.sample()
        best = min(timeit.repeat(lambda: env.step(action), number=steps, repeat=5))  # noqa: B023
        times.append(f"{1e6 * best / steps / arms:.1f}")
    return times[0], times[1]


def ends(engine: Any, p: ArmParameters) -> Any:
    """Return joint angles after 2 s of random commands, (ARMS, 3)."""
    random = np.random.default_rng(0)
    arms = make_arms(engine, p, ARMS, "position")
    arms.reset(random.uniform(-3, 3, (ARMS, 3)))
    for step in range(100):
        if step % 4 == 0:
            values = arms.joint_angles + random.normal(0, SPREAD, (ARMS, 3))
        arms.command(values)
        arms.step()
    return arms.joint_angles.copy()


def convergence(inertia: float, count: int) -> str:
    """Return the median and the largest error of the joint angles on pymunk, rad."""
    p = ArmParameters(drive_inertia=inertia)
    with sweeps(lambda _: count):
        errors = np.abs(ends("pymunk", p) - ends("analytic", p)).max(axis=-1)
    return f"{np.median(errors):.4f} / {errors.max():.3f}"


def energy(p: ArmParameters, arms: Any) -> Any:
    """Return the kinetic energy of each arm."""
    angles, speeds = arms.segment_angles, np.cumsum(arms.joint_velocities, axis=1)
    total, x, y = 0.0, 0.0, 0.0
    for joint, (rod, length) in enumerate(zip(p.rods, p.segment_lengths, strict=True)):
        cosine, sine, speed = np.cos(angles[:, joint]), np.sin(angles[:, joint]), speeds[:, joint]
        v, w = x - rod.centre * sine * speed, y + rod.centre * cosine * speed
        total = total + rod.mass * (v**2 + w**2) / 2 + rod.inertia * speed**2 / 2
        x, y = x - length * sine * speed, y + length * cosine * speed
    return total


def energies(engine: Any, curl: float, spread: float) -> dict[str, str]:
    """Return the energy divided by the initial one, by time: median and range over the arms."""
    p = ArmParameters(force_field=((0.0, curl), (-curl, 0.0)))
    random = np.random.default_rng(0)
    arms = make_arms(engine, p, ARMS, "torque")
    arms.reset(
        random.uniform(-2, 2, (ARMS, 3)), joint_velocities=random.normal(0, spread, (ARMS, 3))
    )
    start, row = energy(p, arms), {}
    arms.command(np.zeros((ARMS, 3)))
    for step in range(1, 101):
        arms.step()
        if step in (5, 25, 50, 100):
            share = energy(p, arms) / start
            row[f"{step / 50:g} s"] = (
                f"{np.median(share):.4f} ({share.min():.3f}-{share.max():.3f})"
            )
    return row


def main(arguments: Arguments) -> None:
    console = Console(width=120)
    rows = [
        {"agent": name} | {s: success(name, s, arguments.episodes) for s in SETTINGS}
        for name in arguments.agents
    ]
    times = {setting: step_times(setting, arguments.steps) for setting in SETTINGS}
    for row, label in enumerate(("a step, µs", "of 256 arms, µs an arm")):
        rows.append({"agent": label} | {setting: pair[row] for setting, pair in times.items()})
    console.print(table_of(rows, f"Success in {ENV}, % of {arguments.episodes} episodes"))
    rows = [
        {"drive inertia": f"{share:g}"}
        | {f"{count} sweeps": convergence(share, count) for count in (10, 20, 40, 60)}
        for share in (0.0, 0.1, 0.25, 0.5)
    ]
    console.print(table_of(rows, "Error after 2 s of random commands, rad: median / largest"))
    rows = [
        {"engine": engine, "curl": f"{curl:g}", "rad/s": f"{spread:g}"}
        | energies(engine, curl, spread)
        for curl in (60.0, 120.0)
        for spread in (0.05, 0.5, 2.0)
        for engine in ("pymunk", "analytic")
    ]
    console.print(table_of(rows, "Energy of slack arms in a field, over that at the start"))


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
