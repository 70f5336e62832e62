"""Which environments are timed, and how: data."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from contestants import OURS, PEER, Contestant, dm_control, envpool, single, vector


@dataclass(frozen=True)
class Entry:
    """One row of a table.

    Attributes:
        environment: its name.
        variant: what is particular about it.
        make: makes it.
        arms: how many there are.
        threads: how many threads, or processes, step them.
    """

    environment: str
    variant: str
    make: Callable[[], Contestant]
    arms: int = 1
    threads: int = 1


def _vector(environment: str, variant: str, arms: int, mode: str) -> Entry:
    threads = arms if mode == "async" else 1
    return Entry(environment, variant, partial(vector, environment, arms, mode), arms, threads)


def _envpool(arms: int, threads: int) -> Entry:
    return Entry(PEER, "EnvPool", partial(envpool, PEER, arms, threads), arms, threads)


def _native(variant: str, arms: int, threads: int, **arguments: str) -> Entry:
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
)

VECTOR = (
    _vector(PEER, "sync", 64, "sync"),
    _vector(PEER, "async", 64, "async"),
    _envpool(64, 1),
    _envpool(64, 2),
    _vector(OURS, "sync", 64, "sync"),
    _vector(OURS, "async", 64, "async"),
    *(_native("native", arms, threads) for arms in (64, 256) for threads in (1, 2)),
    *(_native("native, joint_torque", 256, n, control="joint_torque") for n in (1, 2)),
    *(
        _native("native, analytic", arms, threads, engine="analytic")
        for arms in (256, 4096)
        for threads in (1, 2)
    ),
)

ENGINES = ("pymunk", "analytic")

GROWTH = tuple(
    _native(engine, arms, threads, engine=engine)
    for engine in ENGINES
    for arms in (1, 16, 64, 256, 1024, 4096)
    for threads in (1, 2)
)

WHAT_THEY_SIMULATE = f"""\
Steps are those of all arms; resets are in the time.  What is simulated in a step of 0.02 s:
{PEER}, EnvPool: 2 joints, MuJoCo, 2 substeps of Runge-Kutta, 4th order; reset after 50 steps.
dm_control: 2 joints, MuJoCo, 1 substep of Euler, no contacts; reset after 1000 steps.
{OURS}: 3 joints with servos, 4 substeps of pymunk or of the analytic engine; reset after 100 steps.
MuJoCo works on the thread that calls it.  EnvPool and {OURS} have their own threads."""
