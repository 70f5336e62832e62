"""Gymnasium environments over the simulated arm.  Importing this package registers them."""

import sys
from typing import Any

import gymnasium as gym

from mmc_gym.envs.scenarios import Family, register_all, register_perturbation, register_task

__all__ = ["Family", "register_perturbation", "register_task"]


def _show_wrapped_environments() -> None:
    """Let a notebook that runs now show environments as pictures, though Gymnasium wraps them."""
    ipython: Any = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython else None
    if shell is not None:
        shell.display_formatter.formatters["image/png"].for_type(gym.Wrapper, _picture)


def _picture(env: gym.Wrapper[Any, Any, Any, Any]) -> bytes | None:
    """Return the picture of a wrapper, or of the environment in it; None if there is none."""
    for one in (env, env.unwrapped):
        draw = getattr(one, "_repr_png_", None)
        if draw is not None:
            found: bytes | None = draw()
            return found
    return None


register_all()
_show_wrapped_environments()
