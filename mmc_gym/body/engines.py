"""The two engines that simulate arms, by name, and what an arm of either can do.

`pymunk` is Chipmunk's constraint solver, and the default.  `analytic` integrates the equations of
motion of the chain, compiled by numba: for millions of episodes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Literal, Protocol, get_args

import numpy as np
from numpy.typing import NDArray

from mmc_gym.body.parameters import ArmParameters, Servo, require

Engine = Literal["pymunk", "analytic"]
Floats = NDArray[np.float64]


class SingleArm(Protocol):
    """One arm; see `mmc_gym.body.Arm`."""

    segment_angles: list[float]
    joint_angles: list[float]
    joint_velocities: list[float]
    end_effector: tuple[float, float]
    command: Callable[[Sequence[float]], None]
    records_effort: bool
    servo_impulses: list[float]
    servo_work: list[float]

    def step(self) -> None:
        """Simulate one control step."""

    def reset(
        self, joint_angles: Sequence[float], joint_velocities: Sequence[float] | None = None
    ) -> None:
        """Place the arm."""

    def lock(self) -> None:
        """Make the lockable joints rigid where they are, until the next reset."""

    def pivot_gap(self) -> float:
        """Largest distance between ends that should be together."""


class ArmBatch(Protocol):
    """Many equal arms that know nothing of each other; see `mmc_gym.body.Arms`."""

    segment_angles: Floats
    joint_angles: Floats
    joint_velocities: Floats
    end_effectors: Floats
    records_effort: bool
    servo_impulses: Floats
    servo_work: Floats

    def command(self, values: Floats) -> None:
        """Hand values (n, N) to the servos."""

    def step(self) -> None:
        """Simulate one control step."""

    def reset(
        self,
        joint_angles: Floats,
        arms: NDArray[np.intp] | None = None,
        joint_velocities: Floats | None = None,
    ) -> None:
        """Place the arms of the given indices, or all."""

    def lock(self, arms: NDArray[np.intp]) -> None:
        """Make the lockable joints of these arms rigid where they are."""

    def close(self) -> None:
        """End the threads."""


def make_arm(engine: Engine, parameters: ArmParameters, servo: Servo) -> SingleArm:
    """An arm of the engine called `engine`.

    Raises:
        ValueError: for an unknown engine, or what it cannot simulate.
        ImportError: if the engine needs numba and it is not installed.
    """
    require(engine in get_args(Engine), "engine", engine, f"one of {get_args(Engine)}")
    if engine == "analytic":
        from mmc_gym.body.analytic.arms import AnalyticArm

        return AnalyticArm(parameters, servo)
    from mmc_gym.body.pymunk.arm import Arm

    return Arm(parameters, servo)


def make_arms(
    engine: Engine, parameters: ArmParameters, count: int, servo: Servo, threads: int = 1
) -> ArmBatch:
    """`count` arms of the engine called `engine`, stepped by `threads` threads.

    Raises:
        ValueError: for an unknown engine, or what it cannot simulate.
        ImportError: if the engine needs numba and it is not installed.
    """
    require(engine in get_args(Engine), "engine", engine, f"one of {get_args(Engine)}")
    if engine == "analytic":
        from mmc_gym.body.analytic.arms import AnalyticArms

        return AnalyticArms(parameters, count, servo, threads)
    from mmc_gym.body.pymunk.batch import Arms

    return Arms(parameters, count, servo, threads)
