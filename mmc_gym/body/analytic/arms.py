"""Arms whose equations of motion are integrated by compiled code, for millions of episodes.

The physics are those of pymunk's arms, and so is each physics step, but what Chipmunk approaches by
sweeping over the joints is solved here to the end: pivots and torques are exact.  `kernel` has the
equations.  With 3,000 sweeps in a physics step, Chipmunk's joint angles are the same to 1e-6 rad
after 2 s.

The motion of a slack arm is of second order in the substep: 5.4e-4 rad off after 2 s at 5 ms, and
1.3e-4 at 2.5 ms (median of 60 arms released at up to 3 rad/s).  That of a driven arm is of first
order (at most 0.02 and 0.01 off on its way), because the servos look at the angles once in a
substep.

This engine does not tell the effort of its servos: `records_effort` has no effect.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from mmc_gym._errors import require
from mmc_gym.body.analytic import kernel
from mmc_gym.body.base import ArmBatch, Floats, Indices, SingleArm, wrong_count
from mmc_gym.body.parameters import ArmParameters, Servo

_WORTH_A_THREAD = 256  # arms; sharing out fewer takes longer than it saves


class AnalyticArms(ArmBatch):
    """Arms of the analytic engine; `ArmBatch` documents what they are and do.

    Each is bit for bit an arm alone.  They can be pickled and copied at any time, and the copy has
    the same future.

    Attributes:
        joint_cosines: cosines of the joint angles, (count, N).
        joint_sines: their sines, (count, N).
    """

    @override
    def __init__(
        self,
        parameters: ArmParameters | None = None,
        count: int = 1,
        servo: Servo = "position",
        threads: int = 1,
    ) -> None:
        super().__init__(parameters, count, servo, threads)
        parameters = self.parameters
        require(
            not parameters.obstacles,
            "obstacles",
            parameters.obstacles,
            'empty for the analytic engine, which knows no collisions (use engine="pymunk")',
        )
        self._rods = kernel.make_rods(parameters)
        self._world = kernel.make_world(parameters, servo)
        segments = len(self._rods)
        self._lanes = kernel.lanes_of(segments)
        self._state = kernel.make_state(segments, self._count)
        self._no_work = kernel.no_work(segments)
        self._show(np.zeros(self._count * (5 * segments + 2)))
        self.reset(np.zeros(self._shape))

    def _show(self, output: Floats) -> None:
        """Make the public arrays views of `output`."""
        self._output = output
        size = self._count * len(self._rods)
        self.segment_angles = output[:size].reshape(self._shape)
        self.joint_angles = output[size : 2 * size].reshape(self._shape)
        self.joint_velocities = output[2 * size : 3 * size].reshape(self._shape)
        turned = 3 * size + 2 * self._count
        self.end_effectors = output[3 * size : turned].reshape(self._count, 2)
        self.joint_cosines = output[turned : turned + size].reshape(self._shape)
        self.joint_sines = output[turned + size :].reshape(self._shape)

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "_pool": None}  # threads belong to a process

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._show(self._output)  # copies of views are arrays of their own

    @override
    def _place(self, arms: Indices, postures: Floats, speeds: Floats) -> None:
        kernel.place(self._state, self._output, self._rods, self._world, arms, postures, speeds)

    @override
    def _command(self, values: Floats) -> None:
        self.command_arms(values, 1.0, False, 0, self._count)

    @override
    def step(self) -> None:
        self.share_out(self.step_arms)

    def share_out(self, work: Callable[[int, int], None]) -> None:
        """Call `work(first, last)` for all arms, in shares from arm `first` to before arm `last`.

        Each thread does one share, and this one, too.
        """
        shares = max(1, min(self._threads, self._count // _WORTH_A_THREAD))
        blocks = [len(self._state) * share // shares for share in range(1, shares)]
        edges = [0, *(self._lanes * block for block in blocks), self._count]
        others = [self._executor().submit(work, first, last) for first, last in pairwise(edges[1:])]
        work(*edges[:2])
        for other in others:
            other.result()

    def command_arms(
        self, values: NDArray[np.floating], scale: float, is_relative: bool, first: int, last: int
    ) -> None:
        """Hand `scale` times `values`, (count, N), to the servos of a share of the arms.

        If they are relative, the present joint angles are added.  `values` are of float32 or
        float64, in the order of C.
        """
        arms = self._state, self._output, self._rods, self._world
        kernel.command(*arms, values, scale, is_relative, *self._blocks(first, last))

    def step_arms(self, first: int, last: int) -> None:
        """Simulate one control step of a share of the arms."""
        arms = self._state, self._output, self._rods, self._world
        substeps = self.parameters.substeps
        kernel.step_blocks(*arms, self._no_work, substeps, *self._blocks(first, last))

    def _blocks(self, first: int, last: int) -> tuple[int, int]:
        """Return the blocks of arms that begin a block, up to before arm `last`."""
        return first // self._lanes, -(-last // self._lanes)

    @override
    def _lock(self, arms: Indices) -> None:
        for joint in self.parameters.lockable_joints:
            held = self._state["held"][:, joint]
            held[arms // self._lanes, arms % self._lanes] = self.joint_angles[arms, joint]

    @override
    def pivot_gaps(self) -> Floats:
        return np.zeros(self._count)  # by construction


class AnalyticArm(SingleArm):
    """One arm of the analytic engine; `SingleArm` documents what it is and does."""

    @override
    def __init__(self, parameters: ArmParameters | None = None, servo: Servo = "position") -> None:
        super().__init__(parameters, servo)
        self._arms = AnalyticArms(self.parameters, 1, servo)
        self._segments = len(self.parameters.segment_lengths)
        self._values = np.zeros((1, self._segments))
        self._read()

    @override
    def _place(self, joint_angles: Sequence[float], joint_velocities: Sequence[float]) -> None:
        self._arms.reset([joint_angles], None, [joint_velocities])
        self._read()

    @override
    def command(self, values: Sequence[float]) -> None:
        if len(values) != self._segments:
            raise wrong_count("command", values, self._segments)
        self._values[0] = values
        self._arms._command(self._values)

    @override
    def step(self) -> None:
        self._arms.step_arms(0, 1)
        self._read()

    def _read(self) -> None:
        numbers, count = self._arms._output.tolist(), self._segments
        self.segment_angles = numbers[:count]
        self.joint_angles = numbers[count : 2 * count]
        self.joint_velocities = numbers[2 * count : 3 * count]
        self.end_effector = numbers[3 * count], numbers[3 * count + 1]

    @override
    def lock(self) -> None:
        self._arms.lock([0])

    @override
    def pivot_gap(self) -> float:
        return 0.0  # by construction
