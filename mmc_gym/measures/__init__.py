"""Turn episodes into numbers: rollouts, and measures with their labels and units."""

from mmc_gym.measures.episode import Episode

# This order is that of the columns of data and the rows of tables.
from mmc_gym.measures import reaching, speed, sets  # isort: skip
from mmc_gym.measures.catalogue import (
    MEASURES,
    SET_MEASURES,
    Measure,
    SetMeasure,
    leave_out_failures,
    measure,
    measure_all,
    set_measure,
)
from mmc_gym.measures.rollout import episode_seeds, run_episodes

__all__ = [
    "MEASURES",
    "SET_MEASURES",
    "Episode",
    "Measure",
    "SetMeasure",
    "episode_seeds",
    "leave_out_failures",
    "measure",
    "measure_all",
    "reaching",
    "run_episodes",
    "set_measure",
    "sets",
    "speed",
]
