"""The MMC body model: pure functions over arrays, without Gymnasium and without physics."""

from mmc_gym.network.model import Clamps, MMCNetwork, MMCState
from mmc_gym.network.normalizers import EuclideanNormalizer, LearnedNormalizer, Normalizer

__all__ = [
    "Clamps",
    "EuclideanNormalizer",
    "LearnedNormalizer",
    "MMCNetwork",
    "MMCState",
    "Normalizer",
]
