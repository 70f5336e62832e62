"""Perturbations that are drawn when an episode begins: strengths from distributions, and mixtures.

An arm's own generator gives one uniform number for each strength, before it draws the trial; `ppf`
maps those of all arms at once.  One arm has numbers, k arms have arrays (k,) in their place, and
both go through the same code: so a vector of arms draws what single arms draw, bit for bit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmc_gym._errors import require
from mmc_gym.envs.names import Change, Family
from mmc_gym.envs.perturbations import (
    Cursor,
    Delay,
    Drawn,
    Feedback,
    Noise,
    OneOf,
    Perturbation,
    Timed,
    drawn_fields,
    ends_of,
)

Floats = NDArray[np.float64]
_SENSES = Noise | Cursor | Delay | Feedback | Timed
EXAMPLES = 5  # episodes that are shown of a scenario that draws
_CORNERS, _SAMPLES, _FEW = 64, 16, 20  # of the draws that are tried when an environment is made


class Strength(NamedTuple):
    """A number that is drawn for each episode."""

    name: str  #: in the context
    distribution: Any
    low: float  #: least value, and the greatest
    high: float
    chosen: tuple[int, int] | None  #: place of the choice among options it needs, and its value
    whole: bool  #: whether only whole numbers are drawn: of a joint, or of an option


@dataclass(frozen=True, eq=False)
class Part:
    """A perturbation, and the places of its fields among the drawn numbers."""

    perturbation: Perturbation
    family: Family | None  #: that makes it from its strength, if that has a range
    places: tuple[int, ...]  #: among the drawn numbers
    chosen: tuple[int, int] | None  #: as of `Strength`
    ends: tuple[float, float] = (0.0, 0.0)  #: of the family's range

    def make(self, numbers: Sequence[Any]) -> Perturbation:
        """Return the perturbation with these drawn numbers: m numbers, or m columns (k,)."""
        drawn, timed = [numbers[place] for place in self.places], self.perturbation
        one = _untimed(timed)
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

    @cached_property
    def is_alone(self) -> bool:
        """Whether no strength of it changes nothing: it is left out where it is not chosen."""
        return not _untimed(self.perturbation).neutral

    @cached_property
    def _ends(self) -> Any:
        """The perturbation at both ends of its range; without a range, itself twice."""
        one = _untimed(self.perturbation)
        return (one, one) if self.family is None else [*map(self.family.make, self.ends)]

    @cached_property
    def _varied(self) -> list[str]:
        """The names of the perturbation's fields that are drawn."""
        low, high = self._ends
        if self.family is None:
            return drawn_fields(low)
        return [name for name in _fields(low) if getattr(low, name) != getattr(high, name)]

    def _strength(self, name: str, value: Any) -> Any:
        """Return the drawn number that gives the field `name` this value."""
        if self.family is None or value is None:
            return value
        (low, high), (first, last) = self.ends, (getattr(one, name) for one in self._ends)
        return low + (high - low) * (value - first) / (last - first)

    def read(self, change: Change | None) -> list[float | None] | None:
        """Return the drawn numbers that make it the perturbation of `change`; None if none do.

        Without a change, return the numbers that change nothing, None in the place of one that
        always changes something.
        """
        if change is None:
            none = _untimed(self.perturbation).neutral
            numbers = [self._strength(name, none.get(name)) for name in self._varied]
            return numbers + [0.0] * (len(self.places) - len(numbers))
        one, low = change.untimed, self._ends[0]
        names = [name for name in _fields(low) if name not in self._varied]
        if self.family is not None and self.family is change.family:
            numbers = [change.strength]
        elif type(one) is type(low) and all(getattr(one, k) == getattr(low, k) for k in names):
            numbers = [self._strength(name, getattr(one, name)) for name in self._varied]
        else:
            return None
        timed = drawn_fields(self.perturbation) if isinstance(self.perturbation, Timed) else []
        return numbers + [getattr(change.perturbation, name, 0.0) for name in timed]


