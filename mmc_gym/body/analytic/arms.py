"""Arms whose equations of motion are integrated by compiled code, for millions of episodes.

The physics and the physics steps are those of pymunk's arms.  Chipmunk approaches the forces of the
joints by sweeps; this engine solves for them, so pivots and torques are exact.  `kernel` has the
equations.  With 3,000 sweeps in a physics step, Chipmunk's joint angles agree to 1e-6 rad after
2 s.

The error of a slack arm is of second order in the substep: 5.4e-4 rad after 2 s at 5 ms, and 1.3e-4
at 2.5 ms (median of 60 arms released at up to 3 rad/s).  That of a driven arm is of first order (at
most 0.02 and 0.01 rad on its way), because the servos read the angles once in a substep.

This engine does not compute the effort of its servos: `records_effort` has no effect.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from mmc_gym._errors import require
from mmc_gym.body.analytic import kernel
from mmc_gym.body.base import ArmBatch, Floats, Indices, NewParameters, SingleArm
from mmc_gym.body.parameters import ArmColumns, ArmParameters, Servo, stacked

_WORTH_A_THREAD = 256  # arms; a thread for fewer costs more time than it saves
_STOP_RATE = -60 * math.log(0.9)  # a stop corrects 10 % of its error in 1/60 s, pymunk's default

_LEAST_INDEPENDENCE = 1e-14  # with less, rounding leaves mass matrices that are not positive

Records = NDArray[np.void]


def _fields(names: str, *shape: int) -> list[tuple[str, type[np.float64], tuple[int, ...]]]:
    return [(name, np.float64, shape) for name in names.split()]


def _make_records(segments: int, count: int) -> tuple[Records, Records, Records]:
    """Return the state of `count` arms, their public values, and the type of working memory.

    The state is one record per block of arms, with arrays (N, lanes): `lag` is the part of the
    velocity of u_j that closes the pivots; `asked` is the servo's command, `limit` its largest
    impulse; `held` is the angle of a locked joint, or nan; `yields` is 1 where the servo gave its
    largest torque.  Public values are one record per arm, with arrays (N,) and the hand (2,).

    The working memory of a block is an empty array.  Compiled functions take its type and allocate
    the record, many times faster than numpy does.
    """
    lanes = 16 if segments <= 4 else 8  # the records of a block fit the cache
    names = "angle speed lag_x lag_y asked limit held yields"
    state = np.zeros(-(-count // lanes), _fields(names, segments, lanes))
    names = "segment_angles joint_angles joint_velocities joint_cosines joint_sines"
    shown = np.zeros(count, [*_fields(names, segments), *_fields("end_effector", 2)])
    names = (
        "sine cosine free_x free_y demand turn lowest highest stop_above stop_below load_x load_y "
        "grip drag friction needed bound moment_x moment_y right inverse excess"
    )
    fields = _fields(names, segments, lanes)
    fields += _fields("push_x push_y push_turn velocity_x velocity_y changed is_done", lanes)
    fields += _fields("matrix factor", segments, segments, lanes)
    return state, shown, np.empty(0, fields)


def _make_chain(parameters: ArmParameters, servo: Servo, lanes: int) -> Records:
    """Return the record of a block of equal arms: segments, each with the joint before it."""
    p, count = parameters, len(parameters.segment_lengths)
    fields = _fields("length mass centre inertia lowest_angle highest_angle", count, lanes)
    fields += _fields("speed_limit torque_limit gain joint_friction joint_damping", lanes)
    fields += _fields("gravity", 2, lanes) + _fields("field", 2, 2, lanes)
    fields += _fields("substep stop_gain is_position is_torque has_field has_friction")
    chain = np.zeros(1, fields)
    chain["substep"] = p.substep
    chain["stop_gain"] = -math.expm1(-_STOP_RATE * p.substep) / p.substep
    chain["is_position"], chain["is_torque"] = servo == "position", servo == "torque"
    _write(chain, np.zeros(lanes, np.intp), np.arange(lanes), p)
    return chain


def _write(chain: Records, blocks: Indices, lanes: Indices, p: ArmParameters) -> None:
    """Write the parameters of k arms, which may be `ArmColumns`, into their blocks and lanes."""
    masses, centres, inertias = zip(*p.rods, strict=True)
    lowest, highest = zip(*(p.joint_limits or [(-math.inf, math.inf)] * len(masses)), strict=True)
    decays = [-math.expm1(-gain * p.substep) for gain in np.ravel(p.servo_gain).tolist()]
    field = p.force_field or ((0.0, 0.0), (0.0, 0.0))
    values = {
        "length": stacked(p.segment_lengths),
        "mass": stacked(masses),
        "centre": stacked(centres),
        "inertia": stacked(inertias),
        "lowest_angle": stacked(lowest),
        "highest_angle": stacked(highest),
        "speed_limit": p.speed_limit,
        "torque_limit": p.torque_limit,
        "joint_friction": p.joint_friction,
        "joint_damping": p.joint_damping,
        "gain": np.divide(decays, p.substep),
        "gravity": stacked(p.gravity),
        "field": (of_rows := stacked([*field[0], *field[1]])).reshape(*of_rows.shape[:-1], 2, 2),
    }
    for name, value in values.items():
        chain[name][blocks, ..., lanes] = value
    chain["has_field"] = chain["field"].any(axis=(1, 2, 3))
    rubs = chain["joint_friction"] + chain["joint_damping"]
    chain["has_friction"] = rubs.any(axis=1)


def _independence(parameters: ArmParameters) -> float:
    """Return the least eigenvalue of the stretched arm's mass matrix, of joints scaled to 1."""
    lengths = parameters.segment_lengths
    joints = np.cumsum([0.0, *lengths[:-1]])
    matrix = np.zeros((len(lengths), len(lengths)))
    for number, rod in enumerate(parameters.rods):
        turns = np.arange(len(lengths)) <= number  # the joints that turn this segment
        arms = turns * (joints[number] + rod.centre - joints)
        matrix += rod.mass * np.outer(arms, arms) + rod.inertia * np.outer(turns, turns)
    scale = np.sqrt(np.diag(matrix))
    return float(np.linalg.eigvalsh(matrix / np.outer(scale, scale))[0])


