"""Physical parameters of an arm, the same for every engine."""

from __future__ import annotations

import math
from collections.abc import Iterable
from copy import copy
from dataclasses import dataclass, fields
from functools import partial
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmc_gym._errors import (
    LARGEST_SIZE,
    SMALLEST_SIZE,
    is_disc,
    is_point,
    require,
    require_between,
    require_numbers,
    require_rows,
    require_whole,
    spelt,
)

Servo = Literal["position", "velocity", "torque"]
_DEFAULT_INERTIA = 9.0  # of the default arm, stretched, about its base
_MOST_SUBSTEPS = 10_000
_SWEEPS_PER_MASS = 20 / 3  # of the rods beyond a joint, in masses of the first of them
_SWEEPS_PER_LOAD = 12  # of the load at the hand, in the same unit
_RANGES = {
    "speed_limit": (SMALLEST_SIZE, LARGEST_SIZE),
    "torque_limit": (SMALLEST_SIZE, 1e30),
    "servo_gain": (SMALLEST_SIZE, LARGEST_SIZE),
    "segment_radius": (SMALLEST_SIZE, LARGEST_SIZE),
    "substep": (SMALLEST_SIZE, 1.0),
    "drive_inertia": (0.0, LARGEST_SIZE),
    "joint_friction": (0.0, 1e30),
    "joint_damping": (0.0, 1e30),
    "hand_mass": (0.0, LARGEST_SIZE),
}


class Rod(NamedTuple):
    """Mass and inertia of a segment, including its drive and its load."""

    mass: float  #: mass
    centre: float  #: distance of the centre of gravity from the joint, length
    #: moment of inertia about the centre of gravity plus the drive's, mass · length²
    inertia: float


