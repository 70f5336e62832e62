"""
How does a robot reach whose joint is locked?
=============================================

A ``ReachInterface`` says what agents see and do in third-party environments. Here the arm is a
Panda in space, its elbow is locked, and its forearm 20 % longer than given. ``mmc-body`` is given
neither change: it identifies both, and its network settles in postures that hold the elbow.
:doc:`../panda_reach` is the same robot in pybullet.
"""

import matplotlib.pyplot as plt
import numpy as np

from mmc_gym.agents.body_model.agent import mmc_body
from mmc_gym.agents.body_model.parts import Parts
from mmc_gym.agents.body_model.spatial import lengthened
from mmc_gym.interface import ReachInterface, Seen
from mmc_gym.robots import HingeArm

GIVEN, ELBOW, TURN, STEPS = HingeArm.named("panda"), 3, 0.05, 41  # radians per step
TRUE = lengthened(GIVEN, np.array([0, 0, 0, 0, 0.2, 0, 0, 0]))
target = np.array([0.5, 0.3, 0.3])  # metres


class PandaInterface(ReachInterface):
    """Observations are posture, hand and target; actions are shares of a turn."""

    def see(self, observation):
        angles, hand, target = np.split(observation, [7, 10], axis=-1)
        return Seen(angles, target, joint_speeds=np.zeros_like(angles), hand=hand)

    def act(self, joint_targets, sensed):
        return np.clip((joint_targets - sensed.joint_angles) / TURN, -1, 1).astype(np.float32)


# %%
# The agent as it is, and without its loops. Postures get darker from step to step, the ring is the
# elbow, and the cross the target.

figure = plt.figure(figsize=(11, 4.6))
interface = PandaInterface((), "joint_delta", 1.0, 20.0, TURN, arm=GIVEN)
alone = Parts(identifies_body=False, finds_locks=False)
agents = {"mmc-body": mmc_body(interface), "without its loops": mmc_body(interface, alone)}
for place, (name, agent) in enumerate(agents.items(), start=1):
    angles, state = np.array([0.0, 0.4, 0.0, -1.8, 0.0, 2.2, 0.8]), None
    axes = figure.add_subplot(1, 2, place, projection="3d")
    for step in range(STEPS):
        if step % 3 == 0:
            nodes = np.vstack([np.zeros(3), TRUE.nodes(angles)])
            axes.plot(*nodes.T, color=plt.cm.Greys(min(0.25 + 0.05 * step, 1.0)), linewidth=2)
            axes.plot(*nodes[2], "ko", fillstyle="none", markersize=10)
        hand = TRUE.forward(angles)[:3, 3]
        action, state = agent.predict(np.concatenate([angles, hand, target]), state)
        angles = angles + TURN * action * (np.arange(7) != ELBOW)
    print(f"{name}: the hand is {np.linalg.norm(hand - target):.3f} m from the target")
    axes.plot(*target, "kx", markersize=14, markeredgewidth=3, zorder=9)
    axes.set(title=name, xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    axes.set(xlim=(0, 0.8), ylim=(0, 0.5), zlim=(0, 0.7))
    axes.set_box_aspect((8, 5, 7), zoom=1.05)
plt.show()
