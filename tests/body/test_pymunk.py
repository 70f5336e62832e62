"""Facts about an arm in Chipmunk: what its solver must hold, and what only this engine knows."""

import dataclasses
import math
import os
import pickle
import re
from pathlib import Path

import numpy as np
import pymunk
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from mmc_gym import UserError
from mmc_gym.body import ArmParameters, PymunkArm, make_arm, make_arms
from mmc_gym.geometry import wrap_angle
from tests.body.conftest import DISCS, draw_postures, largest_command, play


def pivot_gap(arm):
    """The largest distance between the two ends that a pivot should hold together."""
    gap, end = 0.0, pymunk.Vec2d(0.0, 0.0)
    for segment, (_, length, centre) in zip(arm._linkage.segments, arm._linkage.rods, strict=True):
        gap = max(gap, segment.local_to_world((-centre, 0.0)).get_distance(end))
        end = segment.local_to_world((length - centre, 0.0))
    return gap


class PublicArm(PymunkArm):
    """The same arm, driven and stepped through pymunk's public interface."""

    def step(self):
        p, segments = self.parameters, self._linkage.segments
        for _ in range(p.substeps):
            speeds = np.diff([body.angular_velocity for body in segments], prepend=0.0)
            for brake, speed in zip(self.brakes, speeds.tolist()):
                brake.max_force = p.joint_friction + p.joint_damping * abs(speed)
            self._space.step(p.substep)
        self._read()

    @property
    def brakes(self):
        """The constraints that brake the joints, from the base outward."""
        handles = self._linkage.brakes
        return [
            joint
            for handle in handles
            for joint in self._space.constraints
            if joint._constraint == handle
        ]

    def _set_servos(self, values):
        p = self.parameters
        for index, (servo, value) in enumerate(zip(self._linkage.servos, values, strict=True)):
            angle = self.joint_angles[index]
            if self._servo == "velocity":
                servo.rate = -min(max(value, -p.speed_limit), p.speed_limit)
            elif self._servo == "torque":
                servo.rate = math.copysign(p.speed_limit, -value)
                servo.max_force = min(abs(value), p.torque_limit)
            elif p.joint_limits is None:
                servo.phase = angle + math.remainder(value - angle, math.tau)
            else:
                low, high = p.joint_limits[index]
                servo.phase = min(max(value, low), high)


def test_direct_calls_give_what_pymunk_gives(parameters, servo):
    parameters = dataclasses.replace(parameters, force_field=None)
    arms = [PymunkArm(parameters, servo), PublicArm(parameters, servo)]
    posture = draw_postures(parameters, np.random.default_rng(0), 1)[0].tolist()
    for arm in arms:
        arm.reset(posture)
    assert play(arms[0], servo, seed=0) == play(arms[1], servo, seed=0)
    assert arms[0].segment_angles == [body.angle for body in arms[1]._linkage.segments]
    speeds = np.diff([body.angular_velocity for body in arms[1]._linkage.segments], prepend=0.0)
    assert arms[0].joint_velocities == speeds.tolist()


def test_an_arm_that_went_too_far_since_its_last_reset_has_no_copy(monkeypatch):
    monkeypatch.setattr("mmc_gym.body.pymunk.arm._LONGEST_HISTORY", 20)
    arm = PymunkArm()
    for _ in range(9):
        arm.command([1.0, 2.0, 3.0])
        arm.step()
    assert pickle.loads(pickle.dumps(arm)).joint_angles == arm.joint_angles
    for _ in range(2):
        arm.step()
    with pytest.raises(RuntimeError, match=r"long after its last reset.* last 20 .* reset"):
        pickle.dumps(arm)
    arm.reset([0.0, 0.0, 0.0])
    assert pickle.loads(pickle.dumps(arm)).joint_angles == arm.joint_angles


def test_no_servo_gives_more_than_the_torque_limit(servo):
    arm, torques = PymunkArm(ArmParameters(torque_limit=50.0), servo), []
    for shares in np.random.default_rng(0).uniform(-1.5, 1.5, (60, 3)):
        arm.command((largest_command(arm.parameters, servo) * shares).tolist())
        for _ in range(5):
            arm.step()
            torques += [abs(drive.impulse) / 0.005 for drive in arm._linkage.servos]
    assert max(torques) <= 50.0 * (1 + 1e-12)
    assert max(torques) > 49.0  # it was tried


@pytest.mark.parametrize(
    ("lengths", "masses"),
    [
        ((1.0,) * 5, None),  # longer ones lack torque
        ((2.0, 1.0, 0.3), None),
        ((1.0, 1.0, 1.0), (0.1, 0.1, 3.0)),
        ((0.2, 0.2, 0.2), (0.01, 0.01, 0.01)),
    ],
)
def test_arms_come_to_rest_at_their_joint_targets(lengths, masses):
    """Whatever they carry: with too few sweeps of the solver a heavy hand buzzes for ever."""
    arm = PymunkArm(ArmParameters(segment_lengths=lengths, segment_masses=masses))
    random = np.random.default_rng(0)
    start, target = random.uniform(-math.pi, math.pi, (2, len(lengths)))
    arm.reset(start.tolist())
    for _ in range(200):
        arm.command(target.tolist())
        arm.step()
    np.testing.assert_allclose(wrap_angle(arm.joint_angles - target), 0, atol=1e-3)
    np.testing.assert_allclose(arm.joint_velocities, 0, atol=0.01)


