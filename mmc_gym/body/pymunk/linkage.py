"""The bodies and joints of one planar arm in a pymunk Space, and the force field on its hand.

    base ── pivot, servo ── segment 0 ── pivot, servo ── segment 1 ── … ── hand

The rods have shapes, and can collide, only if there are obstacles.  The joints are added from the
hand inward, each with its pivot last.  Chipmunk sweeps over them in this order, and satisfies the
last ones best.  Each physics step corrects all of a pivot's error.  In this order the pivots open
ten times less than in the order from the base outward.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from math import cos, sin
from typing import Any

import numpy as np
import pymunk
from pymunk._chipmunk_cffi import lib as chipmunk
from pymunk.batch import BodyFields

from mmc_gym.body.base import MOST_SWEEPS, Floats
from mmc_gym.body.parameters import ArmParameters, Servo

# What a force field needs of each body: x, y, angle, and their velocities.
MOTION = BodyFields.POSITION | BodyFields.ANGLE | BodyFields.VELOCITY | BodyFields.ANGULAR_VELOCITY

_FEWEST_SWEEPS = 20
FULL = 1 - 1e-9  # share of a servo's largest impulse that counts as all of it
_LEFT = np.array([-1.0, 1.0])  # (y, x) times this is (x, y) turned left by a right angle
_STRONG = 1e4  # rad/s, the speed that a strong servo gives a free segment in a physics step


def solver_iterations(parameters: ArmParameters) -> int:
    """Return the number of sweeps per physics step after which the solver has converged.

    In one sweep a servo or a pivot acts on the two segments that it joins as if they were alone;
    further sweeps pass this on to the rest of the arm.  The number grows with the mass beyond a
    segment, relative to the segment's own.  Arms of up to three segments of default masses take 20:
    after 2 s of random commands their joint angles differ from those of 1,000 sweeps by 0.002 rad
    in the median.  Servos that are far too strong for their segments need ten times as many.
    """
    lightest = min(rod.inertia for rod in parameters.rods)
    strong = parameters.torque_limit * parameters.substep / lightest > _STRONG
    sweeps = min(max(_FEWEST_SWEEPS, parameters.sweeps), MOST_SWEEPS)
    return min(round(sweeps * (10 if strong else 1)), 3 * MOST_SWEEPS)


class Linkage:
    """One arm in a Space, which may hold others.  All sequences run from the base outward."""

    parameters: ArmParameters
    #: of each segment, its body's handle, its length, and its centre's distance from its joint
    rods: list[tuple[Any, float, float]]
    force_limits: list[float]  #: of `joint_handles`, with the locks open

    def __init__(
        self,
        space: pymunk.Space,
        parameters: ArmParameters,
        servo: Servo,
        *,
        has_ground: bool = False,
        has_brakes: bool = False,
    ) -> None:
        """Build the arm into `space`, with a ground and brakes if it has or may get any.

        Obstacles stand on the ground, and brakes are the friction of the joints.
        """
        self.parameters, self._servo = parameters, servo
        self._has_brakes = has_brakes or parameters.has_friction
        #: bodies of the N segments; their origin is their centre of gravity
        self.segments: list[pymunk.Body] = []
        self.servos: list[pymunk.Constraint] = []  #: the N constraints that drive the joints
        #: each lockable joint, with the constraint that makes it rigid
        self.locks: list[tuple[int, pymunk.GearJoint]] = []
        self.locked = False  #: whether these constraints are closed
        self.stops: list[Any] = []  #: handles of the joint limits, where there are any
        self.brakes: list[Any] = []  #: handles of the joints' friction, where there may be any
        self._pivots: list[Any] = []  # handles
        # Every arm has its own base, a body outside of the Space.  The Space's static body would be
        # read and written by bulk calls.
        parent = pymunk.Body(body_type=pymunk.Body.STATIC)
        joints: list[list[pymunk.Constraint]] = []
        for joint in range(len(parameters.segment_lengths)):
            segment = pymunk.Body(1.0, 1.0)  # `change` sets the numbers
            space.add(segment)
            joints.append(self._make_joint(joint, parent, segment))
            pivot = pymunk.PivotJoint(parent, segment, (0.0, 0.0), (0.0, 0.0))
            pivot.error_bias = 0.0
            self._pivots.append(pivot._constraint)
            joints[-1].append(pivot)
            self.segments.append(segment)
            parent = segment
        in_order = [constraint for joint in reversed(joints) for constraint in joint]
        space.add(*in_order)
        self.servo_handles = [servo._constraint for servo in self.servos]  #: handles of the servos
        #: of all constraints, in the order in which Chipmunk solves them
        self.joint_handles = [constraint._constraint for constraint in in_order]
        self.change(parameters)
        if has_ground or parameters.obstacles:
            self._add_ground(space)

    def can_become(self, parameters: ArmParameters) -> bool:
        """Return whether `change` takes these parameters: the arm has the joints they need."""
        locks = {joint for joint, _ in self.locks}
        has_limits = parameters.joint_limits is not None
        if parameters.has_friction and not self.brakes:
            return False
        return has_limits == bool(self.stops) and locks.issuperset(parameters.lockable_joints)

    def change(self, parameters: ArmParameters) -> None:
        """Set all numbers; `place` has to follow."""
        self.parameters = p = parameters
        self.rods, anchor = [], 0.0
        for joint, (length, rod) in enumerate(zip(p.segment_lengths, p.rods)):
            segment, pivot = self.segments[joint]._body, self._pivots[joint]
            servo = self.servo_handles[joint]
            chipmunk.cpBodySetMass(segment, rod.mass)
            chipmunk.cpBodySetMoment(segment, rod.inertia)
            chipmunk.cpPivotJointSetAnchorA(pivot, (anchor, 0.0))
            chipmunk.cpPivotJointSetAnchorB(pivot, (-rod.centre, 0.0))
            chipmunk.cpConstraintSetMaxForce(servo, p.torque_limit)
            if self._servo == "position":  # what is left of an error in 1 s
                chipmunk.cpConstraintSetErrorBias(servo, math.exp(-p.servo_gain))
                chipmunk.cpConstraintSetMaxBias(servo, p.speed_limit)
            self.rods.append((segment, length, rod.centre))
            anchor = length - rod.centre
        for stop, (low, high) in zip(self.stops, p.joint_limits or ()):
            chipmunk.cpRotaryLimitJointSetMin(stop, low)
            chipmunk.cpRotaryLimitJointSetMax(stop, high)
        for brake in self.brakes:
            chipmunk.cpConstraintSetMaxForce(brake, 0.0)
        self.unlock()
        self.force_limits = [*map(chipmunk.cpConstraintGetMaxForce, self.joint_handles)]

    def load(self, space: pymunk.Space, parameters: ArmParameters) -> None:
        """Change the load and the force field, while the segments move on as they are."""
        (segment, length, before), rod = self.rods[-1], parameters.rods[-1]
        angle, away = chipmunk.cpBodyGetAngle(segment), rod.centre - before
        x, y, speed = away * cos(angle), away * sin(angle), self.segments[-1].angular_velocity
        position, velocity = self.segments[-1].position, self.segments[-1].velocity
        chipmunk.cpBodySetMass(segment, rod.mass)
        chipmunk.cpBodySetMoment(segment, rod.inertia)
        chipmunk.cpPivotJointSetAnchorB(self._pivots[-1], (-rod.centre, 0.0))
        chipmunk.cpBodySetPosition(segment, (position.x + x, position.y + y))
        chipmunk.cpBodySetVelocity(segment, (velocity.x - speed * y, velocity.y + speed * x))
        for shape in self.segments[-1].shapes:
            assert isinstance(shape, pymunk.Segment)
            shape.unsafe_set_endpoints((-rod.centre, 0.0), (length - rod.centre, 0.0))
        self.rods[-1] = segment, length, rod.centre
        self.parameters = parameters
        change_space(space, parameters)

    def _make_joint(
        self, joint: int, parent: pymunk.Body, segment: pymunk.Body
    ) -> list[pymunk.Constraint]:
        p = self.parameters
        servo: pymunk.GearJoint | pymunk.SimpleMotor
        if self._servo == "position":
            servo = pymunk.GearJoint(parent, segment, 0.0, 1.0)
        else:
            servo = pymunk.SimpleMotor(parent, segment, 0.0)
        self.servos.append(servo)
        constraints: list[pymunk.Constraint] = [servo]
        if p.joint_limits is not None:
            stop = pymunk.RotaryLimitJoint(parent, segment, -1.0, 1.0)
            self.stops.append(stop._constraint)
            constraints.append(stop)
        if self._has_brakes:
            brake = pymunk.SimpleMotor(parent, segment, 0.0)
            brake.max_force = 0.0
            self.brakes.append(brake._constraint)
            constraints.append(brake)
        if joint in p.lockable_joints:
            lock = pymunk.GearJoint(parent, segment, 0.0, 1.0)
            lock.error_bias = 0.0
            lock.max_force = 0.0
            self.locks.append((joint, lock))
            constraints.append(lock)
        return constraints

    def _add_ground(self, space: pymunk.Space) -> None:
        """Add the body of all obstacles, and if there are any, shapes that collide."""
        discs = self.parameters.obstacles
        for segment, (_, length, centre) in zip(self.segments, self.rods if discs else ()):
            ends = (-centre, 0.0), (length - centre, 0.0)
            shape = pymunk.Segment(segment, *ends, self.parameters.segment_radius)
            shape.filter = pymunk.ShapeFilter(group=1)  # no collisions within a group
            space.add(shape)
        ground = pymunk.Body(body_type=pymunk.Body.STATIC)
        space.add(ground)
        for x, y, radius in discs:
            space.add(pymunk.Circle(ground, radius, (x, y)))

    def place(self, joint_angles: Sequence[float], joint_velocities: Sequence[float]) -> None:
        """Set the posture, and the velocities of the rods as rigid rods on pivots."""
        angle = speed = x = y = velocity_x = velocity_y = 0.0
        for (segment, length, centre), joint_angle, joint_velocity in zip(
            self.rods, joint_angles, joint_velocities
        ):
            angle += joint_angle
            speed += joint_velocity
            along_x, along_y = cos(angle), sin(angle)
            centre_x, centre_y = centre * along_x, centre * along_y
            velocity = velocity_x - speed * centre_y, velocity_y + speed * centre_x
            chipmunk.cpBodySetPosition(segment, (x + centre_x, y + centre_y))
            chipmunk.cpBodySetVelocity(segment, velocity)
            chipmunk.cpBodySetAngle(segment, angle)
            chipmunk.cpBodySetAngularVelocity(segment, speed)
            x, y = x + length * along_x, y + length * along_y
            velocity_x -= speed * length * along_y
            velocity_y += speed * length * along_x

    def lock(self, joint_angles: Sequence[float]) -> None:
        """Close the locks at `joint_angles`, one per joint; do nothing if they are closed."""
        if self.locked:
            return
        self.locked = True
        for joint, lock in self.locks:
            if joint not in self.parameters.lockable_joints:  # another arm's, before `change`
                continue
            chipmunk.cpGearJointSetPhase(lock._constraint, joint_angles[joint])
            chipmunk.cpConstraintSetMaxForce(lock._constraint, math.inf)

    def unlock(self) -> None:
        """Open the locks."""
        self.locked = False
        for _, lock in self.locks:
            chipmunk.cpConstraintSetMaxForce(lock._constraint, 0.0)

    def rub(self) -> None:
        """Set the torques with which friction may brake the joints in the next physics step."""
        friction, damping = self.parameters.joint_friction, self.parameters.joint_damping
        before = 0.0
        for brake, (segment, _, _) in zip(self.brakes, self.rods):
            after = chipmunk.cpBodyGetAngularVelocity(segment)
            chipmunk.cpConstraintSetMaxForce(brake, friction + damping * abs(after - before))
            before = after

    def move_joints(self, source: pymunk.Space, target: pymunk.Space) -> None:
        """Move the joints from one Space to another without reordering those of any arm.

        Chipmunk fills the place of a removed joint with the last joint of the Space.  Removed from
        the last to the first, an arm's joints are replaced by those of another arm in order.
        """
        for joint in reversed(self.joint_handles):
            chipmunk.cpSpaceRemoveConstraint(source._space, joint)
        for joint in self.joint_handles:
            chipmunk.cpSpaceAddConstraint(target._space, joint)

    def yields(self) -> list[float]:
        """Return 1 for each joint that yields to a push, and 0 for each joint that is held.

        A joint yields if its servo gave its largest torque in the last physics step, and neither a
        stop nor a lock holds it.
        """
        give, most = chipmunk.cpConstraintGetImpulse, chipmunk.cpConstraintGetMaxForce
        held = {joint for joint, stop in enumerate(self.stops) if give(stop) > 0}
        if self.locked:
            held |= set(self.parameters.lockable_joints)
        substep = self.parameters.substep
        return [
            float(joint not in held and give(servo) >= FULL * most(servo) * substep)
            for joint, servo in enumerate(self.servo_handles)
        ]


def make_space(parameters: ArmParameters) -> pymunk.Space:
    """Return an empty Space with gravity and solver settings for these arms."""
    space = pymunk.Space()
    space.collision_slop = 0.02  # with Chipmunk's 0.1, segments rest deep in obstacles
    change_space(space, parameters)
    return space


def change_space(space: pymunk.Space, parameters: ArmParameters) -> None:
    """Set gravity and solver settings for these arms."""
    space.gravity = parameters.gravity
    space.iterations = solver_iterations(parameters)


def forget_impulses(space: pymunk.Space, linkages: Sequence[Linkage], substep: float) -> None:
    """Clear the impulses that Chipmunk's joints keep from one physics step to the next.

    With them, a reset arm would not move as a new one does.  A step of `space` in which no joint
    may exert a force clears them.  `space` must hold the joints of these linkages and no others.
    Locks are open afterwards.
    """
    for linkage in linkages:
        for joint in linkage.joint_handles:
            chipmunk.cpConstraintSetMaxForce(joint, 0.0)
    chipmunk.cpSpaceStep(space._space, substep)
    for linkage in linkages:
        for joint, limit in zip(linkage.joint_handles, linkage.force_limits):
            chipmunk.cpConstraintSetMaxForce(joint, limit)
        linkage.locked = False


class HandField:
    """The force fields on the hands of n arms, or the field on the hands of arms that are equal.

    Its impulse in a physics step is computed implicitly.

    A field F pushes the hand with F · (its velocity).  Its impulse p over a substep h is that of
    the mean of the hand's velocity before and after the substep (the midpoint rule),

        p = h F (v + J z / 2),     M z = Jᵀ p − c,

    where z are the changes of the joint speeds, so that (M − Jᵀ h F J / 2) z = Jᵀ h F v − c.  A
    field across the velocity turns it and does no work.  The movement of the arm within a substep
    is neglected: in the strongest field that is accepted, 160 (`ArmParameters.strongest_field`), a
    slack arm at joint speeds of 0.5 rad/s keeps its energy for 2 s to within 15 %.

    v is the mean velocity if no joint changes its speed.  c are the impulses that inertia and
    gravity then demand of the joints.  The velocities are those of the rods, which go straight on
    in a substep and then close the pivots.  Only joints that yield change their speed: those whose
    servo gave its largest torque a substep before.  What a servo holds moves as the servo wants,
    whatever the push.

    The analytic engine computes the same in its kernel, from the mobility J M⁻¹ Jᵀ of the hand.
    """

    def __init__(self, arms: Sequence[ArmParameters]) -> None:
        """Prepare for n arms, or one for all; without a `force_field`, it is one of strength 0."""
        none = np.zeros((2, 2))
        numbers = [
            (p.segment_lengths, p.rods, [[p.substep]], [p.gravity], p.force_field or none)
            for p in arms
        ]
        # Those of one arm for all have no axis of arms.
        columns = zip(*numbers) if len(arms) > 1 else numbers[0]
        lengths, rods, self._substep, gravity, field = map(np.array, columns)
        masses, centres, inertias = np.moveaxis(rods, -1, 0)[..., None, :]
        self._half, self._fall = self._substep / 2 * field, self._substep * gravity
        # A joint turns all segments from its own on.
        self._same = np.eye(lengths.shape[-1])
        self._turned = np.tril(np.ones_like(self._same))
        # Row j: how far the centre of rod j moves along each segment.
        self._levers = np.tril(lengths[..., None, :] * np.ones_like(self._same), -1)
        self._levers += centres * self._same
        self._weighted = self._levers.swapaxes(-1, -2) * masses
        self._products = self._weighted @ self._levers
        self._inertias, self._lengths = inertias * self._same, lengths[..., None]
        self._reach = (lengths - centres[..., 0, :])[..., -1:]

    def impulses(self, motion: Floats, yields: Floats) -> Floats:
        """Return impulses (x, y) on the hands and moments about last segments' centres, (..., 3).

        Args:
            motion: of each segment before the substep: centre of gravity (x, y), angle, velocity of
                the centre (x, y) and angular velocity, (..., N, 6).
            yields: 1 for each joint that yields to a push, 0 for each that is held, (..., N).
        """
        centres, velocities, speeds = motion[..., :2], motion[..., 3:5], motion[..., 5:]
        angles = motion[..., 2:3] + self._substep * speeds
        along = np.concatenate([np.cos(angles), np.sin(angles)], axis=-1)
        across = along[..., ::-1] * _LEFT
        # Before the substep rods move on their own.  After it they are rigid rods on pivots, which
        # turn with `speeds`.  The sum of a rod's two velocities follows from where its centre gets.
        turning = speeds * across
        sums = (self._levers @ (along + self._substep * turning) - centres) / self._substep
        velocity = (sums[..., -1, :] + 2 * self._reach * turning[..., -1, :])[..., None]
        push = self._half @ velocity
        if yields.any():
            # M, c and J here are those of the segments; `turned` goes from joints to segments.
            jacobian = self._lengths * across
            masses = self._products * (along @ along.swapaxes(-1, -2)) + self._inertias
            loads = self._weighted @ (sums - 2 * velocities - self._fall)
            pushed = self._lengths * push.swapaxes(-1, -2) - loads
            right = (across * pushed).sum(axis=-1, keepdims=True)  # Jᵀ p − c with z = 0
            masses -= jacobian @ self._half @ jacobian.swapaxes(-1, -2)
            turned = self._turned * yields[..., None, :]
            back = turned.swapaxes(-1, -2)
            # A joint that is held has no equation but 1 · z = 0.
            held = self._same * (1 - yields)[..., None, :]
            changes = turned @ np.linalg.solve(back @ masses @ turned + held, back @ right)
            push = push + self._half @ (jacobian.swapaxes(-1, -2) @ changes)
        moment = self._reach[..., None] * (across[..., -1:, :] @ push)
        return np.concatenate([push, moment], axis=-2)[..., 0]


class Walls:
    """Stiff, damped walls on both sides of the lines to which the hands of n arms are confined.

    After Scheidt, Reinkensmeyer, Conditt, Rymer & Mussa-Ivaldi (2000), J. Neurophysiol. 84:853.
    Stiffness and damping are as large as substeps allow: a free last segment of mobility Λ (see
    `ArmParameters.strongest_field`) loses half of its speed across in a substep.
    """

    def __init__(self, linkages: Sequence[Linkage]) -> None:
        arms = [linkage.parameters for linkage in linkages]
        strongest = np.array([arm.strongest_field for arm in arms])
        self._damping, self._substeps = strongest / 4, np.array([arm.substeps for arm in arms])
        self._stiffness = strongest / (8 * np.array([arm.substep for arm in arms]))
        self._ahead = np.array(
            [length - centre for _, length, centre in (a.rods[-1] for a in linkages)]
        )
        self._starts, self._along = np.zeros((2, len(arms), 2))
        self.contacts = np.zeros((len(arms), 2))  #: `SingleArm.contact` of each

    def confine(self, members: Sequence[int], starts: Floats, ends: Floats) -> None:
        """Confine the hands of some arms to lines; equal ends leave them free."""
        way, self.contacts[members] = ends - starts, 0.0
        length = np.sqrt((way * way).sum(axis=-1, keepdims=True))
        self._starts[members], self._along[members] = starts, way / (length + (length == 0.0))

    def pushes(self, motion: Floats) -> Floats:
        """Return force (x, y) and torque on the last segments, (n, 3); see `HandField.impulses`."""
        last, left = motion[:, -1], self._along[:, ::-1] * _LEFT
        forward = self._ahead[:, None] * np.stack([np.cos(last[:, 2]), np.sin(last[:, 2])], axis=-1)
        aside = forward[:, ::-1] * _LEFT
        hands, velocities = last[:, :2] + forward, last[:, 3:5] + last[:, 5:] * aside
        across = (left * (hands - self._starts)).sum(axis=-1)
        force = self._stiffness * across + self._damping * (left * velocities).sum(axis=-1)
        speed = (self._along * velocities).sum(axis=-1)
        self.contacts += np.stack([force, speed], axis=-1) / self._substeps[:, None]
        back = -force[:, None] * left
        return np.concatenate([back, (aside * back).sum(axis=-1, keepdims=True)], axis=-1)
