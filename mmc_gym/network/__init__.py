"""The MMC body model: pure functions over arrays, without Gymnasium and without physics."""

from mmc_gym.network.hinge_arm import HingeArm
from mmc_gym.network.hinge_network import HingeClamps, HingeNetwork, HingeSolution, HingeState
from mmc_gym.network.model import Clamps, MMCNetwork, MMCState
from mmc_gym.network.normalizers import EuclideanNormalizer, LearnedNormalizer, Normalizer

__all__ = [
    "Clamps",
    "EuclideanNormalizer",
    "HingeArm",
    "HingeClamps",
    "HingeNetwork",
    "HingeSolution",
    "HingeState",
    "LearnedNormalizer",
    "MMCNetwork",
    "MMCState",
    "Normalizer",
]
