"""Many equal arms in a few pymunk Spaces, commanded and read by arrays.

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
from itertools import repeat
from typing import Any, NoReturn

import numpy as np
import pymunk
from numpy.typing import ArrayLike
from pymunk._chipmunk_cffi import lib as chipmunk
from pymunk.batch import BodyFields, Buffer, get_space_bodies, set_space_bodies
from typing_extensions import override

from mmc_gym.body.base import ArmBatch, Floats, Indices
from mmc_gym.body.parameters import ArmParameters, Servo
from mmc_gym.body.pymunk.linkage import (
    FULL,
    MOTION,
    HandField,
    Linkage,
    forget_impulses,
    make_space,
)

ARMS_PER_GROUP = 128  # larger groups need fewer calls, but fit the cache less well
_WORTH_A_THREAD = 16  # arms


class ArmGroup:
    """A group of `count` arms, from index `first` on, that are stepped and read together.

    They share a Space.  Arms with obstacles have a Space each, because they would collide.
    """

    def __init__(self, parameters: ArmParameters, servo: Servo, first: int, count: int) -> None:
        self.arms = slice(first, first + count)
        self._parameters, self._servo = parameters, servo
        self._shape = count, len(parameters.segment_lengths)
        spaces, arms_per_space = (count, 1) if parameters.obstacles else (1, count)
        self._segments_per_space = arms_per_space * self._shape[1]
        bodies = self._segments_per_space + bool(parameters.obstacles)  # all obstacles are the last
        self._buffer = Buffer()
        self._field = None if parameters.force_field is None else HandField(parameters)
        self._pushes = np.zeros((spaces, bodies, 3))  # of each body: force x, y and torque
        self._push_buffers = [Buffer() for _ in range(spaces)]
        for buffer, pushes in zip(self._push_buffers, self._pushes):
            buffer.set_float_buf(pushes)
        self._yields = np.ones(self._shape)
        self._spaces = [make_space(parameters) for _ in range(spaces)]
        by_arm = [space for space in self._spaces for _ in range(arms_per_space)]
        self.linkages = [Linkage(space, parameters, servo) for space in by_arm]
        self._find_handles()

    def _find_handles(self) -> None:
        self._servos = [servo for linkage in self.linkages for servo in linkage.servo_handles]
        self._bodies = [body for linkage in self.linkages for body, _, _ in linkage.rods]

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
        substep = self._parameters.substep
        before = self._joint_velocities() if effort else np.empty(0)
        for array in effort or ():
            array[:] = 0.0
        for _ in range(self._parameters.substeps):
            if self._field is not None:
                self._push_hands(self._field)
            for space in self._spaces:
                chipmunk.cpSpaceStep(space._space, substep)
            if self._field is not None:
                self._yields[:] = self._find_yields(substep)
            if effort:
                after = self._joint_velocities()
                now = self._read(chipmunk.cpConstraintGetImpulse, self._servos)
                impulses, work = effort
                impulses += now
                work += now * np.abs(before + after) / 2
                before = after

    def _find_yields(self, substep: float) -> ArrayLike:
        """Return `Linkage.yields` of all arms, (count, N); without stops and locks all at once."""
        if self._parameters.joint_limits is not None or self._parameters.lockable_joints:
            return [linkage.yields(substep) for linkage in self.linkages]
        give = self._read(chipmunk.cpConstraintGetImpulse, self._servos)
        most = self._read(chipmunk.cpConstraintGetMaxForce, self._servos)
        return give >= FULL * most * substep

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

    def _push_hands(self, field: HandField) -> None:
        """Set the field's forces and torques on the last segments for the next physics step."""
        count = self._shape[1]
        pushes = field.impulses(self._fields(MOTION), self._yields) / self._parameters.substep
        of_hands = self._pushes[:, count - 1 : self._segments_per_space : count]
        of_hands[:] = pushes.reshape(of_hands.shape)
        for space, buffer in zip(self._spaces, self._push_buffers):
            set_space_bodies(space, BodyFields.FORCE | BodyFields.TORQUE, buffer)

    def reset(
        self,
        members: Sequence[int],
        joint_angles: Sequence[Sequence[float]],
        joint_velocities: Sequence[Sequence[float]],
        scratch: pymunk.Space,
    ) -> None:
        """Place the arms `members` of the group; `scratch` is an empty Space."""
        if self._parameters.obstacles:  # Chipmunk remembers contacts, and cannot forget them
            self._rebuild(members)
        linkages = [self.linkages[member] for member in members]
        if not self._parameters.obstacles:
            self._forget_impulses(linkages, scratch)
        for linkage, posture, speeds in zip(linkages, joint_angles, joint_velocities):
            linkage.place(posture, speeds)
        self._yields[members] = 1.0

    def _rebuild(self, members: Sequence[int]) -> None:
        """Build these arms and their Spaces anew."""
        for member in members:
            self._spaces[member] = space = make_space(self._parameters)
            self.linkages[member] = Linkage(space, self._parameters, self._servo)
        self._find_handles()

    def _forget_impulses(self, linkages: Sequence[Linkage], scratch: pymunk.Space) -> None:
        """Clear what the joints of these arms remember; the other arms do not move."""
        [space], substep = self._spaces, self._parameters.substep
        if len(linkages) == len(self.linkages):
            forget_impulses(space, linkages, substep)
            return
        for linkage in linkages:
            linkage.move_joints(space, scratch)
        forget_impulses(scratch, linkages, substep)
        for linkage in linkages:
            linkage.move_joints(scratch, space)


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
        self._groups = [
            ArmGroup(self.parameters, self._servo, first, min(most, self._count - first))
            for first in range(0, self._count, most)
        ]
        self._settings: Floats = np.zeros(shape)  # of the servos: phases or rates
        self._torques: Floats = np.full(shape, self.parameters.torque_limit)
        self._commanded = False  # whether the next step has to set the servos
        self._scratch = pymunk.Space()
        self._scratch.iterations = 1

    @override
    def _command(self, values: Floats, arms: slice | Indices = slice(None)) -> None:
        p = self.parameters
        if self._servo == "velocity":
            self._settings[arms] = -np.minimum(np.maximum(values, -p.speed_limit), p.speed_limit)
        elif self._servo == "torque":
            self._settings[arms] = np.copysign(p.speed_limit, -values)
            self._torques[arms] = np.minimum(np.abs(values), p.torque_limit)
        elif p.joint_limits is None:
            angles = self.joint_angles[arms]
            self._settings[arms] = angles + _each(math.remainder, values - angles, math.tau)
        else:
            low, high = np.transpose(p.joint_limits)
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
        for each in running:
            each.result()
        self._derive(slice(None))

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
        for segment, length in enumerate(self.parameters.segment_lengths):
            hands[:, 0] += length * x[:, segment]  # in the order in which `PymunkArm` adds them
            hands[:, 1] += length * y[:, segment]
        self.end_effectors[arms] = hands

    @override
    def _place(self, arms: Indices, postures: Floats, speeds: Floats) -> None:
        for group, part, members in self._by_group(arms):
            group.reset(members, postures[part].tolist(), speeds[part].tolist(), self._scratch)
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

    def __reduce__(self) -> NoReturn:
        # Chipmunk does not expose the impulses that its joints remember.
        raise TypeError("a PymunkArmBatch cannot be pickled or copied: pickle its parameters")

    def _by_group(self, arms: Indices) -> Iterable[tuple[ArmGroup, Indices, list[int]]]:
        """Yield each group with some of `arms`, their rows in `arms`, and their numbers in it."""
        owners = arms // self._arms_per_group
        for owner in np.unique(owners).tolist():
            part = np.flatnonzero(owners == owner)
            group = self._groups[owner]
            yield group, part, (arms[part] - group.arms.start).tolist()
