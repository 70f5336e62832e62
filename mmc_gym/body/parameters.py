"""Physical parameters of an arm: what both engines simulate, and nothing of how."""

from __future__ import annotations

import math
import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, Literal

Servo = Literal["position", "velocity", "torque"]


@dataclass(frozen=True)
class ArmParameters:
    """Physical parameters of an arm, in segment lengths, segment masses, radians and seconds.

    With the default limits the whole stretched arm turns by 90° in 0.36 s (to within 0.05 rad,
    and passes the target by 0.011), and folded, by its first joint alone, in 0.38 s.

    Attributes:
        segment_lengths: N positive lengths.
        segment_masses: N positive masses of the uniform rods, or None for 1 each.
        speed_limit: largest joint speed that a servo asks for, rad/s.
        torque_limit: largest torque of a servo, mass · length² / s².
        servo_gain: speed that a position servo asks for per angle to its target, 1/s.
        joint_limits: lowest and highest angle of each joint, or None for continuous joints.
        gravity: acceleration (x, y), length / s².
        hand_mass: point mass carried at the hand, mass.
        force_field: 2 × 2 matrix, mass / s, or None for no field: the hand feels the force
            `force_field` · (velocity of the hand), a viscous force field.
        obstacles: fixed discs (x, y, radius) that the segments collide with, without friction.
        segment_radius: half the thickness of the segments, where there are obstacles, length.
        lockable_joints: indices of the joints that `lock` makes rigid where they are.
        substep: duration of a physics step, s.
        substeps: physics steps in a control step.

    Raises:
        ValueError: if a value is outside what is stated here.
    """

    segment_lengths: tuple[float, ...] = (1.0, 1.0, 1.0)
    segment_masses: tuple[float, ...] | None = None
    speed_limit: float = 2 * math.pi
    torque_limit: float = 400.0
    servo_gain: float = 12.0
    joint_limits: tuple[tuple[float, float], ...] | None = None
    gravity: tuple[float, float] = (0.0, 0.0)
    hand_mass: float = 0.0
    force_field: tuple[tuple[float, float], tuple[float, float]] | None = None
    obstacles: tuple[tuple[float, float, float], ...] = ()
    segment_radius: float = 0.05
    lockable_joints: tuple[int, ...] = ()
    substep: float = 0.005
    substeps: int = 4

    def __post_init__(self) -> None:
        lengths = tuple(float(length) for length in self.segment_lengths)
        object.__setattr__(self, "segment_lengths", lengths)
        require(bool(lengths), "segment_lengths", lengths, "at least one length")
        if self.segment_masses is not None:
            masses = tuple(float(mass) for mass in self.segment_masses)
            object.__setattr__(self, "segment_masses", masses)
            expected = f"{len(lengths)} masses, one per segment"
            require(len(masses) == len(lengths), "segment_masses", masses, expected)
        for name, values in (
            ("segment_lengths", lengths),
            ("segment_masses", self.masses),
            ("speed_limit", (self.speed_limit,)),
            ("torque_limit", (self.torque_limit,)),
            ("servo_gain", (self.servo_gain,)),
            ("substep", (self.substep,)),
        ):
            fine = all(0 < value < math.inf for value in values)
            require(fine, name, values, "positive and finite")
        whole = isinstance(self.substeps, int) and self.substeps >= 1
        require(whole, "substeps", self.substeps, "a whole number of at least 1")
        gravity = tuple(float(value) for value in self.gravity)
        object.__setattr__(self, "gravity", gravity)
        fine = len(gravity) == 2 and all(map(math.isfinite, gravity))
        require(fine, "gravity", gravity, "two finite values (x, y)")
        if self.joint_limits is not None:
            limits = tuple((float(low), float(high)) for low, high in self.joint_limits)
            object.__setattr__(self, "joint_limits", limits)
            fine = len(limits) == len(lengths) and all(
                -math.pi <= low < high <= math.pi for low, high in limits
            )
            expected = f"{len(lengths)} pairs low < high within -pi and pi"
            require(fine, "joint_limits", limits, expected)

        self._check_perturbations()

    def _check_perturbations(self) -> None:
        mass = float(self.hand_mass)
        object.__setattr__(self, "hand_mass", mass)
        require(0 <= mass < math.inf, "hand_mass", mass, "finite and not negative")
        if self.force_field is not None:
            field = tuple(tuple(float(value) for value in row) for row in self.force_field)
            object.__setattr__(self, "force_field", field)
            fine = [len(row) for row in field] == [2, 2] and all(
                math.isfinite(value) for row in field for value in row
            )
            require(fine, "force_field", field, "two rows of two finite values")
        obstacles = tuple(tuple(float(value) for value in disc) for disc in self.obstacles)
        object.__setattr__(self, "obstacles", obstacles)
        fine = all(len(disc) == 3 and all(map(math.isfinite, disc)) for disc in obstacles)
        fine = fine and all(disc[2] > 0 for disc in obstacles)
        require(fine, "obstacles", obstacles, "discs (x, y, radius), finite, of positive radius")
        radius = self.segment_radius
        require(0 < radius < math.inf, "segment_radius", radius, "positive and finite")
        joints = tuple(self.lockable_joints)
        object.__setattr__(self, "lockable_joints", joints)
        count = len(self.segment_lengths)
        fine = len(set(joints)) == len(joints) and all(joint in range(count) for joint in joints)
        require(fine, "lockable_joints", joints, f"different indices from 0 to {count - 1}")

    @property
    def masses(self) -> tuple[float, ...]:
        """`segment_masses` with its default filled in."""
        return self.segment_masses or (1.0,) * len(self.segment_lengths)

    @property
    def control_step(self) -> float:
        """Duration of a control step, s."""
        return self.substep * self.substeps


def require(fine: bool, name: str, value: object, accepted: str) -> None:
    """Raise a `ValueError` that names the argument, what is accepted and the value."""
    if not fine:
        raise ValueError(f"{name} must be {accepted}, got {value!r}")


class Workers:
    """Helper threads, begun when they are first asked for, and begun anew in a forked process."""

    def __init__(self, threads: int) -> None:
        """Be ready for `threads` threads, the caller's among them."""
        self._threads = threads
        self._pool: ThreadPoolExecutor | None = None
        self._process = 0

    def executor(self) -> ThreadPoolExecutor:
        """The threads of this process; a forked one has inherited none."""
        if self._pool is None or self._process != os.getpid():
            self._pool = ThreadPoolExecutor(self._threads - 1, "arms")
            self._process = os.getpid()
        return self._pool

    def close(self) -> None:
        """End the threads; who asks for them later begins new ones."""
        if self._pool is not None and self._process == os.getpid():
            self._pool.shutdown()
        self._pool = None

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_pool": None}  # threads belong to a process
