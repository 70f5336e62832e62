"""mmc-gym: the Mean-of-Multiple-Computations body model and its reaching environment.

Importing it registers the environments with Gymnasium.  Everything else is loaded on first use.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from mmc_gym import _interrupts as _interrupts  # first, as the others take a while to import
from mmc_gym import envs as envs  # registers the environments
from mmc_gym.envs import make, make_vec, perturbation

if TYPE_CHECKING:
    from mmc_gym import agents, benchmark, body, experiments, measures, network, report, training
    from mmc_gym._errors import MismatchWarning, UserError
    from mmc_gym.agents import make_agent
    from mmc_gym.agents.trial_learner import TrialLearner
    from mmc_gym.benchmark.compare import compare
    from mmc_gym.check import check_interface
    from mmc_gym.experiments.trials import run_experiment
    from mmc_gym.listing import (
        list_agents,
        list_experiments,
        list_measures,
        list_perturbations,
        list_scenarios,
        list_suites,
        list_tasks,
    )
    from mmc_gym.measures import run_episodes
    from mmc_gym.robots import HingeArm, HingeNetwork
    from mmc_gym.training.training import train

    __version__: str

__all__ = [
    "HingeArm",
    "HingeNetwork",
    "MismatchWarning",
    "TrialLearner",
    "UserError",
    "__version__",
    "agents",
    "benchmark",
    "body",
    "check_interface",
    "compare",
    "envs",
    "experiments",
    "list_agents",
    "list_experiments",
    "list_measures",
    "list_perturbations",
    "list_scenarios",
    "list_suites",
    "list_tasks",
    "make",
    "make_agent",
    "make_vec",
    "measures",
    "network",
    "perturbation",
    "report",
    "run_episodes",
    "run_experiment",
    "train",
    "training",
]

_HOMES = {
    "HingeArm": "robots",
    "HingeNetwork": "robots",
    "MismatchWarning": "_errors",
    "TrialLearner": "agents.trial_learner",
    "UserError": "_errors",
    "check_interface": "check",
    "compare": "benchmark.compare",
    **{name: "listing" for name in __all__ if name.startswith("list_")},
    "make_agent": "agents",
    "run_episodes": "measures",
    "run_experiment": "experiments.trials",
    "train": "training.training",
}


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    if name == "__version__":
        value: Any = import_module("importlib.metadata").version("mmc-gym")
    else:
        home = import_module(f"{__name__}.{_HOMES.get(name, name)}")
        value = getattr(home, name) if name in _HOMES else home
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
