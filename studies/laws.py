"""Laws of human movement, fitted to episodes: posture variability, Fitts' law, the power law.

Each law needs many movements of one agent in the scenario that suits it, see `LAWS`.
`studies.people` fits them to agents.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from mmc_gym.measures.catalogue import Quantity
from mmc_gym.measures.episode import Episode, Floats
from mmc_gym.measures.reaching import arrival_time, success

FITTS_WIDTHS = (0.02, 0.05, 0.1, 0.2)  # diameters of the target, segment lengths

# The power law is fitted where the hand moves on a bent path.
WARM_UP = 1.0  # s; left out, because the hand must first catch the moving target
SLOWEST = 0.05  # of the highest speed; slower samples are left out
STILLEST = 0.01  # segment lengths / s; slower counts as rest, whatever the highest speed
STRAIGHTEST = 0.1  # 1 / segment length; a smaller curvature counts as straight
FEWEST = 10  # samples for a fit


class Line(NamedTuple):
    """A straight line through points (x, y), and the share R² of the variance that it explains."""

    intercept: float
    slope: float
    r_squared: float


NO_LINE = Line(math.nan, math.nan, math.nan)


def _fit_line(x: Floats, y: Floats, fewest: int) -> Line:
    present = ~(np.isnan(x) | np.isnan(y))
    x, y = x[present], y[present]
    if np.unique(x).size < fewest:
        return NO_LINE
    from scipy.stats import linregress  # takes long to import

    fit = linregress(x, y)
    return Line(float(fit.intercept), float(fit.slope), float(fit.rvalue) ** 2)


def posture_spread(joint_angles: ArrayLike) -> float:
    """Return how much the postures with the hand at one place differ, radians.

    √((1/N) Σ_i 2 (1 − R_i)) with R_i = |mean over the movements of e^{i q_i}|.  This is the root
    mean square over the joints of the angular deviation, which equals the standard deviation for
    small spreads and √2 for uniform angles.  0 if the posture depends on the target alone (Donders'
    law), more if it also depends on the way there.
    The joint angles q, with the hand at that place, are in radians, (movements, N); NaN for fewer
    than two movements.

    Angular deviation: Batschelet (1981), Circular Statistics in Biology.  Donders' law for
    the arm: Soechting, Buneo, Herrmann & Flanders (1995), J. Neurosci. 15, 6271–6280.
    """
    angles = np.asarray(joint_angles, dtype=np.float64)
    if len(angles) < 2 or angles.size == 0:
        return math.nan
    lengths = np.hypot(np.cos(angles).mean(axis=0), np.sin(angles).mean(axis=0))
    return math.sqrt(float(np.clip(2 * (1 - lengths), 0.0, None).mean()))


def posture_variability(episodes: Sequence[Episode]) -> float:
    """Return the mean over targets of the `posture_spread` at the end of successful episodes.

    Failed episodes are left out, because the posture differs where the hand is elsewhere.  Targets
    that were reached fewer than twice are left out too.
    """
    postures = defaultdict(list)
    for episode in episodes:
        if success(episode):
            postures[tuple(episode.targets[-1].round(9).tolist())].append(episode.joint_angles[-1])
    spreads = [posture_spread(group) for group in postures.values() if len(group) > 1]
    return float(np.mean(spreads)) if spreads else math.nan


def fitts_law(amplitudes: ArrayLike, widths: ArrayLike, times: ArrayLike) -> Line:
    """Fit Fitts' law, time = a + b · log2(2 A / W), by least squares over the conditions.

    Args:
        amplitudes: A, distance from start to centre of the target, segment lengths, (conditions,).
        widths: W, diameter of the target, segment lengths, (conditions,).
        times: mean time until the hand stays in the target, s; conditions with NaN are left out.

    Returns:
        a in s, b in s per bit, and R²; NaN for fewer than three different difficulties.

    Source: Fitts (1954), J. Exp. Psychol. 47, 381–391.
    """
    bits = np.log2(2 * np.asarray(amplitudes, dtype=np.float64) / np.asarray(widths))
    return _fit_line(bits, np.asarray(times, dtype=np.float64), fewest=3)


def fitts_line(episodes: Sequence[Episode]) -> Line:
    """Fit `fitts_law` to the mean times to stay within half of each of `FITTS_WIDTHS`.

    A condition is a distance and a width.  It is left out if some hand does not settle, because
    the mean over the others would be too short.
    """
    groups = defaultdict(list)
    for episode in episodes:
        groups[round(float(episode.distances[0]), 3)].append(episode)
    conditions = []
    for (distance, group), width in product(groups.items(), FITTS_WIDTHS):
        times = [
            arrival_time(episode.distances, width / 2, episode.control_step) for episode in group
        ]
        conditions.append((distance, width, float(np.mean(times))))
    return fitts_law(*np.transpose(conditions)) if conditions else NO_LINE


def speed_curvature_law(hands: ArrayLike, control_step: float) -> Line:
    """Fit the two-thirds power law, log speed = log K − β log curvature.

    v = K κ^{−β}, or angular speed A = K κ^{1−β}.  In human drawing β = 1/3, hence two thirds.
    κ = |x′y″ − y′x″| / v³ by central differences.  Samples count where the hand is faster than 5 %
    of its highest speed and than 0.01, and where κ > 0.1.  A harmonic ellipse has β = 1/3.

    Positions are (steps + 1, 2), in segment lengths.  Return log K, −β as the slope, and R²; NaN
    for fewer than ten samples.

    Source: Lacquaniti, Terzuolo & Viviani (1983), Acta Psychol. 54, 115–130.
    """
    path = np.asarray(hands, dtype=np.float64)
    if len(path) < 3:
        return NO_LINE
    velocity = (path[2:] - path[:-2]) / (2 * control_step)
    acceleration = (path[2:] - 2 * path[1:-1] + path[:-2]) / control_step**2
    speed = np.linalg.norm(velocity, axis=-1)
    turning = np.abs(velocity[:, 0] * acceleration[:, 1] - velocity[:, 1] * acceleration[:, 0])
    moving = speed > max(SLOWEST * speed.max(), STILLEST)
    speed, curvature = speed[moving], turning[moving] / speed[moving] ** 3
    bent = curvature > STRAIGHTEST
    return _fit_line(np.log(curvature[bent]), np.log(speed[bent]), fewest=FEWEST)


def power_line(episodes: Sequence[Episode]) -> Line:
    """Return the medians over the episodes of the `speed_curvature_law` after `WARM_UP`."""
    lines = [
        speed_curvature_law(e.hands[round(WARM_UP / e.control_step) :], e.control_step)
        for e in episodes
    ]
    fitted = [line for line in lines if not math.isnan(line.slope)]
    return Line(*np.median(fitted, axis=0).tolist()) if fitted else NO_LINE


@dataclass(frozen=True, kw_only=True)
class Law(Quantity):
    """A quantity `of` all episodes of an agent in one scenario; NaN where there is none."""

    scenario: str
    of: Callable[[Sequence[Episode]], float]


LAWS = {
    law.name: law
    for law in (
        Law(
            name="posture_variability",
            label="posture variability",
            unit="rad",
            decimals=3,
            scenario="paper",
            of=posture_variability,
        ),
        Law(
            name="fitts_slope",
            label="Fitts' slope",
            unit="s/bit",
            decimals=3,
            scenario="distances",
            of=lambda episodes: fitts_line(episodes).slope,
        ),
        Law(
            name="fitts_r_squared",
            label="R² of Fitts' law",
            scenario="distances",
            of=lambda episodes: fitts_line(episodes).r_squared,
        ),
        Law(
            name="speed_curvature_exponent",
            label="speed-curvature exponent",
            decimals=3,
            scenario="pursuit",
            of=lambda episodes: -power_line(episodes).slope,
        ),
        Law(
            name="speed_curvature_r_squared",
            label="R² of the power law",
            scenario="pursuit",
            of=lambda episodes: power_line(episodes).r_squared,
        ),
    )
}
