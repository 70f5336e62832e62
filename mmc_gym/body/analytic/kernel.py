"""Blocks of arms side by side in lanes: the records that hold them, placing and commanding them.

Compiled functions that are called from Python are `compiled`, those that they call are `inner`.
numba keeps the former between processes, until their own file changes: after a change in a file
that they call into, delete its `__pycache__`.
"""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from mmc_gym.body.parameters import ArmParameters, Servo
from mmc_gym.body.pymunk.solver import segment_inertia

LANES = 32  # arms in a block
_STOP_RATE = -60 * math.log(0.9)  # a stop corrects 10 % of its error in 1/60 s, pymunk's default


def _lanes(*names: str) -> np.dtype[np.void]:
    return np.dtype([(name, np.float64, (LANES,)) for name in names])


# What an arm remembers, per segment and the joint before it: `lag` is the part of the velocity of
# u_j that closes the pivots; `asked` is what the servo is to do, with at most the impulse `limit`;
# `held` is the angle of a locked joint, or nan.
STATE = _lanes("angle", "speed", "lag_x", "lag_y", "asked", "limit", "held")
# What one physics step works with.
WORK = _lanes(
    "sine",
    "cosine",
    "free_x",
    "free_y",
    "wanted",
    "turn",
    "lowest",
    "highest",
    "stop_above",
    "stop_below",
    "load_x",
    "load_y",
    "needed",
    "bound",
    "moment_x",
    "moment_y",
    "inertia",
    "right",
    "inverse",
    "excess",
)
SUMS = _lanes("x", "y", "turn", "angle", "changed")
RODS = np.dtype(
    [
        (name, np.float64)
        for name in ("length", "mass", "centre", "inertia", "lowest_angle", "highest_angle")
    ]
)
WORLD = np.dtype(
    [
        (name, np.float64)
        for name in (
            "substep",
            "speed_limit",
            "torque_limit",
            "gain",
            "stop_gain",
            "is_position",
            "is_torque",
        )
    ]
    + [("gravity", np.float64, (2,)), ("field", np.float64, (2, 2))]
)


def make_rods(parameters: ArmParameters) -> NDArray[np.void]:
    """One record per segment, with the joint before it."""
    count = len(parameters.segment_lengths)
    rods = np.zeros(count, RODS)
    rods["length"] = parameters.segment_lengths
    inertias = [segment_inertia(parameters, index) for index in range(count)]
    for name, values in zip(("mass", "centre", "inertia"), zip(*inertias)):
        rods[name] = values
    limits = parameters.joint_limits or ((-math.inf, math.inf),) * count
    rods["lowest_angle"], rods["highest_angle"] = zip(*limits)
    return rods


def make_world(parameters: ArmParameters, servo: Servo) -> NDArray[np.void]:
    """One record of what is common to all segments."""
    world, substep = np.zeros(1, WORLD), parameters.substep
    world["substep"] = substep
    world["speed_limit"] = parameters.speed_limit
    world["torque_limit"] = parameters.torque_limit
    world["gain"] = -math.expm1(-parameters.servo_gain * substep) / substep
    world["stop_gain"] = -math.expm1(-_STOP_RATE * substep) / substep
    world["is_position"] = servo == "position"
    world["is_torque"] = servo == "torque"
    world["gravity"] = parameters.gravity
    if parameters.force_field is not None:
        world["field"] = parameters.force_field
    return world


def compiled(function: Any) -> Any:
    """Compile at the first call in any process, and keep the result for the next ones."""
    try:
        return numba.njit(cache=True, nogil=True, error_model="numpy")(function)
    except RuntimeError:  # there is nowhere to write the cache
        return numba.njit(nogil=True, error_model="numpy")(function)


def inner(function: Any) -> Any:
    """Compile for those that call it."""
    return numba.njit(nogil=True, error_model="numpy")(function)


