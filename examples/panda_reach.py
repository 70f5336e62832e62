"""
How do the agents play an environment of somebody else?
=======================================================

Write a ``ReachInterface`` for it: where in an observation posture, hand and target are, and what an
action does. This one is for ``PandaReachJoints-v3`` of panda-gym (``pip install "mmc-gym[bodies]"``
with Python 3.11), a robot of seven joints in space, whose observations say nothing of its joints: a
wrapper reads their encoders.
"""

from dataclasses import replace

import gymnasium as gym
import numpy as np
import panda_gym  # noqa: F401  registers the environment

import mmc_gym
from mmc_gym.interface import ReachInterface, Seen
from mmc_gym.robots import HingeArm

BASE = np.array([-0.6, 0.0, 0.0])  # of the base
STEP, TURN = 0.04, 0.05  # seconds of a control step, radians that an action of 1 asks for


class Encoders(gym.ObservationWrapper):
    """Observations with the angles and speeds of the joints."""

    def __init__(self, env):
        super().__init__(env)
        joints = gym.spaces.Box(-np.inf, np.inf, (2, 7))
        self.observation_space = gym.spaces.Dict({**env.observation_space, "joints": joints})

    def observation(self, observation):
        robot = self.unwrapped.robot
        angles = [robot.get_joint_angle(joint) for joint in range(7)]
        speeds = [robot.get_joint_velocity(joint) for joint in range(7)]
        return {**observation, "joints": np.array([angles, speeds])}


class PandaReach(ReachInterface):
    """What agents are given about the robot, and how they see and move it."""

    def __init__(self, success_distance=0.05):
        arm = HingeArm.named("panda")
        home = arm.home.copy()
        home[2, 3] -= 0.105  # from the flange to between the fingers
        arm = replace(arm, home=home)
        super().__init__(
            segment_lengths=(),  # those of the arm
            control="joint_delta",
            speed_limit=TURN / STEP,
            servo_gain=1 / STEP,
            control_step=STEP,
            joint_limits=arm.limits,
            success_distance=success_distance,
            arm=arm,
        )

    def see(self, observation):
        angles, speeds = np.moveaxis(observation["joints"], -2, 0)
        hand, target = observation["achieved_goal"] - BASE, observation["desired_goal"] - BASE
        return Seen(angles, target, joint_speeds=speeds, hand=hand)

    def act(self, joint_targets, sensed):
        turn = (joint_targets - sensed.joint_angles) / TURN
        return np.clip(turn, -1.0, 1.0).astype(np.float32)


def make(**arguments):
    """Return the environment with encoders."""
    return Encoders(gym.make("PandaReachJoints-v3", **arguments))


if __name__ == "__main__":
    agents = ["mmc-body", "ik-body"]
    print(mmc_gym.compare(agents, make, episodes=20, interface=PandaReach()))
