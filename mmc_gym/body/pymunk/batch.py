"""Many equal arms that know nothing of each other, in a few pymunk Spaces: array in, array out.

    arms      0 … 63    64 … 127    128 …
    Space        0          1         2  …     stepped one after the other, or by several threads

One call into Chipmunk steps all arms of a Space, and one reads them.  Every arm moves bit for bit
as an `Arm` of its own does: Chipmunk solves the joints of a Space one after the other, and those
of an arm in the same order as if it were alone.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from queue import SimpleQueue
from typing import Any, NoReturn, get_args

import numpy as np
import pymunk
from numpy.typing import ArrayLike, NDArray
from pymunk._chipmunk_cffi import lib as chipmunk
from pymunk.batch import BodyFields, Buffer, get_space_bodies, set_space_bodies

from mmc_gym.body.parameters import ArmParameters, Servo, Workers, require
from mmc_gym.body.pymunk.linkage import Linkage, forget_impulses, make_space

Floats = NDArray[np.float64]


class SharedSpace:
    """Arms that share a Space: `count` of them, beginning with number `first` of all."""

    def __init__(self, parameters: ArmParameters, servo: Servo, first: int, count: int) -> None:
        self.first, self.count, self.arms = first, count, slice(first, first + count)
        self._parameters, self._servo = parameters, servo
        self._buffer, self._push_buffer = Buffer(), Buffer()
        bodies = count * len(parameters.segment_lengths) + bool(parameters.obstacles)
        self._pushes = np.zeros((bodies, 3))  # force x, y and torque; the obstacles are one body
        self._push_buffer.set_float_buf(self._pushes)
        self._build()

    def _build(self) -> None:
        self._space = make_space(self._parameters)
        self.linkages = [
            Linkage(self._space, self._parameters, self._servo) for _ in range(self.count)
        ]
        self._servo_handles = [
            servo._constraint for linkage in self.linkages for servo in linkage.servos
        ]

    def drive(self, settings: Floats, torques: Floats) -> None:
        """Set the servos: their phases or rates, and their largest torques, (count, N)."""
        servos = self._servo_handles
        if self._servo == "position":
            _for_each(chipmunk.cpGearJointSetPhase, servos, settings)
        else:
            _for_each(chipmunk.cpSimpleMotorSetRate, servos, settings)
        if self._servo == "torque":
            _for_each(chipmunk.cpConstraintSetMaxForce, servos, torques)

    def step(self) -> None:
        """Simulate one control step."""
        for _ in range(self._parameters.substeps):
            self._simulate()

    def step_recording(self, impulses: Floats, work: Floats) -> None:
        """Simulate one control step, and write the servos' effort to two arrays (count, N)."""
        impulses[:] = work[:] = 0.0
        before = self._joint_velocities()
        for _ in range(self._parameters.substeps):
            self._simulate()
            after = self._joint_velocities()
            sizes = list(map(chipmunk.cpConstraintGetImpulse, self._servo_handles))
            given = np.array(sizes).reshape(self.count, -1)
            impulses += given
            work += given * np.abs(before + after) / 2
            before = after

    def _simulate(self) -> None:
        """Simulate one physics step."""
        if self._parameters.force_field is not None:
            self._push_hands()
        chipmunk.cpSpaceStep(self._space._space, self._parameters.substep)

    def _joint_velocities(self) -> Floats:
        absolute = self._get(BodyFields.ANGULAR_VELOCITY)[:, :, 0]
        return np.diff(absolute, axis=-1, prepend=0.0)

    def _get(self, fields: BodyFields) -> Floats:
        """These fields of all segments, (count, N, values), until the next call."""
        self._buffer.clear()
        get_space_bodies(self._space, fields, self._buffer)
        values = np.frombuffer(self._buffer.float_buf()).reshape(len(self._pushes), -1)
        joints = len(self._parameters.segment_lengths)
        return values[: self.count * joints].reshape(self.count, joints, -1)

    def read(self, angles: Floats, velocities: Floats) -> None:
        """Write the segments' angles and angular velocities to two arrays (count, N)."""
        state = self._get(BodyFields.ANGLE | BodyFields.ANGULAR_VELOCITY)
        angles[:], velocities[:] = state[:, :, 0], state[:, :, 1]

    def _push_hands(self) -> None:
        """Let the force field act on the hands in the next physics step."""
        assert self._parameters.force_field is not None
        (xx, xy), (yx, yy) = self._parameters.force_field
        fields = BodyFields.ANGLE | BodyFields.VELOCITY | BodyFields.ANGULAR_VELOCITY
        angle, centre_x, centre_y, speed = self._get(fields)[:, -1].T
        along_x, along_y = cosine(angle), sine(angle)
        _, reach = self.linkages[0].hand
        x, y = centre_x - reach * speed * along_y, centre_y + reach * speed * along_x
        force_x, force_y = xx * x + xy * y, yx * x + yy * y
        joints = len(self._parameters.segment_lengths)
        last = self._pushes[joints - 1 : self.count * joints : joints]
        last[:, 0], last[:, 1] = force_x, force_y
        last[:, 2] = reach * (along_x * force_y - along_y * force_x)
        set_space_bodies(self._space, BodyFields.FORCE | BodyFields.TORQUE, self._push_buffer)

    def reset(
        self,
        members: Sequence[int],
        joint_angles: Sequence[Sequence[float]],
        joint_velocities: Sequence[Sequence[float]],
        scratch: pymunk.Space,
    ) -> None:
        """Place some of the arms; `scratch` is an empty Space."""
        substep = self._parameters.substep
        linkages = [self.linkages[member] for member in members]
        if self._parameters.obstacles:
            self._build()
            linkages = self.linkages
        elif len(linkages) == self.count:
            forget_impulses(self._space, linkages, substep)
        else:  # the other arms must not move
            for linkage in linkages:
                linkage.move_joints(self._space, scratch)
            forget_impulses(scratch, linkages, substep)
            for linkage in linkages:
                linkage.move_joints(scratch, self._space)
        for linkage, posture, speeds in zip(linkages, joint_angles, joint_velocities):
            linkage.place(posture, speeds)


