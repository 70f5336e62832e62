"""Facts about many arms at once, whatever engine simulates them."""

import copy
import multiprocessing
import pickle
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from mmc_gym import UserError
from mmc_gym.body import ArmParameters, PymunkArmBatch, make_arm, make_arms
from mmc_gym.body.analytic.arms import AnalyticArmBatch
from mmc_gym.body.parameters import ArmColumns
from mmc_gym.body.pymunk import batch as batch_module
from tests.body.conftest import FIELD, draw_postures, largest_command

ROUGH = {
    "joint_limits": ((-2.0, 2.0),) * 3,
    "force_field": FIELD,
    "lockable_joints": (0, 2),
}


@pytest.fixture
def few_arms_in_a_space(monkeypatch):
    monkeypatch.setattr(batch_module, "ARMS_PER_GROUP", 4)


def assert_equal(arms, singles):
    for index, single in singles.items():
        for name in ("segment_angles", "joint_angles", "joint_velocities"):
            assert getattr(arms, name)[index].tolist() == getattr(single, name)
        for name in ("servo_impulses", "servo_work"):
            np.testing.assert_array_equal(getattr(arms, name)[index], getattr(single, name))
        assert arms.end_effectors[index].tolist() == list(single.end_effector)


CURL = np.array([[[0.0], [1.0]], [[-1.0], [0.0]]])


def tuples(values):
    """Return nested tuples of the arrays along the last axis."""
    return values if values.ndim == 1 else tuple(map(tuples, values))


def drawn(parameters, random, count, heaviest):
    """Parameters in which arms differ, as columns and as those of each arm."""
    values = {
        "segment_lengths": random.uniform(0.5, 1.5, (3, count)),
        "hand_mass": random.uniform(0, heaviest, count),
        "joint_friction": random.uniform(0, 50 * heaviest, count) * random.integers(0, 2, count),
        "gravity": random.uniform(-30, 30, (2, count)),
        "speed_limit": random.uniform(3, 7, count),
        "torque_limit": random.uniform(200, 700, count),
        "servo_gain": random.uniform(4, 14, count),
        "force_field": CURL * random.uniform(-30, 30, count) * random.integers(0, 2),
        "lockable_joints": random.integers(0, 3, (1, count)),
    }
    if parameters.joint_limits:
        values["joint_limits"] = random.uniform(1, 2, (3, 2, count)) * [[-1], [1]]
    columns = ArmColumns.of(parameters)
    columns = replace(columns, **{name: tuples(value) for name, value in values.items()})
    rows = [{k: value[..., row].tolist() for k, value in values.items()} for row in range(count)]
    return columns, [replace(parameters, **row) for row in rows]


def play_both(case, servo, count, steps, threads=1, alone=None, others=()):
    """Play a random schedule of commands, partial resets and locks, with single arms beside."""
    engine, parameters = case
    random = np.random.default_rng(count)
    arms = make_arms(engine, parameters, count, servo, threads, others=others)
    alone = range(count) if alone is None else alone
    singles = {index: make_arm(engine, parameters, servo) for index in alone}
    for simulated in (arms, *singles.values()):
        simulated.records_effort = True
    assert_equal(arms, singles)
    for _ in range(steps):
        if random.random() < 0.4:
            rows = random.permutation(count)[: random.integers(0, count + 1)]
            places = draw_postures(parameters, random, len(rows)) / (2 if others else 1)
            speeds = random.uniform(-3, 3, places.shape) if random.random() < 0.5 else None
            columns, each = None, [None] * len(rows)
            if others:
                columns, each = drawn(parameters, random, len(rows), others[-1].hand_mass)
            arms.reset(places, rows, speeds, parameters=columns)
            for row, arm in enumerate(rows):
                if arm in singles:
                    speed = None if speeds is None else speeds[row].tolist()
                    singles[arm].reset(places[row].tolist(), speed, each[row])
            assert_equal(arms, singles)
        if random.random() < 0.3:
            largest = 1.2 * largest_command(parameters, servo) * (2 if servo == "position" else 1)
            values = random.uniform(-largest, largest, arms.joint_angles.shape)
            arms.command(values)
            for index, single in singles.items():
                single.command(values[index].tolist())
        if random.random() < 0.2:
            rows = random.permutation(count)[: random.integers(0, count + 1)]
            arms.lock(rows)
            for arm in set(rows.tolist()) & set(singles):
                singles[arm].lock()
        arms.step()
        for single in singles.values():
            single.step()
        assert_equal(arms, singles)
        assert np.isnan(arms.servo_work).all() == (engine == "analytic")  # which returns none
    arms.close()
    arms.close()
    arms.step()  # closed arms can be stepped again
    arms.close()


@pytest.mark.usefixtures("few_arms_in_a_space")
def test_every_arm_moves_as_a_single_one(case, servo):
    play_both(case, servo, count=9, steps=40)


