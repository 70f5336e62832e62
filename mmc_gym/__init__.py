"""mmc-gym: the Mean-of-Multiple-Computations body model and its reaching environment.

Importing it registers the environments with Gymnasium.
"""

from importlib.metadata import version

from mmc_gym import envs as _envs  # registers the environments
from mmc_gym.agents import make_agent

__version__ = version("mmc-gym")
__all__ = ["__version__", "make_agent"]
del _envs
