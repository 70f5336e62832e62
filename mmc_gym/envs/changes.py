"""Perturbations as values: families, strengths, distributions of them, times and mixtures."""

from __future__ import annotations

import inspect
import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib import import_module
from typing import Any, Literal, Protocol, TypeAlias, runtime_checkable

import numpy as np

from mmc_gym._errors import (
    LONGEST,
    UserError,
    require,
    require_between,
    require_choice,
    require_known,
    require_number,
    require_numbers,
)


@runtime_checkable
class Distribution(Protocol):
    """A distribution of numbers, such as a frozen one of scipy.stats."""

    def ppf(self, q: Any, /) -> Any:
        """Return the numbers at the quantiles `q` (0 to 1), in the same shape."""

    def support(self) -> tuple[float, float]:
        """Return the least and the greatest number."""


@dataclass(frozen=True)
class Range:
    """A range of strengths, uniformly distributed."""

    low: float
    high: float
    whole: bool = False  #: whether only whole numbers are drawn

    def support(self) -> tuple[float, float]:
        """Return the least and the greatest strength."""
        return self.low, self.high

    def ppf(self, shares: Any) -> Any:
        """Return the strengths at the quantiles `shares` (0 to 1), in the same shape."""
        if self.whole:
            return np.minimum(self.low + np.floor((self.high - self.low + 1) * shares), self.high)
        return self.low + (self.high - self.low) * shares


@dataclass(frozen=True)
class Walk:
    """A strength that changes from an arm's episode to its next, so that tasks are not stationary.

    The first is uniformly distributed, and so is that of an episode with a seed of its own.  The
    changes are those of the Real-World RL suite (Dulac-Arnold et al. 2021, Machine Learning
    110:2419): normally distributed ("walk"), or their size, upward ("drift"), from the end back to
    the beginning ("cycle"), or from either end back toward the other ("saw").  A negative `step`
    leads downward.
    """

    low: float
    high: float
    step: float  #: standard deviation of a change
    kind: Literal["walk", "drift", "cycle", "saw"] = "walk"

    def __post_init__(self) -> None:
        require_choice("kind", self.kind, ("walk", "drift", "cycle", "saw"))
        for name in ("low", "high", "step"):
            require_number(name, getattr(self, name), "a finite number")
        require(self.low < self.high, "high", self.high, f"higher than {self.low:g}")

    def support(self) -> tuple[float, float]:
        """Return the least and the greatest strength."""
        return self.low, self.high

    def ppf(self, shares: Any) -> Any:
        """Return the first strengths at the quantiles `shares` (0 to 1), in the same shape."""
        return self.low + (self.high - self.low) * shares

    @property
    def direction(self) -> Direction | None:
        """The second number of a saw, which says where it is heading; None of other walks."""
        is_saw = self.kind == "saw"
        return Direction(self.low, self.high, math.copysign(1, self.step)) if is_saw else None

    def after(self, before: Any, shares: Any, direction: Any = None) -> Any:
        """Return the strengths that follow those before, at the quantiles of the changes, (n,).

        A saw heads upward where `direction` is 1, and downward where it is -1.
        """
        from scipy.special import ndtri  # `import mmc_gym` loads no scipy

        change = self.step * ndtri(np.clip(shares, 1e-12, 1 - 1e-12))
        if self.kind != "walk":
            change = np.copysign(change, self.step if direction is None else direction)
        strengths = before + change
        if self.kind == "cycle":
            is_over = (strengths >= self.high) if self.step > 0 else (strengths <= self.low)
            strengths = np.where(is_over, self.low if self.step > 0 else self.high, strengths)
        return np.clip(strengths, self.low, self.high)


