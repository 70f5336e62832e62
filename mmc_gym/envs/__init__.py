"""Gymnasium environments over the simulated arm.  Importing this package registers them."""

from mmc_gym.envs.scenarios import register_all

register_all()
