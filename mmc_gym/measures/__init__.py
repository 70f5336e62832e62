"""Turn episodes into numbers: rollouts, and measures with their labels and units."""

from mmc_gym.measures.episode import Episode

# This order is that of the columns of data and the rows of tables.
from mmc_gym.measures import reaching, speed  # isort: skip
from mmc_gym.measures.catalogue import (
    MEASURES,
    Measure,
    leave_out_failures,
    measure,
    measure_all,
)
from mmc_gym.measures.rollout import episode_seeds, run_episodes

__all__ = [
    "MEASURES",
    "Episode",
    "Measure",
    "episode_seeds",
    "leave_out_failures",
    "measure",
    "measure_all",
    "reaching",
    "run_episodes",
    "speed",
]
