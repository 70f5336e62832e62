"""The simulated arm: bodies, joints and servos, without Gymnasium and without the network.

Two engines simulate it.  `pymunk`, the default, is Chipmunk's constraint solver.  `analytic`
integrates the equations of motion of the chain, compiled by numba, for millions of episodes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, get_args

from mmc_gym._errors import require_choice
from mmc_gym.body.base import ArmBatch, SingleArm
from mmc_gym.body.parameters import ArmParameters, Servo
from mmc_gym.body.pymunk.arm import PymunkArm
from mmc_gym.body.pymunk.batch import PymunkArmBatch

__all__ = [
    "ArmParameters",
    "Engine",
    "PymunkArm",
    "PymunkArmBatch",
    "Servo",
    "make_arm",
    "make_arms",
]

Engine = Literal["pymunk", "analytic"]


def make_arm(
    engine: Engine, parameters: ArmParameters | None = None, servo: Servo = "position"
) -> SingleArm:
    """Build an arm simulated by `engine`.

    Raises:
        MissingExtraError: if the engine needs numba and it is not installed.
    """
    single, _ = _classes(engine)
    return single(parameters, servo)


def make_arms(
    engine: Engine,
    parameters: ArmParameters | None = None,
    count: int = 1,
    servo: Servo = "position",
    threads: int = 1,
    others: Sequence[ArmParameters] = (),
) -> ArmBatch:
    """Build `count` equal arms, simulated by `engine` in `threads` threads; see `make_arm`.

    Only arms with `others` can be given other parameters at a reset, such as these.
    """
    _, batch = _classes(engine)
    return batch(parameters, count, servo, threads, others)


def _classes(engine: Engine) -> tuple[type[SingleArm], type[ArmBatch]]:
    require_choice("engine", engine, get_args(Engine))
    if engine == "analytic":
        from mmc_gym.body.analytic.arms import AnalyticArm, AnalyticArmBatch  # needs numba

        return AnalyticArm, AnalyticArmBatch
    return PymunkArm, PymunkArmBatch
