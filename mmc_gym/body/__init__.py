"""The simulated arm: pymunk bodies, joints and servos.  Knows no Gymnasium and no network."""

from mmc_gym.body.arm import Arm, ArmParameters, Servo

__all__ = ["Arm", "ArmParameters", "Servo"]
