"""Facts about the simulated arm."""

import copy
import dataclasses
import itertools
import math
import pickle
import resource
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import get_args

import numpy as np
import pymunk
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mmc_gym.body import Arm, ArmParameters, Servo

SERVOS = get_args(Servo)
LIMITS = ((-2.0, 2.5), (-2.5, 2.0), (0.1, 2.9))
CONDITIONS = {
    "default": ArmParameters(),
    "joint limits": ArmParameters(joint_limits=LIMITS),
    "gravity": ArmParameters(gravity=(0.0, -9.81)),
    "limits, gravity, unequal": ArmParameters(
        segment_lengths=(1.5, 1.0, 0.4),
        segment_masses=(2.0, 0.5, 0.1),
        joint_limits=LIMITS,
        gravity=(3.0, -9.81),
    ),
    "hand mass, force field": ArmParameters(hand_mass=1.5, force_field=((-1.0, 5.0), (-5.0, -1.0))),
    "obstacles": ArmParameters(obstacles=((1.2, 0.8, 0.2), (-0.5, -1.5, 0.4))),
    "lockable joints": ArmParameters(lockable_joints=(1, 2)),
}
Trajectory = list[tuple[float, ...]]

every_servo = pytest.mark.parametrize("servo", SERVOS)
every_condition = pytest.mark.parametrize("parameters", CONDITIONS.values(), ids=CONDITIONS.keys())


def random_posture(parameters: ArmParameters, random: np.random.Generator) -> list[float]:
    count = len(parameters.segment_lengths)
    limits = parameters.joint_limits or ((-math.pi, math.pi),) * count
    return [random.uniform(low, high) for low, high in limits]


def command_scale(parameters: ArmParameters, servo: Servo) -> float:
    scales = {
        "position": math.pi,
        "velocity": parameters.speed_limit,
        "torque": parameters.torque_limit,
    }
    return scales[servo]


def play(arm: Arm, servo: Servo, seed: int, steps: int = 40) -> Trajectory:
    """The whole readable state over some steps of rough commands, held for up to ten steps.

    Joints that can be locked are, half way.
    """
    random = np.random.default_rng(seed)
    scale = command_scale(arm.parameters, servo)
    states = []
    for step in range(steps):
        if step == steps // 2:
            arm.lock()
        if random.random() < 0.3:
            arm.command((scale * random.uniform(-1, 1, len(arm.joint_angles))).tolist())
        arm.step()
        states.append(
            (
                *arm.segment_angles,
                *arm.joint_angles,
                *arm.joint_velocities,
                *arm.end_effector,
                *arm.hand_velocity,
            )
        )
    return states


# --- A reset arm is a new arm


@every_servo
@every_condition
def test_a_reset_arm_has_the_future_of_a_new_one(parameters: ArmParameters, servo: Servo) -> None:
    random = np.random.default_rng(5)
    used = Arm(parameters, servo)
    for episode in range(5):
        play(used, servo, seed=episode)
        posture, speeds = random_posture(parameters, random), random.uniform(-3, 3, 3).tolist()
        used.reset(posture, speeds)
        new = Arm(parameters, servo)
        new.reset(posture, speeds)
        assert used.joint_angles == new.joint_angles
        assert play(used, servo, seed=100 + episode) == play(new, servo, seed=100 + episode)


@every_servo
def test_an_arm_that_no_one_commands_after_a_reset_is_as_a_new_one(servo: Servo) -> None:
    used, new = Arm(servo=servo), Arm(servo=servo)
    play(used, servo, seed=1)
    for arm in (used, new):
        arm.reset([0.5, -1.0, 2.0], [1.0, 2.0, -3.0])
        for _ in range(20):
            arm.step()
    assert used.joint_angles == new.joint_angles
    assert used.joint_velocities == new.joint_velocities


@given(
    lengths=st.lists(st.floats(0.5, 3.0), min_size=1, max_size=8),
    seed=st.integers(0, 2**32 - 1),
)
@settings(max_examples=50)
def test_reset_places_any_chain_exactly(lengths: list[float], seed: int) -> None:
    random = np.random.default_rng(seed)
    posture = random.uniform(-math.pi, math.pi, len(lengths))
    speeds = random.uniform(-3, 3, len(lengths))
    arm = Arm(ArmParameters(segment_lengths=tuple(lengths)))
    arm.reset(posture.tolist(), speeds.tolist())
    angles = np.cumsum(posture)
    hand = np.sum(lengths * np.array([np.cos(angles), np.sin(angles)]), axis=-1)
    np.testing.assert_allclose(arm.segment_angles, angles, atol=1e-12)
    np.testing.assert_allclose(arm.joint_angles, posture, atol=1e-12)
    np.testing.assert_allclose(arm.joint_velocities, speeds, atol=1e-12)
    np.testing.assert_allclose(arm.end_effector, hand, atol=1e-12)
    assert arm.pivot_gap() < 1e-12


