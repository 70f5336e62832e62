"""Movement measures: pure functions of one movement, with their definitions.

`measures.MEASURES` says how data and tables name them.  In all of them hand positions are
(steps + 1, 2) in segment lengths, the first before the first action; T is the control step in
seconds, ε the distance within which a target counts as reached.
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.signal import find_peaks

from mmc_gym.network.time_base import minimum_jerk

Floats: TypeAlias = NDArray[np.float64]

# A smaller rise is no peak: the paper's figures count re-rises above 5 % of the peak velocity.
PEAK_PROMINENCE = 0.05


def success_at_end(distances: ArrayLike, tolerance: float) -> float:
    """1 if the hand is within `tolerance` of the target when the episode ends, else 0.

    Passing through the target is no success: the task is to stay there.

    Args:
        distances: from hand to target, segment lengths, (steps + 1,).
        tolerance: ε, segment lengths; at ε exactly counts as within, as in the environment.

    Example:
        >>> success_at_end([1.0, 0.04, 0.3], 0.05), success_at_end([1.0, 0.05], 0.05)
        (0.0, 1.0)
    """
    return float(np.asarray(distances)[-1] <= tolerance)


def final_distance(distances: ArrayLike) -> float:
    """Distance from hand to target when the episode ends, segment lengths."""
    return float(np.asarray(distances)[-1])


def time_to_target(distances: ArrayLike, tolerance: float, control_step: float) -> float:
    """Seconds until the hand is within `tolerance` and stays there until the episode ends.

    T · min{k : distance_j ≤ ε for every j ≥ k}; NaN if the episode ends outside.  Not the first
    entry: a hand that rushes through the target would be the quickest, and one that circles
    around it would have arrived.  It exists exactly where `success_at_end` is 1, so a median of
    it speaks of the successful episodes alone.

    Args:
        distances: from hand to target, segment lengths, (steps + 1,).
        tolerance: ε, segment lengths.
        control_step: T, seconds.

    Example:
        >>> time_to_target([1.0, 0.0, 0.5, 0.04, 0.01], 0.05, 0.02)  # enters, leaves, settles
        0.06
    """
    outside = np.flatnonzero(np.asarray(distances) > tolerance)
    first_to_stay = int(outside[-1]) + 1 if outside.size else 0
    return first_to_stay * control_step if first_to_stay < np.size(distances) else math.nan


def path_ratio(hands: ArrayLike, target: ArrayLike, tolerance: float) -> float:
    """Length of the hand's path over the straight line from start to target; 1 is straight.

    Σ|p_{k+1} − p_k| / |target − p_0|, over the whole episode, corrections and tremor at the
    target included.  Below 1 only if the hand stops short.  NaN where the straight line is
    shorter than ε: there is no movement to make, and the ratio would blow up.

    Args:
        hands: positions, segment lengths, (steps + 1, 2).
        target: segment lengths, (2,).
        tolerance: ε, segment lengths.
    """
    hands = np.asarray(hands, dtype=np.float64)
    straight = float(np.linalg.norm(np.asarray(target) - hands[0]))
    if straight < tolerance:
        return math.nan
    return float(np.linalg.norm(np.diff(hands, axis=0), axis=-1).sum()) / straight


def hand_speed(hands: ArrayLike, control_step: float) -> Floats:
    """Speed of the hand in each control step, |p_{k+1} − p_k| / T, segment lengths/s, (steps,).

    The mean over a step as the crow flies, and so the speed at the middle of the step, up to
    terms in T².
    """
    displacements = np.diff(np.asarray(hands, dtype=np.float64), axis=0)
    speeds: Floats = np.linalg.norm(displacements, axis=-1) / control_step
    return speeds


def peak_speed(speeds: ArrayLike) -> float:
    """Largest speed of the hand, segment lengths/s; 0 for an episode without steps."""
    return float(np.max(np.asarray(speeds), initial=0.0))


def velocity_peaks(speeds: ArrayLike) -> float:
    """Number of peaks in a speed profile (steps,) that stand out by 5 % of the highest.

    Standing out is prominence: how far the speed falls on both sides before it gets higher.  So
    a second peak is a re-rise by 5 % of the peak speed, as in the published figures.  At both
    ends the profile is taken to come from rest and go to rest, so a movement that is fastest in
    its first step has a peak there.  A single smooth submovement has 1, a hand at rest 0.

    Source:
        Velocity peaks as a measure of smoothness: Rohrer et al. (2002), J. Neurosci. 22(18),
        8297–8304, https://doi.org/10.1523/JNEUROSCI.22-18-08297.2002.

    Example:
        >>> velocity_peaks([1.0, 0.5, 0.1]), velocity_peaks([0.1, 1.0, 0.2, 0.3, 0.1])
        (1.0, 2.0)
    """
    highest = peak_speed(speeds)
    if highest == 0.0:
        return 0.0
    profile = np.pad(np.asarray(speeds, dtype=np.float64), 1)
    peaks, _ = find_peaks(profile, prominence=PEAK_PROMINENCE * highest)
    return float(len(peaks))


def second_rise(speeds: ArrayLike) -> float:
    """How far the speed rises again after its peak, as a share of the peak.

    max_{k>j≥p} (s_k − s_j) / s_p, p the step of the peak s_p.  Above 0.05 the published figures
    speak of a second velocity peak; unlike `velocity_peaks`, which is about both sides of the
    peak, this is about the return after it.  0 for a hand at rest.

    Example:
        >>> second_rise([0.2, 0.1, 1.0, 0.3, 0.5]), second_rise([0.2, 0.1, 1.0, 0.5, 0.3])
        (0.2, 0.0)
    """
    profile = np.asarray(speeds, dtype=np.float64)
    highest = peak_speed(profile)
    if highest == 0.0:
        return 0.0
    after = profile[profile.argmax() :]
    return float((after - np.minimum.accumulate(after)).max()) / highest


def peak_to_mean(speeds: ArrayLike) -> float:
    """Highest over mean speed: 1 at constant speed, 15/8 for minimum jerk, NaN at rest.

    Source:
        As a measure of a profile's shape: Nelson (1983), Biol. Cybern. 46, 135–147.
    """
    highest = peak_speed(speeds)
    return highest / float(np.mean(np.asarray(speeds))) if highest > 0.0 else math.nan


def time_to_peak(speeds: ArrayLike) -> float:
    """Middle of the fastest step, as a share of the movement's duration; NaN at rest.

    (p + ½)/n for the step p = 0 … n − 1.  ½ for every symmetric profile of an odd number of
    steps; an even number has two middle steps, of which it is the faster or the first.

    Example:
        >>> time_to_peak([0.1, 1.0, 0.5, 0.2]), time_to_peak([0.5, 1.0, 0.5])
        (0.375, 0.5)
    """
    profile = np.asarray(speeds)
    if peak_speed(profile) == 0.0:
        return math.nan
    return (int(profile.argmax()) + 0.5) / profile.size


def minimum_jerk_correlation(speeds: ArrayLike) -> float:
    """Pearson's correlation of a speed profile with minimum jerk of the same duration.

    With the distances ξ(k/n) − ξ((k − 1)/n) that a minimum-jerk movement covers in each of n
    steps.  1 for minimum jerk of any size, −1 at the least; NaN at constant speed.

    Source:
        Flash and Hogan (1985), J. Neurosci. 5(7), 1688–1703,
        https://doi.org/10.1523/JNEUROSCI.05-07-01688.1985.
    """
    profile = np.asarray(speeds, dtype=np.float64)
    if profile.size < 3 or np.ptp(profile) == 0.0:
        return math.nan
    covered = np.diff(minimum_jerk(np.arange(profile.size + 1) / profile.size))
    return float(np.corrcoef(profile, covered)[0, 1])


def overshoot(distances: ArrayLike) -> float:
    """How far the hand moves away from the target again: max_{k>j} (d_k − d_j), 0 at the least.

    The published figures call more than 0.01 of the way from start to target an overshoot.  In
    the unit of the distances.

    Example:
        >>> overshoot([1.0, 0.5, 0.0]), overshoot([1.0, 0.25, 0.5, 0.0])
        (0.0, 0.25)
    """
    profile = np.asarray(distances, dtype=np.float64)
    return float((profile - np.minimum.accumulate(profile)).max())


def episode_return(rewards: ArrayLike) -> float:
    """Sum of the rewards (steps,) of an episode, undiscounted."""
    return float(np.sum(np.asarray(rewards)))


def action_time(action_times: ArrayLike) -> float:
    """Median time that one `predict` took, for times (steps,), in their unit.

    The median, because now and then the operating system takes the processor away.  NaN for an
    episode without steps.
    """
    times = np.asarray(action_times)
    return float(np.median(times)) if times.size else math.nan
