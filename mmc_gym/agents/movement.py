"""Movements: when one begins, and how long it takes; for agents that plan or time them.

A movement begins with the episode, and wherever the target jumps.  It takes

    T = T₀ + d / v̄,     d the distance of the hand from the target at its beginning

Durations of reaching movements grow about linearly with their amplitude (for given accuracy and
medium amplitudes, Fitts's logarithm is nearly a line).  T₀ and v̄ are chosen for the arm: with them
a minimum-jerk movement of 3 segment lengths peaks at 6 lengths/s, half of what its servos can do,
and the longest there is, of 6, takes 1.7 s.

A target that moves on by less belongs to the same movement, which then goes on for at least
`HORIZON` more control steps, so that the hand pursues the target without haste, and noise in
seeing the target is smoothed.
"""

from __future__ import annotations

from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from mmc_gym.network.chain import Floats

SHORTEST = 0.2
"""T₀: duration of a movement that has nowhere to go, s."""
AVERAGE_SPEED = 4.0
"""v̄: growth of distance with duration, segment lengths/s."""
JUMP = 0.3
"""A target that moves farther than this in a control step has jumped, segment lengths."""
HORIZON = 5
"""Control steps that are left at least while the target moves on."""


class Movement(NamedTuple):
    """A movement under way.

    Attributes:
        target: segment lengths, (..., 2).
        elapsed: control steps since it began, (...).
        duration: T, control steps, (...).
    """

    target: Floats
    elapsed: Floats
    duration: Floats

    @property
    def remaining(self) -> Floats:
        """Control steps until it is over, 0 at the least, (...)."""
        return np.maximum(self.duration - self.elapsed, 0.0)


def begin(hand: Floats, target: Floats, control_step: float) -> Movement:
    """A movement that begins.

    Args:
        hand: segment lengths, (..., 2).
        target: segment lengths, (..., 2).
        control_step: s.

    >>> begin(np.array([1.0, 0.0]), np.array([3.0, 0.0]), control_step=0.02).duration.item()
    35.0
    """
    way = target - hand
    distance = np.hypot(way[..., 0], way[..., 1])
    duration = np.ceil((SHORTEST + distance / AVERAGE_SPEED) / control_step - 1e-9)
    return Movement(target, np.zeros_like(duration), duration)


def follow(movement: Movement, hand: Floats, target: Floats, control_step: float) -> Movement:
    """The movement to where the target is now: a new one if it has jumped.

    Args:
        movement: under way.
        hand: where a new movement would begin, segment lengths, (..., 2).
        target: segment lengths, (..., 2).
        control_step: s.
    """
    shift = target - movement.target
    moved = np.hypot(shift[..., 0], shift[..., 1])
    if not moved.any():
        return movement
    longer = np.where(moved > 0, movement.elapsed + HORIZON, 0.0)
    same = Movement(target, movement.elapsed, np.maximum(movement.duration, longer))
    return where(moved > JUMP, begin(hand, target, control_step), same)


def step(movement: Movement) -> Movement:
    """The movement one control step later."""
    return movement._replace(elapsed=movement.elapsed + 1.0)


Arrays = TypeVar("Arrays", bound="tuple[Floats, ...]")


def where(condition: NDArray[np.bool_], yes: Arrays, no: Arrays) -> Arrays:
    """A named tuple of arrays, from `yes` where a condition on the batch holds, else from `no`."""

    def chosen(first: Floats, second: Floats) -> Floats:
        trailing = (1,) * (np.ndim(first) - np.ndim(condition))
        return np.where(np.reshape(condition, (*np.shape(condition), *trailing)), first, second)

    return type(yes)(*map(chosen, yes, no))
