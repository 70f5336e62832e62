"""Physical parameters of an arm: what every engine simulates, and nothing of how."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from numbers import Integral
from typing import Literal, NamedTuple

from mmc_gym._errors import require

Servo = Literal["position", "velocity", "torque"]


class Rod(NamedTuple):
    """Inertia of a segment with what it carries.

    Attributes:
        mass: mass.
        centre: distance of the centre of gravity from the joint, length.
        inertia: moment of inertia about the centre of gravity, with the drive's, mass · length².
    """

    mass: float
    centre: float
    inertia: float


@dataclass(frozen=True)
class ArmParameters:
    """Physical parameters of an arm, in segment lengths, segment masses, radians and seconds.

    With the default limits the arm turns by 90° in 0.40 s, to within 0.05 rad, and does not
    overshoot, stretched or folded.

    Each segment turns the rotor of a geared drive with it, as where motors at the base drive the
    segments by belts.  Drives are chosen to fit what they move; here the inertia of the stretched
    arm from the joint on, without a hand's load, is four times the drive's.  Bare rods are an
    ill-conditioned chain: with as many sweeps, pymunk leaves them forty times farther from the
    exact movement, or more.

    Attributes:
        segment_lengths: N positive lengths.
        segment_masses: N positive masses of the uniform rods, or None for 1 each.
        speed_limit: largest joint speed that a servo asks for, rad/s.
        torque_limit: largest torque of a servo, mass · length² / s².
        servo_gain: speed that a position servo asks for per angle to its target, 1/s.
        joint_limits: lowest and highest angle of each joint, or None for continuous joints.
        gravity: acceleration (x, y), length / s².
        drive_inertia: inertia of each drive, as a fraction of that of the stretched arm from its
            joint on; 0 for bare rods.
        hand_mass: point mass carried at the hand, mass.
        force_field: 2 × 2 matrix, mass / s, or None for no field: the hand feels the force
            `force_field` · (velocity of the hand), a viscous force field.
        obstacles: fixed discs (x, y, radius) that the segments collide with, without friction.
        segment_radius: half the thickness of the segments, where there are obstacles, length.
        lockable_joints: indices of the joints that `lock` makes rigid where they are.
        substep: duration of a physics step, s.
        substeps: physics steps in a control step.

    Raises:
        UserError: if a value is outside what is stated here.
    """

    segment_lengths: tuple[float, ...] = (1.0, 1.0, 1.0)
    segment_masses: tuple[float, ...] | None = None
    speed_limit: float = 2 * math.pi
    torque_limit: float = 500.0
    servo_gain: float = 12.0
    joint_limits: tuple[tuple[float, float], ...] | None = None
    gravity: tuple[float, float] = (0.0, 0.0)
    drive_inertia: float = 0.25
    hand_mass: float = 0.0
    force_field: tuple[tuple[float, float], tuple[float, float]] | None = None
    obstacles: tuple[tuple[float, float, float], ...] = ()
    segment_radius: float = 0.05
    lockable_joints: tuple[int, ...] = ()
    substep: float = 0.005
    substeps: int = 4

    def __post_init__(self) -> None:
        lengths = self._make_floats("segment_lengths")
        count = len(lengths)
        require(count > 0, "segment_lengths", lengths, "at least one length")
        if self.segment_masses is not None:
            masses = self._make_floats("segment_masses")
            accepted = f"{count} masses, one per segment"
            require(len(masses) == count, "segment_masses", masses, accepted)
        for name in ("segment_lengths", "segment_masses"):
            values = getattr(self, name) or ()
            require(
                all(0 < value < math.inf for value in values), name, values, "positive and finite"
            )
        for name in ("speed_limit", "torque_limit", "servo_gain", "substep", "segment_radius"):
            value = self._make_float(name)
            require(0 < value < math.inf, name, value, "positive and finite")
        for name in ("drive_inertia", "hand_mass"):
            value = self._make_float(name)
            require(0 <= value < math.inf, name, value, "finite and not negative")
        whole = isinstance(self.substeps, Integral) and self.substeps >= 1
        require(whole, "substeps", self.substeps, "a whole number of at least 1")
        gravity = self._make_floats("gravity")
        fine = len(gravity) == 2 and _are_finite(gravity)
        require(fine, "gravity", gravity, "two finite values (x, y)")
        if self.joint_limits is not None:
            limits = self._make_rows("joint_limits")
            fine = len(limits) == count and all(
                len(pair) == 2 and -math.pi <= pair[0] < pair[1] <= math.pi for pair in limits
            )
            accepted = f"{count} pairs low < high within -pi and pi"
            require(fine, "joint_limits", limits, accepted)

        if self.force_field is not None:
            field = self._make_rows("force_field")
            fine = [len(row) for row in field] == [2, 2] and all(map(_are_finite, field))
            require(fine, "force_field", field, "two rows of two finite values")
        discs = self._make_rows("obstacles")
        fine = all(len(disc) == 3 and _are_finite(disc) and disc[2] > 0 for disc in discs)
        require(fine, "obstacles", discs, "discs (x, y, radius), finite, of positive radius")
        joints = tuple(self.lockable_joints)
        object.__setattr__(self, "lockable_joints", joints)
        fine = len(set(joints)) == len(joints) and set(joints) <= set(range(count))
        require(fine, "lockable_joints", joints, f"different indices from 0 to {count - 1}")

    def _make_float(self, name: str) -> float:
        """Turn a field into a float, for arrays of whole numbers round what is written to them."""
        value = float(getattr(self, name))
        object.__setattr__(self, name, value)
        return value

    def _make_floats(self, name: str) -> tuple[float, ...]:
        """Turn a field into a tuple of floats."""
        values = tuple(map(float, getattr(self, name)))
        object.__setattr__(self, name, values)
        return values

    def _make_rows(self, name: str) -> tuple[tuple[float, ...], ...]:
        """Turn a field into a tuple of tuples of floats."""
        rows = tuple(tuple(map(float, row)) for row in getattr(self, name))
        object.__setattr__(self, name, rows)
        return rows

    @property
    def masses(self) -> tuple[float, ...]:
        """`segment_masses` with its default filled in."""
        return self.segment_masses or (1.0,) * len(self.segment_lengths)

    @property
    def rods(self) -> tuple[Rod, ...]:
        """Inertia of each segment with its drive; the last one carries the hand's mass."""
        rods: list[Rod] = []
        held, mass_beyond, moment, stretched = self.hand_mass, 0.0, 0.0, 0.0
        for mass, length in zip(reversed(self.masses), reversed(self.segment_lengths)):
            # Mass, first and second moment of the stretched arm about the joint, without a load.
            stretched += 2 * length * moment + mass_beyond * length**2 + mass * length**2 / 3
            moment += mass_beyond * length + mass * length / 2
            mass_beyond += mass
            total = mass + held
            centre = length / 2 * (1 + held / total)
            inertia = mass * length**2 / 12 + mass * held / total * (length / 2) ** 2
            rods.insert(0, Rod(total, centre, inertia + self.drive_inertia * stretched))
            held = 0.0
        return tuple(rods)

    @property
    def control_step(self) -> float:
        """Duration of a control step, s."""
        return self.substep * self.substeps


def _are_finite(values: Iterable[float]) -> bool:
    return all(map(math.isfinite, values))
