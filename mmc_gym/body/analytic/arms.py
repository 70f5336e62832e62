"""Arms whose equations of motion are integrated by compiled code, for millions of episodes.

The physics are those of the arms simulated by pymunk, and so is each physics step, except that
what Chipmunk approaches by sweeping over the joints is solved here to the end: the pivots hold
exactly, and the servos' torques are the right ones.  `_chain_step` has the equations.  With
3,000 sweeps in a physics step, Chipmunk's joint angles are the same to 1e-6 rad after 2 s.

The motion of a slack arm is of second order in the substep (2.5e-3 rad off after 2 s at 5 ms,
6.3e-4 at 2.5 ms: median of 60 arms released at up to 3 rad/s), a driven one's of first (0.02 and
0.01), as the servos look at the angles once in a substep.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mmc_gym.body.parameters import ArmParameters, Servo, Workers, require

try:
    from mmc_gym.body.analytic import kernel as lanes
    from mmc_gym.body.analytic.kernel import step_blocks
except ModuleNotFoundError as error:
    if error.name != "numba":
        raise
    raise ImportError(
        'the analytic engine is compiled by numba: pip install "mmc-gym[analytic]"'
    ) from error

Floats = NDArray[np.float64]

_WORTH_A_THREAD = 256  # arms; sharing out fewer takes longer than it saves


class AnalyticArms:
    """Many equal arms that know nothing of each other, each bit for bit an arm alone.

    What one arm is and does stands at `mmc_gym.body.Arm`.  Instances can be pickled and copied at
    any time, and the copy has the same future.

    Attributes:
        parameters: the arms' physical parameters.
        segment_angles: (n, N) absolute angles of the segments, rad, not wrapped.
        joint_angles: (n, N) relative angles of the joints, rad, not wrapped.
        joint_velocities: (n, N) their velocities, rad/s.
        end_effectors: (n, 2) where the hands are.

        records_effort: without effect: this engine does not tell the effort of its servos.
        servo_impulses: (n, N) NaN.
        servo_work: (n, N) NaN.

    Every step and reset overwrites these arrays: copy what is to be kept.
    """

    segment_angles: Floats
    joint_angles: Floats
    joint_velocities: Floats
    end_effectors: Floats
    records_effort: bool = False

    def __init__(
        self,
        parameters: ArmParameters | None = None,
        count: int = 1,
        servo: Servo = "position",
        threads: int = 1,
    ) -> None:
        """Build `count` arms, stretched along the x axis and at rest.

        Args:
            parameters: physical parameters, without obstacles.
            count: number of arms, n.
            servo: what the servos take, see `command`.
            threads: how many threads step the arms.  The result does not depend on it.

        Raises:
            ValueError: for an unknown kind of servo, for obstacles, or if `count` or `threads` is
                not a positive whole number.
        """
        parameters = parameters or ArmParameters()
        require(servo in get_args(Servo), "servo", servo, f"one of {get_args(Servo)}")
        for name, value in ("count", count), ("threads", threads):
            whole = isinstance(value, (int, np.integer)) and value >= 1
            require(whole, name, value, "a whole number of at least 1")
        require(
            not parameters.obstacles,
            "obstacles",
            parameters.obstacles,
            'empty for the analytic engine, which knows no collisions (use engine="pymunk")',
        )
        self.parameters = parameters
        self._servo: Servo = servo
        self._count, self._threads = int(count), int(threads)
        self._rods = lanes.make_rods(parameters)
        self._world = lanes.make_world(parameters, servo)
        segments, blocks = len(parameters.segment_lengths), -(-self._count // lanes.LANES)
        self._state = np.zeros((blocks, segments), lanes.STATE)
        self._workers = Workers(self._threads)
        self.servo_impulses: Floats = np.full((self._count, segments), np.nan)
        self.servo_work: Floats = np.full((self._count, segments), np.nan)
        self._show(np.zeros(self._count * (3 * segments + 2)))
        self.reset(np.zeros((self._count, segments)))

    def _show(self, output: Floats) -> None:
        """Make the public arrays views of `output`."""
        self._output = output
        size = self._count * len(self.parameters.segment_lengths)
        for index, name in enumerate(("segment_angles", "joint_angles", "joint_velocities")):
            setattr(self, name, output[index * size : (index + 1) * size].reshape(self._count, -1))
        self.end_effectors = output[3 * size :].reshape(self._count, 2)

    def __getstate__(self) -> dict[str, Any]:
        views = ("segment_angles", "joint_angles", "joint_velocities", "end_effectors")
        return {name: value for name, value in vars(self).items() if name not in views}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._show(self._output)

    def reset(
        self,
        joint_angles: ArrayLike,
        arms: ArrayLike | None = None,
        joint_velocities: ArrayLike | None = None,
    ) -> None:
        """Place some arms, or all; their future is that of newly built ones.

        Args:
            joint_angles: (k, N) relative angles, rad.
            arms: (k,) different indices of the arms, or None for all in their order.
            joint_velocities: (k, N) relative angular velocities, rad/s, or None for rest.

        The servos hold the posture (position), stop the joints (velocity) or are slack (torque)
        until they are commanded.  Locked joints are free again.

        Raises:
            ValueError: for another shape, or indices of no arm or twice of the same.
        """
        chosen = np.arange(self._count) if arms is None else self._indices(arms)
        shape = len(chosen), len(self._rods)
        postures = _table("joint_angles", joint_angles, shape)
        speeds = np.zeros(shape)
        if joint_velocities is not None:
            speeds = _table("joint_velocities", joint_velocities, shape)
        lanes.place(self._state, self._output, self._rods, self._world, chosen, postures, speeds)

    def _indices(self, arms: ArrayLike) -> NDArray[np.intp]:
        rows = np.asarray(arms)
        fine = rows.ndim == 1 and (rows.size == 0 or rows.dtype.kind in "iu")
        fine = fine and bool(np.all((rows >= 0) & (rows < self._count)))
        fine = fine and len(np.unique(rows)) == len(rows)
        require(fine, "arms", arms, f"different indices from 0 to {self._count - 1}")
        return np.ascontiguousarray(rows, np.intp)

    def command(self, values: ArrayLike) -> None:
        """Hand values (n, N) to the servos, which hold them until the next call.

        They are joint targets in rad (reached the short way round, or within the joint limits if
        there are any), joint velocities in rad/s, or torques.

        Raises:
            ValueError: for another shape.
        """
        table = _table("values", values, (self._count, len(self._rods)))
        lanes.command(self._state, self._output, self._rods, self._world, table)

    def step(self) -> None:
        """Simulate one control step of all arms."""
        blocks = len(self._state)
        shares = min(self._threads, self._count // _WORTH_A_THREAD)
        if shares <= 1:
            self._step_blocks(0, blocks)
            return
        pool = self._workers.executor()
        edges = [blocks * share // shares for share in range(shares + 1)]
        others = [
            pool.submit(self._step_blocks, first, last) for first, last in pairwise(edges[1:])
        ]
        self._step_blocks(0, edges[1])
        for other in others:
            other.result()

    def _step_blocks(self, first: int, last: int) -> None:
        step_blocks(
            self._state,
            self._output,
            self._rods,
            self._world,
            self.parameters.substeps,
            first,
            last,
        )

    def lock(self, arms: ArrayLike) -> None:
        """Make the lockable joints of these arms rigid where they are, until the next reset."""
        chosen = self._indices(arms)
        for joint in self.parameters.lockable_joints:
            held = self._state["held"][:, joint]
            held[chosen // lanes.LANES, chosen % lanes.LANES] = self.joint_angles[chosen, joint]

    def pivot_gaps(self) -> Floats:
        """Largest distance (n,) between ends that should be together: none, by construction."""
        return np.zeros(self._count)

    def close(self) -> None:
        """End the threads; the next step would start new ones."""
        self._workers.close()


class AnalyticArm:
    """One arm of the analytic engine; it is used like `mmc_gym.body.Arm`.

    Attributes:
        parameters: the arm's physical parameters.
        segment_angles: absolute angles of the segments after the last step, not wrapped.
        joint_angles: relative angles of the joints after the last step, not wrapped.
        joint_velocities: their velocities, rad/s.
        end_effector: where the hand is, (x, y).
        command: takes N values and hands them to the servos, as `AnalyticArms.command` does.
        records_effort: without effect: this engine does not tell the effort of its servos.
        servo_impulses: NaN for each servo.
        servo_work: NaN for each servo.
    """

    segment_angles: list[float]
    joint_angles: list[float]
    joint_velocities: list[float]
    end_effector: tuple[float, float]
    command: Callable[[Sequence[float]], None]
    records_effort: bool = False
    servo_impulses: list[float]
    servo_work: list[float]

    def __init__(self, parameters: ArmParameters | None = None, servo: Servo = "position") -> None:
        """Build the arm, stretched along the x axis and at rest.

        Raises:
            ValueError: for an unknown kind of servo, or for obstacles.
        """
        self._arms = AnalyticArms(parameters, 1, servo)
        self.parameters = self._arms.parameters
        self._segments = len(self.parameters.segment_lengths)
        self._values = np.zeros((1, self._segments))
        self.servo_impulses = self.servo_work = [np.nan] * self._segments
        self.command = self._command
        self._read()

    def reset(
        self, joint_angles: Sequence[float], joint_velocities: Sequence[float] | None = None
    ) -> None:
        """Place the arm; its future is that of a newly built one, bit for bit.

        Args:
            joint_angles: N relative angles in radians.
            joint_velocities: N relative angular velocities in rad/s, or None for rest.

        Raises:
            ValueError: for another number of angles or velocities than N.
        """
        for name, values in ("joint_angles", joint_angles), ("joint_velocities", joint_velocities):
            fine = values is None or len(values) == self._segments
            require(fine, name, values, f"{self._segments} values")
        speeds = None if joint_velocities is None else np.array([joint_velocities], dtype=float)
        self._arms.reset(np.array([joint_angles], dtype=float), None, speeds)
        self._read()

    def _command(self, values: Sequence[float]) -> None:
        """Hand N values to the servos, which hold them until the next call.

        Raises:
            ValueError: for another number of values.
        """
        if len(values) != self._segments:
            raise ValueError(f"command must be {self._segments} values, got {values!r}")
        self._values[0] = values
        arms = self._arms
        lanes.command(arms._state, arms._output, arms._rods, arms._world, self._values)

    def step(self) -> None:
        """Simulate one control step."""
        self._arms._step_blocks(0, 1)
        self._read()

    def _read(self) -> None:
        numbers, count = self._arms._output.tolist(), self._segments
        self.segment_angles = numbers[:count]
        self.joint_angles = numbers[count : 2 * count]
        self.joint_velocities = numbers[2 * count : 3 * count]
        self.end_effector = numbers[-2], numbers[-1]

    def lock(self) -> None:
        """Make the `lockable_joints` rigid where they are, until the next reset."""
        self._arms.lock(np.array([0]))

    def pivot_gap(self) -> float:
        """Largest distance between ends that should be together: none, by construction."""
        return 0.0


def _table(name: str, values: ArrayLike, shape: tuple[int, int]) -> Floats:
    """`values` as the compiled functions take them: they are compiled for this kind of array."""
    table = np.array(values, dtype=np.float64, order="C")
    require(table.shape == shape, name, table.shape, f"of shape {shape}")
    return table