def test_the_velocities_of_a_reset_are_those_of_rigid_rods_on_pivots() -> None:
    posture, speeds, instant = [0.3, 1.1, -2.0], [1.0, -2.0, 0.5], 1e-6
    arm, later = Arm(), Arm()
    arm.reset(posture, speeds)
    later.reset([angle + instant * speed for angle, speed in zip(posture, speeds, strict=True)])
    for body, moved in zip(arm._linkage.segments, later._linkage.segments, strict=True):
        difference = (moved.position - body.position) / instant
        assert body.velocity == pytest.approx(difference, abs=1e-5)


# --- A copy is the same arm


def pickled(arm: Arm) -> Arm:
    copied = pickle.loads(pickle.dumps(arm))
    assert isinstance(copied, Arm)
    return copied


@every_servo
@every_condition
@pytest.mark.parametrize("copies", [pickled, copy.deepcopy])
def test_a_copy_has_the_same_future(
    parameters: ArmParameters, servo: Servo, copies: Callable[[Arm], Arm]
) -> None:
    random, arm = np.random.default_rng(0), Arm(parameters, servo)
    scale = command_scale(parameters, servo)
    play(arm, servo, seed=0)
    for steps in (0, 1, 25):
        arm.reset(random_posture(parameters, random), random.uniform(-3, 3, 3).tolist())
        play(arm, servo, seed=1, steps=steps)
        command = scale * random.uniform(-1, 1, 3)
        arm.command(command)
        command[:] = np.nan  # the array is the caller's
        copied = copies(copies(arm))
        assert play(copied, servo, seed=2, steps=100) == play(arm, servo, seed=2, steps=100)
        arm.reset([0.5] * 3)
        copied.reset([0.5] * 3)
        assert play(copied, servo, seed=3) == play(arm, servo, seed=3)


def test_moving_a_copy_does_not_move_the_arm() -> None:
    arm = Arm()
    play(arm, "position", seed=0)
    before = arm.joint_angles
    copied = copy.deepcopy(arm)
    play(copied, "position", seed=1)
    assert arm.joint_angles == before
    assert copied.joint_angles != before


