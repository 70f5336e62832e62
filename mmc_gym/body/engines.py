"""The engines that simulate arms, by name.

`pymunk` is Chipmunk's constraint solver, and the default.  `analytic` integrates the equations of
motion of the chain, compiled by numba, for millions of episodes.
"""

from __future__ import annotations

from typing import Literal, get_args

from mmc_gym._errors import require
from mmc_gym.body.base import ArmBatch, SingleArm
from mmc_gym.body.parameters import ArmParameters, Servo

Engine = Literal["pymunk", "analytic"]


def make_arm(engine: Engine, parameters: ArmParameters, servo: Servo) -> SingleArm:
    """Build an arm of the engine called `engine`.

    Raises:
        UserError: for an unknown engine, or what it cannot simulate.
        ImportError: if the engine needs numba and it is not installed.
    """
    _check(engine)
    if engine == "analytic":
        from mmc_gym.body.analytic.arms import AnalyticArm

        return AnalyticArm(parameters, servo)
    from mmc_gym.body.pymunk.arm import Arm

    return Arm(parameters, servo)


def make_arms(
    engine: Engine, parameters: ArmParameters, count: int, servo: Servo, threads: int = 1
) -> ArmBatch:
    """Build `count` arms of the engine called `engine`, stepped by `threads` threads.

    Raises:
        UserError: for an unknown engine, or what it cannot simulate.
        ImportError: if the engine needs numba and it is not installed.
    """
    _check(engine)
    if engine == "analytic":
        from mmc_gym.body.analytic.arms import AnalyticArms

        return AnalyticArms(parameters, count, servo, threads)
    from mmc_gym.body.pymunk.batch import Arms

    return Arms(parameters, count, servo, threads)


def _check(engine: Engine) -> None:
    require(engine in get_args(Engine), "engine", engine, f"one of {get_args(Engine)}")
