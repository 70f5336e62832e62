"""The simulated arm: bodies, joints and servos.  Knows no Gymnasium and no network."""

from mmc_gym.body.parameters import ArmParameters, Servo
from mmc_gym.body.pymunk.arm import Arm
from mmc_gym.body.pymunk.batch import Arms

__all__ = ["Arm", "ArmParameters", "Arms", "Servo"]
