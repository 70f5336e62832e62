"""Arms of every make, and rough commands for them."""

import math
from typing import get_args

import numpy as np
import pytest

from mmc_gym.body import ArmParameters, Servo

LIMITS = ((-2.0, 2.5), (-2.5, 2.0), (0.1, 2.9))
FIELD = ((-1.0, 5.0), (-5.0, -1.0))
DISCS = ((1.2, 0.8, 0.2), (-0.5, -1.5, 0.4))
CONDITIONS = {
    "default": ArmParameters(),
    "one segment": ArmParameters(segment_lengths=(0.7,), gravity=(0.0, -9.81)),
    "limits, locks": ArmParameters(joint_limits=LIMITS, lockable_joints=(1, 2)),
    "field": ArmParameters(hand_mass=1.5, force_field=FIELD),
    "friction": ArmParameters(
        joint_friction=60.0,
        joint_damping=10.0,
        joint_limits=LIMITS,
        force_field=FIELD,
        lockable_joints=(1,),
    ),
    "everything": ArmParameters(
        segment_lengths=(1.5, 1.0, 0.4),
        segment_masses=(2.0, 0.5, 0.1),
        joint_limits=LIMITS,
        gravity=(3.0, -9.81),
        hand_mass=0.5,
        force_field=FIELD,
        lockable_joints=(0, 2),
    ),
    "obstacles": ArmParameters(obstacles=DISCS),
    "obstacles, field": ArmParameters(obstacles=DISCS, force_field=FIELD),
}
FREE = {name: parameters for name, parameters in CONDITIONS.items() if not parameters.obstacles}
CASES = {f"pymunk: {name}": ("pymunk", parameters) for name, parameters in CONDITIONS.items()}
CASES |= {f"analytic: {name}": ("analytic", parameters) for name, parameters in FREE.items()}


@pytest.fixture(scope="session", params=get_args(Servo))
def servo(request):
    return request.param


@pytest.fixture(scope="session", params=CASES.values(), ids=CASES.keys())
def case(request):
    """An engine and parameters that it can simulate."""
    return request.param


@pytest.fixture(scope="session", params=CONDITIONS.values(), ids=CONDITIONS.keys())
def parameters(request):
    return request.param


def largest_command(parameters, servo):
    """Return the largest command that makes sense."""
    limits = {"position": math.pi, "velocity": parameters.speed_limit}
    return limits.get(servo, parameters.torque_limit)


def draw_postures(parameters, random, count):
    """Draw postures that an arm may have, (count, N)."""
    any_angle = ((-math.pi, math.pi),) * len(parameters.segment_lengths)
    low, high = np.transpose(parameters.joint_limits or any_angle)
    return random.uniform(low, high, (count, len(low)))


def play(arm, servo, seed, steps=40):
    """Step an arm under rough commands, each held for some steps; joints are locked half way.

    Returns everything that can be read after each step.
    """
    random, states = np.random.default_rng(seed), []
    largest = largest_command(arm.parameters, servo)
    for step in range(steps):
        if step == steps // 2:
            arm.lock()
        if random.random() < 0.3:
            arm.command((largest * random.uniform(-1, 1, len(arm.joint_angles))).tolist())
        arm.step()
        angles = *arm.segment_angles, *arm.joint_angles
        states.append((*angles, *arm.joint_velocities, *arm.end_effector))
    return states
