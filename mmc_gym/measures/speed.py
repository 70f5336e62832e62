"""Measures of the speed profile of the hand, its shape and smoothness, and of a movement's cost.

A profile (steps,) holds the hand's speed in each control step.  Shape and smoothness are taken from
its `moving_part`: of minimum jerk its `MINIMUM_JERK_SPAN`, with a peak of 1.658 times the mean, not
15/8 = 1.875 as of the whole.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from mmc_gym.measures.catalogue import measure
from mmc_gym.measures.episode import MOVING, Episode, Floats
from mmc_gym.network.time_base import minimum_jerk

PEAK_PROMINENCE = 0.05  # of the highest speed, as in the paper's figures; smaller is no peak

_HALF = math.sqrt(1 - math.sqrt(MOVING))
MINIMUM_JERK_SPAN = (1 - _HALF) / 2, (1 + _HALF) / 2
"""Phases between which minimum jerk is faster than `MOVING` of its peak: 16 τ² (1 − τ)² ≥ 0.05."""

SPARC_CUTOFF = 10.0  # Hz
SPARC_THRESHOLD = 0.05
SPARC_PADDING = 4  # 2⁴ times the next power of two


def highest_speed(speeds: ArrayLike) -> float:
    """Return the largest speed of a profile, 0 without steps."""
    return float(np.max(speeds, initial=0.0))


@measure(label="peak speed", unit="lengths/s", shown=True, successes_only=True)
def peak_speed(episode: Episode) -> float:
    """Return the largest speed of the hand, segment lengths/s."""
    return highest_speed(episode.speeds)


def peakedness(speeds: ArrayLike) -> float:
    """Return the highest speed over the mean: 1 if constant, 15/8 for minimum jerk, NaN at rest.

    As a measure of a profile's shape: Nelson (1983), Biol. Cybern. 46, 135–147.
    """
    highest = highest_speed(speeds)
    return highest / float(np.mean(np.asarray(speeds))) if highest > 0.0 else math.nan


@measure(label="peak / mean speed", successes_only=True)
def peak_to_mean(episode: Episode) -> float:
    """Return the `peakedness` of the movement."""
    return peakedness(episode.movement_speeds)


def phase_of_peak(speeds: ArrayLike) -> float:
    """Return the middle of the fastest step, as a share of the duration; NaN at rest.

    (p + ½)/n for the fastest of the steps p = 0 … n − 1, the first if several are.  ½ for every
    symmetric profile with one peak and an odd number of steps.
    """
    is_moving = highest_speed(speeds) > 0.0
    return (int(np.argmax(speeds)) + 0.5) / np.size(speeds) if is_moving else math.nan


@measure(label="time to peak speed", unit="of duration", shown=True, successes_only=True)
def time_to_peak(episode: Episode) -> float:
    """Return the `phase_of_peak` of the movement."""
    return phase_of_peak(episode.movement_speeds)


def count_peaks(speeds: ArrayLike) -> float:
    """Return the number of peaks in a profile that stand out by 5 % of the highest.

    A peak stands out by its prominence: how far the speed falls on both sides before it gets
    higher.  The hand rests before and after the profile.  A single smooth submovement has 1, a hand
    at rest 0; NaN if a speed is NaN.

    Velocity peaks as a measure of smoothness: Rohrer et al. (2002), J. Neurosci. 22(18),
    8297–8304, https://doi.org/10.1523/JNEUROSCI.22-18-08297.2002.
    """
    from scipy.signal import find_peaks  # a second of imports, which tables do without

    profile = np.concatenate(([0.0], np.asarray(speeds, dtype=np.float64), [0.0]))
    if np.isnan(profile).any():
        return math.nan
    peaks, _ = find_peaks(profile, prominence=PEAK_PROMINENCE * profile.max())
    return float(len(peaks))


@measure(label="velocity peaks", best="low", decimals=1, shown=True, successes_only=True)
def velocity_peaks(episode: Episode) -> float:
    """Return the number of peaks (`count_peaks`) in the speed of the whole episode."""
    return count_peaks(episode.speeds)


def correlation_with_minimum_jerk(
    speeds: ArrayLike, span: tuple[float, float] = (0.0, 1.0)
) -> float:
    """Return Pearson's correlation of a profile with minimum jerk of the same duration.

    The reference are the distances ξ(τ_k) − ξ(τ_{k−1}) that minimum jerk covers in each of n steps
    between the two phases `span`; `MINIMUM_JERK_SPAN` for a `moving_part`.  1 for minimum jerk of
    any size, at least −1; NaN at constant speed.

    Source: Flash and Hogan (1985), J. Neurosci. 5(7), 1688–1703,
    https://doi.org/10.1523/JNEUROSCI.05-07-01688.1985.
    """
    profile = np.asarray(speeds, dtype=np.float64)
    if profile.size < 3 or np.ptp(profile) == 0.0:
        return math.nan
    # As np.corrcoef does, bit for bit, in a fifth of its time.
    both = np.stack((profile - profile.mean(), _minimum_jerk_profile(profile.size, span)))
    (variance, covariance), (_, ideal) = (np.dot(both, both.T) * (1 / (profile.size - 1))).tolist()
    correlation = covariance / math.sqrt(variance) / math.sqrt(ideal)
    return min(max(correlation, -1.0), 1.0)


@measure(
    label="like minimum jerk",
    unit="correlation",
    best="high",
    decimals=3,
    shown=True,
    successes_only=True,
)
def minimum_jerk_correlation(episode: Episode) -> float:
    """Return the `correlation_with_minimum_jerk` of the movement."""
    return correlation_with_minimum_jerk(episode.movement_speeds, MINIMUM_JERK_SPAN)


@lru_cache(maxsize=1024)
def _minimum_jerk_profile(steps: int, span: tuple[float, float]) -> Floats:
    """Return how far minimum jerk moves in each step, less the mean."""
    profile: Floats = np.diff(minimum_jerk(np.linspace(*span, steps + 1)))
    profile -= profile.mean()
    profile.flags.writeable = False  # the cache shares it
    return profile


@measure(label="smoothness", unit="SPARC", best="high", shown=True, successes_only=True)
def sparc(episode: Episode) -> float:
    """Return minus the arc length of the profile's spectrum (SPARC), about −1.4 if smooth.

    −∫₀^{f_c} √((1/f_c)² + (dM̂/df)²) df, where M̂ is the magnitude of the profile's Fourier
    transform (padded with zeros) over its largest, and f_c the highest frequency, up to 10 Hz,
    with M̂ ≥ 0.05.  Submovements, pauses and tremor make it more negative; size and duration do
    not.

    Source: Balasubramanian, Melendez-Calderon, Roby-Brami & Burdet (2015), J. NeuroEng. Rehabil.
    12, 112, https://doi.org/10.1186/s12984-015-0090-9; parameters as published.
    """
    profile = episode.movement_speeds
    if not highest_speed(profile) > 0.0:
        return math.nan
    count = 2 ** (math.ceil(math.log2(profile.size)) + SPARC_PADDING)
    frequencies = np.fft.rfftfreq(count, episode.control_step)
    magnitudes = np.abs(np.fft.rfft(profile, count))
    magnitudes = magnitudes[frequencies <= SPARC_CUTOFF] / magnitudes.max()
    selected = magnitudes[: np.flatnonzero(magnitudes >= SPARC_THRESHOLD)[-1] + 1]
    if selected.size < 2:
        return math.nan
    return -float(np.hypot(1 / (selected.size - 1), np.diff(selected)).sum())


@measure(label="joint effort", unit="mass len²/s", best="low", decimals=1, successes_only=True)
def joint_effort(episode: Episode) -> float:
    """Return ∫ Σ_i |τ_i| dt over the servos of all joints i, mass · length² / s.

    NaN without joints, and where an engine does not report it.
    """
    return _sum(episode.servo_impulses)


@measure(
    label="joint work", unit="mass len²/s²", best="low", decimals=1, shown=True, successes_only=True
)
def joint_work(episode: Episode) -> float:
    """Return ∫ Σ_i |τ_i q̇_i| dt over the servos of all joints i, mass · length² / s².

    Braking counts as much as driving.  NaN where `joint_effort` is.

    Absolute work as the cost of a reach: Alexander (1997), Biol. Cybern. 76, 97–105.
    """
    return _sum(episode.servo_work)


def _sum(values: Floats) -> float:
    return float(values.sum()) if values.size else math.nan


@measure(label="sum of rewards", best="high", decimals=0, shown=True)
def episode_return(episode: Episode) -> float:
    """Return the sum of the rewards, undiscounted."""
    return float(np.sum(episode.rewards))
