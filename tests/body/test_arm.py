"""Facts about an arm, whatever engine simulates it."""

import copy
import dataclasses
import math
import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mmc_gym import UserError
from mmc_gym.body import ArmParameters, make_arm
from tests.body.conftest import draw_postures, largest_command, play


@pytest.mark.parametrize(
    ("name", "value", "accepted"),
    [
        ("segment_lengths", (), "one or more"),
        ("segment_lengths", (1.0, -0.5), "positive"),
        ("segment_masses", (1.0, 1.0), "3 .* masses"),
        ("speed_limit", 0.0, "from 1e-09"),
        ("substeps", 0, "at least 1"),
        ("substeps", 10**18, "at most 10000"),
        ("gravity", 9.81, "two finite values"),
        ("gravity", (0.0, 1e300), "at most"),
        ("joint_limits", ((1.0, -1.0),) * 3, "low < high"),
        ("joint_limits", ((-4.0, 1.0),) * 3, "within -pi and pi"),
        ("drive_inertia", math.inf, "from 0 to"),
        ("force_field", ((1.0, 0.0),), "two rows"),
        ("obstacles", ((0.0, 1.0, 0.0),), "positive radius"),
        ("lockable_joints", (3,), "from 0 to 2"),
        ("segment_length", (1.0,), "did you mean 'segment_lengths'"),
    ],
)
def test_an_impossible_arm_is_refused(name, value, accepted):
    with pytest.raises(UserError, match=f"{name}.*{accepted}"):
        ArmParameters(**{name: value})


def test_parameters_are_floats_whatever_they_were_given_as():
    parameters = ArmParameters(segment_lengths=np.array([2, 1]), substep=0.01, substeps=np.int64(3))
    assert (parameters.segment_lengths, parameters.masses) == ((2.0, 1.0), (1.0, 1.0))
    assert parameters.control_step == pytest.approx(0.03)


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
    parameters = ArmParameters(**arm)
    assert parameters.torque_limit == pytest.approx(torque_limit, rel=1e-12)
    longer = dataclasses.replace(parameters, segment_lengths=(2.0, 1.0), segment_masses=None)
    assert longer.torque_limit == parameters.torque_limit


def arm_of(engine, servo="position", **parameters):
    return make_arm(engine, ArmParameters(**parameters), servo)


def drive(arm, values, steps):
    """Command the same in every step; return the angles of the first joint."""
    angles = []
    for _ in range(steps):
        arm.command(values)
        arm.step()
        angles.append(arm.joint_angles[0])
    return np.array(angles)


def test_a_reset_arm_has_the_future_of_a_new_one(case, servo):
    random = np.random.default_rng(5)
    used = make_arm(*case, servo)
    used.records_effort = True  # which changes no movement
    for episode in range(2):
        play(used, servo, seed=episode)
        posture = draw_postures(case[1], random, 1)[0].tolist()
        speeds = random.uniform(-3, 3, len(posture)).tolist()
        used.reset(posture, speeds)
        new = make_arm(*case, servo)
        new.reset(posture, speeds)
        assert used.joint_angles == new.joint_angles
        assert play(used, servo, seed=100 + episode) == play(new, servo, seed=100 + episode)
        assert np.isnan([*new.servo_impulses, *new.servo_work]).all()  # it was not asked for


@given(
    lengths=st.sampled_from([1, 3, 5]).flatmap(lambda n: st.tuples(*[st.floats(0.5, 3.0)] * n)),
    seed=st.integers(0, 2**32 - 1),
)
@settings(max_examples=20)
def test_reset_places_any_chain_exactly(engine, lengths, seed):
    random = np.random.default_rng(seed)
    posture = random.uniform(-math.pi, math.pi, len(lengths))
    speeds = random.uniform(-3, 3, len(lengths))
    arm = arm_of(engine, segment_lengths=lengths)
    arm.reset(posture.tolist(), speeds.tolist())
    angles = np.cumsum(posture)
    hand = np.sum(np.array(lengths) * np.array([np.cos(angles), np.sin(angles)]), axis=-1)
    np.testing.assert_allclose(arm.segment_angles, angles, atol=1e-12)
    np.testing.assert_allclose(arm.joint_angles, posture, atol=1e-12)
    np.testing.assert_allclose(arm.joint_velocities, speeds, atol=1e-12)
    np.testing.assert_allclose(arm.end_effector, hand, atol=1e-12)


