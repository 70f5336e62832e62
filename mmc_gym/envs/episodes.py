"""What each episode draws: strengths from distributions, options of mixtures, and the arms of them.

An arm's own generator gives one uniform number for each that is drawn, before it draws the trial;
`ppf` maps those of all arms at once.  One arm is a row, so a vector of arms draws what single arms
draw, bit for bit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmc_gym._errors import UserError, require
from mmc_gym.envs.arms import BODY, IN_FLIGHT, Arms, Floats
from mmc_gym.envs.changes import (
    AnyChange,
    Change,
    Direction,
    Distribution,
    Family,
    OneOf,
    ends_of,
)
from mmc_gym.envs.workspace import Point, uniform_numbers

if TYPE_CHECKING:
    from mmc_gym.body import ArmParameters

EXAMPLES = 5  # episodes that are shown of a scenario that draws
_CORNERS, _SAMPLES, _FEW = 64, 16, 20  # of the draws that are tried when an environment is made
_AT_LAST = 10**9  # control steps
Steps = Any  # control steps since the start, (n,); None: all that happens has its full strength


class Strength(NamedTuple):
    """A number that is drawn for each episode."""

    name: str  #: in the context
    distribution: Any
    low: float  #: least value, and the greatest
    high: float
    option: tuple[int, int] | None  #: place of the choice that it needs, and the chosen option
    whole: bool  #: whether only whole numbers are drawn: of a joint, or of an option


@dataclass(frozen=True, eq=False)
class Part:
    """A perturbation, and the places of its numbers among those that are drawn."""

    change: Change
    places: Mapping[str, int]  #: of drawn numbers, by their names in `Change.numbers`
    option: tuple[int, int] | None  #: as of `Strength`

    def numbers(self, drawn: Floats) -> dict[str, Any]:
        """Return the part's numbers, of arms that have drawn (n, m): (n,), or one for all."""
        return {
            name: drawn[:, self.places[name]] if name in self.places else number
            for name, number in self.change.numbers.items()
        }

    def is_chosen(self, drawn: Floats) -> NDArray[np.bool_]:
        """Return which arms have it, (n,)."""
        if self.option is None:
            return np.ones(len(drawn), dtype=bool)
        place, option = self.option
        return np.asarray(drawn[:, place] == option)

    def apply(self, arms: Arms, drawn: Floats, steps: Steps) -> None:
        """Change the arms that have drawn (n, m) to what they are after so many steps."""
        is_chosen, family = self.is_chosen(drawn), self.change.family
        if not is_chosen.any():  # of many options each arm has one
            return
        strength, at, over, until, *values = self.numbers(drawn).values()
        strengths = np.full(len(drawn), strength, dtype=np.float64)
        names = [name for name, _ in self.change.settings]
        settings = dict(zip(names, values, strict=True))
        if family.takes_times:
            settings |= {"at": at, "until": until}
        elif self.change.is_timed and steps is not None:
            share = _share_of(at, over, until, steps, arms.base.control_step)
            if family.neutral is not None:
                strengths = family.neutral + share * (strengths - family.neutral)
            is_chosen &= share > 0
        if is_chosen.all():
            family.apply(arms, strengths, **settings)
        elif is_chosen.any():
            places = np.flatnonzero(is_chosen)  # quicker than a mask
            rows, of_arms = arms.rows(places), [*settings.items()]
            for name, value in of_arms:
                settings[name] = value[places] if isinstance(value, np.ndarray) else value
            family.apply(rows, strengths[places], **settings)
            arms.write(places, rows)

    def spans(self, drawn: Floats, control_step: float) -> list[tuple[Any, Any]]:
        """Return first and last control steps between which it changes, each (n,) or a number."""
        _, at, over, until, *_ = self.numbers(drawn).values()
        first, end = _in_steps(at, control_step), _in_steps(until, control_step)
        return [(first, first + _in_steps(over, control_step)), (end, end)]


