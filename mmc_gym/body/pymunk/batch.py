"""Many arms in a few pymunk Spaces, commanded and read by arrays.

    arms      0 … 127    128 … 255    256 …
    group         0           1          2  …    stepped one after the other, or by several threads

One call into Chipmunk steps all arms of a Space, and one call reads them.  Every arm moves bit for
bit as a single `PymunkArm` does: Chipmunk solves the joints of a Space one after the other, and
those of an arm in the same order as if it were alone.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from itertools import repeat
from typing import Any, NoReturn

import numpy as np
import pymunk
from numpy.typing import ArrayLike
from pymunk._chipmunk_cffi import lib as chipmunk
from pymunk.batch import BodyFields, Buffer, get_space_bodies, set_space_bodies
from typing_extensions import override

from mmc_gym._errors import require
from mmc_gym.body.base import ArmBatch, Floats, Indices, NewParameters
from mmc_gym.body.parameters import ArmColumns, ArmParameters, Servo, joints_that_lock, stacked
from mmc_gym.body.pymunk.linkage import (
    FULL,
    MOTION,
    HandField,
    Linkage,
    Walls,
    change_space,
    forget_impulses,
    make_space,
    solver_iterations,
)

ARMS_PER_GROUP = 128  # larger groups need fewer calls, but fit the cache less well
_WORTH_A_THREAD = 16  # arms


class ArmGroup:
    """A group of `count` arms, from index `first` on, that are stepped and read together.

    They share a Space.  With obstacles each has its own, because they would collide, and so it has
    if they may differ in the number of sweeps or in gravity, which belong to a Space.  But if all
    masses are 1, arms that differ in gravity share a Space without gravity, and a force pulls each
    segment: as gravity would, to the last bit.
    """

    def __init__(
        self, parameters: ArmParameters, servo: Servo, arms: slice, others: Sequence[ArmParameters]
    ) -> None:
        self.arms, count = arms, arms.stop - arms.start
        every = parameters, *others
        self._servo, self._may_differ = servo, bool(others)
        gravities_differ = len({p.gravity for p in every}) > 1
        masses_are_1 = all(rod.mass == 1.0 for p in every for rod in p.rods)
        self.sweeps = solver_iterations(parameters)  #: of all arms that share a Space
        self.is_apart = (
            (gravities_differ and not masses_are_1)
            or len(set(map(solver_iterations, every))) > 1
            or any(p.obstacles for p in every)
        )
        #: whether forces stand for gravity
        self._is_pulled = gravities_differ and not self.is_apart
        self._has_brakes = any(p.has_friction for p in every)
        self._shape = count, len(parameters.segment_lengths)
        spaces, arms_per_space = (count, 1) if self.is_apart else (1, count)
        self._segments_per_space = arms_per_space * self._shape[1]
        bodies = self._segments_per_space + self.is_apart  # all obstacles are the last
        self._buffer = Buffer()
        self._pushes = np.zeros((spaces, bodies, 3))  # of each body: force x, y and torque
        self._push_buffers = [Buffer() for _ in range(spaces)]
        for buffer, pushes in zip(self._push_buffers, self._pushes):
            buffer.set_float_buf(pushes)
        self._yields = np.ones(self._shape)
        self._pulls = np.zeros((*self._shape, 3))  # of gravity on each segment
        self.walls: Walls | None = None
        self._spaces = [make_space(parameters) for _ in range(spaces)]
        self._scratch = pymunk.Space()  # empty but while impulses are forgotten
        self._scratch.iterations = 1
        by_arm = [space for space in self._spaces for _ in range(arms_per_space)]
        self.linkages = [self._link(space, parameters) for space in by_arm]
        self._collect()

    def _link(self, space: pymunk.Space, parameters: ArmParameters) -> Linkage:
        joints = {"has_ground": self.is_apart, "has_brakes": self._has_brakes}
        return Linkage(space, parameters, self._servo, **joints)

    def _collect(self) -> None:
        self._rubbed = [each for each in self.linkages if each.parameters.has_friction]
        self._servos = [servo for linkage in self.linkages for servo in linkage.servo_handles]
        self._bodies = [body for linkage in self.linkages for body, _, _ in linkage.rods]
        every = [linkage.parameters for linkage in self.linkages]
        self._substeps = np.array([[p.substeps] for p in every])
        self._substep = np.array([[p.substep] for p in every])
        #: of each Space: its physics steps in a control step, their duration, and its handle
        self._paces = [
            (p.substeps, p.substep, space._space) for p, space in zip(every, self._spaces)
        ]
        self._field: HandField | None = None
        if any(p.force_field is not None for p in every):
            self._field = HandField(every if self._may_differ else every[:1])
        if self._is_pulled:
            self._spaces[0].gravity = 0.0, 0.0
            masses = np.array([[rod.mass for rod in p.rods] for p in every])
            falls = np.array([[p.gravity] for p in every])
            self._pulls[..., :2] = masses[..., None] * falls
            self._pushes[0] = self._pulls.reshape(-1, 3)

    def drive(self, settings: Floats, torques: Floats) -> None:
        """Set the servos: their phases or rates, and their largest torques, (count, N)."""
        is_position = self._servo == "position"
        drive = chipmunk.cpGearJointSetPhase if is_position else chipmunk.cpSimpleMotorSetRate
        deque(map(drive, self._servos, settings.ravel().tolist()), maxlen=0)
        if self._servo == "torque":
            limits = torques.ravel().tolist()
            deque(map(chipmunk.cpConstraintSetMaxForce, self._servos, limits), maxlen=0)

    def step(self, effort: tuple[Floats, Floats] | None) -> None:
        """Simulate a control step; write the servos' impulses and work (count, N) to `effort`."""
        if self.walls is not None:
            self.walls.contacts[:] = 0.0
        is_pushed = self._field is not None or self.walls is not None or self._is_pulled
        if not is_pushed and not effort and not self._rubbed:
            simulate = chipmunk.cpSpaceStep
            for substeps, substep, space in self._paces:
                for _ in range(substeps):
                    simulate(space, substep)
            return
        before = self._joint_velocities() if effort else np.empty(0)
        for array in effort or ():
            array[:] = 0.0
        for number in range(self._substeps.max()):
            if is_pushed:
                self._push(number)
            for linkage in self._rubbed:
                linkage.rub()
            for substeps, substep, space in self._paces:
                if number < substeps:
                    chipmunk.cpSpaceStep(space, substep)
            if self._field is not None:
                self._yields[:] = self._find_yields()
            if effort:
                after = self._joint_velocities()
                now = self._read(chipmunk.cpConstraintGetImpulse, self._servos)
                now *= number < self._substeps
                impulses, work = effort
                impulses += now
                work += now * np.abs(before + after) / 2
                before = after

    def _find_yields(self) -> ArrayLike:
        """Return `Linkage.yields` of all arms, (count, N); without stops and locks all at once."""
        if self.linkages[0].stops or self.linkages[0].locks:
            return [linkage.yields() for linkage in self.linkages]
        give = self._read(chipmunk.cpConstraintGetImpulse, self._servos)
        most = self._read(chipmunk.cpConstraintGetMaxForce, self._servos)
        return give >= FULL * most * self._substep

    def _joint_velocities(self) -> Floats:
        if len(self._spaces) > 1:  # a call for each body is quicker than one for each Space
            return _relative(self._read(chipmunk.cpBodyGetAngularVelocity, self._bodies))
        return _relative(self._fields(BodyFields.ANGULAR_VELOCITY)[:, :, 0])

    def _read(self, read: Callable[[Any], float], handles: Sequence[Any]) -> Floats:
        """Return what Chipmunk has for the handle of each joint or segment, (count, N)."""
        return np.fromiter(map(read, handles), np.float64, len(handles)).reshape(self._shape)

    def _fields(self, fields: BodyFields) -> Floats:
        """Return these fields of all segments, (count, N, values), valid until the next call."""
        self._buffer.clear()
        for space in self._spaces:
            get_space_bodies(space, fields, self._buffer)
        spaces, bodies, _ = self._pushes.shape
        of_bodies = np.frombuffer(self._buffer.float_buf()).reshape(spaces, bodies, -1)
        of_segments = of_bodies[:, : self._segments_per_space]
        return of_segments.reshape(*self._shape, -1)

    def read(self, angles: Floats, velocities: Floats) -> None:
        """Write the segments' angles and angular velocities to two arrays (count, N)."""
        if len(self._spaces) > 1:
            angles[:] = self._read(chipmunk.cpBodyGetAngle, self._bodies)
            velocities[:] = self._read(chipmunk.cpBodyGetAngularVelocity, self._bodies)
            return
        state = self._fields(BodyFields.ANGLE | BodyFields.ANGULAR_VELOCITY)
        angles[:], velocities[:] = state[:, :, 0], state[:, :, 1]

    def _push(self, number: int) -> None:
        """Set forces and torques on the segments for physics step `number`."""
        if self._field is not None or self.walls is not None:
            count, motion = self._shape[1], self._fields(MOTION)
            pushes: Floats = np.zeros((self._shape[0], 3))
            if self._field is not None:
                pushes = self._field.impulses(motion, self._yields) / self._substep
            if self.walls is not None:
                pushes = pushes + self.walls.pushes(motion)
            pushes = self._pulls[:, -1] + pushes  # in the order in which Chipmunk adds gravity
            of_hands = self._pushes[:, count - 1 : self._segments_per_space : count]
            of_hands[:] = pushes.reshape(of_hands.shape)
        for space, buffer, (substeps, *_) in zip(self._spaces, self._push_buffers, self._paces):
            if number < substeps:
                set_space_bodies(space, BodyFields.FORCE | BodyFields.TORQUE, buffer)

    def reset(
        self,
        members: Sequence[int],
        joint_angles: Sequence[Sequence[float]],
        joint_velocities: Sequence[Sequence[float]],
        parameters: Sequence[ArmParameters] | None = None,
    ) -> None:
        """Place the arms `members` of the group."""
        for member, p in zip(members, parameters or ()):
            is_possible = self.is_apart or self.linkages[member].can_become(p)
            require(is_possible, "parameters", p, "such as those of `others`, or between them")
        of_members = parameters or [self.linkages[member].parameters for member in members]
        standing = []  # arms that are not built anew, with their Spaces
        for member, p in zip(members, of_members):
            linkage, space = self.linkages[member], self._spaces[member * self.is_apart]
            # Chipmunk remembers contacts, and cannot forget them.
            if self.is_apart and (
                linkage.parameters.obstacles or p.obstacles or not linkage.can_become(p)
            ):
                self._spaces[member] = space = make_space(p)
                self.linkages[member] = self._link(space, p)
                continue
            standing.append((linkage, space))
            if parameters is not None:
                linkage.change(p)
                if self.is_apart:
                    change_space(space, p)
        if parameters is not None or len(standing) < len(members):
            self._collect()
        linkages = [linkage for linkage, _ in standing]
        if self.is_apart:
            for linkage, space in standing:
                forget_impulses(space, [linkage], linkage.parameters.substep)
        elif len(linkages) == len(self.linkages):
            forget_impulses(self._spaces[0], linkages, self._paces[0][1])
        else:  # the other arms must not move
            for linkage in linkages:
                linkage.move_joints(self._spaces[0], self._scratch)
            forget_impulses(self._scratch, linkages, self._paces[0][1])
            for linkage in linkages:
                linkage.move_joints(self._scratch, self._spaces[0])
        for member, posture, speeds in zip(members, joint_angles, joint_velocities):
            self.linkages[member].place(posture, speeds)
        self._yields[members] = 1.0
        if self.walls is not None:
            self.walls.confine(members, np.zeros(2), np.zeros(2))

    def confine(self, members: Sequence[int], starts: Floats, ends: Floats) -> None:
        """Confine the hands of some arms, see `SingleArm.confine`."""
        self.walls = self.walls or Walls(self.linkages)
        self.walls.confine(members, starts, ends)

    def load(self, members: Sequence[int], parameters: Sequence[ArmParameters]) -> None:
        """Load some arms, see `SingleArm.load`."""
        for member, p in zip(members, parameters, strict=True):
            self.linkages[member].load(self._spaces[member * self.is_apart], p)
        self._collect()


