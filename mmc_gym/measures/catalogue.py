"""The measures of an episode: names, units, and how tables show them.

A new measure is a pure function in `metrics`, `profiles` or `paths`, and an entry in `MEASURES`;
data and summary follow, and the table if it is `shown`.  `episode_views` says what they look at.

Of a movement that did not arrive, path, shape and cost tell nothing: a hand that never moves has
the shortest path, the least work and no overshoot, and one that ignores where it is wrong moves the
more smoothly for it.  So, as is the custom for movements of people, such measures are told of the
episodes that ended at the target, with the fraction of these beside them (`successes_only`).  Data
hold them for all episodes, and `leave_out_failures` is what tables and comparisons see.

Measures of all episodes of a certain kind together are in `set_measures`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
import pandas as pd

from mmc_gym.measures import path as paths
from mmc_gym.measures import reaching as metrics
from mmc_gym.measures import speed as profiles
from mmc_gym.measures.reaching import Floats
from mmc_gym.measures.rollout import Episode

DWELL = 0.2
"""Seconds that the hand must have stayed for a success with dwell."""

REST = 0.5
"""Seconds at the end of an episode in which the hand's jitter is measured."""

PARTS_OF_REACH = (1, 2, 5)
"""Tolerances of successes with dwell, % of reach."""


def _moves(episode: Episode) -> bool:
    away = np.linalg.norm(episode.hands - episode.hands[0], axis=-1)
    return bool(away.max() > episode.tolerance)


def speeds(episode: Episode) -> Floats:
    """The speed profile of the hand over the whole episode, segment lengths/s, (n,)."""
    return profiles.hand_speed(episode.hands, episode.control_step)


def of_shape(of: Callable[[Floats, float], float]) -> Callable[[Episode], float]:
    """A measure of the speeds of the moving part, and the control step."""

    def measure(episode: Episode) -> float:
        if not _moves(episode):
            return math.nan
        profile = speeds(episode)
        return of(profile[profiles.moving_part(profile)], episode.control_step)

    return measure


def of_path(of: Callable[[Floats, Floats], float]) -> Callable[[Episode], float]:
    """A measure of the hand positions and joint angles of the moving part."""

    def measure(episode: Episode) -> float:
        if not _moves(episode):
            return math.nan
        part = profiles.moving_part(speeds(episode))
        points = slice(part.start, part.stop + 1)
        return of(episode.hands[points], episode.joint_angles[points])

    return measure


def _steps(seconds: float, episode: Episode) -> int:
    return round(seconds / episode.control_step)


def stays_within(percent: int) -> Callable[[Episode], float]:
    """Success with dwell, within so many percent of the reach, for the last `DWELL` seconds."""

    def measure(episode: Episode) -> float:
        tolerance = percent / 100 * episode.reach
        return metrics.success_with_dwell(episode.distances, tolerance, _steps(DWELL, episode))

    return measure


def deviation(episode: Episode) -> float:
    """Largest deviation from the line between the ends of the moving part; NaN if shorter than ε.

    Not from the line to the target: under a visuomotor rotation the hand is to go elsewhere.
    """
    part = profiles.moving_part(speeds(episode))
    hands = episode.hands[part.start : part.stop + 1]
    if np.linalg.norm(hands[-1] - hands[0]) < episode.tolerance:
        return math.nan
    return paths.maximal_deviation(hands, hands[0], hands[-1])


def where_target_stands(of: Callable[[Episode], float]) -> Callable[[Episode], float]:
    """A measure that is about one target; NaN where it moves, or another follows."""

    def measure(episode: Episode) -> float:
        stands = bool((episode.targets == episode.targets[0]).all())
        return of(episode) if stands else math.nan

    return measure


