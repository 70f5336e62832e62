"""Facts about the arms of the analytic engine."""

import copy
import math
import pickle
import subprocess
import sys

import numpy as np
import pytest

from mmc_gym._errors import UserError
from mmc_gym.body import ArmParameters
from mmc_gym.body.analytic.arms import AnalyticArm, AnalyticArmBatch


def scale(parameters, servo):
    return {"position": math.pi, "velocity": parameters.speed_limit, "torque": 45.0}[servo]


# The laws of motion, held against an independent account of one step


class Bookkeeping:
    """The rods of one arm as bodies: what torques must have acted to move it as it moved?"""

    def __init__(self, parameters):
        lengths, count = parameters.segment_lengths, len(parameters.segment_lengths)
        self.step = parameters.substep
        self.masses, self.inertias = np.array(parameters.masses), np.zeros(count)
        self.inertias[:] = [rod.inertia for rod in parameters.rods]
        self.levers = np.tril(np.tile(lengths, (count, 1)), -1) + np.diag(lengths) / 2
        self.gravity = np.array(parameters.gravity)

    def start(self, angles, speeds):
        self.speeds = speeds
        self.positions = self.levers @ self.along(angles)
        self.velocities = self.levers @ (speeds[:, None] * self.across(angles))

    @staticmethod
    def along(angles):
        return np.stack([np.cos(angles), np.sin(angles)], axis=-1)

    @staticmethod
    def across(angles):
        return np.stack([-np.sin(angles), np.cos(angles)], axis=-1)

    def torques(self, angles, speeds):
        """Joint torques of the step that ended so."""
        straight_on = self.positions + self.step * self.velocities
        self.positions = straight_on
        gaps = (self.levers @ self.along(angles) - straight_on) / self.step
        velocities = self.levers @ (speeds[:, None] * self.across(angles)) + gaps
        pushes = velocities - self.velocities - self.step * self.gravity
        forces = self.levers.T @ (self.masses[:, None] * pushes)
        moments = np.sum(self.across(angles) * forces, axis=-1)
        moments += self.inertias * (speeds - self.speeds)
        self.velocities, self.speeds = velocities, speeds
        return np.cumsum(moments[::-1])[::-1] / self.step


@pytest.mark.parametrize("count", [1, 3, 5, pytest.param(12, marks=pytest.mark.slow)])
def test_every_torque_is_the_one_that_gives_the_asked_speed_or_the_largest(servo, count, postures):
    """And all momentum is accounted for: gravity and these torques alone move the rods."""
    random = np.random.default_rng(count)
    parameters = ArmParameters(
        segment_lengths=tuple(random.uniform(0.5, 1.5, count).tolist()),
        segment_masses=tuple(random.uniform(0.5, 1.5, count).tolist()),
        gravity=(1.0, -9.81),
        torque_limit=60.0,
        substeps=1,
    )
    arm, books, bound, free = AnalyticArm(parameters, servo), Bookkeeping(parameters), 0, 0
    fade = -math.expm1(-parameters.servo_gain * parameters.substep) / parameters.substep
    for _ in range(2):
        arm.reset(
            postures(parameters, random, 1)[0].tolist(), random.uniform(-3, 3, count).tolist()
        )
        books.start(np.array(arm.segment_angles), np.cumsum(arm.joint_velocities))
        for step in range(100):
            if step % 20 == 0:
                values = random.uniform(-1, 1, count) * scale(parameters, servo)
                arm.command(values.tolist())
                targets = arm.joint_angles + np.remainder(
                    values - arm.joint_angles + np.pi, 2 * np.pi
                )
                targets -= np.pi
            arm.step()
            torques = books.torques(np.array(arm.segment_angles), np.cumsum(arm.joint_velocities))
            limits, asked = np.full(count, 60.0), values
            if servo == "position":
                asked = np.clip(
                    fade * (targets - arm.joint_angles),
                    -parameters.speed_limit,
                    parameters.speed_limit,
                )
            elif servo == "torque":
                limits, asked = np.abs(values), np.copysign(parameters.speed_limit, values)
            lack = asked - arm.joint_velocities
            assert np.all(np.abs(torques) <= limits * (1 + 1e-6) + 1e-6)
            at_limit = np.isclose(np.abs(torques), limits, rtol=1e-6, atol=1e-6)
            assert np.all(at_limit | (np.abs(lack) < 1e-9))
            assert np.all((torques * lack > -1e-6) | ~at_limit)
            bound, free = bound + at_limit.sum(), free + (~at_limit).sum()
    assert bound > 0
    assert free > 0


# Many arms


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda arms: pickle.loads(pickle.dumps(arms))])
def test_a_copy_of_many_arms_has_the_same_future(copied):
    random = np.random.default_rng(0)
    arms = AnalyticArmBatch(None, 520, threads=2)
    arms.command(random.uniform(-3, 3, (520, 3)))
    for _ in range(3):
        arms.step()
    other = copied(arms)
    assert isinstance(other, AnalyticArmBatch)
    for _ in range(10):
        for each in (arms, other):
            each.step()
    assert not np.shares_memory(arms.joint_angles, other.joint_angles)
    np.testing.assert_array_equal(arms.segment_angles, other.segment_angles)
    np.testing.assert_array_equal(arms.end_effectors, other.end_effectors)
    arms.close()
    other.close()


def test_angles_are_as_the_mathematical_library_has_them():
    angles = np.concatenate([np.linspace(-7, 7, 1001), np.linspace(-1e5, 1e5, 1001)])
    arms = AnalyticArmBatch(ArmParameters(segment_lengths=(1.0,)), len(angles))
    arms.reset(angles[:, None])
    np.testing.assert_allclose(arms.end_effectors[:, 0], np.cos(angles), atol=3e-16)
    np.testing.assert_allclose(arms.end_effectors[:, 1], np.sin(angles), atol=3e-16)


# What is refused


def test_obstacles_are_refused():
    with pytest.raises(UserError, match=r'obstacles must be empty .*engine="pymunk".* got \(\(1'):
        AnalyticArmBatch(ArmParameters(obstacles=((1.0, 1.0, 0.1),)))


def test_numba_is_imported_only_for_this_engine_and_its_absence_is_explained():
    program = """
import sys
import mmc_gym.body
assert "numba" not in sys.modules
sys.modules["numba"] = None
try:
    import mmc_gym.body.analytic.arms
except ImportError as error:
    print(error)
"""
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert run.stdout.strip().endswith('pip install "mmc-gym[fast]"'), run.stderr