def test_pivots_gape_little_and_joints_throw_others_hardly_beyond_their_speed_limit():
    arm, gaps, speeds = PymunkArm(), [], []
    for start, target in np.random.default_rng(0).uniform(-math.pi, math.pi, (10, 2, 3)).tolist():
        arm.reset(start)
        for _ in range(100):
            arm.command(target)
            arm.step()
            gaps.append(pivot_gap(arm))
            speeds += map(abs, arm.joint_velocities)
    assert np.median(gaps) < 1e-5
    assert max(gaps) < 0.003
    assert max(speeds) < 1.01 * arm.parameters.speed_limit


def memory_in_use():
    """Resident memory of this process, MB."""
    statistics = Path("/proc/self/statm")
    if not statistics.exists():
        pytest.skip("knows no other way to ask for it")
    return int(statistics.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


STRONG = {  # near the strongest that are accepted
    "three": ({}, 159.9),
    "light": ({"segment_masses": (0.03,) * 3}, 4.79),
    "light hand": ({"segment_masses": (1.0, 1.0, 0.1)}, 15.9),
    "heavy hand": ({"hand_mass": 10.0}, 159.9),
    "bare rods": ({"drive_inertia": 0.0}, 99.9),
    "five": ({"segment_lengths": (1.0, 0.7, 1.3, 0.4, 1.0)}, 159.9),
    "short substeps": ({"substep": 0.001, "substeps": 20}, 799.0),
}


@pytest.mark.parametrize("case", STRONG)
def test_in_a_strong_field_arms_stay_closed_and_a_stronger_one_is_refused(case, engine):
    settings, curl = STRONG[case]
    p = ArmParameters(**settings, force_field=((0.0, curl), (-curl, 0.0)))
    for servo in ("position", "torque"):
        arm, random, speeds, gaps = make_arm(engine, p, servo), np.random.default_rng(1), [], []
        for _ in range(10):
            arm.reset(random.uniform(-math.pi, math.pi, len(p.segment_lengths)))
            for _ in range(10):
                share = random.uniform(-1, 1, len(p.segment_lengths))
                arm.command(share * (math.pi if servo == "position" else p.torque_limit))
                for _ in range(4):
                    arm.step()
                    speeds.append(np.abs(arm.joint_velocities).max())
                    gaps.append(pivot_gap(arm) if engine == "pymunk" else 0.0)
        assert max(speeds) < 20 * p.speed_limit  # NaN is not; light hands reach 6 without a field
        assert max(gaps) < 0.05 * sum(p.segment_lengths)
    stronger = dataclasses.replace(p, force_field=((0.0, 1.01 * curl), (-1.01 * curl, 0.0)))
    for make in (make_arm, make_arms):
        with pytest.raises(UserError, match=r"field must be at most .* in substeps of 0\.00"):
            make(engine, stronger)
    apart = ArmParameters(force_field=((15, 0), (0, 15)))
    with pytest.raises(UserError, match=r"force_field must be one that pushes .* by at most 1\.47"):
        make_arm(engine, apart)


def test_resets_among_obstacles_leave_the_memory_as_it_was():
    arm, used = PymunkArm(ArmParameters(obstacles=DISCS)), []
    for episodes in (300, 700):
        for _ in range(episodes):
            arm.reset([0.1, 0.2, 0.3])
            arm.step()
        used.append(memory_in_use())
    assert used[1] - used[0] < 5


SIX_DECADES = st.floats(-3, 3).map(lambda exponent: 10**exponent)


@st.composite
def any_arm(draw):
    """One to forty segments, lengths and masses over six decades, equal or not."""
    count = draw(st.integers(1, 40))
    equal_or_not = st.one_of(
        SIX_DECADES.map(lambda value: (value,) * count),
        st.tuples(*[SIX_DECADES] * count),
        st.tuples(*[st.floats(0.3, 3.0)] * count),
    )
    return ArmParameters(
        segment_lengths=draw(equal_or_not),
        segment_masses=draw(equal_or_not),
        hand_mass=draw(st.one_of(st.just(0.0), SIX_DECADES)),
    )


@given(parameters=any_arm(), seed=st.integers(0, 2**32 - 1))
@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@example(parameters=ArmParameters(segment_lengths=(1.0,) * 40), seed=0)
@example(parameters=ArmParameters(segment_masses=(10.0, 1.0, 0.1)), seed=0)
@example(parameters=ArmParameters(segment_masses=(0.1, 0.1, 3.0)), seed=0)
@example(parameters=ArmParameters(hand_mass=20.0), seed=0)
@example(parameters=ArmParameters(segment_masses=(1.0, 1.0, 1.0), hand_mass=1e4), seed=0)
def test_an_arm_holds_together_or_is_refused(parameters, seed, servo):
    try:
        arm = PymunkArm(parameters, servo)
    except UserError as refusal:
        assert re.search("an arm that substeps can hold together: .* got .* times", str(refusal))
        return
    assert parameters.hand_mass < 1e4
    arm.reset(draw_postures(parameters, np.random.default_rng(seed), 1)[0].tolist())
    for _ in range(3):
        assert np.isfinite(play(arm, servo, seed, steps=3)).all()
        assert pivot_gap(arm) < 0.05 * sum(parameters.segment_lengths)
