"""Facts about the arms of the analytic engine."""

import copy
import math
import pickle
import subprocess
import sys
from itertools import pairwise

import numpy as np
import pytest

from mmc_gym._errors import UserError
from mmc_gym.body import Arm, ArmParameters
from mmc_gym.body.analytic.arms import AnalyticArm, AnalyticArmBatch


def scale(parameters, servo):
    return {"position": math.pi, "velocity": parameters.speed_limit, "torque": 45.0}[servo]


LIMITS = ((-2.0, 2.5), (-2.5, 2.0), (0.1, 2.9))
FIELD = ((-1.0, 5.0), (-5.0, -1.0))
QUICK = {("default", "position"), ("joint limits", "torque"), ("hand mass, field", "velocity")}


# Chipmunk agrees once it has solved the joints to the end

slow = pytest.mark.slow
CASES = {
    "default": {},
    "one segment": {"segment_lengths": (0.7,)},
    "joint limits": {"joint_limits": LIMITS},
    "gravity": {"gravity": (0.0, -9.81)},
    "hand mass, field": {"hand_mass": 1.5, "force_field": FIELD},
    "locks": {"lockable_joints": (1, 2)},
}


@pytest.mark.parametrize(
    ("made", "servo"),
    [
        pytest.param(
            made,
            servo,
            id=f"{name}, {servo}",
            marks=() if (name, servo) in QUICK else slow,
        )
        for name, made in CASES.items()
        for servo in ("position", "velocity", "torque")
    ],
)
def test_chipmunk_given_the_time_to_solve_moves_the_same(made, servo, postures):
    """The joint angles of both engines, over rough movements of 2 s."""
    p, random = ArmParameters(**made), np.random.default_rng(1)
    arms = Arm(p, servo), AnalyticArm(p, servo)
    arms[0]._space.iterations = 3000
    start = postures(p, random, 1)[0].tolist()
    for arm in arms:
        arm.reset(start)
    for step in range(100):
        if step % 25 == 0:
            values = random.uniform(-1, 1, len(start)) * scale(p, servo)
        for arm in arms:
            if step == 30:
                arm.lock()
            arm.command(values.tolist())
            arm.step()
        assert arms[0].joint_angles == pytest.approx(arms[1].joint_angles, abs=1e-6)


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


@pytest.mark.parametrize("count", [1, 3, 5, *(pytest.param(n, marks=slow) for n in (2, 12))])
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


def energy_and_momentum(arm):
    """Kinetic and potential energy, and angular momentum about the base, of rods of mass 1."""
    lengths = np.array(arm.parameters.segment_lengths)
    inertias = np.array([rod.inertia for rod in arm.parameters.rods])
    angles, speeds = np.array(arm.segment_angles), np.cumsum(arm.joint_velocities)
    levers = np.tril(np.tile(lengths, (len(lengths), 1)), -1) + np.diag(lengths) / 2
    places = levers @ Bookkeeping.along(angles)
    velocities = levers @ (speeds[:, None] * Bookkeeping.across(angles))
    heights = places @ np.array(arm.parameters.gravity)
    energy = np.sum(velocities**2) / 2 + inertias @ speeds**2 / 2 - heights.sum()
    spins = places[:, 0] * velocities[:, 1] - places[:, 1] * velocities[:, 0]
    return np.array([energy, np.sum(spins) + inertias @ speeds])


def drifts(substeps):
    """Largest relative changes of energy and momentum in 2 s of slack arms."""
    random, worst = np.random.default_rng(0), np.zeros(2)
    arm = AnalyticArm(ArmParameters(substep=0.02 / substeps, substeps=substeps), "torque")
    for _ in range(10):
        arm.reset(random.uniform(-3, 3, 3).tolist(), random.uniform(-3, 3, 3).tolist())
        before = energy_and_momentum(arm)
        for _ in range(100):
            arm.step()
            change = np.abs(energy_and_momentum(arm) - before) / np.maximum(np.abs(before), 1.0)
            worst = np.maximum(worst, change)
    return worst


def test_a_slack_arm_conserves_the_more_the_finer_the_substep():
    by_substeps = [drifts(substeps) for substeps in (4, 16, 64)]
    assert np.all(by_substeps[0] < [0.25, 0.12])
    for coarse, fine in pairwise(by_substeps):
        assert np.all(fine < coarse / 3)  # of first order: a quarter


def test_a_rod_swings_with_the_period_of_a_physical_pendulum():
    length, gravity, amplitude = 1.3, 9.81, 0.1
    parameters = ArmParameters(
        segment_lengths=(length,),
        gravity=(0.0, -gravity),
        substep=0.001,
        substeps=1,
        drive_inertia=0.0,
    )
    arm, crossings = AnalyticArm(parameters, "torque"), []
    arm.reset([-math.pi / 2 + amplitude])
    before = amplitude
    for step in range(1, 10_000):
        arm.step()
        now = arm.joint_angles[0] + math.pi / 2
        if before < 0 <= now:
            crossings.append((step - now / (now - before)) * 0.001)
        before = now
    period = 2 * math.pi * math.sqrt(2 * length / (3 * gravity)) * (1 + amplitude**2 / 16)
    assert np.diff(crossings) == pytest.approx(period, rel=1e-5)
    assert len(crossings) > 3


def test_an_arm_too_weak_to_hold_itself_falls():
    weak = ArmParameters(gravity=(0.0, -9.81), torque_limit=9.81 * 4.5 - 0.1)
    strong = ArmParameters(gravity=(0.0, -9.81), torque_limit=9.81 * 4.5 + 0.1)
    for parameters, falls in ((weak, True), (strong, False)):
        arm = AnalyticArm(parameters)
        for _ in range(20):
            arm.step()
        assert (arm.joint_angles[0] < -1e-4) is falls


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
