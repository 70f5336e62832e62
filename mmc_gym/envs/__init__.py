"""Gymnasium environments of the simulated arm.  Importing this package registers them."""

import os
import sys
from typing import Any

import gymnasium as gym

from mmc_gym.envs.names import Family, register_all, register_perturbation, register_task
from mmc_gym.envs.scenarios import make, make_vec

# Pygame greets on standard output, which may be piped.
os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")

__all__ = ["Family", "make", "make_vec", "register_perturbation", "register_task"]


def _show_wrapped_environments() -> None:
    """Let the running notebook show environments as pictures, although Gymnasium wraps them."""
    ipython: Any = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython else None
    if shell is not None:
        shell.display_formatter.formatters["image/png"].for_type(gym.Wrapper, _picture)


def _picture(env: gym.Wrapper[Any, Any, Any, Any]) -> bytes | None:
    """Return the picture of the environment in a wrapper; None if it has none."""
    draw = getattr(env.unwrapped, "_repr_png_", None)
    return draw() if draw else None


register_all()
_show_wrapped_environments()