def _for_each(function: Callable[[Any, float], None], handles: Sequence[Any], x: Floats) -> None:
    deque(map(function, handles, x.ravel().tolist()), maxlen=0)


def _like_the_c_library(ufunc: np.ufunc, function: Callable[[float], float]) -> Any:
    """`ufunc`, unless numpy was built with another cosine than the one Python and Chipmunk use."""
    sample = np.linspace(-50.0, 50.0, 4099)
    same = ufunc(sample).tolist() == [function(x) for x in sample.tolist()]
    return ufunc if same else np.vectorize(function, otypes=[np.float64])


cosine = _like_the_c_library(np.cos, math.cos)
sine = _like_the_c_library(np.sin, math.sin)


ARMS_PER_SPACE = 64  # fewer calls with more of them, and more that does not fit the cache
_WORTH_A_THREAD = 16


class Arms:
    """`count` arms of N segments.  What one arm is and does stands at `Arm`.

    The arrays are overwritten by every step and reset: copy what should last.  Arms with
    obstacles have a Space each, for otherwise they would collide with each other, and each costs
    as much as an `Arm`.

    Attributes:
        parameters: the arms' physical parameters.
        segment_angles: absolute angles of the segments, not wrapped, (count, N).
        joint_angles: relative angles of the joints, not wrapped, (count, N).
        joint_velocities: their velocities, rad/s, (count, N).
        end_effectors: where the hands are, (count, 2).
        records_effort: tells whether steps record the effort of the servos; False unless set.
        servo_impulses: ∫ |τ| dt of each servo in the last recorded step, (count, N); see `Arm`.
        servo_work: ∫ |τ q̇| dt likewise, (count, N).
    """

    records_effort: bool = False

    def __init__(
        self,
        parameters: ArmParameters | None = None,
        count: int = 1,
        servo: Servo = "position",
        threads: int = 1,
    ) -> None:
        """Build the arms, stretched along the x axis and at rest.

        Args:
            parameters: the physical parameters of every arm.
            count: how many arms.
            servo: what drives the joints.
            threads: how many threads simulate them; the result does not depend on it.

        Raises:
            ValueError: for an unknown kind of servo, less than one arm or thread, or an arm that
                Chipmunk cannot hold together.
        """
        require(servo in get_args(Servo), "servo", servo, f"one of {get_args(Servo)}")
        require(count >= 1, "count", count, "at least 1")
        require(threads >= 1, "threads", threads, "at least 1")
        self.parameters = parameters = parameters or ArmParameters()
        self._servo = servo
        joints = len(parameters.segment_lengths)
        self.segment_angles: Floats = np.zeros((count, joints))
        self.joint_angles: Floats = np.zeros((count, joints))
        self.joint_velocities: Floats = np.zeros((count, joints))
        self.end_effectors: Floats = np.zeros((count, 2))
        self.servo_impulses: Floats = np.full((count, joints), np.nan)
        self.servo_work: Floats = np.full((count, joints), np.nan)
        self._segment_velocities: Floats = np.zeros((count, joints))
        most = (
            1
            if parameters.obstacles
            else min(ARMS_PER_SPACE, max(_WORTH_A_THREAD, -(-count // threads)))
        )
        self._arms_per_space = most
        self._spaces = [
            SharedSpace(parameters, servo, first, min(most, count - first))
            for first in range(0, count, most)
        ]
        self._threads = min(threads, len(self._spaces))
        self._workers = Workers(self._threads)
        self._settings: Floats = np.zeros((count, joints))  # of the servos: phases or rates
        self._torques: Floats = np.full((count, joints), parameters.torque_limit)
        self._commanded = False  # and the servos not yet set: the next step does that
        self._scratch = pymunk.Space()
        self._scratch.iterations = 1
        self.reset(self.joint_angles.copy())

    def command(self, values: ArrayLike) -> None:
        """Hand values (count, N) to the servos, which hold them until the next call.

        They are, by the servos, joint targets in radians (reached the short way round, or within
        the joint limits if there are any), joint velocities in rad/s, or torques.

        Raises:
            ValueError: for another shape.
        """
        commands = np.asarray(values, np.float64)
        shape = self.joint_angles.shape
        require(commands.shape == shape, "values", commands.shape, f"of shape {shape}")
        self._command(commands, slice(None))

    def _command(self, values: Floats, arms: slice | NDArray[np.intp]) -> None:
        """Command k `arms` with values (k, N)."""
        p = self.parameters
        if self._servo == "velocity":
            self._settings[arms] = -np.minimum(np.maximum(values, -p.speed_limit), p.speed_limit)
        elif self._servo == "torque":
            self._settings[arms] = np.copysign(p.speed_limit, -values)
            self._torques[arms] = np.minimum(np.abs(values), p.torque_limit)
        elif p.joint_limits is None:
            angles = self.joint_angles[arms]
            self._settings[arms] = angles + _remainder(values - angles, math.tau)
        else:
            low, high = np.transpose(p.joint_limits)
            self._settings[arms] = np.minimum(np.maximum(values, low), high)
        self._commanded = True

    def step(self) -> None:
        """Simulate one control step of every arm."""
        ready: SimpleQueue[SharedSpace | None] = SimpleQueue()
        helpers = self._threads - 1
        others = [self._workers.executor().submit(self._simulate, ready) for _ in range(helpers)]
        # Setting a servo takes too little time for two threads to share: this one sets those of
        # a Space while others simulate the Spaces before it.
        try:
            for space in self._spaces:
                if self._commanded:
                    space.drive(self._settings[space.arms], self._torques[space.arms])
                ready.put(space)
                if not helpers:
                    self._simulate_next(ready)
            self._commanded = False
        finally:
            for _ in range(self._threads):
                ready.put(None)
        self._simulate(ready)
        for other in others:
            other.result()
        self._derive(slice(None))

    def _simulate(self, ready: SimpleQueue[SharedSpace | None]) -> None:
        while self._simulate_next(ready):
            pass

    def _simulate_next(self, ready: SimpleQueue[SharedSpace | None]) -> bool:
        """Simulate the next Space that is ready, unless there are no more."""
        space = ready.get()
        if space is None:
            return False
        if self.records_effort:
            space.step_recording(self.servo_impulses[space.arms], self.servo_work[space.arms])
        else:
            space.step()
        space.read(self.segment_angles[space.arms], self._segment_velocities[space.arms])
        return True

    def _derive(self, arms: slice | NDArray[np.intp]) -> None:
        """Bring what follows from the segments' angles and velocities up to date."""
        angles, velocities = self.segment_angles[arms], self._segment_velocities[arms]
        for absolute, relative in (
            (angles, self.joint_angles),
            (velocities, self.joint_velocities),
        ):
            differences = absolute.copy()
            differences[:, 1:] -= absolute[:, :-1]
            relative[arms] = differences
        x, y = cosine(angles), sine(angles)
        hands = np.zeros((len(angles), 2))
        for segment, length in enumerate(self.parameters.segment_lengths):
            hands[:, 0] += length * x[:, segment]  # in the order in which `Arm` adds them
            hands[:, 1] += length * y[:, segment]
        self.end_effectors[arms] = hands

    def reset(
        self,
        joint_angles: ArrayLike,
        arms: ArrayLike | None = None,
        joint_velocities: ArrayLike | None = None,
    ) -> None:
        """Place some of the arms, or all; see `Arm.reset`.  The others are not touched.

        Args:
            joint_angles: relative angles in radians, (k, N).
            arms: indices of the k arms, or None for all.
            joint_velocities: relative angular velocities in rad/s, (k, N), or None for rest.

        Raises:
            ValueError: for another shape, or indices of no arm or twice of the same.
        """
        rows = np.arange(len(self.joint_angles)) if arms is None else self._indices(arms)
        postures = np.asarray(joint_angles, np.float64)
        speeds = np.zeros_like(postures)
        if joint_velocities is not None:
            speeds = np.asarray(joint_velocities, np.float64)
        shape = len(rows), len(self.parameters.segment_lengths)
        for name, values in ("joint_angles", postures), ("joint_velocities", speeds):
            require(values.shape == shape, name, values.shape, f"of shape {shape}")
        for space, part, members in self._by_space(rows):
            space.reset(members, postures[part].tolist(), speeds[part].tolist(), self._scratch)
        self.segment_angles[rows] = np.cumsum(postures, axis=1)
        self._segment_velocities[rows] = np.cumsum(speeds, axis=1)
        self._derive(rows)
        self._command(postures if self._servo == "position" else np.zeros(shape), rows)

    def lock(self, arms: ArrayLike) -> None:
        """Make the `lockable_joints` of the arms of these indices rigid; see `Arm.lock`."""
        for space, _, members in self._by_space(self._indices(arms)):
            for member in members:
                angles = self.joint_angles[space.first + member]
                space.linkages[member].lock(angles.tolist())

    def pivot_gaps(self) -> Floats:
        """Largest distance between two ends that a pivot should hold together, (count,)."""
        linkages = (linkage for space in self._spaces for linkage in space.linkages)
        return np.array([linkage.pivot_gap() for linkage in linkages])

    def close(self) -> None:
        """End the threads."""
        self._workers.close()

    def __reduce__(self) -> NoReturn:
        raise TypeError(
            "Arms cannot be pickled or copied: Chipmunk does not show the impulses that its "
            "joints remember; pickle the parameters and build new arms, or use an Arm each"
        )

    def _indices(self, arms: ArrayLike) -> NDArray[np.intp]:
        rows = np.asarray(arms)
        count = len(self.joint_angles)
        fine = rows.ndim == 1 and (rows.size == 0 or rows.dtype.kind in "iu")
        fine = fine and bool(np.all((rows >= 0) & (rows < count)))
        fine = fine and len(np.unique(rows)) == len(rows)
        require(fine, "arms", arms, f"different indices from 0 to {count - 1}")
        return rows.astype(np.intp)

    def _by_space(
        self, arms: NDArray[np.intp]
    ) -> Iterable[tuple[SharedSpace, NDArray[np.intp], list[int]]]:
        """Every Space that holds some of `arms`, which of them, and which of its own those are."""
        owners = arms // self._arms_per_space
        for owner in np.unique(owners).tolist():
            part = np.flatnonzero(owners == owner)
            space = self._spaces[owner]
            yield space, part, (arms[part] - space.first).tolist()


def _remainder(x: Floats, y: float) -> Floats:
    """`math.remainder` of every element, exactly as it is defined: x − n y, n = x / y rounded."""
    size = np.abs(x)
    rest = np.fmod(size, y)
    other = y - rest
    half = rest - 2.0 * np.fmod(0.5 * (size - rest), y)  # between two n: the even one
    return np.copysign(1.0, x) * np.where(rest < other, rest, np.where(rest > other, -other, half))