def test_an_arm_that_went_too_far_since_its_last_reset_has_no_copy(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("mmc_gym.body.pymunk.arm._LONGEST_HISTORY", 100)
    arm = Arm()
    play(arm, "position", seed=0, steps=100)
    assert pickled(arm).joint_angles == arm.joint_angles
    for steps in (1, 50):
        play(arm, "position", seed=0, steps=steps)
        with pytest.raises(RuntimeError, match=r"more than 100 steps after its last reset.* reset"):
            pickle.dumps(arm)
    arm.reset([0.0, 0.0, 0.0])
    assert pickled(arm).joint_angles == arm.joint_angles


# --- The shortcut to Chipmunk is pymunk


class PublicArm(Arm):
    """The same arm through nothing but pymunk's public interface."""

    def step(self) -> None:
        for _ in range(self.parameters.substeps):
            self._space.step(self.parameters.substep)
        self._read()

    def _read(self) -> None:
        angles = [0.0, *(body.angle for body in self._linkage.segments)]
        speeds = [0.0, *(body.angular_velocity for body in self._linkage.segments)]
        lengths = self.parameters.segment_lengths
        self.segment_angles = angles[1:]
        self.joint_angles = [b - a for a, b in itertools.pairwise(angles)]
        self.joint_velocities = [b - a for a, b in itertools.pairwise(speeds)]
        x = y = 0.0
        for angle, length in zip(angles[1:], lengths, strict=True):
            x, y = x + length * math.cos(angle), y + length * math.sin(angle)
        self.end_effector = (x, y)

    def command(self, values: Sequence[float]) -> None:
        p = self.parameters
        for index, (servo, value) in enumerate(zip(self._linkage.servos, values, strict=True)):
            angle = self.joint_angles[index]
            if isinstance(servo, pymunk.SimpleMotor) and self._servo == "velocity":
                servo.rate = -min(max(value, -p.speed_limit), p.speed_limit)
            elif isinstance(servo, pymunk.SimpleMotor):
                servo.rate = math.copysign(p.speed_limit, -value)
                servo.max_force = min(abs(value), p.torque_limit)
            elif isinstance(servo, pymunk.GearJoint) and p.joint_limits is None:
                servo.phase = angle + math.remainder(value - angle, math.tau)
            elif isinstance(servo, pymunk.GearJoint) and p.joint_limits is not None:
                low, high = p.joint_limits[index]
                servo.phase = min(max(value, low), high)


@every_servo
@pytest.mark.parametrize("parameters", [p for p in CONDITIONS.values() if p.force_field is None])
def test_direct_calls_give_what_pymunk_gives(parameters: ArmParameters, servo: Servo) -> None:
    arms = [Arm(parameters, servo), PublicArm(parameters, servo)]
    for seed in range(3):
        posture = random_posture(parameters, np.random.default_rng(seed))
        for arm in arms:
            arm.reset(posture)
        assert play(arms[0], servo, seed) == play(arms[1], servo, seed)


# --- How the arm moves


def turn_first_joint(posture: list[float]) -> tuple[float, float]:
    """Seconds until the first joint is 0.05 rad from a target at 90°, and how far it overshoots."""
    arm = Arm()
    arm.reset(posture)
    target = [posture[0] + math.pi / 2, *posture[1:]]
    errors = []
    for _ in range(100):
        arm.command(target)
        arm.step()
        errors.append(target[0] - arm.joint_angles[0])
    there = next(step for step, error in enumerate(errors, start=1) if abs(error) <= 0.05)
    return there * arm.parameters.control_step, -min(errors)


def test_a_quarter_turn_takes_as_long_as_documented() -> None:
    seconds, overshoot = turn_first_joint([0.0, 0.0, 0.0])
    assert seconds == pytest.approx(0.36)
    assert overshoot < 0.012
    seconds, overshoot = turn_first_joint([0.0, math.pi, math.pi])
    assert seconds == pytest.approx(0.38)
    assert overshoot <= 0


def test_a_servo_asks_for_the_speed_that_its_gain_states() -> None:
    p = ArmParameters(segment_lengths=(1.0,), servo_gain=5.0, speed_limit=2.0)
    arm = Arm(p)
    arm.command([3.0])
    for _ in range(5):
        arm.step()
    assert arm.joint_velocities[0] == pytest.approx(2.0, rel=1e-4)  # far off: the speed limit
    arm.reset([0.0])
    errors = []
    for _ in range(50):
        arm.command([0.3])
        arm.step()
        errors.append(0.3 - arm.joint_angles[0])
    # Near by, the error decays by servo_gain; its first step is spent on setting off.
    rate = math.log(errors[1] / errors[-1]) / (48 * p.control_step)
    assert rate == pytest.approx(5.0, rel=1e-4)


@given(start=st.floats(-math.pi, math.pi), target=st.floats(-20.0, 20.0))
@settings(max_examples=50)
def test_a_position_servo_turns_the_short_way_round(start: float, target: float) -> None:
    way = math.remainder(target - start, math.tau)
    arm = Arm(ArmParameters(segment_lengths=(1.0,)))
    arm.reset([start])
    angles = [start]
    for _ in range(100):
        arm.command([target])
        arm.step()
        angles.append(arm.joint_angles[0])
    assert angles[-1] - start == pytest.approx(way, abs=1e-6)
    assert min(np.diff(angles) * math.copysign(1, way)) >= -1e-12


@pytest.mark.parametrize(
    ("lengths", "masses"),
    [((1.0,) * count, None) for count in range(1, 8)]
    + [
        ((0.3, 1.0, 2.0), None),
        ((2.0, 1.0, 0.3), None),
        ((1.0, 1.0, 1.0), (1.0, 1.0, 3.0)),
        ((1.0, 1.0, 1.0), (1.0, 1.0, 10.0)),
        ((1.0, 1.0, 1.0), (0.1, 0.1, 3.0)),
        ((0.2, 0.2, 0.2), (0.01, 0.01, 0.01)),
    ],
)
def test_arms_come_to_rest_at_their_joint_targets(
    lengths: tuple[float, ...], masses: tuple[float, ...] | None
) -> None:
    """Whatever they carry: with too few sweeps of the solver a heavy hand buzzes for ever."""
    arm = Arm(ArmParameters(segment_lengths=lengths, segment_masses=masses))
    random = np.random.default_rng(0)
    for _ in range(3):
        arm.reset(random.uniform(-math.pi, math.pi, len(lengths)).tolist())
        target = random.uniform(-math.pi, math.pi, len(lengths)).tolist()
        for _ in range(200):
            arm.command(target)
            arm.step()
        errors = [math.remainder(a - b, math.tau) for a, b in zip(arm.joint_angles, target)]
        assert max(map(abs, errors)) < 1e-3
        assert max(map(abs, arm.joint_velocities)) < 0.01


@every_servo
def test_no_servo_gives_more_than_the_torque_limit(servo: Servo) -> None:
    parameters = ArmParameters(torque_limit=50.0)
    arm, random, torques = Arm(parameters, servo), np.random.default_rng(0), []
    scale = command_scale(parameters, servo)
    for step in range(300):
        if step % 5 == 0:
            arm.command((1.5 * scale * random.uniform(-1, 1, 3)).tolist())
        arm.step()
        torques += [abs(drive.impulse) / parameters.substep for drive in arm._linkage.servos]
    assert max(torques) <= 50.0 * (1 + 1e-12)
    assert max(torques) > 49.0  # it was tried


@pytest.mark.parametrize("servo", SERVOS)
def test_a_servo_drives_a_joint_no_faster_than_the_speed_limit(servo: Servo) -> None:
    arm = Arm(ArmParameters(segment_lengths=(1.0,)), servo)
    speeds = []
    for _ in range(60):
        arm.command([{"position": arm.joint_angles[0] + 3.0}.get(servo, 400.0)])
        arm.step()
        speeds.append(arm.joint_velocities[0])
    assert max(speeds) == pytest.approx(2 * math.pi, rel=1e-4)


def test_other_joints_throw_a_joint_no_further_beyond_its_speed_limit_than_stated() -> None:
    random, arm, speeds = np.random.default_rng(0), Arm(), []
    for _ in range(10):
        arm.reset(random.uniform(-math.pi, math.pi, 3).tolist())
        target = random.uniform(-math.pi, math.pi, 3).tolist()
        for _ in range(100):
            arm.command(target)
            arm.step()
            speeds += map(abs, arm.joint_velocities)
    assert max(speeds) < 1.35 * 2 * math.pi


def test_velocity_servos_give_the_commanded_speeds() -> None:
    arm = Arm(servo="velocity")
    arm.reset([0.2, 1.0, -1.0])
    for _ in range(40):
        arm.command([1.0, -2.0, 3.0])
        arm.step()
    assert arm.joint_velocities == pytest.approx([1.0, -2.0, 3.0], abs=0.02)


@pytest.mark.parametrize(("length", "mass", "torque"), [(1.0, 1.0, 0.5), (1.3, 0.7, -0.5)])
def test_torque_turns_a_rod_with_the_textbook_acceleration(
    length: float, mass: float, torque: float
) -> None:
    arm = Arm(ArmParameters(segment_lengths=(length,), segment_masses=(mass,)), "torque")
    acceleration = torque / (mass * length**2 / 3)
    for step in range(1, 26):
        arm.command([torque])
        arm.step()
        assert arm.joint_velocities[0] == pytest.approx(acceleration * 0.02 * step, rel=1e-3)


def test_gravity_pulls_a_rod_down_with_the_textbook_acceleration() -> None:
    arm = Arm(ArmParameters(segment_lengths=(1.3,), gravity=(0.0, -9.81)), "torque")
    arm.step()
    assert arm.joint_velocities[0] / 0.02 == pytest.approx(-3 * 9.81 / (2 * 1.3), rel=1e-4)


def test_a_slack_rod_released_level_swings_to_the_level_on_the_other_side() -> None:
    arm = Arm(ArmParameters(segment_lengths=(1.0,), gravity=(0.0, -9.81)), "torque")
    angles = []
    for _ in range(100):
        arm.step()
        angles.append(arm.joint_angles[0])
    assert min(angles) == pytest.approx(-math.pi, abs=0.02)


def test_position_servos_hold_the_arm_against_gravity() -> None:
    arm = Arm(ArmParameters(gravity=(0.0, -9.81)))
    for _ in range(100):
        arm.command([0.0, 0.0, 0.0])
        arm.step()
    assert arm.joint_angles == pytest.approx([0.0, 0.0, 0.0], abs=1e-4)
    torques = [-drive.impulse / arm.parameters.substep for drive in arm._linkage.servos]
    assert [abs(torque) for torque in torques] == pytest.approx(
        [9.81 * 4.5, 9.81 * 2.0, 9.81 * 0.5], rel=0.02
    )


# --- What is conserved


def momentum_and_energy(arm: Arm) -> tuple[float, float]:
    """Angular momentum about the base and kinetic energy of the whole arm."""
    momentum = energy = 0.0
    for body in arm._linkage.segments:
        momentum += body.mass * body.position.cross(body.velocity)
        momentum += body.moment * body.angular_velocity
        energy += body.mass * body.velocity.dot(body.velocity) / 2
        energy += body.moment * body.angular_velocity**2 / 2
    return momentum, energy


def drift_of_a_slack_arm(substeps: int) -> tuple[float, float, float]:
    """Largest drift of momentum over 2 s, largest gain and loss of energy, all relative."""
    drifts, gains, losses = [], [], []
    parameters = ArmParameters(substep=0.02 / substeps, substeps=substeps)
    arm = Arm(parameters, "torque")
    for seed in range(10):
        random = np.random.default_rng(seed)
        arm.reset(random.uniform(-3, 3, 3).tolist(), random.uniform(-3, 3, 3).tolist())
        momentum, energy = momentum_and_energy(arm)
        for _ in range(100):
            arm.step()
            now = momentum_and_energy(arm)
            drifts.append(abs(now[0] - momentum) / max(abs(momentum), 1.0))
            gains.append(now[1] / energy - 1)
            losses.append(1 - now[1] / energy)
    return max(drifts), max(gains), max(losses)


def test_a_slack_arm_conserves_momentum_and_gains_no_energy() -> None:
    drift, gain, loss = drift_of_a_slack_arm(substeps=4)
    assert drift < 0.03
    assert gain < 1e-3
    assert loss < 0.12


def test_a_finer_substep_conserves_more() -> None:
    drift, gain, loss = drift_of_a_slack_arm(substeps=80)
    assert drift < 0.002
    assert gain < 1e-3
    assert loss < 0.01


def integration_errors(substeps: int, movements: int) -> list[float]:
    """Largest angle errors of movements of 2 s against a substep of 0.25 ms."""
    random, errors = np.random.default_rng(1), []
    coarse = Arm(ArmParameters(substep=0.02 / substeps, substeps=substeps))
    fine = Arm(ArmParameters(substep=0.00025, substeps=80))
    for _ in range(movements):
        start, target = random.uniform(-math.pi, math.pi, (2, 3)).tolist()
        worst = 0.0
        for arm in (coarse, fine):
            arm.reset(start)
        for _ in range(100):
            for arm in (coarse, fine):
                arm.command(target)
                arm.step()
            angles = zip(coarse.joint_angles, fine.joint_angles, strict=True)
            worst = max(worst, *(abs(math.remainder(a - b, math.tau)) for a, b in angles))
        errors.append(worst)
    return errors


def test_the_default_substep_is_fine_enough() -> None:
    default = integration_errors(substeps=4, movements=30)
    assert np.median(default) < 0.033
    assert max(default) < 0.2
    assert np.median(integration_errors(substeps=20, movements=15)) < 0.0065


def test_pivots_gape_little() -> None:
    random, arm, gaps = np.random.default_rng(0), Arm(), []
    for _ in range(20):
        arm.reset(random.uniform(-math.pi, math.pi, 3).tolist())
        target = random.uniform(-math.pi, math.pi, 3).tolist()
        for _ in range(100):
            arm.command(target)
            arm.step()
            gaps.append(arm.pivot_gap())
    assert np.median(gaps) < 1e-3
    assert max(gaps) < 0.005


def memory_in_use() -> float:
    """Resident memory of this process, MB."""
    statistics = Path("/proc/self/statm")
    if not statistics.exists():
        pytest.skip("knows no other way to ask for it")
    return int(statistics.read_text().split()[1]) * resource.getpagesize() / 1e6


def largest_gap_of_random_movements(arm: Arm, servo: Servo, resets: int) -> float:
    """Largest gap of the pivots over 100 steps after each reset, with abrupt random commands."""
    random, largest = np.random.default_rng(0), 0.0
    scale = command_scale(arm.parameters, servo)
    for _ in range(resets):
        arm.reset(random.uniform(-math.pi, math.pi, 3).tolist(), random.uniform(-6, 6, 3).tolist())
        commands = random.uniform(-scale, scale, (20, 3)).tolist()
        held = random.choice((1, 5, 20))
        for step in range(100):
            if step % held == 0:
                arm.command(commands[step % 20])
            arm.step()
            largest = max(largest, arm.pivot_gap())
    return largest


@pytest.mark.slow
@pytest.mark.parametrize(
    ("servo", "resets", "gap"),
    [
        ("position", 10_000, 0.01),
        ("velocity", 500, 0.01),
        ("torque", 500, 0.015),  # the full torque for 0.4 s whips joints round at 35 rad/s
    ],
)
def test_a_long_life_leaves_the_pivots_tight_and_the_memory_as_it_was(
    servo: Servo, resets: int, gap: float
) -> None:
    arm = Arm(servo=servo)
    largest_gap_of_random_movements(arm, servo, resets=50)
    before = memory_in_use()
    assert largest_gap_of_random_movements(arm, servo, resets) <= gap
    assert memory_in_use() - before < 2


def test_resets_among_obstacles_leave_the_memory_as_it_was() -> None:
    arm, before = Arm(CONDITIONS["obstacles"]), 0.0
    for episode in range(1500):
        if episode == 300:
            before = memory_in_use()
        arm.reset([0.1, 0.2, 0.3])
        arm.step()
    assert memory_in_use() - before < 5


@every_servo
@pytest.mark.parametrize("gravity", [(0.0, 0.0), (0.0, -9.81)])
def test_joint_limits_are_held(servo: Servo, gravity: tuple[float, float]) -> None:
    limits = ((-1.0, 1.5), (-0.5, 2.0), (0.1, 0.9))
    parameters = ArmParameters(joint_limits=limits, gravity=gravity)
    arm, random, beyond = Arm(parameters, servo), np.random.default_rng(0), []
    arm.reset(random_posture(parameters, random))
    for step in range(500):
        if step % 5 == 0:
            arm.command((command_scale(parameters, servo) * random.uniform(-1, 1, 3)).tolist())
        arm.step()
        for angle, (low, high) in zip(arm.joint_angles, limits, strict=True):
            beyond.append(max(low - angle, angle - high))
    assert max(beyond) < (0.15 if servo == "torque" else 0.08)  # a stop gives way to a blow


def test_a_steady_push_against_a_stop_does_not_move_it() -> None:
    arm = Arm(ArmParameters(joint_limits=((-1.0, 1.5),), segment_lengths=(1.0,)), "torque")
    for _ in range(100):
        arm.command([400.0])
        arm.step()
    assert arm.joint_angles == pytest.approx([1.5], abs=1e-6)


def test_a_joint_with_limits_never_turns_through_the_forbidden_arc() -> None:
    arm = Arm(ArmParameters(joint_limits=((-3.0, 3.0),), segment_lengths=(1.0,)))
    arm.reset([-2.9])
    angles = []
    for _ in range(150):
        arm.command([2.9])  # the short way, 0.48 rad, is barred
        arm.step()
        angles.append(arm.joint_angles[0])
    assert np.all(np.diff(angles) >= -1e-12)
    assert angles[-1] == pytest.approx(2.9, abs=1e-6)


@pytest.mark.parametrize("count", [1, 2, 5, 8])
@every_servo
def test_arms_of_any_number_of_segments_move_and_stay_finite(count: int, servo: Servo) -> None:
    lengths = tuple(np.linspace(1.5, 0.3, count).tolist())
    arm = Arm(ArmParameters(segment_lengths=lengths), servo)
    states = play(arm, servo, seed=0, steps=200)
    assert np.isfinite(states).all()
    assert len(arm.joint_angles) == count
    assert states[0] != states[-1]


# --- What an arm can be made to feel


def test_the_hand_moves_as_the_end_effector_does() -> None:
    arm = Arm()
    arm.reset([0.3, -1.0, 2.0], [1.0, 2.0, -3.0])
    start, velocity, instant = np.array(arm.end_effector), arm.hand_velocity, 1e-6
    arm.reset([0.3 + instant, -1.0 + 2 * instant, 2.0 - 3 * instant])
    assert velocity == pytest.approx(tuple((arm.end_effector - start) / instant), abs=1e-5)


@pytest.mark.parametrize("hand_mass", [0.5, 3.0])
def test_torque_turns_a_rod_with_a_hand_mass_with_the_textbook_acceleration(
    hand_mass: float,
) -> None:
    length, mass = 1.3, 0.7
    p = ArmParameters(segment_lengths=(length,), segment_masses=(mass,), hand_mass=hand_mass)
    arm = Arm(p, "torque")
    acceleration = 0.5 / ((mass / 3 + hand_mass) * length**2)
    for step in range(1, 26):
        arm.command([0.5])
        arm.step()
        assert arm.joint_velocities[0] == pytest.approx(acceleration * 0.02 * step, rel=2e-3)


def test_gravity_pulls_a_hand_mass() -> None:
    p = ArmParameters(segment_lengths=(1.3,), gravity=(0.0, -9.81), hand_mass=2.0)
    arm = Arm(p, "torque")
    arm.step()
    acceleration = -9.81 * (1 / 2 + 2.0) / ((1 / 3 + 2.0) * 1.3)
    assert arm.joint_velocities[0] / 0.02 == pytest.approx(acceleration, rel=2e-3)


def test_a_viscous_field_brakes_a_rod_as_in_the_textbook() -> None:
    length, viscosity = 1.3, 0.8
    field = ((-viscosity, 0.0), (0.0, -viscosity))
    p = ArmParameters(segment_lengths=(length,), force_field=field, substep=0.0005, substeps=40)
    arm = Arm(p, "torque")
    arm.reset([0.4], [3.0])
    for step in range(1, 51):
        arm.step()
        expected = 3.0 * math.exp(-viscosity / (1 / 3) * 0.02 * step)
        assert arm.joint_velocities[0] == pytest.approx(expected, rel=0.01)


def test_a_curl_field_pushes_a_movement_aside_and_does_no_work() -> None:
    curl = ArmParameters(force_field=((0.0, 2.0), (-2.0, 0.0)), substep=0.0005, substeps=40)
    arms = [Arm(curl, "torque"), Arm(dataclasses.replace(curl, force_field=None), "torque")]
    for arm in arms:
        arm.reset([0.4, 1.0, -0.5], [1.0, -0.5, 0.5])
        energy = momentum_and_energy(arm)[1]
        for _ in range(25):
            arm.step()
        assert momentum_and_energy(arm)[1] == pytest.approx(energy, rel=0.02)
    assert math.dist(arms[0].end_effector, arms[1].end_effector) > 0.05


def test_an_obstacle_stops_a_segment_at_its_surface() -> None:
    p = ArmParameters(segment_lengths=(1.0,), obstacles=((0.0, 0.8, 0.2),), torque_limit=40.0)
    arm = Arm(p)
    for _ in range(100):
        arm.command([math.pi / 2])
        arm.step()
    touching = math.pi / 2 - math.asin((0.2 + p.segment_radius) / 0.8)
    assert arm.joint_angles[0] == pytest.approx(touching, abs=0.02)


@every_servo
def test_segments_pass_each_other_and_feel_no_obstacle_out_of_reach(servo: Servo) -> None:
    arms = [Arm(ArmParameters(), servo), Arm(ArmParameters(obstacles=((0.0, 5.0, 1.0),)), servo)]
    for seed in range(3):
        for arm in arms:
            arm.reset([0.0, 3.0, -3.0])  # the segments lie on each other
        assert play(arms[0], servo, seed) == play(arms[1], servo, seed)


@every_servo
def test_a_locked_joint_is_rigid_until_the_next_reset(servo: Servo) -> None:
    p = ArmParameters(lockable_joints=(1,))
    arm = Arm(p, servo)
    arm.reset([0.1, 0.7, -0.4])
    arm.lock()
    states = np.array(play(arm, servo, seed=3, steps=200))
    assert np.abs(states[:, 4] - 0.7).max() < 0.01
    assert np.ptp(states[:, 3]) > 0.3
    arm.reset([0.1, 0.7, -0.4])
    free = Arm(p, servo)
    free.reset([0.1, 0.7, -0.4])
    scale = command_scale(p, servo)
    for _ in range(20):
        for each in (arm, free):
            each.command([0.3 * scale, -0.9 * scale, 0.5 * scale])
            each.step()
    assert arm.joint_angles == free.joint_angles


# --- Arms of any make

SIX_DECADES = st.floats(-3, 3).map(lambda exponent: 10**exponent)


@st.composite
def any_arm(draw: st.DrawFn) -> ArmParameters:
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


@every_servo
@given(parameters=any_arm(), seed=st.integers(0, 2**32 - 1))
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_an_arm_holds_together_or_is_refused(
    parameters: ArmParameters, seed: int, servo: Servo
) -> None:
    try:
        arm = Arm(parameters, servo)
    except ValueError as refusal:
        assert "an arm that pymunk can hold together" in str(refusal)
        return
    arm.reset(random_posture(parameters, np.random.default_rng(seed)))
    for _ in range(3):
        assert np.isfinite(play(arm, servo, seed, steps=3)).all()
        assert arm.pivot_gap() < 0.05 * sum(parameters.segment_lengths)


@every_servo
@pytest.mark.parametrize(
    "parameters",
    [
        *(ArmParameters(segment_lengths=(1.0,) * count) for count in (1, 20, 40)),
        *(
            ArmParameters(segment_lengths=(length,) * 3, segment_masses=(mass,) * 3)
            for length in (1e-3, 1e3)
            for mass in (1e-3, 1e3)
        ),
        ArmParameters(segment_masses=(10.0, 1.0, 0.1)),
        ArmParameters(segment_masses=(0.1, 0.1, 3.0)),
        ArmParameters(hand_mass=20.0),
    ],
)
def test_arms_that_are_not_refused(parameters: ArmParameters, servo: Servo) -> None:
    arm = Arm(parameters, servo)
    arm.reset(random_posture(parameters, np.random.default_rng(0)))
    for _ in range(5):
        assert np.isfinite(play(arm, servo, seed=0, steps=3)).all()
        assert arm.pivot_gap() < 0.01 * sum(parameters.segment_lengths)


# --- What is refused


def test_an_arm_with_too_heavy_a_hand_for_the_solver_is_refused() -> None:
    message = "segment_lengths, segment_masses and hand_mass must .* hold together: .* got .* times"
    with pytest.raises(ValueError, match=message):
        Arm(ArmParameters(segment_masses=(1.0, 1.0, 1.0), hand_mass=1e4))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"segment_lengths": ()}, r"segment_lengths must be at least one length, got \(\)"),
        (
            {"segment_lengths": (1.0, -0.5, 1.0)},
            r"segment_lengths must be positive and finite, got \(1.0, -0.5, 1.0\)",
        ),
        ({"segment_lengths": (1.0, math.nan)}, "segment_lengths must be positive and finite"),
        ({"segment_masses": (1.0, 1.0)}, r"segment_masses must be 3 masses.* got \(1.0, 1.0\)"),
        ({"segment_masses": ()}, "segment_masses must be 3 masses"),
        ({"segment_masses": (1.0, 0.0, 1.0)}, "segment_masses must be positive"),
        ({"speed_limit": 0.0}, "speed_limit must be positive"),
        ({"torque_limit": math.inf}, "torque_limit must be positive and finite"),
        ({"servo_gain": -1.0}, "servo_gain must be positive"),
        ({"substep": 0.0}, "substep must be positive"),
        ({"substeps": 0}, "substeps must be a whole number of at least 1, got 0"),
        ({"substeps": 2.5}, "substeps must be a whole number"),
        ({"gravity": (1.0,)}, "gravity must be two finite values"),
        ({"gravity": (0.0, math.nan)}, "gravity must be two finite values"),
        ({"joint_limits": ((-1.0, 1.0),)}, "joint_limits must be 3 pairs"),
        ({"joint_limits": ((1.0, -1.0),) * 3}, "joint_limits must be 3 pairs low < high"),
        ({"joint_limits": ((-4.0, 1.0),) * 3}, "joint_limits must be .* within -pi and pi"),
        ({"joint_limits": ((-1.0, math.nan),) * 3}, "joint_limits must be"),
    ],
)
def test_impossible_arms_are_refused(arguments: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        ArmParameters(**arguments)  # type: ignore[arg-type]


def test_an_unknown_servo_is_refused() -> None:
    with pytest.raises(ValueError, match=r"servo must be one of .*'position'.* got 'hydraulic'"):
        Arm(servo="hydraulic")  # type: ignore[arg-type]


@every_servo
def test_commands_of_the_wrong_length_are_refused_and_leave_no_trace(servo: Servo) -> None:
    tried, untried = Arm(servo=servo), Arm(servo=servo)
    for command in ([0.5, 0.5], [0.5] * 4):
        with pytest.raises(ValueError, match=r"command must be 3 values, got \[0\.5"):
            tried.command(command)
    assert play(tried, servo, seed=0) == play(untried, servo, seed=0)


def test_lengths_are_floats_whatever_they_were_given_as() -> None:
    parameters = ArmParameters(segment_lengths=np.array([2, 1]), segment_masses=[1, 2])  # type: ignore[arg-type]
    assert parameters.segment_lengths == (2.0, 1.0)
    assert parameters.masses == (1.0, 2.0)
    assert ArmParameters().masses == (1.0, 1.0, 1.0)
    assert ArmParameters(substep=0.01, substeps=3).control_step == pytest.approx(0.03)
