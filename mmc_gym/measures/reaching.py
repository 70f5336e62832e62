"""Measures of reaching: success, time, accuracy and rest at the target, and what it costs.

Pure functions of one movement.  `profiles` has those of its speed, `paths` those of its path, and
`measures.MEASURES` says how data and tables name them.  In all of them hand positions are
(steps + 1, 2) in segment lengths, the first before the first action; T is the control step in
seconds, ε the distance within which a target counts as reached.
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats: TypeAlias = NDArray[np.float64]


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


def success_with_dwell(distances: ArrayLike, tolerance: float, dwell_steps: int) -> float:
    """1 if the hand is within `tolerance` throughout the last `dwell_steps` steps, else 0.

    distance_j ≤ ε for j = n − dwell … n, n the last; `success_at_end` for a dwell of 0.  A hand
    that happens to pass when time is up does not count.

    Args:
        distances: from hand to target, segment lengths, (steps + 1,).
        tolerance: ε, segment lengths.
        dwell_steps: control steps; the whole of a shorter episode.

    Example:
        >>> (
        ...     success_with_dwell([1.0, 0.3, 0.04], 0.05, 0),
        ...     success_with_dwell([1.0, 0.3, 0.04], 0.05, 1),
        ... )
        (1.0, 0.0)
    """
    return float((np.asarray(distances)[-dwell_steps - 1 :] <= tolerance).all())


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


def settling_time(distances: ArrayLike, tolerance: float, control_step: float) -> float:
    """Seconds from the first time that the hand is within `tolerance` until it stays there.

    `time_to_target` less T · min{k : distance_k ≤ ε}: 0 for a hand that comes and stays, NaN for
    one that does not stay.

    Args:
        distances: from hand to target, segment lengths, (steps + 1,).
        tolerance: ε, segment lengths.
        control_step: T, seconds.

    Example:
        >>> settling_time([1.0, 0.0, 0.5, 0.04, 0.01], 0.05, 0.02)
        0.04
    """
    arrived = time_to_target(distances, tolerance, control_step)
    if math.isnan(arrived):
        return math.nan
    return arrived - int(np.argmax(np.asarray(distances) <= tolerance)) * control_step


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


def jitter(hands: ArrayLike, targets: ArrayLike, steps: int) -> float:
    """How much the hand trembles in the last `steps` steps: √(mean |e_k − ē|²), segment lengths.

    e_k is the hand seen from the target, ē its mean, so that neither an error that stays nor a
    target that moves counts.  The radius, for a hand that circles.

    Args:
        hands: positions, segment lengths, (steps + 1, 2).
        targets: at the same times, (steps + 1, 2).
        steps: control steps; the whole of a shorter episode.

    Example:
        >>> jitter([[5, 5], [0, 0], [2, 0], [0, 0], [2, 0]], np.zeros((5, 2)), 3)
        1.0
    """
    errors = (np.asarray(hands, dtype=np.float64) - np.asarray(targets))[-steps - 1 :]
    return float(np.sqrt(((errors - errors.mean(axis=0)) ** 2).sum(axis=-1).mean()))


def joint_effort(impulses: ArrayLike) -> float:
    """∫ Σ_i |τ_i| dt over all joints i, from each servo's impulses (steps, N), in their unit.

    Of the servos, mass · length² / s: see `mmc_gym.body.Arm`.  Holding still costs nothing
    in the horizontal plane.  NaN without joints, or where an engine does not tell.
    """
    values = np.asarray(impulses, dtype=np.float64)
    return float(values.sum()) if values.size else math.nan


def joint_work(work: ArrayLike) -> float:
    """∫ Σ_i |τ_i q̇_i| dt over all joints i, from each servo's work (steps, N), in its unit.

    Mass · length² / s²; braking counts as much as driving, as in muscles and in motors that do not
    feed back.  NaN without joints, or where an engine does not tell.

    Source:
        Absolute work as the cost of a reach: Alexander (1997), Biol. Cybern. 76, 97–105.
    """
    return joint_effort(work)


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


def slow_action_time(action_times: ArrayLike) -> float:
    """The time that one `predict` in a hundred exceeds, for times (steps,), in their unit.

    The 99th percentile: what a control loop must be prepared for.  NaN for an episode without
    steps.
    """
    times = np.asarray(action_times)
    return float(np.percentile(times, 99)) if times.size else math.nan
