"""One planar arm in a pymunk Space: N uniform rods on pivots, with a servo at every joint.

The rods have no shapes (nothing collides) unless there are obstacles, and the plane is horizontal
unless gravity is set.  Joint angles are relative, 0 = straight on; the base stands at the origin.

A servo is a constraint, solved implicitly inside the physics step: stable at the full substep,
and one write per control step.

    position   a GearJoint holds the joint at its target; it asks for the speed
               servo_gain · (target − angle), at most `speed_limit`
    velocity   a SimpleMotor turns the joint at the commanded speed
    torque     a SimpleMotor gives the commanded torque until the joint turns at `speed_limit`

None gives more than `torque_limit`.

The few calls made in every step go to Chipmunk directly, through the library that pymunk's own
properties call: `pymunk.Space.step` alone spends as long on callbacks and on bodies added
meanwhile, of which there are none here, as Chipmunk on the physics.  A test holds them against
pymunk's own, bit by bit.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from math import copysign, cos, nan, remainder, sin, tau
from typing import Any, get_args

from pymunk._chipmunk_cffi import lib as chipmunk

from mmc_gym.body.parameters import ArmParameters, Servo, require
from mmc_gym.body.pymunk.linkage import Linkage, forget_impulses, make_space

_LONGEST_HISTORY = 10_000
_History = deque[tuple[float, ...] | None]
_FORGOTTEN: _History = deque(maxlen=0)


class Arm:
    """A simulated arm of N segments.  All sequences run from the base outward.

    A copy or a pickle of an arm has the same future, bit for bit.  Chipmunk does not show the
    impulses that its joints remember, so it is made by replaying what the arm has been told since
    its last reset; after more than 10,000 steps without one there is no copy.

    Attributes:
        parameters: the arm's physical parameters.
        segment_angles: absolute angles of the segments after the last step, not wrapped.
        joint_angles: relative angles of the joints after the last step, not wrapped.
        joint_velocities: their velocities, rad/s.
        end_effector: where the hand is, (x, y).  It is computed from the angles: the pivots
            gape a little under load.
        command: takes N values and hands them to the servos, which hold them until the next
            call: joint targets in radians (reached the short way round, or within the joint
            limits if there are any), joint velocities in rad/s, or torques.
        records_effort: tells whether steps record the effort of the servos; False unless set.
        servo_impulses: ∫ |τ| dt of each servo in the last recorded step, mass · length² / s;
            NaN before it.  Stops and locks are no servos.
        servo_work: ∫ |τ q̇| dt likewise, mass · length² / s².
    """

    segment_angles: list[float]
    joint_angles: list[float]
    joint_velocities: list[float]
    end_effector: tuple[float, float]
    command: Callable[[Sequence[float]], None]
    records_effort: bool = False
    servo_impulses: list[float]
    servo_work: list[float]
    _start: tuple[tuple[float, ...], tuple[float, ...]]
    _history: _History  # of every step since the reset, the command before it, if there was one
    _new_command: tuple[float, ...] | None
    _steps_to_lock: int | None

    def __init__(self, parameters: ArmParameters | None = None, servo: Servo = "position") -> None:
        """Build the arm, stretched along the x axis and at rest.

        Raises:
            ValueError: for an unknown kind of servo, or an arm that Chipmunk cannot hold together.
        """
        require(servo in get_args(Servo), "servo", servo, f"one of {get_args(Servo)}")
        self.parameters = parameters or ArmParameters()
        self._servo = servo
        self.command = getattr(self, f"_command_{servo}")
        self._pushes_hand = self.parameters.force_field is not None
        self._build()
        self.servo_impulses = self.servo_work = [nan] * len(self._handles)
        self.reset([0.0] * len(self._handles))

    def _build(self) -> None:
        self._space = make_space(self.parameters)
        self._linkage = Linkage(self._space, self.parameters, self._servo)
        self._servos = self._linkage.servos
        self._servo_handles = [servo._constraint for servo in self._servos]
        self._handles = [
            (segment._body, length)
            for segment, length in zip(self._linkage.segments, self.parameters.segment_lengths)
        ]

    def reset(
        self, joint_angles: Sequence[float], joint_velocities: Sequence[float] | None = None
    ) -> None:
        """Place the arm; its future is that of a newly built one, bit for bit.

        Args:
            joint_angles: N relative angles in radians.
            joint_velocities: N relative angular velocities in rad/s, or None for rest.

        The servos hold the posture (position), stop the joints (velocity) or are slack
        (torque) until they are commanded.  Locked joints are free again.

        Raises:
            ValueError: for another number of angles or velocities than N.
        """
        at_rest = [0.0] * len(self._handles)
        velocities = at_rest if joint_velocities is None else joint_velocities
        for name, values in ("joint_angles", joint_angles), ("joint_velocities", velocities):
            require(len(values) == len(at_rest), name, values, f"{len(at_rest)} values")
        if self.parameters.obstacles:  # contacts are remembered, and are not to be forgotten
            self._build()
        else:
            forget_impulses(self._space, [self._linkage], self.parameters.substep)
        self._linkage.place(joint_angles, velocities)
        self._read()
        self.command(joint_angles if self._servo == "position" else at_rest)
        self._start = tuple(joint_angles), tuple(velocities)
        self._history = deque()
        self._new_command = None
        self._steps_to_lock = None

    def lock(self) -> None:
        """Make the `lockable_joints` rigid where they are, until the next reset."""
        if not self._linkage.locked:
            self._linkage.lock(self.joint_angles)
            self._steps_to_lock = len(self._history)

    @property
    def hand_velocity(self) -> tuple[float, float]:
        """Velocity (x, y) of the end of the last segment, lengths / s."""
        return self._linkage.hand_velocity()

    def pivot_gap(self) -> float:
        """Largest distance between the two ends that a pivot should hold together, lengths."""
        return self._linkage.pivot_gap()

    def step(self) -> None:
        """Simulate one control step."""
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

    def __reduce__(self) -> tuple[Callable[..., Arm], tuple[Any, ...], dict[str, Any]]:
        if self._history is _FORGOTTEN:
            raise RuntimeError(
                f"an arm cannot be copied or pickled more than {_LONGEST_HISTORY} steps after its "
                "last reset: a copy replays what the arm has been told since, and no more than "
                "that is kept; reset it first, or pickle its parameters"
            )
        told = self._start, list(self._history), self._new_command, self._steps_to_lock
        effort = ("records_effort", "servo_impulses", "servo_work")
        state = {name: getattr(self, name) for name in effort}
        return _replay, (type(self), self.parameters, self._servo, *told), state

    def _push_hand(self) -> None:
        """Let the force field act on the hand in the next physics step."""
        assert self.parameters.force_field is not None
        (xx, xy), (yx, yy) = self.parameters.force_field
        x, y = self._linkage.hand_velocity()
        force_x, force_y = xx * x + xy * y, yx * x + yy * y
        body, reach = self._linkage.hand
        angle = chipmunk.cpBodyGetAngle(body)
        chipmunk.cpBodySetForce(body, (force_x, force_y))
        chipmunk.cpBodySetTorque(body, reach * (cos(angle) * force_y - sin(angle) * force_x))

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

    def _command_position(self, joint_targets: Sequence[float]) -> None:
        servos, limits = self._servo_handles, self.parameters.joint_limits
        if len(joint_targets) != len(servos):  # strict zips would cost 1 % of the step
            raise _wrong_count("joint targets", len(servos), joint_targets)
        self._new_command = tuple(joint_targets)
        set_phase = chipmunk.cpGearJointSetPhase
        if limits is None:
            for servo, target, angle in zip(servos, joint_targets, self.joint_angles):
                set_phase(servo, angle + remainder(target - angle, tau))
        else:
            for servo, target, (low, high) in zip(servos, joint_targets, limits):
                set_phase(servo, min(max(target, low), high))

    def _command_velocity(self, joint_velocities: Sequence[float]) -> None:
        servos, limit = self._servo_handles, self.parameters.speed_limit
        if len(joint_velocities) != len(servos):
            raise _wrong_count("joint velocities", len(servos), joint_velocities)
        self._new_command = tuple(joint_velocities)
        set_rate = chipmunk.cpSimpleMotorSetRate
        for servo, velocity in zip(servos, joint_velocities):
            set_rate(servo, -min(max(velocity, -limit), limit))  # pymunk's: of the parent

    def _command_torque(self, torques: Sequence[float]) -> None:
        servos, speed_limit = self._servo_handles, self.parameters.speed_limit
        if len(torques) != len(servos):
            raise _wrong_count("torques", len(servos), torques)
        self._new_command = tuple(torques)
        set_rate, set_limit = chipmunk.cpSimpleMotorSetRate, chipmunk.cpConstraintSetMaxForce
        torque_limit = self.parameters.torque_limit
        for servo, torque in zip(servos, torques):
            set_rate(servo, copysign(speed_limit, -torque))
            set_limit(servo, min(abs(torque), torque_limit))


def _replay(
    kind: type[Arm],
    parameters: ArmParameters,
    servo: Servo,
    start: tuple[tuple[float, ...], tuple[float, ...]],
    history: list[tuple[float, ...] | None],
    new_command: tuple[float, ...] | None,
    steps_to_lock: int | None,
) -> Arm:
    """An arm that has been told all this."""
    arm = kind(parameters, servo)
    arm.reset(*start)
    for steps, command in enumerate([*history, new_command]):
        if command is not None:
            arm.command(command)
        if steps == steps_to_lock:
            arm.lock()
        if steps < len(history):
            arm.step()
    return arm


def _wrong_count(name: str, count: int, values: Sequence[float]) -> ValueError:
    return ValueError(f"command must be {count} {name}, got {values!r}")
