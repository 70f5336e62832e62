"""
How do the agents play Gymnasium's Reacher-v5?
==============================================

No training is needed: write a ``ReachInterface`` that says where in an observation posture,
hand and target are, and what torque brings the joints to the posture that an agent commands.
``pip install "mmc-gym[bodies]"``, then either of:

.. code-block:: sh

    python examples/reacher.py
    mmc-gym compare --agents mmc-body ik-body --scenarios Reacher-v5 \
        --interface examples.reacher:INTERFACE --episodes 1000

.. image:: /reacher.gif
   :alt: Five reaches of mmc-body in Reacher-v5, seen from above

The torque follows from the model by a rule, without a tuned constant. In each step the environment
charges the distance in metres and the squared torques; a joint turns by ``q'' = GEAR torque - q'``.
With the angles x that are left, and the Jacobian J of the posture asked for, the distance is about
``d = |J x|``, which equals ``x' Q x`` with ``Q = J'J / d``. For such a cost, quadratic at each d,
the Riccati equation has a solution in closed form: ``torque = K x - D q'`` with ``K = root(Q)`` and
``D = (root(1 + 2 GEAR K) - 1) / GEAR``. Both are computed anew in each step, as d falls.
"""

import numpy as np

import mmc_gym
from mmc_gym.interface import ReachInterface, Seen

METRES = 0.1  # the unit of length: so segments have lengths near 1
GEAR = 200.0  # acceleration of a joint by a torque of 1, rad/s²; its damping is 1/s


class ReacherInterface(ReachInterface):
    """What agents are given about the arm, how they see it and how they move it."""

    def see(self, observation):
        cosines, sines, target, speeds, offset = np.split(observation, [2, 4, 6, 8], axis=-1)
        target = target / METRES
        hand = target + offset / METRES
        return Seen(np.arctan2(sines, cosines), target, joint_speeds=speeds, hand=hand)

    def act(self, joint_targets, sensed):
        left = self.turn(sensed.joint_angles, joint_targets)
        posture = sensed.joint_angles + left
        segments = self.segment_lengths * np.exp(1j * np.cumsum(posture, axis=-1))
        jacobian = 1j * np.cumsum(segments[..., ::-1], axis=-1)[..., ::-1]
        square = (jacobian[..., :, None].conj() * jacobian[..., None, :]).real
        distance = np.abs((jacobian * left).sum(axis=-1))
        distance = np.maximum(distance, self.success_distance)  # nearer it would only tremble
        stiffness = root(METRES * square / distance[..., None, None])
        damping = (root(np.eye(2) + 2 * GEAR * stiffness) - np.eye(2)) / GEAR
        torque = stiffness @ left[..., None] - damping @ sensed.joint_speeds[..., None]
        return np.clip(torque[..., 0], -1.0, 1.0).astype(np.float32)


def root(matrices):
    """Return the square roots of symmetric positive matrices (..., 2, 2)."""
    of_determinant = np.sqrt(np.maximum(np.linalg.det(matrices), 0.0))[..., None, None]
    trace = np.trace(matrices, axis1=-2, axis2=-1)[..., None, None]
    return (matrices + of_determinant * np.eye(2)) / np.sqrt(trace + 2 * of_determinant)


INTERFACE = ReacherInterface(
    segment_lengths=(1.0, 1.1),
    control="joint_position",
    speed_limit=10.0,  # rad/s, about what the rule reaches in half a turn
    servo_gain=1.4,  # 1/s: a quarter of the rule at 0.1 m, as joints wait for each other
    control_step=0.02,
    joint_limits=((-np.pi, np.pi), (-3.0, 3.0)),
    success_distance=0.1,  # 1 cm
    has_drive=True,
)

if __name__ == "__main__":
    agents = ["mmc-body", "ik-body", "ik-dls"]
    print(mmc_gym.compare(agents, "Reacher-v5", episodes=20, interface=INTERFACE))
