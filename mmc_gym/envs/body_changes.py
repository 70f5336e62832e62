"""Perturbations of the body: each is a frozen dataclass that makes another arm of an arm.

Lengths are in segment lengths, masses in segment masses (the arm weighs 3, reaches 3).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from mmc_gym.body import ArmParameters


class Perturbation:
    """Something that goes wrong; by itself it changes nothing.

    Attributes:
        told: whether agents are told of the changed body.
    """

    told: bool = False

    def change_body(self, body: ArmParameters) -> ArmParameters:
        """The arm under this perturbation."""
        return body


@dataclass(frozen=True)
class ForceField(Perturbation):
    """A viscous curl field pushes the hand sideways: force = `curl` · (v_y, −v_x).

    Viscous fields at the hand are Shadmehr & Mussa-Ivaldi's (1994), J. Neurosci. 14:3208.
    Servos with torque to spare hold their course: the hand leaves it where the field takes them
    to their torque limit.  From a curl of about 80 on, they may fail to bring it to the target.

    Attributes:
        curl: mass / s; positive bends to the right of the movement.
    """

    curl: float = 60.0

    def change_body(self, body: ArmParameters) -> ArmParameters:
        """See `Perturbation.change_body`; fields add."""
        old = body.force_field or ((0.0, 0.0), (0.0, 0.0))
        field = ((old[0][0], old[0][1] + self.curl), (old[1][0] - self.curl, old[1][1]))
        return replace(body, force_field=field)


@dataclass(frozen=True)
class HandMass(Perturbation):
    """The hand carries a point mass.

    Attributes:
        mass: segment masses; 3 is as heavy as the default arm.
    """

    mass: float = 3.0

    def change_body(self, body: ArmParameters) -> ArmParameters:
        """See `Perturbation.change_body`; masses add."""
        return replace(body, hand_mass=body.hand_mass + self.mass)


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

    def change_body(self, body: ArmParameters) -> ArmParameters:
        """See `Perturbation.change_body`."""
        lengths = list(body.segment_lengths)
        lengths[_index("segment", self.segment, len(lengths))] *= self.factor
        return replace(body, segment_lengths=tuple(lengths))


@dataclass(frozen=True)
class LockedJoint(Perturbation):
    """A joint becomes rigid at the angle that it has, and stays so until the next reset.

    Locked from the start, the targets are ones that the other joints can reach.  Locked on the
    way, the target may have become unreachable, and there is no way to tell beforehand.

    Attributes:
        joint: index of the joint, from the base outward.
        time: when it locks, s after the start.
        told: whether agents are told which joint it is (`env.unwrapped.parameters`).
    """

    joint: int = 1
    time: float = 0.0
    told: bool = False

    def change_body(self, body: ArmParameters) -> ArmParameters:
        """See `Perturbation.change_body`."""
        joint = _index("joint", self.joint, len(body.segment_lengths))
        return replace(body, lockable_joints=(*body.lockable_joints, joint))


@dataclass(frozen=True)
class Obstacles(Perturbation):
    """Fixed discs in the plane stop the arm, without friction.

    Starting postures and drawn targets are clear of them.  The way between may be blocked, and
    the path of a pursued target may lead through.  A segment that is pressed or thrown against
    a disc sinks in a little, by up to about 0.08.

    Attributes:
        discs: (x, y, radius) of each.
        segment_radius: half the thickness of the segments.
    """

    discs: tuple[tuple[float, float, float], ...] = ((1.5, 1.0, 0.25), (-1.5, 1.0, 0.25))
    segment_radius: float = 0.05

    def change_body(self, body: ArmParameters) -> ArmParameters:
        """See `Perturbation.change_body`; discs add."""
        discs = (*body.obstacles, *self.discs)
        return replace(body, obstacles=discs, segment_radius=self.segment_radius)


def _index(name: str, index: int, count: int) -> int:
    if not -count <= index < count:
        raise ValueError(f"{name} must be an index from {-count} to {count - 1}, got {index}")
    return index % count
