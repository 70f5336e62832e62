from __future__ import annotations

import copy

import numpy as np
import pytest

from mmc_gym.body.engines import make_arm
from mmc_gym.body.parameters import ArmParameters
from mmc_gym.body.pymunk.arm import Arm, ServoWatch

ROD = ArmParameters(segment_lengths=(1.0,))  # its moment of inertia about the joint is 1/3


def play(arm, steps=40):
    for number in range(steps):
        arm.command([np.sin(0.1 * number), 0.5, -0.02 * number])
        arm.step()
    return arm.joint_angles


@pytest.mark.parametrize("field", [None, ((0.0, 3.0), (-3.0, 0.0))])
def test_a_watched_arm_moves_bit_for_bit_as_one_that_is_not(field):
    parameters = ArmParameters(force_field=field)
    alone, watched = Arm(parameters), Arm(parameters)
    with ServoWatch(watched, 3):
        assert play(watched) == play(alone)
        assert play(copy.deepcopy(watched)) == play(copy.deepcopy(alone))


def test_a_constant_torque_gives_torque_times_time_and_torque_times_angle():
    arm = Arm(ROD, servo="torque")
    impulses, work = [], []
    with ServoWatch(arm, 1) as watch:
        for _ in range(10):
            arm.command([2.0])
            arm.step()
            impulses.append(watch.impulses[0])
            work.append(watch.work[0])
    # A turn of ½ (τ/I) t², and the kinetic energy ½ I ω² of what the torque has made of rest.
    assert sum(impulses) == pytest.approx(2.0 * 0.2)
    assert arm.joint_velocities[0] == pytest.approx(2.0 / (1 / 3) * 0.2, rel=1e-4)
    assert sum(work) == pytest.approx(0.5 / 3 * arm.joint_velocities[0] ** 2, rel=1e-4)
    assert sum(work) == pytest.approx(2.0 * arm.joint_angles[0], rel=0.05)


def test_braking_is_work_too():
    arm = Arm(ROD, servo="torque")
    arm.reset([0.0], [3.0])
    with ServoWatch(arm, 1) as watch:
        arm.command([-5.0])
        arm.step()
    left = arm.joint_velocities[0]
    assert left == pytest.approx(3.0 - 5.0 / (1 / 3) * 0.02, rel=1e-3)
    assert watch.impulses[0] == pytest.approx(5.0 * 0.02)
    assert watch.work[0] == pytest.approx(0.5 / 3 * (3.0**2 - left**2), rel=0.01)


def test_an_arm_left_to_itself_costs_its_servos_nothing():
    arm = Arm(servo="torque")
    arm.reset([0.3, 0.4, 0.5], [1.0, -1.0, 2.0])
    with ServoWatch(arm, 3) as watch:
        arm.step()
    assert (watch.impulses == 0).all() and (watch.work == 0).all()


def test_after_the_watch_the_arm_steps_as_before_and_the_watch_stands_still():
    arm = Arm()
    with ServoWatch(arm, 3) as watch:
        play(arm, 3)
    last = watch.impulses
    play(arm, 3)
    assert watch.impulses is last
    assert arm.step == arm._step


def test_an_engine_that_does_not_tell_gives_no_numbers():
    arm = make_arm("analytic", ArmParameters(), "position")
    with ServoWatch(arm, 3) as watch:
        play(arm, 2)
    assert np.isnan(watch.impulses).all() and np.isnan(watch.work).all()