class Episodes:
    """The arms of all episodes: which perturbations they have, and what is drawn of them."""

    def __init__(
        self, changes: Sequence[AnyChange], arm: ArmParameters, start: Point | None = None
    ) -> None:
        """Collect the numbers that these perturbations of the arm draw.

        Raises:
            UserError: if a perturbation is not possible for this arm.
        """
        self.changes = tuple(changes)
        self.strengths: list[Strength] = []
        self.arm, self._plain = arm, Arms.of(arm, start)
        parts: list[Part] = []
        for change in changes:
            if isinstance(change, Change):
                parts.append(self._part(change, None))
                continue
            place = self._place("choice", change, None)
            options = enumerate(change.options)
            parts += [self._part(option, (place, number)) for number, option in options if option]
        self._touches = {part: self._find_touched(part) for part in parts}
        #: the columns of `Arms` that any of them overwrites
        self.touched: frozenset[str] = frozenset().union(*self._touches.values())
        self.given_body = self._given(parts)
        self._plain.given_lengths[:] = self.given_body.segment_lengths
        #: in the order in which they are applied: cursors need the lengths of the segments
        self.parts = sorted(parts, key=lambda part: "segment_lengths" not in self._touches[part])
        timed = [part for part in self.parts if part.change.is_timed]
        self._timed = [part for part in timed if not part.change.family.takes_times]
        #: columns that change within an episode
        self.in_flight: frozenset[str] = frozenset().union(*map(self.touches, self._timed))
        accepted = "such that the body changes within an episode by hand_mass and force_field only"
        names = [part.change.name for part in self._timed]
        require(self.in_flight <= IN_FLIGHT, "perturbations", names, accepted)

    @property
    def is_drawn(self) -> bool:
        """Whether anything is drawn."""
        return bool(self.strengths)

    @property
    def is_timed(self) -> bool:
        """Whether perturbations begin or grow within an episode."""
        return bool(self._timed)

    @property
    def draws_body(self) -> bool:
        """Whether the body may depend on what is drawn."""
        drawn = [part for part in self.parts if part.places or part.option]
        return any(self._touches[part] & BODY for part in drawn)

    def _part(self, change: Change, option: tuple[int, int] | None) -> Part:
        places = {
            name: self._place(name, number, option)
            for name, number in change.numbers.items()
            if isinstance(number, Distribution)
        }
        can_be_chosen = option is None or not change.known or change.family.is_given
        accepted = "False for what is drawn: agents are given their arm once"
        require(can_be_chosen, f"known of {change.name}", True, accepted)
        return Part(change, places, option)

    def _place(self, name: str, distribution: Any, option: tuple[int, int] | None) -> int:
        same = sum(strength.name.partition("#")[0] == name for strength in self.strengths)
        name = f"{name}#{same + 1}" if same else name
        if direction := getattr(distribution, "direction", None):  # stands before its strength
            self._place(f"{name}.direction", direction, option)
        are_whole = not (distribution.ppf(np.linspace(0.01, 0.99, 50)) % 1).any()
        whole = getattr(distribution, "whole", are_whole)
        self.strengths.append(Strength(name, distribution, *ends_of(distribution), option, whole))
        return len(self.strengths) - 1

    def _given(self, parts: Sequence[Part]) -> ArmParameters:
        """Return the arm that agents are given: with what is known of it, and what is not drawn."""
        arms, nothing = self._plain.rows([0]), np.zeros((1, len(self.strengths)))
        known = [part for part in parts if part.change.known and not (part.places or part.option)]
        for part in known:
            _apply(part, arms, nothing)
        return arms.parameters(frozenset().union(*(self._touches[part] for part in known)))

    def _find_touched(self, part: Part) -> set[str]:
        """Return the columns that a perturbation overwrites, at any of a few strengths.

        Arms with these strengths are changed one by one and together, which must be the same.
        """
        touched, rows, errors = set[str](), [], []
        family, name = part.change.family, part.change.name
        settings = {key: ends_of(value)[0] for key, value in part.change.settings}
        for strength in dict.fromkeys((*ends_of(part.change.strength), family.default)):
            arms = self._plain.rows([0])
            try:
                _call(family, arms, np.array([float(strength)]), settings)
                changed = arms.changed(self._plain)
                arms.check(changed)
                touched |= changed
                rows.append((float(strength), arms))
            except UserError as error:
                errors.append(error)
        if errors and not rows:
            raise UserError(f"{name} is not possible for this arm: {errors[0]}")
        accepted = f"one that overwrites columns of the arms at a strength of {family.default:g}"
        require(bool(touched), f"the perturbation {name}", family.apply, accepted)
        together = self._plain.rows(np.zeros(len(rows), dtype=np.intp))
        _call(family, together, np.array([strength for strength, _ in rows]), settings)
        for row, (_, arms) in enumerate(rows):
            differ = sorted(together.rows([row]).changed(arms))
            accepted = "one that changes each arm by its own strength alone"
            require(not differ, f"the perturbation {name}", differ, accepted)
        return touched

    def touches(self, part: Part) -> set[str]:
        """Return the columns that a part overwrites."""
        return self._touches[part]

    # Drawn numbers

    def numbers(self, uniform: Floats, before: Floats | None = None) -> Floats:
        """Return the m drawn numbers of k arms, (k, m), from uniform numbers in [0, 1), (k, m).

        What walks follows the numbers of the episodes `before`, (k, m); NaN before the first.
        """
        drawn = np.empty_like(uniform)
        for place, strength in enumerate(self.strengths):
            distribution, shares = strength.distribution, uniform[:, place]
            column = distribution.ppf(shares)
            if before is not None and hasattr(distribution, "after"):
                more: tuple[Floats, ...] = ()
                if isinstance(distribution, Direction):
                    more = (before[:, place + 1],)
                elif getattr(distribution, "direction", None):
                    more = (drawn[:, place - 1],)
                last = before[:, place]
                column = np.where(np.isnan(last), column, distribution.after(last, shares, *more))
            drawn[:, place] = np.clip(column, strength.low, strength.high)
        return drawn

    def context(self, numbers: Floats) -> dict[str, Any]:
        """Return the drawn numbers (..., m) by name; NaN where their option was not chosen."""
        context = {}
        for place, strength in enumerate(self.strengths):
            column = numbers[..., place]
            if strength.option is not None:
                choice, option = strength.option
                column = np.where(numbers[..., choice] == option, column, np.nan)
            context[strength.name] = np.array(column) if np.ndim(column) else float(column)
        return context

    def drawn(
        self,
        randoms: Sequence[np.random.Generator],
        context: Floats | None,
        before: Floats | None = None,
    ) -> Floats:
        """Return the numbers, (k, m), that k generators draw; those of a context replace them."""
        numbers = self.numbers(uniform_numbers(randoms, len(self.strengths)), before)
        return numbers if context is None else np.where(np.isnan(context), numbers, context)

    def is_like(self, other: Episodes) -> bool:
        """Return whether both draw numbers of the same names, perhaps from other distributions.

        Numbers that are not drawn must be equal.
        """
        kinds = [
            [
                (part.change.family, part.change.known, part.option, _fixed(part.change.numbers))
                for part in each.in_order
            ]
            for each in (self, other)
        ]
        names = [[strength.name for strength in each.strengths] for each in (self, other)]
        return kinds[0] == kinds[1] and names[0] == names[1]

    def samples(self) -> Floats:
        """Return rows of numbers that may be drawn, (n, m): the middle, extremes and others.

        Each option is among them, and each of a few whole numbers, such as those of the joints.
        """
        count, random = len(self.strengths), np.random.default_rng(0)
        others = self.numbers(np.vstack([np.full(count, 0.5), random.random((_SAMPLES, count))]))
        corners, single = np.empty((_CORNERS, count)), []
        for place, strength in enumerate(self.strengths):
            is_few = strength.high - strength.low <= _FEW and strength.whole
            ends = (
                np.arange(strength.low, strength.high + 1)
                if is_few
                else (strength.low, strength.high)
            )
            corners[:, place] = random.permutation(np.resize(ends, _CORNERS))
            for end in ends:
                single.append(others[0].copy())
                single[-1][place] = end
                if strength.option is not None:
                    single[-1][strength.option[0]] = strength.option[1]
        rows = dict.fromkeys(map(tuple, (*others, *single, *corners)))
        return np.array([*rows]).reshape(len(rows), count)

    # Arms

    def arms(self, numbers: Floats, steps: Steps = None) -> Arms:
        """Return the arms that have drawn numbers, (n, m), after so many control steps.

        Without steps, all that happens to them has its full strength.
        """
        arms = self._plain.rows(np.zeros(len(numbers), dtype=np.intp))
        for part in self.parts:
            _apply(part, arms, numbers, steps)
        return arms

    def changed_in(self, numbers: Floats, steps: Steps) -> NDArray[np.bool_]:
        """Return whether anything changed in the last of so many control steps, (n,)."""
        changed = np.zeros(len(numbers), dtype=bool)
        for part in self._timed:
            for first, last in part.spans(numbers, self.arm.control_step):
                changed |= (first <= steps) & (steps <= last)
        return changed

    def spans(self, numbers: Floats) -> list[tuple[int, int]]:
        """Return the first and last control steps in which something changes, of numbers (m,)."""
        parts = [part.spans(numbers[None], self.arm.control_step) for part in self._timed]
        ends = [(np.ravel(first)[0], np.ravel(last)[0]) for spans in parts for first, last in spans]
        return [(int(first), int(last)) for first, last in ends if first < _AT_LAST]

    def moments(self, numbers: Floats) -> NDArray[np.intp]:
        """Return sorted control steps, between which little changes for an arm, of numbers (m,)."""
        moments: set[int] = set()
        for first, last in self.spans(numbers):
            growing = np.linspace(first, last, min(last - first, 100) + 1).round()
            moments |= {first - 1, *growing.astype(int).tolist()}
        return np.array(sorted(moments or {0}))

    # The observed context

    def shown(self, numbers: Floats) -> NDArray[np.float32]:
        """Return the observed context, (..., c), of drawn numbers, (..., m).

        Strengths are scaled to ±1; those of an option that was not chosen are 0.  A choice becomes
        one number for each option but None: 1 if it was chosen, else 0.  The numbers may be those
        of other episodes that are alike.
        """

        def is_chosen(place: int, option: int) -> Any:
            return numbers[..., place] == option

        return self._shown(numbers, is_chosen)

    def shown_of(self, changes: Sequence[Change]) -> NDArray[np.float32]:
        """Return the observed context, (c,), of given perturbations; beyond the ranges, beyond ±1.

        A strength that no perturbation sets is the one that changes nothing, or else shown as 0.
        """
        low, high = np.array([[strength.low, strength.high] for strength in self.strengths]).T
        numbers, options = (low + high) / 2, set()
        left = [part for part in self.in_order if part.places or part.option]
        for part in left:
            if part.change.family.neutral is not None:
                for name in {part.change.family.name} & part.places.keys():
                    numbers[part.places[name]] = part.change.family.neutral
        for change in changes:
            fits = [part for part in left if _strength_in(part.change, change) is not None]
            if fits:
                part = min(fits, key=lambda part: _misfit(part.change, change))
                left.remove(part)
                options.add(part.option)
                values = {**change.numbers, change.family.name: _strength_in(part.change, change)}
                values[part.change.family.name] = values[change.family.name]
                for name, place in part.places.items():
                    numbers[place] = values.get(name, numbers[place])
        return self._shown(numbers, lambda *option: option in options)

    @property
    def in_order(self) -> list[Part]:
        """The parts in the order in which they were given."""
        return list(self._touches)

    def _shown(self, numbers: Floats, is_chosen: Callable[[int, int], Any]) -> NDArray[np.float32]:
        columns = []
        for place, strength in enumerate(self.strengths):
            if isinstance(strength.distribution, OneOf):
                options = enumerate(strength.distribution.options)
                columns += [1.0 * is_chosen(place, k) for k, option in options if option]
                continue
            share = (numbers[..., place] - strength.low) / ((strength.high - strength.low) or 1.0)
            columns.append(
                (2 * share - 1) * (is_chosen(*strength.option) if strength.option else 1.0)
            )
        return np.stack(columns, axis=-1).astype(np.float32)

    def drawn_changes(self, numbers: Floats) -> list[Change]:
        """Return the perturbations of an arm that has drawn numbers, (m,), none of them drawn."""
        drawn = numbers[None]
        return [
            _with_numbers(
                part.change, [float(np.ravel(x)[0]) for x in part.numbers(drawn).values()]
            )
            if part.places
            else part.change
            for part in self.in_order
            if part.is_chosen(drawn)[0]
        ]


