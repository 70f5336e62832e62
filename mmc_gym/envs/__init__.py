"""Gymnasium environments of the simulated arm.  Importing this package registers them."""

import os

from mmc_gym.envs.changes import Change, Family, OneOf, Range, Walk
from mmc_gym.envs.names import perturbation, register_all, register_task
from mmc_gym.envs.scenarios import make, make_vec

# Pygame greets on standard output, which may be piped.
os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")

__all__ = [
    "Change",
    "Family",
    "OneOf",
    "Range",
    "Walk",
    "make",
    "make_vec",
    "perturbation",
    "register_task",
]


register_all()