@spelt
@dataclass(frozen=True, kw_only=True)
class ArmParameters:
    """Physical parameters of an arm, in segment lengths, segment masses, radians and seconds.

    Lengths, masses, speeds and gains are from 1e-9 to 1e9 (drives and loads may be 0), torques up
    to 1e30, and a substep lasts at most a second: with more, states would not stay finite.

    With the default limits the arm, stretched or folded, turns by 90° in 0.40 s to within 0.05 rad,
    and does not overshoot.

    Each segment also turns the rotor of a geared drive, as if motors at the base drove the segments
    by belts.  By default a drive has a quarter of the inertia that it moves: that of the stretched
    arm from the joint on, without a load at the hand.  Bare rods are an ill-conditioned chain:
    after the same number of sweeps, pymunk leaves them at least forty times farther from the exact
    movement.
    """

    segment_lengths: tuple[float, ...] = (1.0, 1.0, 1.0)  #: N positive lengths
    #: N positive masses of the uniform rods, or None for 1 each
    segment_masses: tuple[float, ...] | None = None
    speed_limit: float = 2 * math.pi  #: largest joint speed that a servo asks for, rad/s
    #: largest torque of a servo, mass · length² / s².  The default is 500.  With default masses and
    #: more inertia about the base than the default arm (both stretched), it is 500 times the ratio
    #: of these inertias: 18,519 for ten segments.  A changed arm (`dataclasses.replace`,
    #: perturbations) keeps its limit.
    torque_limit: float = None  # type: ignore[assignment]  # a number from `__post_init__` on
    servo_gain: float = 12.0  #: speed that a position servo asks for per angle to its target, 1/s
    #: lowest and highest angle of each joint, or None for continuous joints
    joint_limits: tuple[tuple[float, float], ...] | None = None
    gravity: tuple[float, float] = (0.0, 0.0)  #: acceleration (x, y), length / s²
    #: inertia of each drive, as a fraction of that of the stretched arm from its joint on; 0 for
    #: bare rods
    drive_inertia: float = 0.25
    #: dry friction (Coulomb's), the torque against the movement of each joint, mass · length² / s²;
    #: it holds joints at rest
    joint_friction: float = 0.0
    joint_damping: float = 0.0  #: viscous friction, torque per speed, mass · length² / s
    hand_mass: float = 0.0  #: point mass carried at the hand, mass
    #: 2 × 2 matrix of a viscous force field, mass / s, or None.  The force on the hand is
    #: `force_field` · (velocity of the hand).  Engines refuse a field stronger than
    #: `strongest_field`, or that pushes more than `strongest_push`.
    force_field: tuple[tuple[float, float], tuple[float, float]] | None = None
    #: fixed discs (x, y, radius) that the segments collide with, without friction
    obstacles: tuple[tuple[float, float, float], ...] = ()
    segment_radius: float = 0.05  #: half the thickness of the segments in collisions, length
    #: indices of the joints that `lock` makes rigid where they are
    lockable_joints: tuple[int, ...] = ()
    substep: float = 0.005  #: duration of a physics step, s
    substeps: int = 4  #: number of physics steps in a control step

    def __post_init__(self) -> None:
        # All fields become floats: arrays made from whole numbers would round later values.
        write = partial(object.__setattr__, self)
        sizes = f"from {SMALLEST_SIZE:g} to {LARGEST_SIZE:g}"
        accepted = f"positive and finite lengths {sizes}, one or more"
        lengths = require_numbers("segment_lengths", self.segment_lengths, accepted, _are_positive)
        write("segment_lengths", lengths)
        count = len(lengths)
        if self.segment_masses is not None:
            accepted = f"{count} positive and finite masses {sizes}, one per segment"
            masses = require_numbers("segment_masses", self.segment_masses, accepted, _are_positive)
            require(len(masses) == count, "segment_masses", masses, accepted)
            write("segment_masses", masses)
        if self.torque_limit is None:
            # Strong servos would tear light segments among heavy ones apart in pymunk.
            is_plain = self.segment_masses is None
            heavier = self._stretched_inertias()[0] / _DEFAULT_INERTIA if is_plain else 1.0
            write("torque_limit", 500.0 * max(1.0, heavier))
        for name, (least, most) in _RANGES.items():
            require_between(least, most, **{name: getattr(self, name)})
            write(name, float(getattr(self, name)))
        require_whole("substeps", self.substeps, most=_MOST_SUBSTEPS)
        accepted = "two finite values (x, y)"
        gravity = require_numbers("gravity", self.gravity, accepted, is_point)
        accepted = f"at most {LARGEST_SIZE:g}"
        require(math.hypot(*gravity) <= LARGEST_SIZE, "gravity", gravity, accepted)
        write("gravity", gravity)
        if self.joint_limits is not None:
            accepted = f"{count} pairs low < high within -pi and pi, one per joint"
            limits = require_rows("joint_limits", self.joint_limits, accepted, _is_range, (count,))
            write("joint_limits", limits)
        if self.force_field is not None:
            accepted = "two rows of two finite values"
            field = require_rows("force_field", self.force_field, accepted, is_point, (2,))
            write("force_field", field)
        accepted = "discs (x, y, radius), finite, of positive radius"
        write("obstacles", require_rows("obstacles", self.obstacles, accepted, is_disc))
        accepted = f"a tuple of different indices from 0 to {count - 1}"
        joints = require_numbers(
            "lockable_joints",
            self.lockable_joints,
            accepted,
            lambda joints: len(set(joints) & set(range(count))) == len(joints),
        )
        write("lockable_joints", tuple(map(int, joints)))

    @property
    def masses(self) -> tuple[float, ...]:
        """`segment_masses` with its default filled in."""
        return self.segment_masses or (1.0,) * len(self.segment_lengths)

    @property
    def has_friction(self) -> bool:
        """Whether friction brakes its joints."""
        return self.joint_friction > 0.0 or self.joint_damping > 0.0

    @property
    def rods(self) -> tuple[Rod, ...]:
        """Mass and inertia of each segment; the last one carries `hand_mass`."""
        rods: list[Rod] = []
        held = (0.0,) * (len(self.masses) - 1) + (self.hand_mass,)
        beyond = self._stretched_inertias()
        for mass, length, load, moved in zip(self.masses, self.segment_lengths, held, beyond):
            total, half = mass + load, length / 2
            centre = half * (1 + load / total)
            inertia = mass * (length * length) / 12 + mass * load / total * (half * half)
            rods.append(Rod(total, centre, inertia + self.drive_inertia * moved))
        return tuple(rods)

    def _stretched_inertias(self) -> list[float]:
        """Return the inertia of the stretched arm, without a load, about each joint from it on."""
        inertias: list[float] = []
        mass_beyond, moment, inertia = 0.0, 0.0, 0.0
        for mass, length in zip(reversed(self.masses), reversed(self.segment_lengths)):
            square = length * length  # rounds alike for numbers and arrays; `length**2` does not
            inertia = inertia + (2 * length * moment + mass_beyond * square + mass * square / 3)
            moment = moment + (mass_beyond * length + mass * length / 2)
            mass_beyond = mass_beyond + mass
            inertias.insert(0, inertia)
        return inertias

    @property
    def strongest_field(self) -> float:
        """Largest force field (its spectral norm) that the substeps can simulate, mass / s.

        In a substep h the field F turns the hand's velocity by up to 2 arctan(h |F| Λ / 2), 90° at
        the bound.  Λ = 1/m + (l/2)²/I is the hand's mobility on a last segment that flies free;
        pivots, servos and loads lower it.  Twice as strong fields throw arms at up to thirty times
        their speed limit.
        """
        mobility = (1 + 3 / (1 + 4 * self.drive_inertia)) / self.masses[-1]
        return 2 / (self.substep * mobility)

    @property
    def strongest_push(self) -> float:
        """Largest rate at which a force field may push along the movement of the hand, mass / s.

        It is the larger eigenvalue of the field's symmetric part.  Servos at their torque limit
        still stop an arm that turns at three times its speed limit; beyond, arms may run away.
        """
        reaches = [sum(self.segment_lengths[joint:]) for joint in range(len(self.masses))]
        return self.torque_limit / (3 * self.speed_limit * reaches[0] * sum(reaches))

    @property
    def control_step(self) -> float:
        """Duration of a control step, s."""
        return self.substep * self.substeps

    @property
    def fastest(self) -> float:
        """Joint speed that is out of control, rad/s: ten times the limit, half a turn a substep."""
        return max(10 * self.speed_limit, math.pi / self.substep)

    @property
    def sweeps(self) -> float:
        """Sweeps over the joints in a physics step that pymunk's solver needs for these masses."""
        masses = self.masses
        beyond = [_SWEEPS_PER_MASS * sum(masses[joint:]) for joint in range(len(masses))]
        loads = _SWEEPS_PER_LOAD * self.hand_mass
        return max((moved + loads) / mass for moved, mass in zip(beyond, masses))


