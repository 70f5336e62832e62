"""Facts about many arms at once."""

import copy
import math
import multiprocessing
import pickle
from typing import get_args

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mmc_gym.body import Arm, ArmParameters, Servo
from mmc_gym.body.pymunk import batch as batch_module
from mmc_gym.body.pymunk.batch import Arms

SERVOS = get_args(Servo)
LIMITS = ((-2.0, 2.5), (-2.5, 2.0), (0.1, 2.9))
CONDITIONS = {
    "default": ArmParameters(),
    "one segment": ArmParameters(segment_lengths=(0.7,)),
    "everything": ArmParameters(
        segment_lengths=(1.5, 1.0, 0.4),
        segment_masses=(2.0, 0.5, 0.1),
        joint_limits=LIMITS,
        gravity=(3.0, -9.81),
        hand_mass=0.5,
        force_field=((-1.0, 5.0), (-5.0, -1.0)),
        lockable_joints=(0, 2),
    ),
    "force field": ArmParameters(force_field=((-1.0, 5.0), (-5.0, -1.0)), hand_mass=1.0),
    "obstacles, force field": ArmParameters(
        obstacles=((1.2, 0.8, 0.2), (-0.5, -1.5, 0.4)), force_field=((-1.0, 5.0), (-5.0, -1.0))
    ),
    "lockable joints": ArmParameters(lockable_joints=(1,)),
}

every_servo = pytest.mark.parametrize("servo", SERVOS)
every_condition = pytest.mark.parametrize("parameters", CONDITIONS.values(), ids=CONDITIONS.keys())


def random_postures(
    parameters: ArmParameters, random: np.random.Generator, count: int
) -> np.ndarray:
    joints = len(parameters.segment_lengths)
    limits = parameters.joint_limits or ((-math.pi, math.pi),) * joints
    return random.uniform(*np.transpose(limits), (count, joints))


def command_scale(parameters: ArmParameters, servo: Servo) -> float:
    return {
        "position": 2 * math.pi,
        "velocity": parameters.speed_limit,
        "torque": parameters.torque_limit,
    }[servo]


def assert_equal(arms: Arms, singles: list[Arm]) -> None:
    for name in ("segment_angles", "joint_angles", "joint_velocities"):
        assert getattr(arms, name).tolist() == [getattr(single, name) for single in singles]
    assert arms.end_effectors.tolist() == [list(single.end_effector) for single in singles]


def play_both(
    parameters: ArmParameters, servo: Servo, count: int, seed: int, steps: int, threads: int = 1
) -> None:
    """A random schedule of commands, partial resets and locks, of arms and of single ones."""
    random = np.random.default_rng(seed)
    arms = Arms(parameters, count, servo, threads)
    singles = [Arm(parameters, servo) for _ in range(count)]
    assert_equal(arms, singles)
    for _ in range(steps):
        if random.random() < 0.4:
            chosen = random.permutation(count)[: random.integers(0, count + 1)]
            postures = random_postures(parameters, random, len(chosen))
            speeds = random.uniform(-3, 3, postures.shape) if random.random() < 0.5 else None
            arms.reset(postures, chosen, speeds)
            for row, arm in enumerate(chosen):
                speed = None if speeds is None else speeds[row].tolist()
                singles[arm].reset(postures[row].tolist(), speed)
            assert_equal(arms, singles)
        if random.random() < 0.3:
            values = command_scale(parameters, servo) * random.uniform(
                -1.2, 1.2, arms.joint_angles.shape
            )
            arms.command(values)
            for single, value in zip(singles, values.tolist(), strict=True):
                single.command(value)
        if random.random() < 0.2:
            chosen = random.permutation(count)[: random.integers(0, count + 1)]
            arms.lock(chosen)
            for arm in chosen:
                singles[arm].lock()
        arms.step()
        for single in singles:
            single.step()
        assert_equal(arms, singles)
    gaps = [single.pivot_gap() for single in singles]
    np.testing.assert_allclose(arms.pivot_gaps(), gaps, atol=1e-15)
    arms.close()


# --- An arm among others is an arm alone