def _call(family: Family, arms: Arms, strengths: Floats, settings: Mapping[str, Any]) -> None:
    """Call a family's function, which may be a user's; what it raises becomes a `UserError`."""
    try:
        family.apply(arms, strengths, **settings)
    except UserError:
        raise
    except Exception as error:
        count = f"{len(arms)} arms" if len(arms) > 1 else "an arm"
        reason = f"{type(error).__name__}: {error}"
        raise UserError(f"the function of {family.name} fails for {count}: {reason}") from error


def _share_of(at: Any, over: Any, until: Any, steps: Steps, control_step: float) -> Any:
    """Return the share (0 to 1) of the full strength of what begins `at` s and grows `over` s."""
    rise = _in_steps(over, control_step)
    since = steps - _in_steps(at, control_step) + (rise == 0)
    is_over = steps >= _in_steps(until, control_step)
    return np.where(is_over, 0.0, np.clip(since / np.maximum(rise, 1), 0.0, 1.0))


def _in_steps(seconds: Any, control_step: float) -> Any:
    """Return a time, or an array of times, in s as the nearest whole control steps."""
    return np.minimum(np.rint(np.divide(seconds, control_step)), _AT_LAST).astype(int)


def _apply(part: Part, arms: Arms, drawn: Floats, steps: Steps = None) -> None:
    """Apply a perturbation to arms; an error message names the perturbation."""
    try:
        part.apply(arms, drawn, steps)
    except UserError as error:
        raise UserError(f"{part.change.name} is not possible for this arm: {error}") from error


