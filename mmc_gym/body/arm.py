"""One planar arm in a pymunk Space: N uniform rods on pivots, with a servo at every joint.

The rods have no shapes (nothing collides) and the plane is horizontal unless gravity is set.
Joint angles are relative, 0 = straight on; the base stands at the origin.

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

import math
from collections.abc import Callable, Sequence
from math import copysign, cos, remainder, sin, tau
from typing import get_args

import pymunk
from pymunk._chipmunk_cffi import lib as chipmunk

from mmc_gym.body.parameters import ArmParameters, Servo, require

_MOST_SOLVER_ITERATIONS = 500  # a step of three segments then takes 0.1 ms instead of 0.01


class Arm:
    """A simulated arm of N segments.  All sequences run from the base outward.

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
    """

    segment_angles: list[float]
    joint_angles: list[float]
    joint_velocities: list[float]
    end_effector: tuple[float, float]
    command: Callable[[Sequence[float]], None]

    def __init__(self, parameters: ArmParameters | None = None, servo: Servo = "position") -> None:
        """Build the arm, stretched along the x axis and at rest.

        Raises:
            ValueError: for an unknown kind of servo.
        """
        require(servo in get_args(Servo), "servo", servo, f"one of {get_args(Servo)}")
        self.parameters = parameters or ArmParameters()
        self._servo = servo
        self.command = getattr(self, f"_command_{servo}")
        self._space = pymunk.Space()
        self._space.gravity = self.parameters.gravity
        self._space.iterations = _solver_iterations(self.parameters)
        self._segments: list[pymunk.Body] = []
        self._servos: list[pymunk.Constraint] = []
        self._build()
        lengths = self.parameters.segment_lengths
        self._handles = [
            (body._body, length) for body, length in zip(self._segments, lengths, strict=True)
        ]
        self._servo_handles = [servo._constraint for servo in self._servos]
        self.reset([0.0] * len(self._segments))

    def _build(self) -> None:
        p = self.parameters
        parent, anchor = pymunk.Body(body_type=pymunk.Body.STATIC), (0.0, 0.0)
        for index, (length, mass) in enumerate(zip(p.segment_lengths, p.masses, strict=True)):
            segment = pymunk.Body(mass, mass * length**2 / 12)
            pivot = pymunk.PivotJoint(parent, segment, anchor, (-length / 2, 0.0))
            drive = self._make_servo(parent, segment)
            self._space.add(segment, pivot, drive)
            if p.joint_limits is not None:
                self._space.add(pymunk.RotaryLimitJoint(parent, segment, *p.joint_limits[index]))
            self._segments.append(segment)
            self._servos.append(drive)
            parent, anchor = segment, (length / 2, 0.0)

    def _make_servo(self, parent: pymunk.Body, segment: pymunk.Body) -> pymunk.Constraint:
        p = self.parameters
        drive: pymunk.GearJoint | pymunk.SimpleMotor
        if self._servo == "position":
            drive = pymunk.GearJoint(parent, segment, 0.0, 1.0)
            drive.error_bias = math.exp(-p.servo_gain)  # what is left of an error after 1 s
            drive.max_bias = p.speed_limit
        else:
            drive = pymunk.SimpleMotor(parent, segment, 0.0)
        drive.max_force = p.torque_limit
        return drive

    def reset(
        self, joint_angles: Sequence[float], joint_velocities: Sequence[float] | None = None
    ) -> None:
        """Place the arm; its future is that of a newly built one, bit for bit.

        Args:
            joint_angles: N relative angles in radians.
            joint_velocities: N relative angular velocities in rad/s, or None for rest.

        The servos hold the posture (position), stop the joints (velocity) or are slack
        (torque) until they are commanded.
        """
        self._forget_impulses()
        velocities = [0.0] * len(joint_angles) if joint_velocities is None else joint_velocities
        angle = speed = x = y = velocity_x = velocity_y = 0.0
        for segment, length, joint_angle, joint_velocity in zip(
            self._segments, self.parameters.segment_lengths, joint_angles, velocities, strict=True
        ):
            angle += joint_angle
            speed += joint_velocity
            half_x, half_y = length / 2 * cos(angle), length / 2 * sin(angle)
            segment.position = (x + half_x, y + half_y)
            segment.velocity = (velocity_x - speed * half_y, velocity_y + speed * half_x)
            segment.angle = angle
            segment.angular_velocity = speed
            x, y = x + 2 * half_x, y + 2 * half_y
            velocity_x -= 2 * speed * half_y
            velocity_y += 2 * speed * half_x
        self._read()
        self.command(joint_angles if self._servo == "position" else [0.0] * len(joint_angles))

    def _forget_impulses(self) -> None:
        """Clear the impulses that pymunk's joints keep from one physics step to the next.

        They are not part of a body's pose or velocity, and would make the future of a reset arm
        another than that of a new one.  A step in which no joint may exert a force clears them.
        """
        limits = [(joint, joint.max_force) for joint in self._space.constraints]
        for joint, _ in limits:
            joint.max_force = 0.0
        self._space.step(self.parameters.substep)
        for joint, limit in limits:
            joint.max_force = limit

    def step(self) -> None:
        """Simulate one control step."""
        space, substep = self._space._space, self.parameters.substep
        for _ in range(self.parameters.substeps):
            chipmunk.cpSpaceStep(space, substep)
        self._read()

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
        set_rate = chipmunk.cpSimpleMotorSetRate
        for servo, velocity in zip(servos, joint_velocities):
            set_rate(servo, -min(max(velocity, -limit), limit))  # pymunk's: of the parent

    def _command_torque(self, torques: Sequence[float]) -> None:
        servos, speed_limit = self._servo_handles, self.parameters.speed_limit
        if len(torques) != len(servos):
            raise _wrong_count("torques", len(servos), torques)
        set_rate, set_limit = chipmunk.cpSimpleMotorSetRate, chipmunk.cpConstraintSetMaxForce
        torque_limit = self.parameters.torque_limit
        for servo, torque in zip(servos, torques):
            set_rate(servo, copysign(speed_limit, -torque))
            set_limit(servo, min(abs(torque), torque_limit))

    def pivot_gap(self) -> float:
        """Largest distance between the two ends that a pivot should hold together, lengths."""
        gap, end = 0.0, pymunk.Vec2d(0.0, 0.0)
        for segment, length in zip(self._segments, self.parameters.segment_lengths, strict=True):
            gap = max(gap, segment.local_to_world((-length / 2, 0.0)).get_distance(end))
            end = segment.local_to_world((length / 2, 0.0))
        return gap


def _solver_iterations(parameters: ArmParameters) -> int:
    """Sweeps of Chipmunk's solver over the joints in a physics step.

    The heavier the arm beyond a joint, measured by the rod that carries it, the more of them an
    arm needs to come to rest at its joint targets instead of buzzing around them.  Three equal
    rods (a ratio of inertias of 27) need pymunk's 10; in random arms of two to five segments,
    four times lighter and heavier, the need was seen to grow in proportion to that ratio.
    """
    lengths, masses = parameters.segment_lengths, parameters.masses
    ratio = 0.0
    for joint in range(len(lengths)):
        inertia = start = 0.0  # of the arm beyond this joint, stretched, about the joint
        for length, mass in zip(lengths[joint:], masses[joint:]):
            inertia += mass * ((start + length / 2) ** 2 + length**2 / 12)
            start += length
        ratio = max(ratio, inertia / (masses[joint] * lengths[joint] ** 2 / 3))
    return min(max(10, round(10 / 27 * ratio)), _MOST_SOLVER_ITERATIONS)


def _wrong_count(name: str, count: int, values: Sequence[float]) -> ValueError:
    return ValueError(f"command must be {count} {name}, got {values!r}")