@every_servo
@every_condition
def test_every_arm_moves_as_a_single_one(
    parameters: ArmParameters, servo: Servo, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(batch_module, "ARMS_PER_SPACE", 4)
    for seed, count in enumerate((1, 4, 9)):
        play_both(parameters, servo, count, seed, steps=60)


@every_servo
def test_threads_change_nothing(servo: Servo, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(batch_module, "ARMS_PER_SPACE", 4)
    play_both(CONDITIONS["everything"], servo, count=18, seed=0, steps=60, threads=3)


def test_a_whole_space_of_arms_moves_as_single_ones() -> None:
    play_both(ArmParameters(), "position", count=150, seed=0, steps=20, threads=2)


@given(
    x=st.one_of(
        st.floats(-1e6, 1e6),
        st.integers(-1000, 1000).map(lambda n: n * math.pi),
        st.floats(allow_nan=False, allow_infinity=False),
    )
)
def test_the_remainder_is_that_of_the_standard(x: float) -> None:
    assert batch_module._remainder(np.array([x]), math.tau)[0] == math.remainder(x, math.tau)


# --- How it is used


def test_resetting_all_arms_needs_no_indices() -> None:
    random = np.random.default_rng(0)
    arms, named = Arms(count=70), Arms(count=70)
    postures = random.uniform(-math.pi, math.pi, (70, 3))
    arms.reset(postures)
    named.reset(postures, np.arange(70))
    np.testing.assert_allclose(arms.joint_angles, postures, atol=1e-15)
    for _ in range(5):
        arms.step()
        named.step()
    np.testing.assert_array_equal(arms.joint_angles, named.joint_angles)


def stepped_elsewhere(arms: Arms, results: "multiprocessing.Queue[list[list[float]]]") -> None:
    arms.step()
    results.put(arms.joint_angles.tolist())


@pytest.mark.skipif("fork" not in multiprocessing.get_all_start_methods(), reason="needs fork")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of a process with threads that forks
def test_a_forked_process_has_threads_of_its_own() -> None:
    arms = Arms(count=40, threads=2)
    arms.command(np.ones((40, 3)))
    arms.step()
    context = multiprocessing.get_context("fork")
    results: multiprocessing.Queue[list[list[float]]] = context.Queue()
    process = context.Process(target=stepped_elsewhere, args=(arms, results))
    process.start()
    elsewhere = results.get(timeout=30)
    process.join()
    arms.step()
    assert elsewhere == arms.joint_angles.tolist()
    arms.close()


def test_closed_arms_can_be_stepped_again() -> None:
    arms = Arms(count=40, threads=2)
    for _ in range(2):
        arms.step()
        arms.close()
        arms.close()


# --- What is refused


@pytest.mark.parametrize("copies", [pickle.dumps, copy.copy, copy.deepcopy])
def test_arms_cannot_be_copied(copies: object) -> None:
    with pytest.raises(TypeError, match="Arms cannot be pickled or copied"):
        copies(Arms(count=2))  # type: ignore[operator]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"count": 0}, "count must be a whole number of at least 1, got 0"),
        ({"threads": 0}, "threads must be a whole number of at least 1, got 0"),
        ({"servo": "hydraulic"}, "servo must be one of .* got 'hydraulic'"),
    ],
)
def test_impossible_batches_are_refused(arguments: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Arms(ArmParameters(), **arguments)  # type: ignore[arg-type]


def test_arrays_of_another_shape_and_unknown_arms_are_refused() -> None:
    arms = Arms(count=4)
    with pytest.raises(ValueError, match=r"values must be of shape \(4, 3\), got \(3,\)"):
        arms.command(np.zeros(3))
    with pytest.raises(ValueError, match=r"joint_angles must be of shape \(2, 3\), got \(4, 3\)"):
        arms.reset(np.zeros((4, 3)), [0, 1])
    with pytest.raises(ValueError, match=r"joint_velocities must be of shape \(4, 3\)"):
        arms.reset(np.zeros((4, 3)), joint_velocities=np.zeros(3))
    for unknown in ([4], [-1], [0, 0], [0.5], [True, False]):
        with pytest.raises(ValueError, match="arms must be different indices from 0 to 3"):
            arms.reset(np.zeros((len(unknown), 3)), unknown)
    arms.reset(np.zeros((0, 3)), [])
