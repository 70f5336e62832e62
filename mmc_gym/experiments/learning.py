"""Measures of movements over trials, from plain arrays: your own data fit in as well.

Paths are (..., time, 2); leading axes are subjects, trials or resamples.  Angles are in degrees, as
in the literature, positive to the left.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mmc_gym.measures.episode import Floats

ONSET = 0.05  # share of the peak speed at which a movement begins


def initial_direction(paths: ArrayLike, targets: ArrayLike, *, steps: int | None = None) -> Floats:
    """Return the direction of the hand less that of the target, degrees.

    Both are seen from the start of the movement; in (−180, 180], NaN for a hand that never moves
    and for a target at the start.

    Args:
        paths: of hand or cursor, (..., time, 2), in any unit of length.
        targets: (..., 2).
        steps: when the hand is looked at, steps of time after `movement_onset`, so that feedback
            has not changed it yet.  None: at its peak speed.

    Source: Krakauer, Pine, Ghilardi & Ghez (2000), J. Neurosci. 20, 8916–8924.
    """
    hand, aim = _early(paths, targets, steps)
    return _angle_between(aim, hand)


def lateral_deviation(paths: ArrayLike, targets: ArrayLike) -> Floats:
    """Return how far the hand is to the left of the line from start to target at its peak speed.

    In the unit of `paths`; for arguments and NaN see `initial_direction`.
    """
    hand, aim = _early(paths, targets, None)
    way = np.linalg.norm(aim, axis=-1)
    return np.asarray(_cross(aim, hand) / np.where(way > 0, way, math.nan))


def movement_onset(paths: ArrayLike) -> NDArray[np.int64]:
    """Return the step of time (...) before the speed of paths (..., time, 2) first is 5 % of peak.

    0 for a hand that never moves.
    """
    return _onset(_steps(np.asarray(paths, dtype=np.float64)))


def describe_movements(
    hands: ArrayLike,
    cursors: ArrayLike,
    targets: ArrayLike,
    *,
    go_steps: ArrayLike,
    control_step: float,
    early: float,
    tolerance: float,
) -> dict[str, NDArray[Any]]:
    """Return the dependent variables of movements by name, (...) each; NaN for a hand at rest.

    - hand_angle and cursor_error: direction of hand and cursor at the hand's peak speed, less that
      of the target, degrees; early_hand_angle: the hand's, `early` seconds after onset.
    - reaction_time: from the go cue to onset, where the speed is 5 % of its peak; movement_time:
      from there until it is less again, after the peak; seconds.
    - peak_speed: segment lengths a second.
    - largest_deviation: of the hand from the line from start to target, to the left; segment
      lengths.
    - end_error: distance of cursor and target at the end, segment lengths; success: whether it is
      within `tolerance`.

    Args:
        hands: (..., time, 2), segment lengths.
        cursors: likewise; the hand's where there is none.
        targets: likewise; directions are measured to the first one after the go cue.
        go_steps: when the go cue is, control steps after the start, (...).
        control_step: seconds.
        early: seconds.
        tolerance: segment lengths.
    """
    hand, cursor, target = (np.asarray(paths, np.float64) for paths in (hands, cursors, targets))
    steps, go = _steps(hand), np.asarray(go_steps)[..., None]
    steps = np.where(np.arange(steps.shape[-1]) >= go, steps, 0.0)
    peak, fastest = steps.max(axis=-1), np.argmax(steps, axis=-1)
    onset, last = _onset(steps), steps.shape[-1]
    slow = (steps < ONSET * peak[..., None]) & (np.arange(last) > fastest[..., None])
    end = np.where(slow.any(axis=-1), np.argmax(slow, axis=-1), last)
    aim = _positions(target, np.minimum(go[..., 0] + 1, last))
    later = np.minimum(onset + round(early / control_step), last)

    def direction(path: Floats, step: NDArray[np.int64]) -> Floats:
        return _angle_between(aim - path[..., 0, :], _positions(path, step) - path[..., 0, :])

    way = aim - hand[..., 0, :]
    left = _cross(way[..., None, :], hand - hand[..., :1, :])
    farthest = np.take_along_axis(left, np.argmax(np.abs(left), axis=-1)[..., None], axis=-1)
    with np.errstate(invalid="ignore", divide="ignore"):
        deviation = farthest[..., 0] / np.linalg.norm(way, axis=-1)
    end_error = np.linalg.norm(cursor[..., -1, :] - target[..., -1, :], axis=-1)
    measures = {
        "hand_angle": direction(hand, fastest + 1),
        "early_hand_angle": direction(hand, later),
        "cursor_error": direction(cursor, fastest + 1),
        "reaction_time": (onset - go[..., 0]) * control_step,
        "movement_time": (end - onset) * control_step,
        "peak_speed": peak / control_step,
        "largest_deviation": deviation,
    }
    measures = {name: np.where(peak > 0, values, math.nan) for name, values in measures.items()}
    return {**measures, "end_error": end_error, "success": end_error <= tolerance}


def _steps(paths: Floats) -> Floats:
    return np.asarray(np.linalg.norm(np.diff(paths, axis=-2), axis=-1))


def _onset(steps: Floats) -> NDArray[np.int64]:
    return np.argmax(steps >= ONSET * steps.max(axis=-1, keepdims=True), axis=-1)


def _positions(paths: Floats, steps: NDArray[np.int64]) -> Floats:
    """Return where paths (..., time, 2) are at a step of each, (...)."""
    return np.take_along_axis(paths, steps[..., None, None], axis=-2)[..., 0, :]


def _angle_between(aim: Floats, hand: Floats) -> Floats:
    """Return the direction of the hand less that of the aim, degrees; NaN without an aim."""
    turns = np.degrees(np.arctan2(_cross(aim, hand), (aim * hand).sum(axis=-1)))
    return np.asarray(np.where(aim.any(axis=-1), turns, math.nan))


def _early(paths: ArrayLike, targets: ArrayLike, after: int | None) -> tuple[Floats, Floats]:
    """Return from the start the hand after its fastest step, or `after` onset, and the target."""
    hands = np.asarray(paths, dtype=np.float64)
    if hands.shape[-2] < 2:  # it never moves
        hands = np.full((*hands.shape[:-2], 2, 2), math.nan)
    steps = _steps(hands)
    at = np.argmax(steps, axis=-1) + 1
    if after is not None:
        at = np.minimum(_onset(steps) + after, hands.shape[-2] - 1)
    hand = _positions(hands, at) - hands[..., 0, :]
    moves = steps.max(axis=-1, keepdims=True) > 0
    return np.where(moves, hand, math.nan), np.asarray(targets) - hands[..., 0, :]


def _cross(first: Floats, second: Floats) -> Floats:
    return np.asarray(first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0])


def correction_gain(response: ArrayLike, jump: float) -> Floats:
    """Return which share of a jump in flight the hand has corrected at the end.

    The response is the mean path with the jump less that without, along the full correction,
    (..., time), and `jump` the size of the jump, in the same unit.  NaN for a jump of 0.

    Source: Veyrat-Masson, Brière & Proteau (2010), J. Vision 10(14), 27.
    """
    ends = np.asarray(response, dtype=np.float64)[..., -1:].sum(axis=-1)
    return np.asarray(ends / (jump if jump and np.size(response) else math.nan))


def correction_latency(
    response: ArrayLike, jump: float, jump_time: float, control_step: float
) -> float:
    """Return the seconds from a jump in flight until the mean path responds.

    A line through the points where the response's acceleration first has 25 % and 75 % of its peak
    is extended to 0, so that a strong response does not count as an early one (Oostwoud Wijdenes,
    Brenner & Smeets 2014, Behav. Res. Methods 46).  NaN if the response never is 1 % of the jump in
    its direction, is not known throughout, or ends before the jump.

    The response, (time,), and the jump are those of `correction_gain`; `jump_time` is in seconds
    after the first position.
    """
    path = np.asarray(response, dtype=np.float64)
    is_response = len(path) > 2 and path.max() >= 0.01 * jump > 0  # False with NaN, as the next one
    if not (is_response and jump_time < len(path) * control_step):
        return math.nan
    accelerations = np.diff(path, 2)  # centred at the times control_step, 2 control_step, …
    accelerations[: max(0, math.ceil(jump_time / control_step) - 1)] = 0.0
    rise = np.maximum.accumulate(accelerations[: np.argmax(accelerations) + 1])
    if not rise[-1] > 0:
        return math.nan
    times = (np.arange(len(rise)) + 1) * control_step
    quarter, three_quarters = np.interp([0.25 * rise[-1], 0.75 * rise[-1]], rise, times)
    return max(0.0, float(quarter - (three_quarters - quarter) / 2) - jump_time)
