"""One planar arm in a pymunk Space: N uniform rods on pivots, with a servo at every joint.

The rods have no shapes (nothing collides) unless there are obstacles, and the plane is horizontal
unless gravity is set.

A servo is a constraint, solved implicitly inside the physics step, so that it is stable at the full
substep and needs one write per control step.  None gives more than `torque_limit`:

    position   a GearJoint holds the joint at its target; it asks for the speed
               servo_gain · (target − angle), at most `speed_limit`
    velocity   a SimpleMotor turns the joint at the commanded speed
    torque     a SimpleMotor gives the commanded torque until the joint turns at `speed_limit`

The few calls made in every step go to Chipmunk directly, through the library that pymunk's own
properties call.  `pymunk.Space.step` spends as long on callbacks and on bodies added meanwhile, of
which there are none here, as Chipmunk on the physics.  A test holds the direct calls against
pymunk's own, bit by bit.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from math import copysign, cos, remainder, sin, tau
from typing import Any

from pymunk._chipmunk_cffi import lib as chipmunk
from typing_extensions import override

from mmc_gym.body.base import SingleArm, wrong_count
from mmc_gym.body.force_field import field_impulse
from mmc_gym.body.parameters import ArmParameters, Servo
from mmc_gym.body.pymunk.linkage import Linkage, forget_impulses, make_space

_LONGEST_HISTORY = 10_000
_History = deque[tuple[float, ...] | None]
_FORGOTTEN: _History = deque(maxlen=0)


class Arm(SingleArm):
    """An arm simulated by pymunk; `SingleArm` documents what it is and does.

    `end_effector` is computed from the angles, because the pivots gape a little under load.

    A copy or a pickle of an arm has the same future, bit for bit.  Chipmunk does not show the
    impulses that its joints remember, so a copy replays what the arm has been told since its last
    reset.  After more than 10,000 steps without a reset there is no copy.

    Example:
        >>> arm = Arm(servo="torque")
        >>> arm.records_effort = True
        >>> arm.command([6.0, 0.0, -3.0])
        >>> arm.step()
        >>> [round(impulse, 9) for impulse in arm.servo_impulses]  # torque · 0.02 s
        [0.12, 0.0, 0.06]
    """

    _start: tuple[tuple[float, ...], tuple[float, ...]]
    _history: _History  # for every step since the reset, the command before it, if there was one
    _new_command: tuple[float, ...] | None
    _steps_to_lock: int | None
    _yields: list[float]  # see `Linkage.yields`; used where there is a force field

    @override
    def __init__(self, parameters: ArmParameters | None = None, servo: Servo = "position") -> None:
        super().__init__(parameters, servo)
        self._pushes_hand = self.parameters.force_field is not None
        self._build()
        self.reset([0.0] * len(self._handles))

    def _build(self) -> None:
        self._space = make_space(self.parameters)
        self._linkage = Linkage(self._space, self.parameters, self._servo)
        self._servo_handles = [servo._constraint for servo in self._linkage.servos]
        self._handles = [
            (segment._body, length)
            for segment, length in zip(self._linkage.segments, self.parameters.segment_lengths)
        ]

    @override
    def _place(self, joint_angles: Sequence[float], joint_velocities: Sequence[float]) -> None:
        if self.parameters.obstacles:  # contacts are remembered, and cannot be forgotten
            self._build()
        else:
            forget_impulses(self._space, [self._linkage], self.parameters.substep)
        self._linkage.place(joint_angles, joint_velocities)
        self._yields = [1.0] * len(joint_angles)
        self._read()
        self.command(joint_angles if self._servo == "position" else [0.0] * len(joint_angles))
        self._start = tuple(joint_angles), tuple(joint_velocities)
        self._history = deque()
        self._new_command = None
        self._steps_to_lock = None

    @override
    def command(self, values: Sequence[float]) -> None:
        servos, p = self._servo_handles, self.parameters
        if len(values) != len(servos):  # strict zips would cost 1 % of the step
            raise wrong_count("command", values, len(servos))
        self._new_command = tuple(values)
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
        if self._pushes_hand or self.records_effort:
            self._simulate_attended()
        else:
            space, substep = self._space._space, self.parameters.substep
            for _ in range(self.parameters.substeps):
                chipmunk.cpSpaceStep(space, substep)
        self._read()
        history = self._history
        history.append(self._new_command)
        self._new_command = None
        if len(history) > _LONGEST_HISTORY:
            self._history = _FORGOTTEN

    def _simulate_attended(self) -> None:
        """Simulate a control step in which there is something to do in every physics step."""
        space, substep = self._space._space, self.parameters.substep
        records, servos = self.records_effort, self._servo_handles
        impulses, work = [0.0] * len(servos), [0.0] * len(servos)
        before = self._velocities() if records else []
        for _ in range(self.parameters.substeps):
            if self._pushes_hand:
                self._push_hand()
            chipmunk.cpSpaceStep(space, substep)
            if self._pushes_hand:
                self._yields = self._linkage.yields(substep)
            if records:
                after = self._velocities()
                for joint, servo in enumerate(servos):
                    impulse = chipmunk.cpConstraintGetImpulse(servo)  # its size, without a sign
                    impulses[joint] += impulse
                    work[joint] += impulse * abs(before[joint] + after[joint]) / 2
                before = after
        if records:
            self.servo_impulses, self.servo_work = impulses, work

    def _velocities(self) -> list[float]:
        """Return the velocities of the joints as they are within a control step."""
        velocities, parent = [], 0.0
        for segment, _ in self._handles:
            velocity = chipmunk.cpBodyGetAngularVelocity(segment)
            velocities.append(velocity - parent)
            parent = velocity
        return velocities

    def _push_hand(self) -> None:
        """Let the force field act on the hand in the next physics step."""
        substep = self.parameters.substep
        bodies = [body for body, _ in self._handles]
        speeds = [*map(chipmunk.cpBodyGetAngularVelocity, bodies)]
        turned = [
            angle + substep * speed
            for angle, speed in zip(map(chipmunk.cpBodyGetAngle, bodies), speeds)
        ]
        centres = [(at.x, at.y) for at in map(chipmunk.cpBodyGetPosition, bodies)]
        velocities = [(v.x, v.y) for v in map(chipmunk.cpBodyGetVelocity, bodies)]
        cosines, sines, yields = [*map(cos, turned)], [*map(sin, turned)], self._yields
        x, y, turn = field_impulse(
            self.parameters, cosines, sines, speeds, yields, centres, velocities
        )
        body = bodies[-1]
        chipmunk.cpBodySetForce(body, (x / substep, y / substep))
        chipmunk.cpBodySetTorque(body, turn / substep)

    def _read(self) -> None:
        get_angle, get_velocity = chipmunk.cpBodyGetAngle, chipmunk.cpBodyGetAngularVelocity
        self.segment_angles = angles = []
        self.joint_angles = joint_angles = []
        self.joint_velocities = joint_velocities = []
        x = y = parent_angle = parent_velocity = 0.0
        for segment, length in self._handles:
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
        if not self._linkage.locked:
            self._linkage.lock(self.joint_angles)
            self._steps_to_lock = len(self._history)

    @property
    def hand_velocity(self) -> tuple[float, float]:
        """Velocity (x, y) of the end of the last segment, lengths / s."""
        return self._linkage.hand_velocity()

    @override
    def pivot_gap(self) -> float:
        return self._linkage.pivot_gap()

    def __reduce__(self) -> tuple[Any, ...]:
        if self._history is _FORGOTTEN:
            raise RuntimeError(
                f"an arm cannot be copied or pickled more than {_LONGEST_HISTORY} steps after its "
                "last reset: a copy replays what the arm has been told since, and no more than "
                "that is kept; reset it first, or pickle its parameters"
            )
        told = self._start, list(self._history), self._new_command, self._steps_to_lock
        effort = ("records_effort", "servo_impulses", "servo_work")
        state = told, {name: getattr(self, name) for name in effort}
        return type(self), (self.parameters, self._servo), state

    def __setstate__(self, state: tuple[Any, dict[str, Any]]) -> None:
        """Tell the arm again all that its original has been told since its reset."""
        (start, history, new_command, steps_to_lock), effort = state
        self.reset(*start)
        for steps, command in enumerate([*history, new_command]):
            if command is not None:
                self.command(command)
            if steps == steps_to_lock:
                self.lock()
            if steps < len(history):
                self.step()
        vars(self).update(effort)
