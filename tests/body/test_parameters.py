"""Facts about the physical parameters of arms."""

import math
from dataclasses import replace

import numpy as np
import pytest

from mmc_gym._errors import UserError
from mmc_gym.body import ArmParameters


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"segment_lengths": ()}, r"segment_lengths must be .* one or more, got \(\)"),
        ({"segment_lengths": (1.0, -0.5)}, r"segment_lengths must be positive .*, got \(1.0, -0.5"),
        ({"segment_lengths": np.ones((1, 2))}, "segment_lengths must be .*, got array"),
        ({"segment_masses": (1.0, 1.0)}, r"segment_masses must be 3 .* masses.* got \(1.0, 1.0\)"),
        ({"speed_limit": 0.0}, "speed_limit must be positive and finite, got 0.0"),
        ({"substeps": 0}, "substeps must be a whole number of at least 1, got 0"),
        ({"gravity": 9.81}, r"gravity must be two finite values \(x, y\), got 9.81"),
        ({"joint_limits": ((1.0, -1.0),) * 3}, "joint_limits must be 3 pairs low < high"),
        ({"joint_limits": ((-4.0, 1.0),) * 3}, "joint_limits must be .* within -pi and pi"),
        ({"drive_inertia": math.inf}, "drive_inertia must be finite and not negative, got inf"),
        ({"force_field": ((1.0, 0.0),)}, "force_field must be two rows of two finite values"),
        ({"obstacles": ((0.0, 1.0, 0.0),)}, "obstacles must be discs .*of positive radius"),
        ({"lockable_joints": (3,)}, "lockable_joints must be .*different indices from 0 to 2"),
        ({"substep": 5e-324}, "substep must be from 1e-09 to"),
        ({"substep": 10**400}, "substep must be positive and finite"),
        ({"substeps": 10**18}, "substeps must be at most 10000, got 1000000000"),
        ({"hand_mass": 1e20}, r"hand_mass must be from 0 to 1e\+09, got 1e\+20"),
        ({"segment_masses": (1.0, 1.0, 1e-300)}, "segment_masses must be .* masses from 1e-09 to"),
        ({"gravity": (0.0, 1e300)}, "gravity must be at most"),
        ({"segment_length": (1.0,)}, "'segment_length'; did you mean 'segment_lengths'"),
    ],
)
def test_impossible_arms_are_refused(arguments, message):
    with pytest.raises(UserError, match=message):
        ArmParameters(**arguments)


def test_parameters_are_floats_whatever_they_were_given_as():
    parameters = ArmParameters(segment_lengths=np.array([2, 1]), segment_masses=[1, 2])
    assert parameters.segment_lengths == (2.0, 1.0)
    assert parameters.masses == (1.0, 2.0)
    assert ArmParameters().masses == (1.0, 1.0, 1.0)
    assert ArmParameters(torque_limit=400).torque_limit.hex() == (400.0).hex()
    assert ArmParameters(substep=0.01, substeps=np.int64(3)).control_step == pytest.approx(0.03)


@pytest.mark.parametrize(
    ("arm", "torque_limit"),
    [
        ({}, 500.0),
        ({"drive_inertia": 0.0, "hand_mass": 3.0}, 500.0),
        ({"segment_lengths": (1.0,) * 6}, 500.0 * 2**3),
        ({"segment_lengths": (0.1,) * 3}, 500.0),
        ({"segment_masses": (4.0,) * 3}, 500.0),
        ({"segment_lengths": (1.0,) * 6, "torque_limit": 500}, 500.0),
    ],
)
def test_servos_of_default_masses_are_as_much_stronger_as_the_arm_is_heavier(arm, torque_limit):
    made = ArmParameters(**arm)
    assert made.torque_limit == pytest.approx(torque_limit, rel=1e-12)
    longer = replace(made, segment_lengths=(2.0, 1.0), segment_masses=None)
    assert longer.torque_limit == made.torque_limit
    assert ArmParameters().torque_limit == 500.0