def _relative(absolute: Floats) -> Floats:
    """Return angles or velocities of joints from those of segments, (..., N)."""
    differences = absolute.copy()
    differences[..., 1:] -= absolute[..., :-1]
    return differences


def _each(function: Callable[..., float], values: Floats, *arguments: float) -> Floats:
    """Apply a function of `math` to each value; numpy's may differ in the last bit."""
    numbers = map(function, values.ravel().tolist(), *map(repeat, arguments))
    return np.fromiter(numbers, np.float64, values.size).reshape(values.shape)


class PymunkArmBatch(ArmBatch):
    """Arms simulated by pymunk; see `ArmBatch`.  They cannot be copied or pickled."""

    @override
    def _build(self) -> None:
        shape = self._shape
        self.segment_angles, self.joint_angles = np.zeros(shape), np.zeros(shape)
        self.joint_velocities, self._segment_velocities = np.zeros(shape), np.zeros(shape)
        self.end_effectors = np.zeros((self._count, 2))
        fair = max(_WORTH_A_THREAD, -(-self._count // self._threads))
        self._arms_per_group = most = min(ARMS_PER_GROUP, fair)
        every = self.parameters, *self._others
        self._groups = [
            ArmGroup(
                replace(self.parameters, lockable_joints=tuple(sorted(joints_that_lock(every)))),
                self._servo,
                slice(first, min(first + most, self._count)),
                self._others,
            )
            for first in range(0, self._count, most)
        ]
        self._settings: Floats = np.zeros(shape)  # of the servos: phases or rates
        self._torques: Floats = np.full(shape, self.parameters.torque_limit)
        self._lengths, self._lowest, self._highest = np.zeros((3, *shape))
        self._speed_limits, self._torque_limits = np.zeros((2, self._count, 1))
        self._note(np.arange(self._count), self.parameters)
        self._commanded = False  # whether the next step has to set the servos

    def _note(self, arms: Indices, p: ArmParameters) -> None:
        """Keep the parameters of these arms that are read in every step."""
        self._lengths[arms] = stacked(p.segment_lengths)
        self._speed_limits[arms] = np.reshape(p.speed_limit, (-1, 1))
        self._torque_limits[arms] = np.reshape(p.torque_limit, (-1, 1))
        if p.joint_limits is not None:
            lowest, highest = zip(*p.joint_limits)
            self._lowest[arms], self._highest[arms] = stacked(lowest), stacked(highest)

    @override
    def can_become(self, arm: int, parameters: ArmParameters) -> bool:
        group = self._groups[arm // self._arms_per_group]
        has_joints = group.linkages[arm % self._arms_per_group].can_become(parameters)
        return group.is_apart or (has_joints and group.sweeps == solver_iterations(parameters))

    @override
    def _command(self, values: Floats, arms: slice | Indices = slice(None)) -> None:
        fastest = self._speed_limits[arms]
        if self._servo == "velocity":
            self._settings[arms] = -np.minimum(np.maximum(values, -fastest), fastest)
        elif self._servo == "torque":
            self._settings[arms] = np.copysign(fastest, -values)
            self._torques[arms] = np.minimum(np.abs(values), self._torque_limits[arms])
        elif self.parameters.joint_limits is None:
            angles = self.joint_angles[arms]
            self._settings[arms] = angles + _each(math.remainder, values - angles, math.tau)
        else:
            low, high = self._lowest[arms], self._highest[arms]
            self._settings[arms] = np.minimum(np.maximum(values, low), high)
        self._commanded = True

    @override
    def step(self) -> None:
        shared = min(self._threads, len(self._groups)) > 1
        running = []
        # This thread sets the servos of a group while others simulate the groups before it.
        for group in self._groups:
            if self._commanded:
                group.drive(self._settings[group.arms], self._torques[group.arms])
            if shared:
                running.append(self._executor().submit(self._simulate, group))
            else:
                self._simulate(group)
        self._commanded = False
        for simulation in running:
            simulation.result()
        self._derive(slice(None))
        self._require_control()

    def _simulate(self, group: ArmGroup) -> None:
        arms, effort = group.arms, None
        if self.records_effort:
            effort = self.servo_impulses[arms], self.servo_work[arms]
        group.step(effort)
        group.read(self.segment_angles[arms], self._segment_velocities[arms])

    def _derive(self, arms: slice | Indices) -> None:
        """Compute joints and hands from the segments' angles and velocities."""
        angles = self.segment_angles[arms]
        self.joint_angles[arms] = _relative(angles)
        self.joint_velocities[arms] = _relative(self._segment_velocities[arms])
        x, y = _each(math.cos, angles), _each(math.sin, angles)
        hands = np.zeros((len(angles), 2))
        for segment, length in enumerate(self._lengths[arms].T):
            hands[:, 0] += length * x[:, segment]  # in the order in which `PymunkArm` adds them
            hands[:, 1] += length * y[:, segment]
        self.end_effectors[arms] = hands

    @override
    def _place(self, arms: Indices, postures: Floats, speeds: Floats, new: NewParameters) -> None:
        rows: list[ArmColumns] = []
        for changed_arms, parameters in new:
            rows += ArmColumns.of(parameters).rows(len(changed_arms))
            self._note(changed_arms, parameters)
        for group, part, members in self._by_group(arms):
            angles, velocities = postures[part].tolist(), speeds[part].tolist()
            of_members = [rows[row] for row in part] if rows else None
            group.reset(members, angles, velocities, of_members)
        self.segment_angles[arms] = np.cumsum(postures, axis=1)
        self._segment_velocities[arms] = np.cumsum(speeds, axis=1)
        self._derive(arms)
        self._command(postures if self._servo == "position" else np.zeros_like(postures), arms)

    @override
    def _lock(self, arms: Indices) -> None:
        for group, _, members in self._by_group(arms):
            for member in members:
                angles = self.joint_angles[group.arms.start + member]
                group.linkages[member].lock(angles.tolist())

    @override
    def _unlock(self, arms: Indices) -> None:
        for group, _, members in self._by_group(arms):
            for member in members:
                group.linkages[member].unlock()

    @override
    def confine(self, arms: ArrayLike, starts: Floats, ends: Floats) -> None:
        for group, part, members in self._by_group(self._indices(arms)):
            group.confine(members, starts[part], ends[part])

    @property
    def contacts(self) -> Floats:  # type: ignore[override]
        """Contact of each arm, (count, 2)."""
        contacts = np.zeros((self._count, 2))
        for group in self._groups:
            if group.walls is not None:
                contacts[group.arms] = group.walls.contacts
        return contacts

    @override
    def _load(self, parameters: ArmParameters, arms: Indices) -> None:
        rows = ArmColumns.of(parameters).rows(len(arms))
        for group, part, members in self._by_group(arms):
            group.load(members, [rows[row] for row in part])

    def __reduce__(self) -> NoReturn:
        # Chipmunk does not expose the impulses that its joints remember.
        raise TypeError("a PymunkArmBatch cannot be pickled or copied: pickle its parameters")

    def _by_group(self, arms: Indices) -> Iterable[tuple[ArmGroup, Indices, list[int]]]:
        """Yield each group with some of `arms`, their rows in `arms`, and their numbers in it."""
        owners = arms // self._arms_per_group
        for owner in np.unique(owners).tolist():
            part, group = np.flatnonzero(owners == owner), self._groups[owner]
            yield group, part, (arms[part] - group.arms.start).tolist()