def _are_positive(numbers: tuple[float, ...]) -> bool:
    return len(numbers) > 0 and all(SMALLEST_SIZE <= number <= LARGEST_SIZE for number in numbers)


def _is_range(numbers: tuple[float, ...]) -> bool:
    return len(numbers) == 2 and -math.pi <= numbers[0] < numbers[1] <= math.pi


class ArmColumns(ArmParameters):
    """Parameters of k arms of N segments: any number may be an array (k,), and none is checked.

    Where a joint of `lockable_joints` is NaN, the arm has no such joint.
    """

    @classmethod
    def of(cls, arm: ArmParameters) -> ArmColumns:
        """Return the parameters of arms that are all equal to `arm`."""
        return cls(**{field.name: getattr(arm, field.name) for field in fields(ArmParameters)})

    def __post_init__(self) -> None:
        """Leave the numbers as they are."""

    def lockable(self, count: int) -> NDArray[np.bool_]:
        """Return a mask of the lockable joints of `count` arms, (count, N)."""
        mask = np.zeros((count, len(self.segment_lengths)), dtype=bool)
        for joint in self.lockable_joints:
            joints = np.broadcast_to(joint, count)
            arms = np.flatnonzero(joints == joints)  # NaN is none
            mask[arms, joints[arms].astype(np.intp)] = True
        return mask

    def rows(self, count: int) -> list[ArmColumns]:
        """Return the parameters of each of `count` arms, as numbers."""
        values = {field.name: getattr(self, field.name) for field in fields(ArmParameters)}
        rows = [copy(self) for _ in range(count)]
        for name, column in values.items():
            if _has_arrays(column):
                for row, value in zip(rows, _of_each(column, count), strict=True):
                    if name == "lockable_joints":
                        value = tuple(int(joint) for joint in value if not math.isnan(joint))
                    object.__setattr__(row, name, value)
        return rows


def stacked(values: Iterable[Any]) -> NDArray[np.float64]:
    """Return n numbers, or arrays (k,) of the numbers of k arms, as an array (n,) or (k, n)."""
    return np.stack(np.broadcast_arrays(*values), axis=-1).astype(np.float64)


def joints_that_lock(arms: Iterable[ArmParameters]) -> set[int]:
    """Return the joints that are lockable in any of these arms."""
    return {joint for arm in arms for joint in arm.lockable_joints}


def _has_arrays(value: Any) -> bool:
    return any(map(_has_arrays, value)) if type(value) is tuple else isinstance(value, np.ndarray)


def _of_each(value: Any, count: int) -> list[Any]:
    """Return a number, or a tuple of numbers, for each of `count` arms."""
    if type(value) is tuple:
        return [*zip(*(_of_each(part, count) for part in value), strict=True)] or [()] * count
    return value.tolist() if isinstance(value, np.ndarray) else [value] * count
