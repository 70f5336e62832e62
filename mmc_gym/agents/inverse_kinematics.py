"""Inverse kinematics as a policy: damped least squares.

    Δq = Jᵀ (J Jᵀ + λ² I)⁻¹ e,      e = target − hand, shortened to at most `max_step`

(Wampler 1986; Nakamura & Hanafusa 1986; the shortened error after Buss & Kim 2005).  J is the
Jacobian of the hand's position with respect to the joint angles.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mmc_gym.agents.base import JointTargetAgent, ReachInterface, Sensed
from mmc_gym.network.chain import Floats, node_positions, segments_from_joint_angles


class DampedLeastSquaresAgent(JointTargetAgent[Floats]):
    """Follows the target by damped least squares; its state is its joint targets (..., N)."""

    def __init__(
        self,
        interface: ReachInterface,
        damping: float = 0.1,
        max_step: float = 0.1,
        iterations_per_step: int = 3,
    ) -> None:
        """Make the agent.

        Args:
            interface: of the environment.
            damping: λ, in segment lengths.
            max_step: longest error that one iteration acts on, in segment lengths.
            iterations_per_step: iterations in a control step.

        Raises:
            ValueError: if a value is not positive, or under torque control.
        """
        for name, value in (
            ("damping", damping),
            ("max_step", max_step),
            ("iterations_per_step", iterations_per_step),
        ):
            if not 0 < value < np.inf:
                raise ValueError(f"{name} must be positive and finite, got {value}")
        super().__init__(interface)
        self.damping = damping
        self.max_step = max_step
        self.iterations_per_step = iterations_per_step

    def start(self, sensed: Sensed) -> Floats:
        """The sensed postures."""
        return sensed.joint_angles

    def restart(self, state: Floats, fresh: Floats, started: NDArray[np.bool_]) -> Floats:
        """The joint targets, those of the observed posture where an episode started."""
        return np.where(started[..., None], fresh, state)

    def advance(self, state: Floats, sensed: Sensed) -> tuple[Floats, Floats]:
        """Joint targets after the iterations of one control step."""
        lengths = self.interface.segment_lengths
        for _ in range(self.iterations_per_step):
            state = state + damped_least_squares_step(
                state, sensed.target, lengths, self.damping, self.max_step
            )
        return state, state


def damped_least_squares_step(
    joint_angles: Floats,
    target: Floats,
    segment_lengths: tuple[float, ...],
    damping: float,
    max_step: float,
) -> Floats:
    """One iteration: the change of the joint angles, radians, shape (..., N).

    Args:
        joint_angles: shape (..., N).
        target: shape (..., 2).
        segment_lengths: N lengths.
        damping: λ.
        max_step: longest error that is acted on.
    """
    nodes = node_positions(segments_from_joint_angles(joint_angles, segment_lengths))
    hand = nodes[..., -1, :]
    error = target - hand
    distance = np.hypot(error[..., 0], error[..., 1])[..., None]
    error = error * (max_step / np.maximum(distance, max_step))
    # A joint turns the hand about itself: column i of J is (hand − p_i) turned by 90°.
    arm = hand[..., None, :] - nodes[..., :-1, :]
    jacobian_x, jacobian_y = -arm[..., 1], arm[..., 0]
    # (J Jᵀ + λ² I) is 2 × 2 and symmetric; its inverse is written out.
    xx = (jacobian_x * jacobian_x).sum(axis=-1) + damping**2
    yy = (jacobian_y * jacobian_y).sum(axis=-1) + damping**2
    xy = (jacobian_x * jacobian_y).sum(axis=-1)
    determinant = xx * yy - xy * xy
    force_x = (yy * error[..., 0] - xy * error[..., 1]) / determinant
    force_y = (xx * error[..., 1] - xy * error[..., 0]) / determinant
    change: Floats = jacobian_x * force_x[..., None] + jacobian_y * force_y[..., None]
    return change
