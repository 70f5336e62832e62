"""What the servos of many arms do in a control step: `ServoWatch` for arms that share Spaces.

The sums are those of `mmc_gym.body.servo_watch`, taken in the same order, so that every arm's are
the same, bit for bit, as if it were watched alone.
"""

from __future__ import annotations

from functools import partial
from types import TracebackType

import numpy as np
from numpy.typing import NDArray
from pymunk._chipmunk_cffi import lib as chipmunk
from pymunk.batch import BodyFields

from mmc_gym.body.batch import Arms
from mmc_gym.body.shared_space import SharedSpace

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
        self._spaces = arms._spaces if isinstance(arms, Arms) else []
        self.impulses: Floats = np.full(shape, np.nan)
        self.work: Floats = np.full(shape, np.nan)

    def __enter__(self) -> BatchServoWatch:
        for space in self._spaces:
            space.step = partial(self._step, space)  # type: ignore[method-assign]
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        for space in self._spaces:
            del space.step

    def _step(self, space: SharedSpace) -> None:
        parameters, shape = space._parameters, self.impulses[space.arms].shape
        impulses, work = np.zeros(shape), np.zeros(shape)
        before = self._velocities(space)
        for _ in range(parameters.substeps):
            if parameters.force_field is not None:
                space._push_hands()
            chipmunk.cpSpaceStep(space._space._space, parameters.substep)
            after = self._velocities(space)
            given = list(map(chipmunk.cpConstraintGetImpulse, space._servo_handles))
            impulse = np.array(given).reshape(shape)
            impulses += impulse
            work += impulse * np.abs(before + after) / 2
            before = after
        self.impulses[space.arms], self.work[space.arms] = impulses, work

    @staticmethod
    def _velocities(space: SharedSpace) -> Floats:
        absolute = space._get(BodyFields.ANGULAR_VELOCITY)[:, :, 0]
        return np.diff(absolute, axis=-1, prepend=0.0)
