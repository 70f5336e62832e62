"""The simulated arm: bodies, joints and servos.  Knows no Gymnasium and no network."""

from mmc_gym.body.arm import Arm
from mmc_gym.body.batch import Arms
from mmc_gym.body.parameters import ArmParameters, Servo

__all__ = ["Arm", "ArmParameters", "Arms", "Servo"]