@inner
def sine_cosine(angle):  # type: ignore[no-untyped-def]
    """Sine and cosine to an ulp or so, in arithmetic alone: the same in every lane.

    The polynomials and the three parts of π/2 are those of fdlibm (Sun Microsystems, 1993), good
    for angles up to 1e6.
    """
    quarter = np.floor(angle * 0.6366197723675814 + 0.5)
    x = angle - quarter * 1.57079632673412561417
    x = (x - quarter * 6.07710050630396597660e-11) - quarter * 2.02226624879595063154e-21
    z = x * x
    s = -2.50507602534068634195e-08 + z * 1.58969099521155010221e-10
    s = 2.75573137070700676789e-06 + z * s
    s = -1.98412698298579493134e-04 + z * s
    s = 8.33333333332248946124e-03 + z * s
    s = -1.66666666666666324348e-01 + z * s
    s = x + x * z * s
    c = 2.08757232129817482790e-09 + z * -1.13596475577881948265e-11
    c = -2.75573143513906633035e-07 + z * c
    c = 2.48015872894767294178e-05 + z * c
    c = -1.38888888888741095749e-03 + z * c
    c = 4.16666666666666019037e-02 + z * c
    c = (1.0 - 0.5 * z) + z * z * c
    quarter -= 4.0 * np.floor(0.25 * quarter)
    odd = quarter - 2.0 * np.floor(0.5 * quarter) > 0.5
    sine = c if odd else s
    cosine = s if odd else c
    sine = -sine if quarter > 1.5 else sine
    cosine = -cosine if abs(quarter - 1.5) < 1.0 else cosine
    return sine, cosine


@inner
def any_lane(counts, lanes):  # type: ignore[no-untyped-def]
    """Tell whether a count is above zero in any lane."""
    total = 0.0
    for k in range(lanes):
        total += counts[k]
    return total > 0.0


@compiled
def place(state, output, rods, world, chosen, postures, speeds):  # type: ignore[no-untyped-def]
    """Put arms where they are asked to be; servos hold the posture, the speed 0 or no torque."""
    segments = rods.shape[0]
    count = output.shape[0] // (3 * segments + 2)
    size = count * segments
    is_position, is_torque = world[0].is_position > 0.0, world[0].is_torque > 0.0
    for row in range(chosen.shape[0]):
        arm = chosen[row]
        block, k = arm // LANES, arm % LANES
        angle = speed = x = y = parent_angle = parent_speed = 0.0
        for i in range(segments):
            a = state[block, i]
            angle += postures[row, i]
            speed += speeds[row, i]
            a.angle[k] = angle
            a.speed[k] = speed
            a.lag_x[k] = 0.0
            a.lag_y[k] = 0.0
            a.held[k] = np.nan
            a.limit[k] = 0.0 if is_torque else world[0].substep * world[0].torque_limit
            a.asked[k] = postures[row, i] if is_position else 0.0
            if is_position:
                a.asked[k] = angle - parent_angle
                if np.isfinite(rods[i].lowest_angle):
                    a.asked[k] = min(
                        max(postures[row, i], rods[i].lowest_angle), rods[i].highest_angle
                    )
            sine, cosine = sine_cosine(angle)
            x += rods[i].length * cosine
            y += rods[i].length * sine
            at = arm * segments + i
            output[at] = angle
            output[size + at] = angle - parent_angle
            output[2 * size + at] = speed - parent_speed
            parent_angle, parent_speed = angle, speed
        output[3 * size + 2 * arm] = x
        output[3 * size + 2 * arm + 1] = y


@compiled
def command(state, output, rods, world, values):  # type: ignore[no-untyped-def]
    """Hand one value per joint and arm to the servos."""
    segments = rods.shape[0]
    count = values.shape[0]
    size = count * segments
    w = world[0]
    for arm in range(count):
        block, k = arm // LANES, arm % LANES
        for i in range(segments):
            a = state[block, i]
            value = values[arm, i]
            if w.is_torque > 0.0:
                a.asked[k] = w.speed_limit if value >= 0.0 else -w.speed_limit
                a.limit[k] = w.substep * min(abs(value), w.torque_limit)
            elif w.is_position > 0.0:
                if np.isfinite(rods[i].lowest_angle):
                    a.asked[k] = min(max(value, rods[i].lowest_angle), rods[i].highest_angle)
                else:
                    angle = output[size + arm * segments + i]
                    way = value - angle
                    turns = np.rint(way / (2.0 * np.pi))
                    a.asked[k] = angle + (way - turns * (2.0 * np.pi))
            else:
                a.asked[k] = value