class Draws:
    """What is drawn for each episode."""

    def __init__(self, changes: Sequence[Change]) -> None:
        """Collect the drawn numbers of these perturbations."""
        self.strengths: list[Strength] = []
        self._parts: list[Part] = []
        self._alone: list[tuple[int, int]] = []  # options that arms cannot have as arrays
        self._unchanged: dict[Part, Perturbation] = {}  # of options that are not chosen
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
        if change.range is None:
            self._parts.append(Part(timed, None, places, chosen))
        else:
            ends = change.range.support()
            self._parts.append(Part(timed, change.family, places, chosen, ends))
        if chosen is not None and self._parts[-1].is_alone:
            self._alone.append(chosen)

    def _number(self, name: str, distribution: Any, chosen: tuple[int, int] | None) -> int:
        same = sum(one.name.partition("#")[0] == name for one in self.strengths)
        name = f"{name}#{same + 1}" if same else name
        are_whole = not (distribution.ppf(np.linspace(0.01, 0.99, 50)) % 1).any()
        whole = getattr(distribution, "whole", are_whole)
        self.strengths.append(Strength(name, distribution, *ends_of(distribution), chosen, whole))
        return len(self.strengths) - 1

    def is_like(self, other: Draws) -> bool:
        """Return whether both draw the same numbers, if from other distributions."""
        kinds = [
            [(type(_untimed(part.perturbation)), part.family, part.chosen) for part in draws._parts]
            for draws in (self, other)
        ]
        names = [[strength.name for strength in draws.strengths] for draws in (self, other)]
        return kinds[0] == kinds[1] and names[0] == names[1]

    def numbers(self, uniform: Floats) -> Floats:
        """Return the m drawn numbers of k arms, (k, m), from uniform numbers in [0, 1), (k, m)."""
        drawn = np.empty_like(uniform)
        for place, one in enumerate(self.strengths):
            drawn[:, place] = np.clip(one.distribution.ppf(uniform[:, place]), one.low, one.high)
        return drawn

    def context(self, numbers: Floats) -> dict[str, Any]:
        """Return the drawn numbers (..., m) by name; NaN where their option was not chosen."""
        context = {}
        for place, one in enumerate(self.strengths):
            shown = numbers[..., place]
            if one.chosen is not None:
                shown = np.where(numbers[..., one.chosen[0]] == one.chosen[1], shown, np.nan)
            context[one.name] = np.array(shown) if np.ndim(shown) else float(shown)
        return context

    def shown(self, numbers: Floats) -> NDArray[np.float32]:
        """Return the observed context, (..., c), of drawn numbers, (..., m).

        Strengths are scaled to ±1; those of an option that was not chosen are 0.  A choice becomes
        one number for each option but None: 1 if it was chosen, else 0.  The numbers may be those
        of other draws that are alike.
        """

        def is_chosen(place: int, option: int) -> Any:
            return numbers[..., place] == option

        return self._shown(numbers, is_chosen)

    def shown_of(self, changes: Sequence[Change]) -> NDArray[np.float32]:
        """Return the observed context, (c,), of given perturbations; beyond the ranges, beyond ±1.

        A strength that no perturbation sets is the one that changes nothing, or else shown as 0.
        """
        low, high = np.array([[one.low, one.high] for one in self.strengths]).T
        numbers, read = (low + high) / 2, [part.read(None) for part in self._parts]
        left = set(range(len(self._parts)))

        def misfit(index: int) -> tuple[bool, float]:
            part = self._parts[index]
            places = zip(part.places, found[index] or (), strict=True)
            beyond = [max(low[k] - x, x - high[k], 0.0) for k, x in places if x is not None]
            return part.family is not change.family, sum(beyond)

        for change in changes:
            found = {index: self._parts[index].read(change) for index in left}
            fit = [index for index in left if found[index] is not None]
            if fit:
                best = min(sorted(fit), key=misfit)
                left.remove(best)
                read[best] = found[best]
        chosen = {part.chosen for index, part in enumerate(self._parts) if index not in left}
        for part, of_part in zip(self._parts, read, strict=True):
            for place, number in zip(part.places, of_part or (), strict=True):
                numbers[place] = numbers[place] if number is None else number
        return self._shown(numbers, lambda *option: option in chosen)

    def _shown(self, numbers: Floats, is_chosen: Callable[[int, int], Any]) -> NDArray[np.float32]:
        columns = []
        for place, one in enumerate(self.strengths):
            if isinstance(one.distribution, OneOf):
                options = enumerate(one.distribution.options)
                columns += [1.0 * is_chosen(place, k) for k, option in options if option]
                continue
            share = (numbers[..., place] - one.low) / ((one.high - one.low) or 1.0)
            columns.append((2 * share - 1) * (is_chosen(*one.chosen) if one.chosen else 1.0))
        return np.stack(columns, axis=-1).astype(np.float32)

    def perturbations(self, numbers: Floats) -> list[Perturbation]:
        """Return the perturbations of an arm, from (m,), or of k arms as arrays, from (k, m).

        Of k arms, none may be alone, see `are_alone`.
        """
        is_one = numbers.ndim == 1
        columns = numbers.tolist() if is_one else [*np.ascontiguousarray(numbers.T).view(Drawn)]
        found = []
        for part in self._parts:
            is_chosen: Any = True
            if part.chosen is not None:
                is_chosen = columns[part.chosen[0]] == part.chosen[1]
            if part.chosen is not None and part.is_alone:
                if is_one and is_chosen:
                    found.append(part.make(columns))
            elif is_one and not is_chosen:
                if part not in self._unchanged:
                    self._unchanged[part] = part.make(columns).grown(0.0)
                found.append(self._unchanged[part])
            else:
                made = part.make(columns)
                found.append(made if part.chosen is None else made.grown(is_chosen * 1.0))
        return found

    @property
    def changes_body(self) -> bool:
        """Whether the body may depend on what is drawn."""
        kinds = [
            type(_untimed(one.perturbation)) for one in self._parts if one.places or one.chosen
        ]
        return any(kind.change_body is not Perturbation.change_body for kind in kinds)

    @property
    def may_be_alone(self) -> bool:
        """Whether a draw is possible that arrays of many arms cannot hold."""
        return bool(self._alone)

    def are_alone(self, numbers: Floats) -> NDArray[np.bool_]:
        """Return which of k arms, (k,), drew what arrays cannot hold, from their numbers (k, m)."""
        alone = np.zeros(len(numbers), dtype=bool)
        for place, option in self._alone:
            alone |= numbers[:, place] == option
        return alone

    def samples(self) -> Floats:
        """Return rows of numbers that may be drawn, (n, m): the middle, extremes and others.

        Each option is among them, and each of a few whole numbers, such as those of the joints.
        """
        count, random = len(self.strengths), np.random.default_rng(0)
        others = self.numbers(np.vstack([np.full(count, 0.5), random.random((_SAMPLES, count))]))
        corners, single = np.empty((_CORNERS, count)), []
        for place, one in enumerate(self.strengths):
            is_few = one.high - one.low <= _FEW and one.whole
            ends = np.arange(one.low, one.high + 1) if is_few else (one.low, one.high)
            corners[:, place] = random.permutation(np.resize(ends, _CORNERS))
            for end in ends:
                single.append(others[0].copy())
                single[-1][place] = end
                if one.chosen is not None:
                    single[-1][one.chosen[0]] = one.chosen[1]
        return np.array([*dict.fromkeys(map(tuple, np.vstack([others, single, corners])))])