@pytest.mark.usefixtures("few_arms_in_a_space")
@pytest.mark.parametrize(("engine", "count"), [("pymunk", 40), ("analytic", 520)])
@pytest.mark.parametrize("arm", [{}, ROUGH], ids=["default", "rough"])
def test_threads_change_nothing(engine, count, arm, servo):
    case = engine, ArmParameters(**arm)
    play_both(case, servo, count, steps=20, threads=2, alone=(0, 13, count - 1))


@pytest.mark.usefixtures("few_arms_in_a_space")
@pytest.mark.parametrize("heaviest", [0.0, 2.0], ids=["without loads", "with loads"])
@pytest.mark.parametrize("arm", [{}, ROUGH], ids=["default", "rough"])
def test_arms_that_differ_move_as_single_ones_with_their_parameters(engine, arm, heaviest, servo):
    """Lengths, loads, friction, field, gravity, limits, gain and locks, drawn anew at resets."""
    parameters = replace(ArmParameters(**arm), lockable_joints=(0, 1, 2))
    other = replace(
        parameters, gravity=(0.0, 30.0), hand_mass=heaviest, joint_friction=50 * heaviest
    )
    play_both((engine, parameters), servo, 37, 30, others=[parameters, other])


def test_a_whole_space_of_arms_moves_as_single_ones():
    play_both(("pymunk", ArmParameters()), "position", count=150, steps=20, threads=2)


@pytest.mark.skipif("fork" not in multiprocessing.get_all_start_methods(), reason="needs fork")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of a process with threads that forks
def test_a_forked_process_has_threads_of_its_own():
    arms = PymunkArmBatch(count=40, threads=2)
    arms.command(np.ones((40, 3)))
    arms.step()
    context = multiprocessing.get_context("fork")
    results = context.Queue()
    process = context.Process(target=lambda: (arms.step(), results.put(arms.joint_angles.tolist())))
    process.start()
    elsewhere = results.get(timeout=30)
    process.join()
    arms.step()
    assert elsewhere == arms.joint_angles.tolist()
    arms.close()


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda arms: pickle.loads(pickle.dumps(arms))])
def test_a_copy_of_analytic_arms_has_the_same_future(copied):
    arms = AnalyticArmBatch(None, 520, threads=2)
    arms.command(np.random.default_rng(0).uniform(-3, 3, (520, 3)))
    arms.step()
    other = copied(arms)
    for each in (arms, other):
        each.step()
        each.close()
    assert not np.shares_memory(arms.joint_angles, other.joint_angles)
    np.testing.assert_array_equal(arms.segment_angles, other.segment_angles)
    np.testing.assert_array_equal(arms.end_effectors, other.end_effectors)


def test_angles_are_as_the_mathematical_library_has_them():
    angles = np.concatenate([np.linspace(-7, 7, 1001), np.linspace(-1e5, 1e5, 1001)])
    arms = AnalyticArmBatch(ArmParameters(segment_lengths=(1.0,)), len(angles))
    arms.reset(angles[:, None])
    expected = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    np.testing.assert_allclose(arms.end_effectors, expected, atol=3e-16)


LOADED = ArmParameters(hand_mass=1.0)
AMONG_OBSTACLES = ArmParameters(obstacles=((1.0, 1.0, 0.1),))
INDICES = "arms must be different indices from 0 to 3"
ODD_ROWS = [[4], [-1], [0, 0], [0.5], [True, False], [[0]]]


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda make: make(0), "count must be a whole number of at least 1, got 0"),
        (lambda make: make(2, "position", 0), "threads must be a whole number of at least 1"),
        (lambda make: make(4, "hydraulic"), "servo 'hydraulic'"),
        (lambda make: make_arms("bullet"), "engine 'bullet'"),
        (lambda make: make_arm("bullet"), "engine 'bullet'"),
        (lambda make: make(4).command(np.zeros(3)), r"shape \(4, 3\)"),
        (lambda make: make(4).reset(np.zeros((4, 3)), [0, 1]), r"shape \(2, 3\)"),
        (lambda make: make(4).reset(np.zeros((4, 3)), None, np.zeros(3)), r"shape \(4, 3\)"),
        *((lambda make, rows=rows: make(4).lock(rows), INDICES) for rows in ODD_ROWS),
        (lambda make: make(4).reset(np.zeros((1, 3)), [4]), INDICES),
        (lambda make: make(1).reset([[0.0] * 3], parameters=LOADED), "parameters must be left out"),
        (lambda make: AnalyticArmBatch(AMONG_OBSTACLES), "obstacles must be empty"),
    ],
)
def test_impossible_batches_and_calls_are_refused(engine, call, message):
    with pytest.raises(UserError, match=message):
        call(partial(make_arms, engine, ArmParameters()))