class AnalyticArmBatch(ArmBatch):
    """Arms of the analytic engine; see `ArmBatch`.

    Arms can be pickled and copied at any time; the copy moves as the original does, bit for bit.

    Attributes:
        shown: all public arrays in one, with a record for each arm (`_make_records`).
        joint_cosines: cosines of the joint angles, (count, N).
        joint_sines: their sines, (count, N).
    """

    @override
    def _build(self) -> None:
        p = self.parameters
        accepted = 'empty for the analytic engine, which knows no collisions (use engine="pymunk")'
        require(not p.obstacles, "obstacles", p.obstacles, accepted)
        accepted = (
            "larger for the analytic engine, or lengths and masses more alike: the movements of "
            'the joints cannot be told apart (engine="pymunk" takes such arms)'
        )
        is_clear = _independence(p) > _LEAST_INDEPENDENCE
        require(is_clear, "drive_inertia", p.drive_inertia, accepted)
        self._state, shown, self._no_work = _make_records(self._shape[1], self._count)
        self._lanes = self._state["angle"].shape[-1]
        self._lockable = ArmColumns.of(p).lockable(self._count)
        #: one record, or one for each block if arms differ
        self._chain = _make_chain(p, self._servo, self._lanes)
        self._show(shown)

    def _show(self, shown: Records) -> None:
        """Make the public arrays views of `shown`."""
        self.shown, self._numbers = shown, shown.view(np.float64)
        self.segment_angles, self.joint_angles = shown["segment_angles"], shown["joint_angles"]
        self.joint_velocities, self.end_effectors = shown["joint_velocities"], shown["end_effector"]
        self.joint_cosines, self.joint_sines = shown["joint_cosines"], shown["joint_sines"]

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "_pool": None}  # threads belong to a process

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._show(self.shown)  # copying or unpickling turns views into separate arrays

    @override
    def _place(self, arms: Indices, postures: Floats, speeds: Floats, new: NewParameters) -> None:
        for changed_arms, parameters in new:
            self._load(parameters, changed_arms)
            self._lockable[changed_arms] = ArmColumns.of(parameters).lockable(len(changed_arms))
        kernel.place(self._state, self.shown, self._chain, self._no_work, arms, postures, speeds)

    @override
    def _command(self, values: Floats) -> None:
        self.command_arms(values, 1.0, False, 0, self._count)

    @override
    def step(self) -> None:
        self.share_out(self.step_arms)

    def share_out(self, work: Callable[[int, int], None]) -> None:
        """Call `work(first, last)` for shares of the arms, each `first` to `last` - 1.

        The calling thread does the first share, other threads one each.  Then raise a `UserError`
        if an arm is out of control, see `SingleArm.step`.
        """
        shares = max(1, min(self._threads, self._count // _WORTH_A_THREAD))
        blocks = [len(self._state) * share // shares for share in range(1, shares)]
        edges = [0, *(self._lanes * block for block in blocks), self._count]
        others = [self._executor().submit(work, first, last) for first, last in pairwise(edges[1:])]
        work(*edges[:2])
        for other in others:
            other.result()
        self._require_control()

    def command_arms(
        self, values: NDArray[np.floating], scale: float, is_relative: bool, first: int, last: int
    ) -> None:
        """Command `scale` times `values`, (count, N), to the servos of a share of the arms.

        Relative values are added to the present joint angles.  `values` are float32 or float64, in
        C order.
        """
        state, chain = self._blocks(first, last)
        kernel.command(state, chain, values[first:last], scale, is_relative)

    def step_arms(self, first: int, last: int) -> None:
        """Simulate one control step of a share of the arms."""
        state, chain = self._blocks(first, last)
        kernel.step(state, self.shown[first:last], chain, self._no_work, self.parameters.substeps)

    def _blocks(self, first: int, last: int) -> tuple[Records, Records]:
        """Return state and chain of arms `first` to `last` - 1; `first` begins a block."""
        if last - first == self._count:  # cutting out takes a tenth of a step of one arm
            return self._state, self._chain
        blocks = slice(first // self._lanes, -(-last // self._lanes))
        return self._state[blocks], self._chain[blocks] if len(self._chain) > 1 else self._chain

    @override
    def _lock(self, arms: Indices) -> None:
        rows, joints = np.nonzero(self._lockable[arms])
        arms = arms[rows]
        held = self._state["held"]
        held[arms // self._lanes, joints, arms % self._lanes] = self.joint_angles[arms, joints]

    @override
    def _unlock(self, arms: Indices) -> None:
        self._state["held"][arms // self._lanes, :, arms % self._lanes] = np.nan

    @override
    def _load(self, parameters: ArmParameters, arms: Indices) -> None:
        if len(self._chain) < len(self._state):
            self._chain = np.repeat(self._chain, len(self._state))
        _write(self._chain, arms // self._lanes, arms % self._lanes, parameters)


class AnalyticArm(SingleArm):
    """One arm of the analytic engine; see `SingleArm`."""

    @override
    def _build(self) -> None:
        self._arms = AnalyticArmBatch(self.parameters, 1, self._servo, others=[self.parameters])

    @override
    def _place(self, joint_angles: Sequence[float], joint_velocities: Sequence[float]) -> None:
        self._arms.reset([joint_angles], None, [joint_velocities])
        self._read()

    @override
    def _command(self, values: Sequence[float]) -> None:
        self._arms._command(np.array([values], dtype=np.float64))

    @override
    def step(self) -> None:
        self._arms.step_arms(0, 1)
        self._read()
        self._require_control()

    def _read(self) -> None:
        numbers, count = self._arms._numbers.tolist(), self._count
        self.segment_angles = numbers[:count]
        self.joint_angles = numbers[count : 2 * count]
        self.joint_velocities = numbers[2 * count : 3 * count]
        self.end_effector = numbers[-2], numbers[-1]

    @override
    def lock(self) -> None:
        self._arms.lock([0])

    @override
    def unlock(self) -> None:
        self._arms.unlock([0])

    @override
    def load(self, parameters: ArmParameters) -> None:
        self._arms.load(parameters, [0])
