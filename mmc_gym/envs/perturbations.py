"""Perturbations: what goes wrong with the body, with the sight of the hand, or with the senses.

Each is a frozen dataclass of physical parameters.  They can be combined.  Some change the body
(`change_body`); a visuomotor rotation moves the cursor that stands for the hand; noise and delay
change what is observed, not what is rewarded.  Lengths are in segment lengths.

`mmc_gym.envs.scenarios` gives them names, with any strength.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar, TypeVar

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from mmc_gym._errors import (
    is_disc,
    is_point,
    is_whole,
    require,
    require_finite,
    require_not_negative,
    require_numbers,
    require_positive,
    require_rows,
    spelt,
)

if TYPE_CHECKING:  # names are registered without loading the physics
    from mmc_gym.body import ArmParameters

Floats = NDArray[np.float64]
Coordinate = TypeVar("Coordinate", float, Floats)


class Perturbation:
    """Something that goes wrong; this base class changes nothing."""

    told: bool = False  # whether agents know the changed body

    def change_body(self, body: ArmParameters) -> ArmParameters:
        """Return the arm under this perturbation."""
        return body


@spelt
@dataclass(frozen=True)
class ForceField(Perturbation):
    """A viscous curl field pushes the hand sideways: force = `curl` · (v_y, −v_x).

    Viscous fields at the hand are Shadmehr & Mussa-Ivaldi's (1994), J. Neurosci. 14:3208.
    The hand leaves its course where the field takes the servos to their torque limit.  Up to a curl
    of about 120 they bring it to its target in 2 s nearly always, at 200 in 85 % of random
    movements.

    Attributes:
        curl: mass / s; positive bends to the right of the movement.
    """

    curl: float = 60.0

    def __post_init__(self) -> None:
        require_finite("curl", self.curl)

    @override
    def change_body(self, body: ArmParameters) -> ArmParameters:
        old = body.force_field or ((0.0, 0.0), (0.0, 0.0))
        # Several fields add.
        field = ((old[0][0], old[0][1] + self.curl), (old[1][0] - self.curl, old[1][1]))
        return replace(body, force_field=field)


@spelt
@dataclass(frozen=True)
class HandMass(Perturbation):
    """The hand carries a point mass; several add.

    Attributes:
        mass: segment masses; 3 is as heavy as the default arm.
    """

    mass: float = 3.0

    def __post_init__(self) -> None:
        require_not_negative(mass=self.mass)

    @override
    def change_body(self, body: ArmParameters) -> ArmParameters:
        return replace(body, hand_mass=body.hand_mass + self.mass)


@spelt
@dataclass(frozen=True)
class Gravity(Perturbation):
    """The arm hangs in gravity, which pulls along −y.  Agents are told of it.

    Attributes:
        acceleration: segment lengths / s²; it adds to the `gravity` of the arm.
    """

    acceleration: float = 60.0
    told = True

    def __post_init__(self) -> None:
        require_finite("acceleration", self.acceleration)

    @override
    def change_body(self, body: ArmParameters) -> ArmParameters:
        x, y = body.gravity
        return replace(body, gravity=(x, y - self.acceleration))


@spelt
@dataclass(frozen=True)
class SegmentLength(Perturbation):
    """A segment is longer or shorter than it was: a tool, a growth, a cut.  Its mass stays.

    Attributes:
        factor: new length over old.
        segment: index of the segment; -1 is the last.
        told: whether agents are told the new length.
    """

    factor: float = 1.2
    segment: int = -1
    told: bool = False

    def __post_init__(self) -> None:
        require_positive("factor", self.factor)

    @override
    def change_body(self, body: ArmParameters) -> ArmParameters:
        lengths = list(body.segment_lengths)
        lengths[_index("segment", self.segment, len(lengths))] *= self.factor
        return replace(body, segment_lengths=tuple(lengths))


@spelt
@dataclass(frozen=True)
class LockedJoint(Perturbation):
    """A joint becomes rigid at the angle that it has, and stays so until the next reset.

    Locked from the start, the targets are ones that the other joints can reach.  Locked on the
    way, the target may have become unreachable, and there is no way to tell beforehand.

    Attributes:
        joint: index of the joint, from the base outward.
        time: when it locks, s after the start; the same for all joints that lock.
        told: whether agents are told which joint it is (`env.unwrapped.parameters`).
    """

    joint: int = 1
    time: float = 0.0
    told: bool = False

    def __post_init__(self) -> None:
        require_not_negative(time=self.time)

    @override
    def change_body(self, body: ArmParameters) -> ArmParameters:
        joint = _index("joint", self.joint, len(body.segment_lengths))
        return replace(body, lockable_joints=(*body.lockable_joints, joint))


@spelt
@dataclass(frozen=True)
class Obstacles(Perturbation):
    """Fixed discs in the plane stop the arm, without friction; several add.

    Starting postures and drawn targets are clear of them.  The way between may be blocked, and
    the path of a pursued target may lead through.  A segment that is thrown against a disc is
    stopped once it is in it.  Physics steps are therefore half as long as without obstacles:
    in a million control steps of rough commands segments sank in by at most 0.07, and without
    that by 0.14.

    Attributes:
        discs: (x, y, radius) of each.
        segment_radius: half the thickness of the segments.
    """

    discs: tuple[tuple[float, float, float], ...] = ((1.5, 1.0, 0.25), (-1.5, 1.0, 0.25))
    segment_radius: float = 0.05

    def __post_init__(self) -> None:
        accepted = "discs (x, y, radius), finite, of positive radius"
        require_rows("discs", self.discs, accepted, is_disc)
        require_positive("segment_radius", self.segment_radius)

    @override
    def change_body(self, body: ArmParameters) -> ArmParameters:
        discs = (*body.obstacles, *self.discs)
        arm = replace(body, obstacles=discs, segment_radius=self.segment_radius)
        if body.obstacles:  # with steps that are short enough
            return arm
        return replace(arm, substep=body.substep / 2, substeps=2 * body.substeps)


@dataclass(frozen=True)
class Readings:
    """Readings of the senses of arms before they are encoded; the hand may be a cursor's."""

    joint_angles: Floats  # (..., N), radians
    joint_velocities: Floats  # (..., N), rad/s
    hand: Floats  # (..., 2), segment lengths
    target: Floats  # (..., 2)


