"""Measures of sets of movements: posture variability, Fitts' law, the two-thirds power law.

Pure functions over arrays.  `set_measures` says which episodes they are taken from.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import linregress

from mmc_gym.measures.reaching import Floats

SLOWEST = 0.05
"""Share of the highest speed below which the curvature of a path is not defined well enough."""

STILLEST = 0.01
"""Speed below which a hand is at rest, whatever its highest speed is, segment lengths / s."""

STRAIGHTEST = 0.1
"""Curvature below which a path is straight, and has no power law, 1 / segment length."""

FEWEST = 10
"""Samples that a power law is fitted to at least."""


class Line(NamedTuple):
    """A straight line through points (x, y): intercept, slope, and the share R² it explains."""

    intercept: float
    slope: float
    r_squared: float


NO_LINE = Line(math.nan, math.nan, math.nan)


def posture_variability(joint_angles: ArrayLike) -> float:
    """How much postures that put the hand to one place differ, radians.

    √((1/N) Σ_i 2 (1 − R_i)), R_i = |mean over the movements of e^{i q_i}|: the root mean square
    over the joints of the angular deviation, which is the standard deviation for small spreads
    and √2 for uniform angles.  0 if the posture depends on the target alone (Donders' law), and
    more if on the way to it too.

    Args:
        joint_angles: when the hand is there, radians, (movements, N).

    Source:
        Angular deviation: Batschelet (1981), Circular Statistics in Biology.  Donders' law for the
        arm: Soechting, Buneo, Herrmann & Flanders (1995), J. Neurosci. 15, 6271–6280.

    Example:
        >>> posture_variability([[0.1, 3.2], [0.1, 3.2 - 2 * np.pi]])
        0.0
        >>> posture_variability([[0.0], [np.pi / 2], [np.pi], [-np.pi / 2]]) ** 2
        2.0
    """
    angles = np.asarray(joint_angles, dtype=np.float64)
    if angles.size == 0:
        return math.nan
    lengths = np.hypot(np.cos(angles).mean(axis=0), np.sin(angles).mean(axis=0))
    return math.sqrt(float(np.clip(2 * (1 - lengths), 0.0, None).mean()))


def fitts_law(amplitudes: ArrayLike, widths: ArrayLike, times: ArrayLike) -> Line:
    """Fitts' law: time = a + b · log2(2 A / W), by least squares over the conditions.

    Args:
        amplitudes: A, distance from start to centre of the target, segment lengths, (conditions,).
        widths: W, diameter of the target, segment lengths, (conditions,).
        times: mean time to be in the target and to stay, s; conditions with NaN are left out.

    Returns:
        a in s, b in s per bit, and R²; NaN for fewer than three different difficulties.

    Source:
        Fitts (1954), J. Exp. Psychol. 47, 381–391.

    Example:
        >>> fitts_law([1, 2, 4], [0.5, 0.5, 0.5], [0.4, 0.5, 0.6])
        Line(intercept=0.2, slope=0.1, r_squared=1.0)
    """
    bits = np.log2(2 * np.asarray(amplitudes, dtype=np.float64) / np.asarray(widths))
    return _line(bits, np.asarray(times, dtype=np.float64), fewest=3)


def speed_curvature_law(hands: ArrayLike, control_step: float) -> Line:
    """Two-thirds power law: log speed = log K − β log curvature, with β = 1/3 in human drawing.

    v = K κ^{−β}, or angular speed A = K κ^{1−β}: two thirds.  κ = |x′y″ − y′x″| / v³ by central
    differences, where the hand is faster than 5 % of its highest speed, and than 0.01, and κ > 0.1:
    a straight path has none.  A harmonic ellipse has β = 1/3 exactly.

    Args:
        hands: positions, segment lengths, (steps + 1, 2).
        control_step: T, seconds.

    Returns:
        log K, −β as the slope, and R²; NaN for fewer than ten samples.

    Source:
        Lacquaniti, Terzuolo & Viviani (1983), Acta Psychol. 54, 115–130.
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
    return _line(np.log(curvature[bent]), np.log(speed[bent]), fewest=FEWEST)


def _line(x: Floats, y: Floats, fewest: int) -> Line:
    present = ~(np.isnan(x) | np.isnan(y))
    x, y = x[present], y[present]
    if np.unique(x).size < fewest:
        return NO_LINE
    fit = linregress(x, y)
    return Line(float(fit.intercept), float(fit.slope), float(fit.rvalue) ** 2)
