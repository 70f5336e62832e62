"""The cursor: what is seen, measured and rewarded in place of the hand."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from mmc_gym.envs.arms import Arms, Floats, Matrix

Place = tuple[Any, Any]  # (x, y): numbers, or arrays of one shape


class Cursor(NamedTuple):
    """The cursor of one arm, in numbers, or those of n arms, in arrays (n,).

    The hand is turned about a centre and shifted.  A clamp then sets the direction in which the
    cursor is from the centre, and a jump moves it aside.  What is None, no arm has.
    """

    centre: Place  #: where cursor and hand coincide
    turn: Matrix | None
    shift: Place
    clamp: Any  #: degrees from the direction of the target; NaN for an arm without a clamp
    clamp_turn: Place  #: cosine and sine of the clamp
    jump: Any  #: across the way to the target, as a share of the way
    jump_after: Any  #: share of the way after which the cursor jumps

    @classmethod
    def of(cls, arms: Arms, touched: frozenset[str]) -> Cursor:
        """Return the cursors of arms, given the names of the columns that perturbations touch."""
        has_clamp = "clamp" in touched
        return cls(
            _pair(arms.centre),
            (_pair(arms.turn[:, 0]), _pair(arms.turn[:, 1])) if touched & _LINEAR else None,
            _pair(arms.shift),
            arms.clamp if has_clamp else None,
            cosine_and_sine(arms.clamp) if has_clamp else (1.0, 0.0),
            arms.jump if "jump" in touched else None,
            arms.jump_after,
        )

    def rows(self, arms: Any) -> Cursor:
        """Return the cursors of some arms, given by indices, a mask or a slice."""
        return Cursor(*(_mapped(value, lambda column: column[arms]) for value in self))

    def row(self, row: int) -> Cursor:
        """Return the cursor of one of the arms, in numbers."""
        return Cursor(*(_mapped(value, lambda column: column[row].item()) for value in self))

    def at(self, x: Any, y: Any, target: Place) -> Place:
        """Return where the cursor is for a hand at (x, y) and a target (x, y)."""
        if self.turn is not None:
            x, y = self._turned(x, y)
        centre = self.centre
        if self.clamp is not None:
            along, across, _ = _direction(centre, target)
            _, _, away = _direction(centre, (x, y))
            cos, sin = self.clamp_turn
            clamped_x = centre[0] + away * (cos * along - sin * across)
            clamped_y = centre[1] + away * (sin * along + cos * across)
            is_free = np.isnan(self.clamp)
            x, y = np.where(is_free, x, clamped_x)[()], np.where(is_free, y, clamped_y)[()]
        if self.jump is not None:
            along, across, way = _direction(centre, target)
            covered = (x - centre[0]) * along + (y - centre[1]) * across
            jump = (covered >= self.jump_after * way) * self.jump * way
            x, y = x - jump * across, y + jump * along
        return x, y

    def hand(self, x: Any, y: Any) -> Place:
        """Return where the hand is for a cursor that shows a target at (x, y)."""
        if self.turn is None:
            return x, y
        ((a, b), (c, d)), centre, shift = self.turn, self.centre, self.shift
        x, y = x - centre[0] - shift[0], y - centre[1] - shift[1]
        area = a * d - b * c
        return centre[0] + (d * x - b * y) / area, centre[1] + (a * y - c * x) / area

    def farthest(self, reach: Any) -> Any:
        """Return a distance from the base that no cursor exceeds while the hand is in `reach`."""
        away, (x, y) = _length(*self.centre), self._turned(0.0, 0.0)
        farthest = reach if self.turn is None else self._stretch * reach + _length(x, y)
        if self.clamp is not None:
            farthest = np.where(np.isnan(self.clamp), farthest, farthest + 2 * away)
        return farthest if self.jump is None else farthest + np.abs(self.jump) * (away + reach)

    @property
    def turns_about_base(self) -> bool:
        """Whether all cursors are as far from the base as the hand."""
        is_centred = not np.any(self.centre) and not np.any(self.shift) and self.jump is None
        return is_centred and bool(np.all(self._stretch == 1.0))

    @property
    def _stretch(self) -> Any:
        """The largest factor by which turns and gains move the cursor from the centre."""
        if self.turn is None:
            return 1.0
        (a, b), (c, d) = self.turn
        stretch = (_length(a + d, c - b) + _length(a - d, c + b)) / 2  # the spectral norm
        return np.where(np.abs(stretch - 1.0) < 1e-12, 1.0, stretch)

    def _turned(self, x: Any, y: Any) -> Place:
        if self.turn is None:
            return x, y
        ((a, b), (c, d)), centre, shift = self.turn, self.centre, self.shift
        x, y = x - centre[0], y - centre[1]
        return centre[0] + a * x + b * y + shift[0], centre[1] + c * x + d * y + shift[1]


_LINEAR = {"turn", "shift"}
CURSOR = frozenset((*_LINEAR, "clamp", "jump"))
"""The columns of `Arms` that say what stands for the hand."""


def cosine_and_sine(degrees: Floats) -> tuple[Floats, Floats]:
    """Return cosines and sines, (n,), of angles in degrees, (n,).

    They are those of the C library: numpy's may differ with the length of the array.
    """
    angles, places = np.unique(degrees, return_inverse=True)  # few differ
    turns = [(math.cos(angle), math.sin(angle)) for angle in map(math.radians, angles.tolist())]
    cosines, sines = np.array(turns)[places].T
    return cosines, sines


def _direction(centre: Place, target: Place) -> tuple[Any, Any, Any]:
    """Return x and y of the unit vector from centre to target (0 if equal), and their distance."""
    x, y = target[0] - centre[0], target[1] - centre[1]
    way = _length(x, y)
    whole = way + (way == 0.0)
    return x / whole, y / whole, way


def _length(x: Any, y: Any) -> Any:
    return np.sqrt(x * x + y * y)  # rounds alike for numbers and arrays; `hypot` does not


def _pair(columns: Floats) -> Place:
    return columns[:, 0], columns[:, 1]


def _mapped(value: Any, change: Callable[[Any], Any]) -> Any:
    """Apply a function to each column in a value: a column, a tuple of some, or none."""
    if isinstance(value, tuple):
        return tuple(_mapped(part, change) for part in value)
    return change(value) if isinstance(value, np.ndarray) else value
