"""Facts about the effort of the servos, which an arm records when it is asked to."""

from __future__ import annotations

import copy

import numpy as np
import pytest

from mmc_gym.body import Arm, ArmParameters, make_arm, make_arms

ROD = ArmParameters(segment_lengths=(1.0,), drive_inertia=0.0)  # 1/3 about the joint
FIELD = ArmParameters(force_field=((0.0, 3.0), (-3.0, 0.0)))


def recording(arm):
    arm.records_effort = True
    return arm


def play(arm, steps=40):
    for number in range(steps):
        arm.command([np.sin(0.1 * number), 0.5, -0.02 * number])
        arm.step()
    return arm.joint_angles


@pytest.mark.parametrize("parameters", [ArmParameters(), FIELD], ids=["free", "field"])
def test_recording_changes_no_movement_and_is_copied(parameters):
    alone, recorded = Arm(parameters), recording(Arm(parameters))
    assert play(recorded) == play(alone)
    copied = copy.deepcopy(recorded)
    assert copied.servo_work == recorded.servo_work
    assert play(copied) == play(copy.deepcopy(alone)) == play(recorded)
    assert copied.servo_work == recorded.servo_work and np.isfinite(copied.servo_work).all()


def test_a_constant_torque_gives_torque_times_time_and_torque_times_angle():
    arm = recording(Arm(ROD, servo="torque"))
    impulses, work = 0.0, 0.0
    for _ in range(10):
        arm.command([2.0])
        arm.step()
        impulses += arm.servo_impulses[0]
        work += arm.servo_work[0]
    # A turn of ½ (τ/I) t², and the kinetic energy ½ I ω² of what the torque has made of rest.
    assert impulses == pytest.approx(2.0 * 0.2)
    assert arm.joint_velocities[0] == pytest.approx(2.0 / (1 / 3) * 0.2, rel=1e-4)
    assert work == pytest.approx(0.5 / 3 * arm.joint_velocities[0] ** 2, rel=1e-4)
    assert work == pytest.approx(2.0 * arm.joint_angles[0], rel=0.05)


def test_braking_is_work_too():
    arm = recording(Arm(ROD, servo="torque"))
    arm.reset([0.0], [3.0])
    arm.command([-5.0])
    arm.step()
    left = arm.joint_velocities[0]
    assert left == pytest.approx(3.0 - 5.0 / (1 / 3) * 0.02, rel=1e-3)
    assert arm.servo_impulses[0] == pytest.approx(5.0 * 0.02)
    assert arm.servo_work[0] == pytest.approx(0.5 / 3 * (3.0**2 - left**2), rel=0.01)


def test_nothing_is_recorded_unless_it_is_asked_for():
    arm = Arm()
    play(arm, 3)
    assert np.isnan(arm.servo_impulses).all() and np.isnan(arm.servo_work).all()
    recording(arm)
    play(arm, 3)
    last = arm.servo_impulses
    arm.records_effort = False
    play(arm, 3)
    assert arm.servo_impulses is last


def test_the_analytic_engine_tells_no_effort():
    arm = recording(make_arm("analytic", ArmParameters(), "position"))
    arms = recording(make_arms("analytic", ArmParameters(), 2, "position"))
    play(arm, 2)
    arms.step()
    for effort in (arm.servo_impulses, arm.servo_work, arms.servo_impulses, arms.servo_work):
        assert np.isnan(effort).all()
    assert arms.servo_work.shape == (2, 3)