def test_a_copy_has_the_same_future(case, servo):
    random, arm = np.random.default_rng(0), make_arm(*case, servo)
    count, arm.records_effort = len(arm.joint_angles), True
    play(arm, servo, seed=0)
    for steps in (0, 25):
        arm.reset(draw_postures(case[1], random, 1)[0], random.uniform(-3, 3, count))
        play(arm, servo, seed=1, steps=steps)
        command = largest_command(case[1], servo) * random.uniform(-1, 1, count)
        arm.command(command)
        command[:] = np.nan  # the array is the caller's
        copied = copy.deepcopy(pickle.loads(pickle.dumps(arm)))
        assert play(copied, servo, seed=2) == play(arm, servo, seed=2)
        np.testing.assert_array_equal(copied.servo_work, arm.servo_work)
        assert np.isfinite(arm.servo_work).all() == (case[0] == "pymunk")
        arm.reset([0.5] * count)
        copied.reset([0.5] * count)
        assert play(copied, servo, seed=3) == play(arm, servo, seed=3)


@pytest.mark.parametrize("posture", [[0.0] * 3, [0.0, math.pi, math.pi]], ids=["out", "folded"])
def test_a_quarter_turn_takes_as_long_as_documented(posture):
    arm = arm_of("pymunk")
    arm.reset(posture)
    target = [posture[0] + math.pi / 2, *posture[1:]]
    beyond = drive(arm, target, 100) - target[0]
    there = 1 + np.argmax(np.abs(beyond) <= 0.05)
    assert there * arm.parameters.control_step == pytest.approx(0.40)
    assert beyond.max() <= 1e-9


def test_a_servo_asks_for_the_speed_that_its_gain_states(engine):
    arm = arm_of(engine, segment_lengths=(1.0,), servo_gain=5.0, speed_limit=2.0)
    drive(arm, [3.0], 5)
    assert arm.joint_velocities[0] == pytest.approx(2.0, rel=1e-4)  # far off: the speed limit
    arm.reset([0.0])
    errors = 0.3 - drive(arm, [0.3], 50)
    # Near by, the error decays by servo_gain; its first step is spent on setting off.
    rate = math.log(errors[1] / errors[-1]) / (48 * 0.02)
    assert rate == pytest.approx(5.0, rel=1e-4)


def test_dry_friction_stops_a_joint_and_holds_it_until_a_torque_exceeds_it(engine):
    arm = arm_of(engine, "torque", segment_lengths=(1.0,), joint_friction=2.0)
    inertia = 1 / 3 * (1 + arm.parameters.drive_inertia)
    arm.reset([0.0], [3.0])
    angles = drive(arm, [0.0], 50)
    assert angles[-1] == pytest.approx(inertia * 3.0**2 / (2 * 2.0), rel=0.02)
    assert angles[-10:] == pytest.approx(angles[-1], abs=1e-6)
    assert drive(arm, [1.9], 50)[-1] == pytest.approx(angles[-1], abs=1e-6)
    assert drive(arm, [-2.1], 50)[-1] < angles[-1] - 0.1


def test_viscous_friction_slows_a_joint_exponentially(engine):
    arm = arm_of(engine, "torque", segment_lengths=(1.0,), joint_damping=1.0)
    arm.reset([0.0], [3.0])
    drive(arm, [0.0], 25)
    inertia = 1 / 3 * (1 + arm.parameters.drive_inertia)
    assert arm.joint_velocities[0] == pytest.approx(3.0 * math.exp(-0.5 / inertia), rel=0.02)


@given(start=st.floats(-math.pi, math.pi), target=st.floats(-20.0, 20.0))
@settings(max_examples=20)
def test_a_position_servo_turns_the_short_way_round(engine, start, target):
    way = math.remainder(target - start, math.tau)
    arm = arm_of(engine, segment_lengths=(1.0,))
    arm.reset([start])
    angles = [start, *drive(arm, [target], 100)]
    assert angles[-1] - start == pytest.approx(way, abs=1e-6)
    assert min(np.diff(angles) * math.copysign(1, way)) >= -1e-12


def test_position_servos_hold_the_arm_against_gravity(engine):
    arm = arm_of(engine, gravity=(0.0, -9.81))
    arm.records_effort = True
    drive(arm, [0.3, -0.2, 0.1], 100)
    exact = engine == "analytic"
    assert arm.joint_angles == pytest.approx([0.3, -0.2, 0.1], abs=1e-9 if exact else 1e-4)
    assert arm.joint_velocities == pytest.approx([0.0] * 3, abs=1e-9 if exact else 1e-3)
    if not exact:  # the analytic engine does not return its torques
        along = np.cos(arm.segment_angles)
        torques = [9.81 * along[joint:] @ [2.5, 1.5, 0.5][-3 + joint :] for joint in range(3)]
        assert np.divide(arm.servo_impulses, 0.02) == pytest.approx(torques, rel=0.03)


