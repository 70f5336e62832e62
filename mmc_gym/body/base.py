"""The interfaces of arms for every engine: one arm, or many arms at once."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from math import nan
from typing import get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mmc_gym._errors import UserError, require, require_choice, require_whole
from mmc_gym.body.parameters import ArmParameters, Servo

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]
NewParameters = list[tuple[Indices, ArmParameters]]  # of some arms, which may be `ArmColumns`
MOST_SWEEPS = 500  # of pymunk's solver; with them, a step of three segments takes 0.1 ms
_LARGEST_RATIO_OF_NEIGHBOURS = 10.0


class SingleArm(ABC):
    """A planar arm of N segments, its base at the origin.

    All sequences run from the base outward.  Joint angles are relative, 0 = straight on.
    """

    segment_angles: list[float]  #: absolute, after the last step, rad, not wrapped
    joint_angles: list[float]  #: relative, after the last step, rad, not wrapped
    joint_velocities: list[float]  #: rad/s
    end_effector: tuple[float, float]  #: position of the hand, (x, y)
    records_effort: bool = False  #: whether steps record the effort of the servos
    #: ∫ |τ| dt of each servo in the last recorded step, mass · length² / s.  NaN before the first,
    #: and always on the analytic engine.  Stops and locks do not count.
    servo_impulses: list[float]
    servo_work: list[float]  #: ∫ |τ q̇| dt of each servo in the same step, mass · length² / s²
    #: force of a confined hand on the wall to its left, mass · length / s², and its speed along the
    #: line, length / s; means over the last step
    contact: Sequence[float] = (0.0, 0.0)

    def __init__(self, parameters: ArmParameters | None = None, servo: Servo = "position") -> None:
        """Build the arm, stretched along the x axis and at rest; see `command` for its servos.

        An arm that the engine cannot simulate raises a `UserError`.
        """
        require_choice("servo", servo, get_args(Servo))
        self.parameters = _checked(parameters)
        self._fastest = self.parameters.fastest
        self._servo: Servo = servo
        self._count = len(self.parameters.segment_lengths)
        self.servo_impulses = self.servo_work = [nan] * self._count
        self._build()
        self.reset([0.0] * self._count)

    def reset(
        self,
        joint_angles: Sequence[float],
        joint_velocities: Sequence[float] | None = None,
        parameters: ArmParameters | None = None,
    ) -> None:
        """Place the arm.  From then on it moves as a newly built one does, bit for bit.

        Until the first command the servos hold the posture (position), stop the joints (velocity)
        or are slack (torque).  Locks are open again.  Angles are N, relative, in radians;
        velocities N, relative, in rad/s, or None for rest.  `parameters` are new ones, of as many
        segments; None keeps those of the arm.
        """
        speeds = [0.0] * self._count if joint_velocities is None else joint_velocities
        self._require_count("joint_angles", joint_angles)
        self._require_count("joint_velocities", speeds)
        if parameters is not None and parameters != self.parameters:
            self._require_count("segment_lengths", parameters.segment_lengths)
            self.parameters = _checked(parameters)
            self._fastest = parameters.fastest
            self._build()
        self._place(joint_angles, speeds)

    def command(self, values: Sequence[float]) -> None:
        """Set N values for the servos, which keep them until the next call.

        The values are joint targets in radians ("position"), joint velocities in rad/s ("velocity")
        or torques ("torque").  A joint with limits turns to its target within them; any other joint
        turns the short way round.  Another number of values raises a `UserError`.
        """
        self._require_count("command", values)
        self._command(values)

    def _require_count(self, name: str, values: Sequence[float]) -> None:
        if len(values) != self._count:
            raise UserError(f"{name} must be {self._count} values, got {values!r}")

    @abstractmethod
    def step(self) -> None:
        """Simulate one control step; raise a `UserError` if the movement gets out of control."""

    def _require_control(self) -> None:
        fastest = self._fastest
        for velocity in self.joint_velocities:
            if not -fastest <= velocity <= fastest:  # true for NaN too
                raise _out_of_control(fastest, self.joint_velocities)

    @abstractmethod
    def lock(self) -> None:
        """Make the `lockable_joints` rigid at their present angles, until the next reset."""

    @abstractmethod
    def unlock(self) -> None:
        """Let locked joints turn again."""

    def confine(self, start: Sequence[float], end: Sequence[float]) -> None:
        """Let walls confine the hand to the line from start to end (x, y), until the next reset."""
        raise UserError('engine must be "pymunk" for a channel, which the analytic engine has not')

    @abstractmethod
    def load(self, parameters: ArmParameters) -> None:
        """Take on the `hand_mass` and the `force_field` of other parameters, until the next reset.

        No speed changes with it.  All other parameters must be equal.
        """

    @abstractmethod
    def _build(self) -> None: ...

    @abstractmethod
    def _place(self, joint_angles: Sequence[float], joint_velocities: Sequence[float]) -> None: ...

    @abstractmethod
    def _command(self, values: Sequence[float]) -> None: ...


class ArmBatch(ABC):
    """Many arms, each of which moves as if it were alone.

    The attributes are those of `SingleArm` with a leading axis: `end_effectors` have shape
    (count, 2); angles, velocities and efforts have shape (count, N).  Every step and reset
    overwrites these arrays: copy what you want to keep.
    """

    segment_angles: Floats
    joint_angles: Floats
    joint_velocities: Floats
    end_effectors: Floats
    contacts: Floats  # as `SingleArm.contact`, (count, 2); of arms in pymunk
    records_effort: bool = False

    def __init__(
        self,
        parameters: ArmParameters | None = None,
        count: int = 1,
        servo: Servo = "position",
        threads: int = 1,
        others: Sequence[ArmParameters] = (),
    ) -> None:
        """Build equal arms, stretched along the x axis and at rest; see `SingleArm`.

        The number of threads does not change the result.  With `others`, a reset can give arms new
        parameters: those of `others`, or values between them.
        """
        require_choice("servo", servo, get_args(Servo))
        self._count = require_whole("count", count)
        self._threads = require_whole("threads", threads)
        self.parameters = _checked(parameters)
        self._servo: Servo = servo
        self._others, self._is_loaded = tuple(others), False
        self._shape = self._count, len(self.parameters.segment_lengths)
        self.servo_impulses: Floats = np.full(self._shape, nan)
        self.servo_work: Floats = np.full(self._shape, nan)
        self._pool: ThreadPoolExecutor | None = None
        self._pool_owner = 0  # the process that its threads belong to
        self._build()
        self.reset(np.zeros(self._shape))

    def reset(
        self,
        joint_angles: ArrayLike,
        arms: ArrayLike | None = None,
        joint_velocities: ArrayLike | None = None,
        parameters: ArmParameters | Sequence[ArmParameters] | None = None,
    ) -> None:
        """Place k of the arms, see `SingleArm.reset`.  The others do not change.

        Angles and velocities are (k, N); `arms` are k different indices, or None for all.  If the
        batch was built with `others`, new `parameters` are taken: `ArmColumns` of k arms, or a
        sequence of k.  An arm with `joint_limits` must keep some, and one without gets none.
        """
        indices = np.arange(self._count) if arms is None else self._indices(arms)
        shape = len(indices), self._shape[1]
        postures = _table("joint_angles", joint_angles, shape)
        speeds = np.zeros(shape) if joint_velocities is None else joint_velocities
        speeds = _table("joint_velocities", speeds, shape)
        if parameters is None and self._is_loaded:
            parameters = self.parameters
        new: NewParameters = []
        if parameters is not None:
            accepted = "left out for arms without others"
            require(bool(self._others), "parameters", parameters, accepted)
            if isinstance(parameters, ArmParameters):
                new = [(indices, parameters)]
            else:
                new = [(indices[[row]], p) for row, p in enumerate(parameters)]
        self._place(indices, postures, speeds, new)

    def can_become(self, arm: int, parameters: ArmParameters) -> bool:
        """Return whether a reset can give an arm these parameters, which the engine accepts."""
        return True

    def command(self, values: ArrayLike) -> None:
        """Set values (count, N) for the servos, see `SingleArm.command`."""
        self._command(_table("values", values, self._shape))

    @abstractmethod
    def step(self) -> None:
        """Simulate one control step of every arm, see `SingleArm.step`."""

    def _require_control(self) -> None:
        fastest, velocities = self.parameters.fastest, self.joint_velocities
        if not (velocities.max() <= fastest and velocities.min() >= -fastest):  # true for NaN too
            arm = int(np.argmin((np.abs(velocities) <= fastest).all(axis=-1)))
            raise _out_of_control(fastest, velocities[arm].tolist(), f" for arm {arm}")

    def lock(self, arms: ArrayLike) -> None:
        """Make the `lockable_joints` of arms with these indices rigid, see `SingleArm.lock`."""
        self._lock(self._indices(arms))

    def unlock(self, arms: ArrayLike) -> None:
        """Let the locked joints of arms with these indices turn again."""
        self._unlock(self._indices(arms))

    def confine(self, arms: ArrayLike, starts: Floats, ends: Floats) -> None:
        """Confine k hands to lines from starts to ends, (k, 2), see `SingleArm.confine`."""
        raise UserError('engine must be "pymunk" for a channel, which the analytic engine has not')

    def load(self, parameters: ArmParameters, arms: ArrayLike) -> None:
        """Load k arms with these indices, which may differ, see `SingleArm.load`.

        The next reset gives them their first parameters, unless it is given others.
        """
        require(bool(self._others), "arms", arms, "arms with others")
        self._is_loaded = True
        self._load(parameters, self._indices(arms))

    def close(self) -> None:
        """End the threads.  The next step starts new ones."""
        if self._pool is not None and self._pool_owner == os.getpid():
            self._pool.shutdown()
        self._pool = None

    def _executor(self) -> ThreadPoolExecutor:
        """Return the thread pool of this process; a forked process inherits no threads."""
        if self._pool is None or self._pool_owner != os.getpid():
            self._pool, self._pool_owner = ThreadPoolExecutor(self._threads, "arms"), os.getpid()
        return self._pool

    @abstractmethod
    def _build(self) -> None: ...

    @abstractmethod
    def _place(
        self, arms: Indices, postures: Floats, speeds: Floats, new: NewParameters
    ) -> None: ...

    @abstractmethod
    def _command(self, values: Floats) -> None: ...

    @abstractmethod
    def _lock(self, arms: Indices) -> None: ...

    @abstractmethod
    def _unlock(self, arms: Indices) -> None: ...

    @abstractmethod
    def _load(self, parameters: ArmParameters, arms: Indices) -> None: ...

    def _indices(self, arms: ArrayLike) -> Indices:
        rows = np.asarray(arms)
        accepted = f"different indices from 0 to {self._count - 1}"
        are_whole = rows.size == 0 or rows.dtype.kind in "iu"
        require(rows.ndim == 1 and are_whole, "arms", arms, accepted)
        require(bool(((rows >= 0) & (rows < self._count)).all()), "arms", arms, accepted)
        require(len(np.unique(rows)) == len(rows), "arms", arms, accepted)
        return np.ascontiguousarray(rows, np.intp)


def _checked(parameters: ArmParameters | None) -> ArmParameters:
    """Return the parameters; raise a `UserError` if substeps cannot simulate masses or field."""
    p = parameters or ArmParameters()
    neighbours = max((b.mass / a.mass for a, b in pairwise(p.rods)), default=0.0)
    if p.sweeps > MOST_SWEEPS and neighbours > _LARGEST_RATIO_OF_NEIGHBOURS:
        raise UserError(
            "segment_masses and hand_mass must make an arm that substeps can hold together: no "
            f"segment with its load may have {_LARGEST_RATIO_OF_NEIGHBOURS:.0f} times the mass of "
            f"the one before it, got {neighbours:.3g} times"
        )
    if p.force_field is not None:
        field = np.array(p.force_field)
        accepted = f"at most {p.strongest_field:.4g} mass/s strong in substeps of {p.substep:g} s"
        accepted += " (shorter ones or a heavier last segment allow more)"
        is_followed = bool(np.linalg.norm(field, 2) <= p.strongest_field)
        require(is_followed, "force_field", p.force_field, accepted)
        accepted = f"one that pushes along the movement by at most {p.strongest_push:.4g} mass/s"
        accepted += ", or servos of this torque_limit cannot stop the arm"
        is_stopped = bool(np.linalg.eigvalsh(field + field.T).max() <= 2 * p.strongest_push)
        require(is_stopped, "force_field", p.force_field, accepted)
    return p


def _out_of_control(fastest: float, velocities: list[float], whose: str = "") -> UserError:
    return UserError(
        f"joint velocities must stay below {fastest:.4g} rad/s, or substeps cannot follow them: "
        "reset, and take shorter substeps, a larger drive_inertia, or weaker loads and forces; "
        f"got {velocities}{whose}"
    )


def _table(name: str, values: ArrayLike, shape: tuple[int, int]) -> Floats:
    """Return a copy of `values` in C order, the only layout that the kernel is compiled for."""
    table = np.array(values, dtype=np.float64, order="C")
    require(table.shape == shape, name, table.shape, f"of shape {shape}")
    return table
