"""The measures of an episode: names, units, and how tables show them.

A new measure is a pure function in `metrics` and an entry in `MEASURES`; data, summary and table
follow.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from mmc_gym.evaluation import metrics
from mmc_gym.evaluation.rollout import Episode

Statistic = Literal["mean", "median"]
Direction = Literal["high", "low", "neither"]


@dataclass(frozen=True, kw_only=True)
class Measure:
    """How a measure is taken from an episode, and how it is shown.

    Attributes:
        name: its column in the data.
        label: its heading in tables.
        unit: of its values; empty for a number.
        best: whether high or low values are good.
        statistic: what a table says about many episodes.
        decimals: at most so many are shown.
        of: the measure of an episode; NaN where it has none.
    """

    name: str
    label: str
    unit: str
    best: Direction
    statistic: Statistic
    decimals: int
    of: Callable[[Episode], float]


def _speeds(episode: Episode) -> metrics.Floats:
    return metrics.hand_speed(episode.hands, episode.control_step)


MEASURES: tuple[Measure, ...] = (
    Measure(
        name="success",
        label="success at the end",
        unit="fraction",
        best="high",
        statistic="mean",
        decimals=3,
        of=lambda e: metrics.success_at_end(e.distances, e.tolerance),
    ),
    Measure(
        name="final_distance",
        label="final distance",
        unit="lengths",
        best="low",
        statistic="median",
        decimals=3,
        of=lambda e: metrics.final_distance(e.distances),
    ),
    Measure(
        name="time_to_target",
        label="time to target",
        unit="s",
        best="low",
        statistic="median",
        decimals=2,
        of=lambda e: metrics.time_to_target(e.distances, e.tolerance, e.control_step),
    ),
    Measure(
        name="path_ratio",
        label="path / direct line",
        unit="",
        best="low",
        statistic="median",
        decimals=2,
        of=lambda e: metrics.path_ratio(e.hands, e.target, e.tolerance),
    ),
    Measure(
        name="peak_speed",
        label="peak speed",
        unit="lengths/s",
        best="neither",
        statistic="median",
        decimals=2,
        of=lambda e: metrics.peak_speed(_speeds(e)),
    ),
    Measure(
        name="velocity_peaks",
        label="velocity peaks",
        unit="",
        best="low",
        statistic="median",
        decimals=1,
        of=lambda e: metrics.velocity_peaks(_speeds(e)),
    ),
    Measure(
        name="episode_return",
        label="sum of rewards",
        unit="",
        best="high",
        statistic="median",
        decimals=0,
        of=lambda e: metrics.episode_return(e.rewards),
    ),
    Measure(
        name="action_time",
        label="time per action",
        unit="µs",
        best="low",
        statistic="median",
        decimals=1,
        of=lambda e: metrics.action_time(e.action_times * 1e6),
    ),
)
