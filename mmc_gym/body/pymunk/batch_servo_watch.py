"""What the servos of many arms do in a control step: `ServoWatch` for arms that share Spaces.

The sums are those of `servo_watch`, taken in the same order, so that every arm's are the same, bit for bit, as if it were watched alone.
"""

from __future__ import annotations

from types import TracebackType

import numpy as np
from numpy.typing import NDArray

from mmc_gym.body.pymunk.batch import Arms
from mmc_gym.body.pymunk.shared_space import SharedSpace

Floats = NDArray[np.float64]


class BatchServoWatch:
    """Watches the servos of many arms as long as it is entered; they move as ever.

    Attributes:
        impulses: of each joint in the last control step, (count, N), see `ServoWatch`; NaN if the
            engine does not tell, or before the first step.
        work: of each joint in the last control step, (count, N).

    Example:
        >>> arms = Arms(count=2, servo="torque")
        >>> with BatchServoWatch(arms, (2, 3)) as watch:
        ...     arms.command([[6.0, 0.0, -3.0], [0.0, 0.0, 0.0]])
        ...     arms.step()
        >>> watch.impulses.round(9).tolist()  # torque times the control step of 0.02 s
        [[0.12, 0.0, 0.06], [0.0, 0.0, 0.0]]
    """

    def __init__(self, arms: object, shape: tuple[int, int]) -> None:
        """Prepare to watch arms, (count, N), of any engine; some tell nothing."""
        self._arms = arms if isinstance(arms, Arms) else None
        self.impulses: Floats = np.full(shape, np.nan)
        self.work: Floats = np.full(shape, np.nan)
        self._velocities: Floats = np.zeros(shape)  # of the joints, before each physics step

    def __enter__(self) -> BatchServoWatch:
        if self._arms is not None:
            self._arms.observe(self)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if self._arms is not None:
            self._arms.observe(None)

    def begin(self, space: SharedSpace) -> None:
        """See `mmc_gym.body.pymunk.shared_space.Observer`."""
        self.impulses[space.arms] = self.work[space.arms] = 0.0
        self._velocities[space.arms] = space.joint_velocities()

    def observe(self, space: SharedSpace) -> None:
        """See `mmc_gym.body.pymunk.shared_space.Observer`."""
        impulses, after = space.servo_impulses(), space.joint_velocities()
        before = self._velocities[space.arms]
        self.impulses[space.arms] += impulses
        self.work[space.arms] += impulses * np.abs(before + after) / 2
        self._velocities[space.arms] = after
