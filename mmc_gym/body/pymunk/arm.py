"""One planar arm in a pymunk Space: N uniform rods on pivots, with a servo at every joint.

The rods have no shapes (nothing collides) unless there are obstacles, and the plane is horizontal
unless gravity is set.

A servo is a constraint, solved implicitly inside the physics step, so that it is stable at the full
substep and needs one write per control step.  None gives more than `torque_limit`:

    position   a GearJoint holds the joint at its target; it asks for the speed
               servo_gain · (target − angle), at most `speed_limit`
    velocity   a SimpleMotor turns the joint at the commanded speed
    torque     a SimpleMotor gives the commanded torque until the joint turns at `speed_limit`

Frequent calls go directly to Chipmunk, through the same library as pymunk's properties.
`pymunk.Space.step` spends as long on callbacks and added bodies, of which there are none here, as
Chipmunk spends on the physics.  A test holds the direct calls against pymunk's own, bit for bit.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from math import copysign, cos, remainder, sin, tau
from typing import Any

import numpy as np
from pymunk._chipmunk_cffi import lib as chipmunk
from pymunk.batch import Buffer, get_space_bodies
from typing_extensions import override

from mmc_gym.body.base import Floats, SingleArm
from mmc_gym.body.parameters import ArmParameters
from mmc_gym.body.pymunk.linkage import (
    MOTION,
    HandField,
    Linkage,
    Walls,
    forget_impulses,
    make_space,
)

_LONGEST_HISTORY = 20_000  # calls: 10,000 steps, each with a command


class PymunkArm(SingleArm):
    """An arm simulated by pymunk; see `SingleArm`.

    `end_effector` follows from the angles, because pivots open a little under load.

    A copied or unpickled arm moves as the original does, bit for bit.  Chipmunk does not expose the
    impulses that its joints remember, so a copy replays all calls since the last reset.  Copying
    fails after 20,000 calls, which is 10,000 steps with a command each.

    >>> arm = PymunkArm(servo="torque")
    >>> arm.records_effort = True
    >>> arm.command([6.0, 0.0, -3.0])
    >>> arm.step()
    >>> [round(impulse, 9) for impulse in arm.servo_impulses]  # torque · 0.02 s
    [0.12, 0.0, 0.06]
    """

    _history: deque[tuple[Any, ...]]  # the last reset and the calls since; the oldest drop out
    _walls: Walls | None
    _yields: list[float]  # see `Linkage.yields`; only a force field needs them

    @override
    def _build(self) -> None:
        p = self.parameters
        self._buffer = Buffer()
        self._space = make_space(p)
        self._linkage = Linkage(self._space, p, self._servo)
        self._field = None if p.force_field is None else HandField([p])

    @override
    def _place(self, joint_angles: Sequence[float], joint_velocities: Sequence[float]) -> None:
        if self.parameters.obstacles:  # Chipmunk remembers contacts, and cannot forget them
            self._build()
        else:
            if self._linkage.parameters is not self.parameters:
                self._carry(self.parameters)
            forget_impulses(self._space, [self._linkage], self.parameters.substep)
        self._linkage.place(joint_angles, joint_velocities)
        self._walls, self.contact = None, (0.0, 0.0)
        self._yields = [1.0] * self._count
        self._read()
        self._set_servos(joint_angles if self._servo == "position" else [0.0] * self._count)
        start = "reset", tuple(joint_angles), tuple(joint_velocities)
        self._history = deque([start], maxlen=_LONGEST_HISTORY)

    @override
    def _command(self, values: Sequence[float]) -> None:
        self._history.append(("command", tuple(values)))
        self._set_servos(values)

    def _set_servos(self, values: Sequence[float]) -> None:
        servos, p = self._linkage.servo_handles, self.parameters
        if self._servo == "position":
            set_phase = chipmunk.cpGearJointSetPhase
            if p.joint_limits is None:
                for servo, target, angle in zip(servos, values, self.joint_angles):
                    set_phase(servo, angle + remainder(target - angle, tau))
            else:
                for servo, target, (low, high) in zip(servos, values, p.joint_limits):
                    set_phase(servo, min(max(target, low), high))
        elif self._servo == "velocity":
            fastest = p.speed_limit
            for servo, velocity in zip(servos, values):  # pymunk's rate is the parent's
                chipmunk.cpSimpleMotorSetRate(servo, -min(max(velocity, -fastest), fastest))
        else:
            for servo, torque in zip(servos, values):
                chipmunk.cpSimpleMotorSetRate(servo, copysign(p.speed_limit, -torque))
                chipmunk.cpConstraintSetMaxForce(servo, min(abs(torque), p.torque_limit))

    @override
    def step(self) -> None:
        self._history.append(("step",))
        space, substep = self._space._space, self.parameters.substep
        field, walls, records = self._field, self._walls, self.records_effort
        is_pushed = field is not None or walls is not None
        is_rubbed = self.parameters.has_friction
        if records:
            before = self._velocities()
            self.servo_impulses, self.servo_work = [0.0] * self._count, [0.0] * self._count
        if walls is not None:
            walls.contacts[:] = 0.0
        for _ in range(self.parameters.substeps):
            if is_pushed:
                self._push_hand()
            if is_rubbed:
                self._linkage.rub()
            chipmunk.cpSpaceStep(space, substep)
            if field is not None:
                self._yields = self._linkage.yields()
            if records:
                after = self._velocities()
                for joint, servo in enumerate(self._linkage.servo_handles):
                    impulse = chipmunk.cpConstraintGetImpulse(servo)  # its size, without a sign
                    self.servo_impulses[joint] += impulse
                    self.servo_work[joint] += impulse * abs(before[joint] + after[joint]) / 2
                before = after
        if walls is not None:
            self.contact = walls.contacts[0].tolist()
        self._read()
        self._require_control()

    def _velocities(self) -> list[float]:
        """Return the present joint velocities, within a control step too."""
        of_segments = [chipmunk.cpBodyGetAngularVelocity(rod) for rod, _, _ in self._linkage.rods]
        return [velocity - parent for velocity, parent in zip(of_segments, [0.0, *of_segments])]

    def _push_hand(self) -> None:
        self._buffer.clear()
        get_space_bodies(self._space, MOTION, self._buffer)
        motion = np.frombuffer(self._buffer.float_buf()).reshape(-1, 6)[: self._count]
        pushes: Floats = np.zeros(3)
        if self._field is not None:
            impulses = self._field.impulses(motion, np.array(self._yields))
            pushes = impulses / self.parameters.substep
        if self._walls is not None:
            pushes = pushes + self._walls.pushes(motion[None])[0]
        x, y, torque = pushes.tolist()
        hand = self._linkage.rods[-1][0]
        chipmunk.cpBodySetForce(hand, (x, y))
        chipmunk.cpBodySetTorque(hand, torque)

    def _read(self) -> None:
        get_angle, get_velocity = chipmunk.cpBodyGetAngle, chipmunk.cpBodyGetAngularVelocity
        self.segment_angles = angles = []
        self.joint_angles = joint_angles = []
        self.joint_velocities = joint_velocities = []
        x = y = parent_angle = parent_velocity = 0.0
        for segment, length, _ in self._linkage.rods:
            angle, velocity = get_angle(segment), get_velocity(segment)
            angles.append(angle)
            joint_angles.append(angle - parent_angle)
            joint_velocities.append(velocity - parent_velocity)
            x += length * cos(angle)
            y += length * sin(angle)
            parent_angle, parent_velocity = angle, velocity
        self.end_effector = (x, y)

    @override
    def lock(self) -> None:
        self._history.append(("lock",))
        self._linkage.lock(self.joint_angles)

    @override
    def unlock(self) -> None:
        self._history.append(("unlock",))
        self._linkage.unlock()

    @override
    def confine(self, start: Sequence[float], end: Sequence[float]) -> None:
        self._history.append(("confine", start, end))
        self._walls = Walls([self._linkage])
        self._walls.confine([0], np.array([start]), np.array([end]))

    @override
    def load(self, parameters: ArmParameters) -> None:
        self._history.append(("load", parameters))
        self._carry(parameters)

    def _carry(self, p: ArmParameters) -> None:
        self._linkage.load(self._space, p)
        self._field = None if p.force_field is None else HandField([p])

    def __reduce__(self) -> tuple[Any, ...]:
        if self._history[0][0] != "reset":
            raise RuntimeError(
                "an arm cannot be copied or pickled this long after its last reset: a copy replays "
                f"all calls since then, but only the last {_LONGEST_HISTORY} are kept; reset the "
                "arm first, or pickle its parameters"
            )
        effort = ("records_effort", "servo_impulses", "servo_work")
        state = self._history, {name: getattr(self, name) for name in effort}
        return type(self), (self.parameters, self._servo), state

    def __setstate__(self, state: tuple[deque[tuple[Any, ...]], dict[str, Any]]) -> None:
        """Repeat all calls that the original received since its reset."""
        history, effort = state
        for name, *arguments in history:
            getattr(self, name)(*arguments)
        vars(self).update(effort)