@dataclass(frozen=True)
class Direction:
    """The number that says where a saw is heading: upward (1) or downward (-1)."""

    low: float  #: strength at which it turns upward
    high: float  #: strength at which it turns downward
    first: float  #: direction of the first episode

    def support(self) -> tuple[float, float]:
        """Return the least and the greatest direction."""
        return -1.0, 1.0

    def ppf(self, shares: Any) -> Any:
        """Return the first directions, in the shape of `shares`."""
        return np.full_like(shares, self.first, dtype=np.float64)

    def after(self, before: Any, shares: Any, strengths: Any) -> Any:
        """Return the directions that follow those of the episode before and its strengths, (n,)."""
        downward = np.where(strengths >= self.high, -1.0, before)
        return np.where(strengths <= self.low, 1.0, downward)


@dataclass(frozen=True)
class InUnits:
    """A distribution in other units: `offset + factor · number`, with a positive factor."""

    distribution: Distribution
    factor: float
    offset: float = 0.0

    def support(self) -> tuple[float, float]:
        """Return the least and the greatest number."""
        low, high = self.distribution.support()
        return self.offset + self.factor * low, self.offset + self.factor * high

    def ppf(self, shares: Any) -> Any:
        """Return the numbers at the quantiles `shares` (0 to 1), in the same shape."""
        return self.offset + self.factor * self.distribution.ppf(shares)

    @property
    def direction(self) -> Direction | None:
        """As of `Walk`, between ends in these units."""
        direction = getattr(self.distribution, "direction", None)
        return direction and Direction(*self.support(), direction.first)

    def after(self, before: Any, shares: Any, direction: Any = None) -> Any:
        """Return the numbers of an episode, given those of the one before, see `Walk`."""
        after = getattr(self.distribution, "after", None)
        if after is None:
            return self.ppf(shares)
        numbers = after((before - self.offset) / self.factor, shares, direction)
        return self.offset + self.factor * numbers


def ends_of(number: Any) -> tuple[float, float]:
    """Return the least and greatest value; for an infinite tail, its quantile at 1e-6."""
    if not isinstance(number, Distribution):
        return number, number
    ends = zip(number.support(), (1e-6, 1 - 1e-6), strict=True)
    low, high = (float(end if np.isfinite(end) else number.ppf(tail)) for end, tail in ends)
    return low, high


_ENDINGS = {"of": "-of-", "steps": "-for-"}  # of names, by arguments of the family's function


