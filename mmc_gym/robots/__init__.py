"""Arms of hinges in space: robots and their tables, URDF files, and the network that moves them."""

from mmc_gym.robots.arm import HingeArm
from mmc_gym.robots.network import HingeClamps, HingeNetwork, HingeSolution, HingeState

__all__ = ["HingeArm", "HingeClamps", "HingeNetwork", "HingeSolution", "HingeState"]
