"""Perturbations that are drawn when an episode begins: strengths from distributions, and mixtures.

An arm's own generator gives one uniform number for each strength, before it draws the trial; `ppf`
maps those of all arms at once.  One arm has numbers, k arms have arrays (k,) in their place, and
both go through the same code: so a vector of arms draws what single arms draw, bit for bit.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmc_gym._errors import require, require_numbers
from mmc_gym.envs.perturbations import (
    Cursor,
    Delay,
    Drawn,
    Feedback,
    Noise,
    Perturbation,
    Timed,
    drawn_fields,
    ends_of,
)

if TYPE_CHECKING:
    from mmc_gym.envs.names import Change, Family

Floats = NDArray[np.float64]
_SENSES = Noise | Cursor | Delay | Feedback | Timed
_MOST_CORNERS, _SAMPLES = 64, 16  # of the draws that are tried when an environment is made


class NoColumns(Exception):
    """The perturbations of many arms cannot be computed as arrays."""


class OneOf(Perturbation):
    """One of several perturbations, drawn for each episode; `None` is no change.

    Options that are drawn themselves, such as `VisuomotorRotation(uniform(-60, 120))`, are welcome.
    """

    def __init__(self, *options: Any, weights: Sequence[float] | None = None) -> None:
        """Take perturbations, their names or None, and their relative weights (equal if None)."""
        accepted = "at least two perturbations, names of them, or None"
        require(len(options) > 1, "OneOf", options, accepted)
        self.options = options
        accepted = f"{len(options)} numbers of at least 0, not all 0"
        self.weights = require_numbers(
            "weights",
            [1.0] * len(options) if weights is None else weights,
            accepted,
            lambda numbers: (
                len(numbers) == len(options) and min(numbers) >= 0 and 0 < sum(numbers) < np.inf
            ),
        )

    def __repr__(self) -> str:
        return f"OneOf({', '.join(map(repr, self.options))}, weights={self.weights})"

    def __eq__(self, other: object) -> bool:
        return type(other) is type(self) and vars(other) == vars(self)

    def __hash__(self) -> int:
        return hash((self.options, self.weights))

    def check_hooks(self) -> None:
        """Nothing to check: its options are checked by themselves."""

    def ppf(self, shares: Floats) -> Floats:
        """Return the numbers of the options at these quantiles."""
        borders = np.cumsum(self.weights) / np.sum(self.weights)
        return np.searchsorted(borders[:-1], shares, side="right").astype(np.float64)

    def support(self) -> tuple[float, float]:
        """Return the first and the last number."""
        return 0.0, len(self.options) - 1.0


class Strength(NamedTuple):
    """A number that is drawn for each episode."""

    name: str  #: in the context
    distribution: Any
    low: float  #: least value, and the greatest
    high: float
    chosen: tuple[int, int] | None  #: place of the choice among options it needs, and its value


@dataclass(frozen=True)
class Part:
    """A perturbation, and which of the drawn numbers are its fields."""

    perturbation: Perturbation
    family: Family | None  #: that makes it from its strength, if that has a range
    places: tuple[int, ...]  #: among the drawn numbers
    chosen: tuple[int, int] | None  #: as of `Strength`

    def make(self, numbers: Sequence[Any]) -> Perturbation:
        """Return it with these drawn numbers."""
        drawn, timed = [numbers[place] for place in self.places], self.perturbation
        one = timed.perturbation if isinstance(timed, Timed) else timed
        made = one
        if self.family is not None:
            made = self.family.make(drawn.pop(0))
        elif names := drawn_fields(one):
            made = replace(one, **{name: drawn.pop(0) for name in names})  # type: ignore[type-var]
        if isinstance(timed, Timed):
            own = {name: drawn.pop(0) for name in drawn_fields(timed)}
            return replace(timed, perturbation=made, **own)
        if self.places or self.chosen:
            vars(made)["known"] = False  # an agent is given its arm once
        return made


class Draws:
    """What is drawn for each episode."""

    def __init__(self, changes: Sequence[Change]) -> None:
        """Collect the drawn numbers of these perturbations."""
        self.strengths: list[Strength] = []
        self._parts: list[Part] = []
        for change in changes:
            one = change.perturbation
            if not isinstance(one, OneOf):
                self._add(change, None)
                continue
            place = self._number("choice", one, None)
            for number, option in enumerate(one.options):
                if option is not None:
                    self._add(option, (place, number))

    def _add(self, change: Change, chosen: tuple[int, int] | None) -> None:
        one, timed = change.untimed, change.perturbation
        require(not isinstance(one, OneOf), "OneOf", one, "without another OneOf in it")
        is_range = change.range is not None
        drawn = (
            []
            if is_range
            else [
                (f"{type(one).__name__}.{name}", getattr(one, name)) for name in drawn_fields(one)
            ]
        )
        if is_range and change.family is not None:
            drawn = [(change.family.name, change.range)]
        if timed is not one:
            drawn += [(f"Timed.{name}", getattr(timed, name)) for name in drawn_fields(timed)]
        places = tuple(self._number(name, value, chosen) for name, value in drawn)
        fine = not (change.known and "known" in vars(one)) or not (places or chosen)
        require(fine, "known", True, "False for what is drawn: agents are given their arm once")
        is_sense = bool(senses_of([one]))
        accepted = f"declared by {type(one).__name__}, as an option of OneOf"
        require(not (chosen and is_sense) or bool(one.neutral), "neutral", one.neutral, accepted)
        family = change.family if is_range else None
        self._parts.append(Part(timed, family, places, chosen))

    def _number(self, name: str, distribution: Any, chosen: tuple[int, int] | None) -> int:
        same = sum(one.name.partition("#")[0] == name for one in self.strengths)
        name = f"{name}#{same + 1}" if same else name
        self.strengths.append(Strength(name, distribution, *ends_of(distribution), chosen))
        return len(self.strengths) - 1

    def numbers(self, uniform: Floats) -> Floats:
        """Return what k arms draw, (k, m), from numbers that are uniform in [0, 1)."""
        drawn = np.empty_like(uniform)
        for place, one in enumerate(self.strengths):
            drawn[:, place] = np.clip(one.distribution.ppf(uniform[:, place]), one.low, one.high)
        return drawn

    def context(self, numbers: Floats) -> dict[str, Any]:
        """Return the numbers (..., m) by name; NaN where an option was not chosen."""
        context = {}
        for place, one in enumerate(self.strengths):
            shown = numbers[..., place]
            if one.chosen is not None:
                shown = np.where(numbers[..., one.chosen[0]] == one.chosen[1], shown, np.nan)
            context[one.name] = np.array(shown) if np.ndim(shown) else float(shown)
        return context

    def scaled(self, numbers: Floats) -> NDArray[np.float32]:
        """Return the context as it is observed, (..., m): within ±1, and 0 where not chosen."""
        low, high = np.array([[one.low, one.high] for one in self.strengths]).T
        width = np.where(high > low, high - low, 1.0)
        shown = np.clip(2 * (numbers - low) / width - 1, -1.0, 1.0)
        for place, one in enumerate(self.strengths):
            if one.chosen is not None:
                shown[..., place] *= numbers[..., one.chosen[0]] == one.chosen[1]
        return shown.astype(np.float32)

    def set(self, numbers: Floats, context: dict[str, Floats] | None) -> Floats:
        """Return the numbers, (k, m), with those of a context in their places."""
        for place, one in enumerate(self.strengths):
            given = (context or {}).get(one.name)
            if given is not None:
                numbers[:, place] = np.where(np.isnan(given), numbers[:, place], given)
        return numbers

    def perturbations(self, numbers: Floats) -> list[Perturbation]:
        """Return the perturbations of one arm, from (m,), or of k arms as arrays, from (k, m).

        Raises:
            NoColumns: if those of k arms cannot be computed as arrays.
        """
        is_one = numbers.ndim == 1
        columns = numbers.tolist() if is_one else [*np.ascontiguousarray(numbers.T).view(Drawn)]
        found = []
        for part in self._parts:
            is_chosen: Any = True
            if part.chosen is not None:
                is_chosen = columns[part.chosen[0]] == part.chosen[1]
            made = part.make(columns)
            has_neutral = bool((made.perturbation if isinstance(made, Timed) else made).neutral)
            if part.chosen is not None and has_neutral:
                found.append(made.grown(is_chosen * 1.0))
            elif part.chosen is None or (is_one and is_chosen):
                found.append(made)
            elif not is_one:
                raise NoColumns
        return found

    def samples(self) -> Floats:
        """Return rows of numbers that may be drawn, (n, m): the middle, extremes and others."""
        ends = [
            range(len(one.distribution.options))
            if isinstance(one.distribution, OneOf)
            else sorted({one.low, one.high})
            for one in self.strengths
        ]
        corners = np.array([*itertools.islice(itertools.product(*ends), 4 * _MOST_CORNERS)], float)
        random = np.random.default_rng(0)
        chosen = random.permutation(len(corners))[:_MOST_CORNERS]
        count = len(self.strengths)
        others = self.numbers(np.vstack([np.full(count, 0.5), random.random((_SAMPLES, count))]))
        return np.vstack([others, corners[chosen]])


def senses_of(perturbations: Sequence[Perturbation]) -> list[Perturbation]:
    """Return those that disturb the senses."""
    return [one for one in perturbations if isinstance(one, _SENSES)]


# Perturbations of many arms: every number in them an array


def of_many(one: Perturbation, count: int) -> Any:
    """Return a perturbation of `count` arms, all like `one`."""
    return _mapped(one, lambda value: np.full(count, value, np.float64))


def of_some(many: Any, arms: Any) -> Any:
    """Return the perturbations of some of the arms."""
    return _mapped(many, lambda value: value[arms])


def write(many: Any, arms: NDArray[np.intp], new: Any) -> None:
    """Write new perturbations, with numbers or arrays (k,), for k of the arms."""
    for name, value in vars(many).items():
        given = getattr(new, name)
        for to, given_one in zip(*_pairs(value, given), strict=True):
            if isinstance(to, np.ndarray):
                to[arms] = given_one
            elif isinstance(to, Perturbation):
                write(to, arms, given_one)


def _pairs(value: Any, given: Any) -> tuple[Any, Any]:
    return (value, given) if isinstance(value, tuple) else ((value,), (given,))


def _mapped(value: Any, change: Any) -> Any:
    """Return a copy in which each number, or array, is changed."""
    if isinstance(value, Perturbation):
        made = object.__new__(type(value))
        vars(made).update({name: _mapped(one, change) for name, one in vars(value).items()})
        if isinstance(value, Cursor) and "degrees" in vars(value):
            vars(made)["turn"] = _mapped(value.turn, change)
        return made
    if isinstance(value, tuple):
        return tuple(_mapped(one, change) for one in value)
    return change(value) if isinstance(value, float | np.ndarray) else value
