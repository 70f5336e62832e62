"""Pandas whose body is not as given: longer links, joints that are locked."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from xml.etree import ElementTree

import gymnasium as gym
import numpy as np
import pybullet_data
from gymnasium.wrappers import TimeLimit
from panda_gym.envs.core import RobotTaskEnv
from panda_gym.envs.robots.panda import Panda
from panda_gym.envs.tasks.reach import Reach
from panda_gym.pybullet import PyBullet

DATA = Path(pybullet_data.getDataPath()) / "franka_panda"
NEUTRAL = np.array([0.0, 0.41, 0.0, -1.85, 0.0, 2.26, 0.79])  # where the robot starts


def changed_urdf(longer: Mapping[str, float], folder: Path) -> Path:
    """Write a copy of pybullet's Panda, with links longer by factors; return its path.

    A link is named by the joint at its end, such as "panda_joint5" for the forearm.
    """
    robot = ElementTree.parse(DATA / "panda.urdf")
    for joint, factor in longer.items():
        origin = robot.find(f"joint[@name='{joint}']/origin")
        assert origin is not None, f"no joint {joint} in {DATA}"
        place = factor * np.array(origin.get("xyz", "").split(), float)
        origin.set("xyz", " ".join(map(str, place)))
    (folder / "meshes").symlink_to(DATA / "meshes")
    robot.write(folder / "panda.urdf")
    return folder / "panda.urdf"


class ChangedPanda(Panda):
    """A Panda with another URDF, of which joints may be locked where they start.

    Attributes:
        locked: indices of these joints.
    """

    def __init__(self, sim: PyBullet, urdf: Path, locked: tuple[int, ...]) -> None:
        self.urdf, self.locked = urdf, list(locked)
        base = np.array([-0.6, 0.0, 0.0])
        super().__init__(sim, block_gripper=True, base_position=base, control_type="joints")

    def _load_robot(self, file_name: str, base_position: Any) -> None:
        super()._load_robot(str(self.urdf), base_position)

    def arm_joint_ctrl_to_target_arm_angles(self, arm_joint_ctrl: Any) -> Any:
        """Return the targets of the servos, for locked joints where they started."""
        targets = super().arm_joint_ctrl_to_target_arm_angles(arm_joint_ctrl)
        targets[self.locked] = NEUTRAL[self.locked]
        return targets


def make_env(
    longer: Mapping[str, float] | None = None,
    locked: tuple[int, ...] = (),
    within: float = 0.05,
    **arguments: Any,
) -> gym.Env[Any, Any]:
    """Return `PandaReachJoints-v3` with links longer by factors, and locked joints.

    Args:
        longer: see `changed_urdf`.
        locked: indices of joints that stay where they start.
        within: distance to the target within which an episode succeeds, metres.
        arguments: of panda-gym's simulation, such as `renderer`.
    """
    sim = PyBullet(**arguments)
    with TemporaryDirectory() as folder:
        robot = ChangedPanda(sim, changed_urdf(longer or {}, Path(folder)), locked)
    task = Reach(sim, robot.get_ee_position, distance_threshold=within)
    return TimeLimit(RobotTaskEnv(robot, task), 50)