@dataclass(frozen=True)
class Family:
    """Perturbations of one kind, which differ in strength.

    Called with a strength, it returns a `Change`.
    """

    name: str  #: the first part of their names, words with hyphens
    unit: str  #: of the strength
    description: str  #: of a scenario, one line; `{}` stands for the strength
    default: float  #: strength of a name without one
    #: overwrites columns of `Arms`, given strengths (n,) and what else the function takes
    apply: Callable[..., None] = field(compare=False)
    neutral: float | None = None  #: strength that changes nothing; None: it cannot grow
    low: float = -math.inf  #: least strength
    high: float = math.inf  #: greatest strength
    whole: bool = False  #: whether strengths are whole numbers: the number of a joint, or a count
    begins: bool = True  #: whether it may begin within an episode
    known: bool = False  #: whether agents can be given the change (`-known`)
    is_given: bool = False  #: whether agents are always given it
    has_strength: bool = True  #: if not, there is one perturbation, without a number
    opposite: str = ""  #: name of the family whose negative strengths are this one's
    group: str = ""  #: one of `GROUPS`; empty for one of your own
    of: str = ""  #: what its function's argument `of` counts (`-of-`), such as "motor"

    def __call__(
        self,
        strength: float | Distribution | None = None,
        *,
        at: float | Distribution = 0.0,
        over: float | Distribution = 0.0,
        until: float | Distribution = math.inf,
        known: bool = False,
        **settings: Any,
    ) -> Change:
        """Return the perturbation of a strength; see `Change` for the arguments.

        The strength may be named as the family's function names it.
        """
        _, strength_name, *others = inspect.signature(self.apply).parameters
        for word, ending in _ENDINGS.items():
            can_have = word in others or word not in settings
            require(can_have, f"{self.name}{ending}", settings.get(word), f"without {ending}")
        names = (strength_name, "strength", *others, "at", "over", "until", "known")
        require_known(self.name, settings, names)
        strength = settings.pop(strength_name, strength)
        number = self.default if strength is None else strength
        return Change(self, number, at, over, until, known, tuple(sorted(settings.items())))

    @property
    def endings(self) -> tuple[str, ...]:
        """The endings that its names may have besides those of times: "-of-", "-for-", "-known"."""
        words = inspect.signature(self.apply).parameters
        endings = [ending for word, ending in _ENDINGS.items() if word in words]
        return (*endings, "-known") if self.known else tuple(endings)

    @cached_property
    def takes_times(self) -> bool:
        """Whether its function takes the times, and sees to them, as those of locks do."""
        return {"at", "until"} <= inspect.signature(self.apply).parameters.keys()

    def __repr__(self) -> str:
        return f"<Family {self.name}>"

    def __reduce_ex__(self, protocol: Any) -> Any:
        """Pickle a family as what its module calls it; the function alone has no name there."""
        module, name = self.apply.__module__, self.apply.__qualname__
        if module != "__main__" and getattr(sys.modules.get(module), name, None) is self:
            return _find, (module, name)
        return super().__reduce_ex__(protocol)

    def _require(self, name: str, strength: Any) -> None:
        accepted = f"from {self.low:g} to {self.high:g}"
        if self.low == -math.inf:
            accepted = "a finite number" if self.high == math.inf else f"at most {self.high:g}"
        elif self.high == math.inf:
            accepted = f"at least {self.low:g}"
        if self.whole:
            accepted = f"a whole number{f' {accepted}' if self.high < math.inf else ' from 1 on'}"

        def is_accepted(number: float) -> bool:
            is_within = math.isfinite(number) and self.low <= number <= self.high
            return is_within and not (self.whole and number % 1)

        require_number(name, strength, accepted, is_accepted)


