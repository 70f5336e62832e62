"""The engines that simulate arms, by name.

`pymunk` is Chipmunk's constraint solver, and the default.  `analytic` integrates the equations of
motion of the chain, compiled by numba, for millions of episodes.
"""

from __future__ import annotations

from typing import Literal, get_args

from mmc_gym._errors import require_choice
from mmc_gym.body.base import ArmBatch, SingleArm
from mmc_gym.body.parameters import ArmParameters, Servo
from mmc_gym.body.pymunk.arm import Arm
from mmc_gym.body.pymunk.batch import Arms

Engine = Literal["pymunk", "analytic"]


def make_arm(engine: Engine, parameters: ArmParameters, servo: Servo) -> SingleArm:
    """Build an arm of the engine called `engine`.

    Raises:
        UserError: for an unknown engine, or what it cannot simulate.
        MissingExtraError: if the engine needs numba and it is not installed.
    """
    single, _ = _classes(engine)
    return single(parameters, servo)


def make_arms(
    engine: Engine, parameters: ArmParameters, count: int, servo: Servo, threads: int = 1
) -> ArmBatch:
    """Build `count` arms, stepped by `threads` threads; it raises what `make_arm` raises."""
    _, batch = _classes(engine)
    return batch(parameters, count, servo, threads)


def _classes(engine: Engine) -> tuple[type[SingleArm], type[ArmBatch]]:
    require_choice("engine", engine, get_args(Engine))
    if engine == "analytic":
        from mmc_gym.body.analytic.arms import AnalyticArm, AnalyticArms  # needs numba

        return AnalyticArm, AnalyticArms
    return Arm, Arms