def _untimed(one: Perturbation) -> Perturbation:
    return one.perturbation if isinstance(one, Timed) else one


def _fields(one: Perturbation) -> list[str]:
    """Return the names of the fields that say what a perturbation does."""
    return [name for name in vars(one) if name not in ("known", "turn")]


def senses_of(perturbations: Sequence[Perturbation]) -> list[Perturbation]:
    """Return the perturbations that disturb the senses."""
    return [one for one in perturbations if isinstance(one, _SENSES)]


# Perturbations of many arms: every number in them an array


def of_many(one: Perturbation, count: int) -> Any:
    """Return a perturbation whose fields are arrays (count,), all equal to those of `one`."""
    return _mapped(one, lambda value: np.full(count, value, np.float64))


def of_some(many: Any, arms: Any) -> Any:
    """Return a perturbation of many arms for some of them; a plain number is that of all arms."""
    return _mapped(many, lambda value: value[arms] if isinstance(value, np.ndarray) else value)


def write(many: Any, arms: NDArray[np.intp], new: Any) -> None:
    """Overwrite the fields of a perturbation of many arms, for k of them, by numbers or (k,)."""
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
    """Return a copy of a perturbation, with `change` applied to each number and array in it."""
    if isinstance(value, Perturbation):
        made = object.__new__(type(value))
        vars(made).update({name: _mapped(one, change) for name, one in vars(value).items()})
        if isinstance(value, Cursor) and "degrees" in vars(value):
            vars(made)["turn"] = _mapped(value.turn, change)
        return made
    if isinstance(value, tuple):
        return tuple(_mapped(one, change) for one in value)
    return change(value) if isinstance(value, float | np.ndarray) else value