def _with_numbers(change: Change, numbers: Sequence[float]) -> Change:
    strength, at, over, until, *values = numbers
    names = [name for name, _ in change.settings]
    settings = tuple(zip(names, values, strict=True))
    return replace(change, strength=strength, at=at, over=over, until=until, settings=settings)


def _fixed(numbers: Mapping[str, Any]) -> dict[str, Any]:
    """Return the numbers that are not drawn."""
    return {name: value for name, value in numbers.items() if not isinstance(value, Distribution)}


def _strength_in(drawn: Change, change: Change) -> Any:
    """Return which strength in the family of `drawn` is the same as `change`; None if none is."""
    settings, drawn_settings = dict(change.settings), dict(drawn.settings)
    is_other = settings.keys() != drawn_settings.keys()
    if is_other or not _fixed(drawn_settings).items() <= settings.items():
        return None
    if change.family is drawn.family:
        return change.strength
    pair = {change.family.name, drawn.family.name}
    is_opposite = {change.family.opposite, drawn.family.opposite} & pair
    return -change.strength if is_opposite else None  # type: ignore[operator]


def _misfit(drawn: Change, change: Change) -> tuple[bool, float]:
    """Return whether a family is not that of a change, and how far its range misses a strength."""
    (low, high), strength = ends_of(drawn.strength), _strength_in(drawn, change)
    return drawn.family is not change.family, max(low - strength, strength - high, 0.0)