class Noise(Perturbation):
    """Noise of the senses, white in time and normally distributed."""

    def draws(self, joint_count: int) -> int:
        """Return how many standard normal numbers `disturb` takes."""
        raise NotImplementedError

    def disturb(self, readings: Readings, normals: Floats) -> Readings:
        """Return the readings under noise made of standard normal numbers (..., draws)."""
        raise NotImplementedError


@spelt
@dataclass(frozen=True)
class VisuomotorRotation(Perturbation):
    """A cursor stands for the hand, turned about a centre; it is seen, measured and rewarded.

    After Krakauer, Pine, Ghilardi & Ghez (2000), J. Neurosci. 20:8916, who turned by 30°.

    Attributes:
        degrees: counter-clockwise.
        centre: (x, y) of the one place where the cursor is on the hand.  None: where the task's
            movements begin; the base, if they begin anywhere.  Turned about the base, the cursor
            reaches whatever the hand does; about another point, tasks with fixed targets near
            the border of the reach may ask for more than that.
    """

    degrees: float = 30.0
    centre: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        require_finite("degrees", self.degrees)
        if self.centre is not None:
            require_numbers("centre", self.centre, "two finite values (x, y)", is_point)

    def cursor(self, x: Coordinate, y: Coordinate) -> tuple[Coordinate, Coordinate]:
        """Return where the cursor is for a hand at (x, y): numbers, or arrays of one shape."""
        cos, sin = math.cos(math.radians(self.degrees)), math.sin(math.radians(self.degrees))
        centre = self.centre or (0.0, 0.0)
        x, y = x - centre[0], y - centre[1]
        return centre[0] + cos * x - sin * y, centre[1] + sin * x + cos * y

    def hand(self, x: Coordinate, y: Coordinate) -> tuple[Coordinate, Coordinate]:
        """Return where the hand is for a cursor at (x, y)."""
        return replace(self, degrees=-self.degrees).cursor(x, y)


@spelt
@dataclass(frozen=True)
class JointNoise(Noise):
    """Noise of joint angles and velocities.

    Standing still, people feel their joint angles to about 1° (van Beers, Sittig & Denier van
    der Gon, 1998, Exp. Brain Res. 122:367).

    Attributes:
        std: standard deviation of the angles, rad; that of the velocities is ten a second of it.
        speed_std: what is added to it by the joint's speed, s.
    """

    std: float = 0.02
    speed_std: float = 0.0
    _RATE: ClassVar[float] = 10.0  # 1/s

    def __post_init__(self) -> None:
        require_not_negative(std=self.std, speed_std=self.speed_std)

    @override
    def draws(self, joint_count: int) -> int:
        return 2 * joint_count

    @override
    def disturb(self, readings: Readings, normals: Floats) -> Readings:
        count = readings.joint_angles.shape[-1]
        std = self.std + self.speed_std * np.abs(readings.joint_velocities)
        return replace(
            readings,
            joint_angles=readings.joint_angles + std * normals[..., :count],
            joint_velocities=readings.joint_velocities + self._RATE * std * normals[..., count:],
        )


@spelt
@dataclass(frozen=True)
class VisionNoise(Noise):
    """Noise of where hand and target are seen, in each coordinate.

    Attributes:
        std: standard deviation, segment lengths.
        distance_std: what is added to it by the distance between hand and target, as a
            fraction of it (Weber's law).
    """

    std: float = 0.03
    distance_std: float = 0.0

    def __post_init__(self) -> None:
        require_not_negative(std=self.std, distance_std=self.distance_std)

    @override
    def draws(self, joint_count: int) -> int:
        return 4

    @override
    def disturb(self, readings: Readings, normals: Floats) -> Readings:
        offset = readings.target - readings.hand
        x, y = offset[..., 0], offset[..., 1]
        std = (self.std + self.distance_std * np.sqrt(x * x + y * y))[..., None]
        return replace(
            readings,
            hand=readings.hand + std * normals[..., :2],
            target=readings.target + std * normals[..., 2:],
        )


@spelt
@dataclass(frozen=True)
class SensoryDelay(Perturbation):
    """All is observed late; until the delay is over, the state at the start is shown.

    `gymnasium.wrappers.DelayObservation` delays likewise, but shows zeros at first, which are
    the observation of no posture, and cannot wrap a vector environment.

    Attributes:
        seconds: by how much, rounded to control steps; several add.
    """

    seconds: float = 0.1

    def __post_init__(self) -> None:
        require_not_negative(seconds=self.seconds)


def _index(name: str, index: int, count: int) -> int:
    """Return the index from 0 on, of one that may count from the end."""
    fine = is_whole(index) and -count <= index < count
    require(fine, name, index, f"an index from {-count} to {count - 1}")
    return index % count
