"""What the servos of an arm do in a control step: the impulses they give, and their work.

    impulse   ∫ |τ| dt  =  Σ |λ|                    λ the servo's angular impulse in a physics step
    work      ∫ |τ q̇| dt  =  Σ |λ (q̇ + q̇′)/2|       q̇, q̇′ the joint's velocity before and after it

both of each joint, over the physics steps of the last control step.  λ (q̇ + q̇′)/2 is what an
impulse adds to the kinetic energy.  Torques read once a control step would be off by 5 to 30 %, as
a position servo pushes hardest in the first physics step after a command.

Only an arm that is watched pays for it, and moves as if it were not, bit for bit.
"""

from __future__ import annotations

from types import TracebackType

import numpy as np
from numpy.typing import NDArray
from pymunk._chipmunk_cffi import lib as chipmunk

from mmc_gym.body.pymunk.arm import Arm

Floats = NDArray[np.float64]


class ServoWatch:
    """Watches the servos of an arm as long as it is entered.

    Stops and locks are no servos.  Chipmunk tells the size of impulses only, not their sign.

    Attributes:
        impulses: of each joint in the last control step, mass · length² / s, (N,); NaN if the
            engine does not tell (the analytic one does not), or before the first step.
        work: of each joint in the last control step, mass · length² / s², (N,); NaN likewise.

    Example:
        >>> arm = Arm(servo="torque")
        >>> with ServoWatch(arm, 3) as watch:
        ...     arm.command([6.0, 0.0, -3.0])
        ...     arm.step()
        >>> watch.impulses.round(9).tolist()  # torque times the control step of 0.02 s
        [0.12, 0.0, 0.06]
    """

    def __init__(self, arm: object, joint_count: int) -> None:
        """Prepare to watch an arm of any engine, or anything else, which tells nothing."""
        self._arm = arm if isinstance(arm, Arm) else None
        self.impulses: Floats = np.full(joint_count, np.nan)
        self.work: Floats = np.full(joint_count, np.nan)

    def __enter__(self) -> ServoWatch:
        if self._arm is not None:
            self._unwatched = self._arm.step
            self._arm.step = self._step
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if self._arm is not None:
            self._arm.step = self._unwatched

    def _step(self) -> None:
        arm = self._arm
        assert arm is not None
        space, parameters = arm._space._space, arm.parameters
        pushed = parameters.force_field is not None
        joints = range(len(arm._servo_handles))
        impulses, work = [0.0] * len(joints), [0.0] * len(joints)
        before = self._velocities(arm)
        for _ in range(parameters.substeps):
            if pushed:
                arm._push_hand()
            chipmunk.cpSpaceStep(space, parameters.substep)
            after = self._velocities(arm)
            for joint in joints:
                impulse = chipmunk.cpConstraintGetImpulse(arm._servo_handles[joint])
                impulses[joint] += impulse
                work[joint] += impulse * abs(before[joint] + after[joint]) / 2
            before = after
        arm._read()
        arm._record()
        self.impulses, self.work = np.array(impulses), np.array(work)

    @staticmethod
    def _velocities(arm: Arm) -> list[float]:
        velocities, parent = [], 0.0
        for segment, _ in arm._handles:
            velocity = chipmunk.cpBodyGetAngularVelocity(segment)
            velocities.append(velocity - parent)
            parent = velocity
        return velocities