def test_joint_limits_are_held(engine, servo):
    limits = ((-1.0, 1.5), (-0.5, 2.0), (0.1, 0.9))
    arm = arm_of(engine, servo, joint_limits=limits, gravity=(0.0, -9.81))
    arm.reset([0.0, 1.0, 0.5])
    low, high = np.transpose(limits)
    gives = 0.15 if servo == "torque" else 0.08  # a stop gives way to a blow
    for shares in np.random.default_rng(0).uniform(-1, 1, (100, 3)):
        arm.command((largest_command(arm.parameters, servo) * shares).tolist())
        for _ in range(5):
            arm.step()
            assert ((low - gives < arm.joint_angles) & (arm.joint_angles < high + gives)).all()


def test_a_joint_with_limits_never_turns_through_the_forbidden_arc(engine):
    arm = arm_of(engine, joint_limits=((-3.0, 3.0),), segment_lengths=(1.0,))
    arm.reset([-2.9])
    angles = drive(arm, [2.9], 150)  # the short way, 0.48 rad, is barred
    assert np.all(np.diff(angles) >= -1e-12)
    assert angles[-1] == pytest.approx(2.9, abs=1e-6)


@pytest.mark.parametrize(("engine", "slip"), [("pymunk", 0.01), ("analytic", 1e-12)])
def test_a_locked_joint_is_rigid_until_the_next_reset(engine, slip, servo):
    arm, free = (arm_of(engine, servo, lockable_joints=(1,)) for _ in range(2))
    arm.reset([0.1, 0.7, -0.4])
    arm.lock()
    states = np.array(play(arm, servo, seed=3, steps=100))
    assert np.abs(states[:, 4] - 0.7).max() < slip
    assert np.ptp(states[:, 3]) > 0.3
    largest = largest_command(arm.parameters, servo)
    for each in (arm, free):
        each.reset([0.1, 0.7, -0.4])
        drive(each, [0.3 * largest, -0.9 * largest, 0.5 * largest], 20)
    assert arm.joint_angles == free.joint_angles
    assert abs(arm.joint_angles[1] - 0.7) > 0.1


@pytest.mark.parametrize("obstacles", [(), ((5.0, 5.0, 0.1),)])
def test_a_load_deals_no_blow_and_is_gone_after_a_reset(engine, obstacles, servo):
    if obstacles and engine == "analytic":
        pytest.skip("it has none")
    arm, fresh = (arm_of(engine, servo, obstacles=obstacles) for _ in range(2))
    loaded = dataclasses.replace(arm.parameters, hand_mass=4.0, force_field=((0, 3), (-3, 0)))
    twin = make_arm(engine, dataclasses.replace(loaded, force_field=None), servo)
    play(arm, servo, seed=3, steps=20)
    hand, speeds, angles = arm.end_effector, list(arm.joint_velocities), list(arm.joint_angles)
    twin.reset(angles, speeds)
    arm.load(loaded)
    assert (arm.end_effector, arm.joint_velocities) == (hand, speeds)
    arm.load(twin.parameters)  # without the field again
    copied = copy.deepcopy(arm)
    for each in (arm, copied, twin):
        each.command([0.2 * largest_command(arm.parameters, servo)] * 3)
        each.step()
    assert arm.joint_velocities == copied.joint_velocities
    # A placed arm goes round at once, while a moving one goes straight on in a substep.
    np.testing.assert_allclose(arm.joint_velocities, twin.joint_velocities, atol=0.3)
    for each in (arm, fresh):
        each.reset([0.1, 0.7, -0.4])
    assert play(arm, servo, seed=4, steps=30) == play(fresh, servo, seed=4, steps=30)


@pytest.mark.parametrize(("speed", "torque"), [(0.0, 2.0), (3.0, 5.0), (3.0, -5.0)])
def test_a_torque_has_its_impulse_and_its_work_is_kinetic_energy_gained_or_lost(speed, torque):
    arm = arm_of("pymunk", "torque", segment_lengths=(1.0,), drive_inertia=0.0)
    arm.records_effort = True
    arm.reset([0.0], [speed])
    drive(arm, [torque], 1)
    (reached,), inertia = arm.joint_velocities, 1 / 3
    assert reached == pytest.approx(speed + torque / inertia * 0.02, rel=1e-3)
    assert arm.servo_impulses[0] == pytest.approx(abs(torque) * 0.02)
    energy = 0.5 * inertia * abs(reached**2 - speed**2)
    assert arm.servo_work[0] == pytest.approx(energy, rel=0.01)


def test_values_of_the_wrong_length_are_refused_and_leave_no_trace(engine):
    tried, untried = arm_of(engine), arm_of(engine)
    for call in (tried.command, tried.reset, lambda values: tried.reset([0.0] * 3, values)):
        for values in ([0.5, 0.5], [0.5] * 4):
            with pytest.raises(UserError, match="must be 3 values"):
                call(values)
    assert play(tried, "position", seed=0) == play(untried, "position", seed=0)