@dataclass(frozen=True)
class Change:
    """A family of perturbations at a strength, from a time on.

    Each number may be a distribution, from which every episode draws.  From no change at `at` it
    grows linearly to its strength for `over` s, and ends at `until`.  Drawn targets stay in reach.
    People correct for a change within the movement (Crevecoeur, Thonnard & Lefèvre 2020, eNeuro 7).
    """

    family: Family
    strength: float | Distribution
    at: float | Distribution = 0.0  #: when it begins, s after the start, rounded to control steps
    over: float | Distribution = 0.0  #: how long it grows, s, also rounded; 0: not at all
    until: float | Distribution = math.inf  #: when it ends, s after the start, also rounded
    known: bool = False  #: whether agents are given the changed body
    settings: tuple[tuple[str, Any], ...] = ()  #: more arguments of the family's function

    def __post_init__(self) -> None:
        family, name = self.family, self.family.name
        if family.is_given:
            object.__setattr__(self, "known", True)
        if self.known and not (family.known or family.is_given):
            raise UserError(f"{name} cannot be known: agents are given changes of the body only")
        if not family.has_strength and self.strength != family.default:
            raise UserError(f"{name} takes no strength, got {digits(self.strength)}")
        if isinstance(self.strength, Range):
            is_range = self.strength.low <= self.strength.high
            accepted = "from a low to a strength that is not lower"
            require(is_range, f"the range of {name}", digits(self.strength), accepted)
        for strength in ends_of(self.strength):
            family._require(f"the strength of {name}", strength)
        if not isinstance(self.strength, Distribution):
            object.__setattr__(self, "strength", float(self.strength))
        elif family.whole:
            strengths = np.asarray(self.strength.ppf(np.linspace(0.01, 0.99, 50)))
            accepted = "a distribution of whole numbers, such as scipy.stats.randint(1, 4)"
            require(not (strengths % 1).any(), f"the strength of {name}", self.strength, accepted)
        for time, seconds in (("at", self.at), ("over", self.over), ("until", self.until)):
            never_ends = time == "until" and seconds == math.inf
            for end in () if never_ends else ends_of(seconds):
                require_between(0, LONGEST, **{time: end})
        settings = [pair for pair in self.settings if pair != ("of", None)]
        object.__setattr__(self, "settings", tuple(settings))
        for setting, number in settings:
            for end in ends_of(number) if setting in ("of", "steps") else ():
                require_number(f"{setting} of {name}", end, "a finite number")
        begins, (ends, _) = ends_of(self.at)[1] + ends_of(self.over)[1], ends_of(self.until)
        require(ends > begins, "until", ends, f"later than it has begun and grown, at {begins:g} s")
        accepted = "a perturbation that can begin within an episode (cursors, motors, senses, "
        accepted += "locks, loads, force fields)"
        words = "what has -at-, -over- or -until-"
        require(not self.is_timed or family.begins, words, name, accepted)
        can_grow = family.neutral is not None
        require(self.over == 0.0 or can_grow, "over", self.over, f"0, as {name} cannot grow")
        accepted = "False for what is drawn: agents are given their arm once"
        is_given_once = not (self.known and family.known and self.is_drawn)
        require(is_given_once, f"known of {name}", True, accepted)

    def __repr__(self) -> str:
        return f"<Change {self.name}>"

    @property
    def is_timed(self) -> bool:
        """Whether it begins, grows or ends within an episode."""
        return bool(self._timing)

    @property
    def numbers(self) -> dict[str, Any]:
        """All numbers, any of which may be drawn, by their names in a context."""
        more = {"at": self.at, "over": self.over, "until": self.until, **dict(self.settings)}
        name = self.family.name
        return {name: self.strength, **{f"{name}.{key}": value for key, value in more.items()}}

    @property
    def is_drawn(self) -> bool:
        """Whether each episode draws a number of its own."""
        return any(isinstance(number, Distribution) for number in self.numbers.values())

    @property
    def range(self) -> Range | None:
        """The range of strengths that each episode draws from, if there is one."""
        return self.strength if isinstance(self.strength, Range) else None

    @property
    def number(self) -> float | None:
        """The strength, comparable within the family; None if it is drawn."""
        return None if isinstance(self.strength, Distribution) else self.strength

    @property
    def unit(self) -> str:
        """The unit of the strength."""
        return self.family.unit

    @property
    def is_named(self) -> bool:
        """Whether its name says all of it, so that a file can hold it."""
        is_distribution = isinstance(self.strength, Distribution) and self.range is None
        numbers = [*dict(self.settings).values(), *(seconds for _, seconds in self._timing)]
        is_drawn = any(isinstance(number, Distribution) for number in numbers)
        return not (self._unnamed or is_distribution or is_drawn)

    @property
    def name(self) -> str:
        """The name for people and files: "longer-35-known"."""
        number = f"-{digits(self.strength)}" if self.family.has_strength else ""
        more = ",".join(f"{key}={value}" for key, value in self._unnamed)
        return f"{self.family.name}{number}{self.suffix}{f'({more})' if more else ''}"

    @property
    def of(self) -> Any:
        """The number, from the base, of the joint, segment or motor that it changes; or None."""
        return dict(self.settings).get("of")

    @property
    def _unnamed(self) -> list[tuple[str, Any]]:
        """The settings that a name has no words for."""
        return [(name, value) for name, value in self.settings if name not in ("of", "steps")]

    @property
    def suffix(self) -> str:
        """The end of the name, after the strength: "-at-1-over-2", "-known", or empty."""
        words = {"of": "of", "steps": "for"}
        named = [(words[name], value) for name, value in self.settings if name in words]
        timing = "".join(f"-{word}-{digits(value)}" for word, value in named)
        timing += "".join(f"-{word}-{digits(seconds)}" for word, seconds in self._timing)
        return timing + ("-known" if self.known and self.family.known else "")

    @property
    def _timing(self) -> list[tuple[str, Any]]:
        """The pairs ("at", s), ("over", s) and ("until", s), without those that change nothing."""
        timing = (("at", self.at, 0.0), ("over", self.over, 0.0), ("until", self.until, math.inf))
        return [(word, seconds) for word, seconds, never in timing if seconds != never]

    @property
    def description(self) -> str:
        """One line that says what changes, and when."""
        text = self.family.description.format(digits(self.strength))
        parts = [text.removesuffix(" from the start") if self.at else text]
        if self.of is not None:
            parts[0] = parts[0].replace("last segment", "a segment")
            is_from_hand = not isinstance(self.of, Distribution) and self.of < 0
            end, number = ("hand", -self.of) if is_from_hand else ("base", self.of)
            parts.append(f"{self.family.of or 'joint'} {digits(number)} from the {end}")
        if "steps" in dict(self.settings):
            parts.append(f"for {digits(dict(self.settings)['steps'])} control steps")
        if self.family.known:
            parts.append("given to agents" if self.known else "not given to agents")
        if isinstance(self.strength, Distribution):
            parts.append("drawn for each episode")
        words = {"at": "from {} s on", "over": "growing over {} s", "until": "until {} s"}
        parts += [words[word].format(digits(seconds)) for word, seconds in self._timing]
        return ", ".join(parts)

    def with_strength(self, strength: float) -> Change:
        """Return the same perturbation with another strength."""
        return replace(self, strength=strength)