def final_jitter(episode: Episode) -> float:
    """Jitter in the last `REST` seconds; NaN unless the hand is at the target throughout."""
    steps = _steps(REST, episode)
    if not metrics.success_with_dwell(episode.distances, episode.tolerance, steps):
        return math.nan
    return metrics.jitter(episode.seen_hands, episode.targets, steps)


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
        shown: whether tables show it; files hold all.
        successes_only: whether it tells something only of episodes that ended at the target.
    """

    name: str
    label: str
    unit: str
    best: Direction
    statistic: Statistic
    decimals: int
    of: Callable[[Episode], float]
    shown: bool = False
    successes_only: bool = False


MEASURES: tuple[Measure, ...] = (
    Measure(
        name="success",
        label="success at the end",
        unit="fraction",
        best="high",
        statistic="mean",
        decimals=3,
        of=lambda e: metrics.success_at_end(e.distances, e.tolerance),
        shown=True,
    ),
    *(
        Measure(
            name=f"success_{percent}_percent",
            label=f"within {percent} % of reach",
            unit="fraction",
            best="high",
            statistic="mean",
            decimals=3,
            of=stays_within(percent),
            shown=percent == min(PARTS_OF_REACH),
        )
        for percent in PARTS_OF_REACH
    ),
    Measure(
        name="final_distance",
        label="final distance",
        unit="lengths",
        best="low",
        statistic="median",
        decimals=3,
        of=lambda e: metrics.final_distance(e.distances),
        shown=True,
    ),
    Measure(
        name="time_to_target",
        label="time to target",
        unit="s",
        best="low",
        statistic="median",
        decimals=2,
        of=lambda e: metrics.time_to_target(e.distances, e.tolerance, e.control_step),
        shown=True,
        successes_only=True,
    ),
    Measure(
        name="settling_time",
        label="settling at the target",
        unit="s",
        best="low",
        statistic="median",
        decimals=2,
        of=lambda e: metrics.settling_time(e.distances, e.tolerance, e.control_step),
        successes_only=True,
    ),
    Measure(
        name="overshoot",
        label="overshoot",
        unit="lengths",
        best="low",
        statistic="median",
        decimals=3,
        of=where_target_stands(lambda e: metrics.overshoot(e.distances)),
        successes_only=True,
    ),
    Measure(
        name="jitter",
        label="jitter at the target",
        unit="lengths",
        best="low",
        statistic="median",
        decimals=4,
        of=final_jitter,
        successes_only=True,
    ),
    Measure(
        name="path_ratio",
        label="path / direct line",
        unit="",
        best="low",
        statistic="median",
        decimals=2,
        of=where_target_stands(lambda e: paths.path_ratio(e.seen_hands, e.target, e.tolerance)),
        shown=True,
        successes_only=True,
    ),
    Measure(
        name="path_efficiency",
        label="path efficiency",
        unit="",
        best="high",
        statistic="median",
        decimals=3,
        of=of_path(lambda hands, _: paths.path_efficiency(hands)),
        successes_only=True,
    ),
    Measure(
        name="maximal_deviation",
        label="largest deviation / length",
        unit="",
        best="low",
        statistic="median",
        decimals=3,
        of=deviation,
        successes_only=True,
    ),
    Measure(
        name="joint_path_efficiency",
        label="path efficiency of the joints",
        unit="",
        best="high",
        statistic="median",
        decimals=3,
        of=of_path(lambda _, joints: paths.path_efficiency(joints)),
        successes_only=True,
    ),
    Measure(
        name="hand_over_joint_straightness",
        label="straighter in hand than in joint space",
        unit="",
        best="neither",
        statistic="median",
        decimals=2,
        of=of_path(paths.hand_over_joint_straightness),
        successes_only=True,
    ),
    Measure(
        name="peak_speed",
        label="peak speed",
        unit="lengths/s",
        best="neither",
        statistic="median",
        decimals=2,
        of=lambda e: profiles.peak_speed(speeds(e)),
        shown=True,
        successes_only=True,
    ),
    Measure(
        name="peak_to_mean",
        label="peak / mean speed",
        unit="",
        best="neither",
        statistic="median",
        decimals=2,
        of=of_shape(lambda profile, _: profiles.peak_to_mean(profile)),
        successes_only=True,
    ),
    Measure(
        name="time_to_peak",
        label="time to peak speed",
        unit="of duration",
        best="neither",
        statistic="median",
        decimals=2,
        of=of_shape(lambda profile, _: profiles.time_to_peak(profile)),
        shown=True,
        successes_only=True,
    ),
    Measure(
        name="velocity_peaks",
        label="velocity peaks",
        unit="",
        best="low",
        statistic="median",
        decimals=1,
        of=lambda e: profiles.velocity_peaks(speeds(e)),
        shown=True,
        successes_only=True,
    ),
    Measure(
        name="minimum_jerk_correlation",
        label="like minimum jerk",
        unit="correlation",
        best="high",
        statistic="median",
        decimals=3,
        of=of_shape(
            lambda profile, _: profiles.minimum_jerk_correlation(
                profile, profiles.MINIMUM_JERK_SPAN
            )
        ),
        shown=True,
        successes_only=True,
    ),
    Measure(
        name="minimum_jerk_rmse",
        label="unlike minimum jerk",
        unit="mean speeds",
        best="low",
        statistic="median",
        decimals=3,
        of=of_shape(
            lambda profile, _: profiles.minimum_jerk_rmse(profile, profiles.MINIMUM_JERK_SPAN)
        ),
        successes_only=True,
    ),
    Measure(
        name="sparc",
        label="smoothness",
        unit="SPARC",
        best="high",
        statistic="median",
        decimals=2,
        of=of_shape(profiles.sparc),
        shown=True,
        successes_only=True,
    ),
    Measure(
        name="log_dimensionless_jerk",
        label="smoothness",
        unit="log dimensionless jerk",
        best="high",
        statistic="median",
        decimals=2,
        of=of_shape(lambda profile, _: profiles.log_dimensionless_jerk(profile)),
        successes_only=True,
    ),
    Measure(
        name="joint_effort",
        label="joint effort",
        unit="mass len²/s",
        best="low",
        statistic="median",
        decimals=1,
        of=lambda e: metrics.joint_effort(e.servo_impulses),
        successes_only=True,
    ),
    Measure(
        name="joint_work",
        label="joint work",
        unit="mass len²/s²",
        best="low",
        statistic="median",
        decimals=1,
        of=lambda e: metrics.joint_work(e.servo_work),
        shown=True,
        successes_only=True,
    ),
    Measure(
        name="episode_return",
        label="sum of rewards",
        unit="",
        best="high",
        statistic="median",
        decimals=0,
        of=lambda e: metrics.episode_return(e.rewards),
        shown=True,
    ),
    Measure(
        name="action_time",
        label="time per action",
        unit="µs",
        best="low",
        statistic="median",
        decimals=1,
        of=lambda e: metrics.action_time(e.action_times * 1e6),
        shown=True,
    ),
    Measure(
        name="slow_action_time",
        label="time per action, 99th percentile",
        unit="µs",
        best="low",
        statistic="median",
        decimals=1,
        of=lambda e: metrics.slow_action_time(e.action_times * 1e6),
    ),
)


def leave_out_failures(episodes: pd.DataFrame) -> pd.DataFrame:
    """Episodes as tables and comparisons see them: no value where it tells nothing.

    Args:
        episodes: a row each, with columns of `MEASURES`, "success" among them.

    Returns:
        The same with NaN for measures of `successes_only` wherever success is not 1.
    """
    names = [one.name for one in MEASURES if one.successes_only and one.name in episodes]
    arrived = episodes["success"].to_numpy() == 1.0
    return episodes.assign(
        **{name: np.where(arrived, episodes[name].to_numpy(np.float64), np.nan) for name in names}
    )
