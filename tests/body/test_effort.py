"""Facts about the effort of the servos, which an arm records when it is asked to."""

import copy

import numpy as np
import pytest

from mmc_gym.body import Arm, ArmParameters, make_arm, make_arms

ROD = ArmParameters(segment_lengths=(1.0,), drive_inertia=0.0)  # 1/3 about the joint


def recording(arm):
    arm.records_effort = True
    return arm


def test_recording_changes_no_movement_and_is_copied(play):
    parameters = ArmParameters(force_field=((0.0, 3.0), (-3.0, 0.0)))
    alone, recorded = Arm(parameters), recording(Arm(parameters))
    assert play(recorded, "position", 0) == play(alone, "position", 0)
    assert np.isnan([*alone.servo_impulses, *alone.servo_work]).all()  # it was not asked for
    copied = copy.deepcopy(recorded)
    assert copied.servo_work == recorded.servo_work
    played = [play(arm, "position", 1) for arm in (copied, copy.deepcopy(alone), recorded)]
    assert played[0] == played[1] == played[2]
    assert copied.servo_work == recorded.servo_work and np.isfinite(copied.servo_work).all()


@pytest.mark.parametrize(("speed", "torque"), [(0.0, 2.0), (3.0, 5.0), (3.0, -5.0)])
def test_a_torque_has_its_impulse_and_its_work_is_kinetic_energy_gained_or_lost(speed, torque):
    arm = recording(Arm(ROD, servo="torque"))
    arm.reset([0.0], [speed])
    arm.command([torque])
    arm.step()
    reached = arm.joint_velocities[0]
    assert reached == pytest.approx(speed + torque / (1 / 3) * 0.02, rel=1e-3)
    assert arm.servo_impulses[0] == pytest.approx(abs(torque) * 0.02)
    assert arm.servo_work[0] == pytest.approx(0.5 / 3 * abs(reached**2 - speed**2), rel=0.01)


def test_the_analytic_engine_tells_no_effort():
    arm = recording(make_arm("analytic", ArmParameters(), "position"))
    arms = recording(make_arms("analytic", ArmParameters(), 2, "position"))
    for each in (arm, arms):
        each.step()
        assert np.isnan(each.servo_impulses).all() and np.isnan(each.servo_work).all()
    assert arms.servo_work.shape == (2, 3)