@dataclass(frozen=True, init=False)
class OneOf:
    """One of several perturbations, drawn for each episode; `None` is no change.

    Options may be drawn themselves, such as `VisuomotorRotation(uniform(-60, 120))`.
    """

    options: tuple[Any, ...]  #: changes, names of them, or None
    weights: tuple[float, ...]  #: relative, of the options

    def __init__(self, *options: Any, weights: Sequence[float] | None = None) -> None:
        """Take perturbations, their names or None, and their relative weights (equal if None)."""
        accepted = "at least two perturbations, names of them, or None"
        require(len(options) > 1, "OneOf", options, accepted)

        def are_weights(numbers: tuple[float, ...]) -> bool:
            is_finite = 0 < sum(numbers) < np.inf
            return len(numbers) == len(options) and min(numbers) >= 0 and is_finite

        accepted = f"{len(options)} numbers of at least 0, not all 0"
        equal = [1.0] * len(options)
        numbers = require_numbers("weights", weights or equal, accepted, are_weights)
        object.__setattr__(self, "options", options)
        object.__setattr__(self, "weights", numbers)

    @property
    def name(self) -> str:
        """The names of the options, for people."""
        names = ("none" if option is None else option.name for option in self.options)
        return f"one of {', '.join(names)}"

    description = name
    known = False
    is_drawn = True

    def ppf(self, shares: Any) -> Any:
        """Return the indices of the options at the quantiles `shares`, as floats of its shape."""
        borders = np.cumsum(self.weights) / np.sum(self.weights)
        return np.searchsorted(borders[:-1], shares, side="right").astype(np.float64)

    def support(self) -> tuple[float, float]:
        """Return the indices of the first and the last option."""
        return 0.0, len(self.options) - 1.0


AnyChange: TypeAlias = Change | OneOf


def digits(strength: Any) -> str:
    """Return a strength as text for a name: exact, and without an exponent (0.00001, not 1e-05)."""
    if isinstance(strength, Range):
        return f"{digits(strength.low)}..{digits(strength.high)}"
    if isinstance(strength, Distribution):
        return getattr(getattr(strength, "dist", None), "name", type(strength).__name__)
    return np.format_float_positional(strength, trim="-")


def _find(module: str, name: str) -> Any:
    return getattr(import_module(module), name)
