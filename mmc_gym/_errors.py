"""Errors about what a user gave."""

from __future__ import annotations

import functools
import inspect
import math
import sys
from collections.abc import Callable, Container, Iterable, Mapping, Set
from difflib import get_close_matches
from numbers import Integral, Real
from typing import TYPE_CHECKING, Any, TypeGuard, TypeVar

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from pydantic import ValidationError

Class = TypeVar("Class", bound=type)
_LONGEST_VALUE = 200  # signs


class UserError(ValueError):
    """An argument, a file or a command is not what is accepted.

    Its message names the argument, the value and what is accepted; where that is a choice among
    names, the value comes first and the names last.  The command line prints it in one line.  Any
    other exception is a defect, and keeps its traceback.
    """


class MissingExtraError(UserError, ImportError):
    """A package of an extra is needed, and not installed."""


def missing(what: str, package: str, extra: str) -> MissingExtraError:
    """Return the error about something that needs a package of an extra.

    >>> print(missing("--cluster ray", "ray", "cluster"))
    --cluster ray needs ray, which is not installed: pip install "mmc-gym[cluster]"
    """
    return MissingExtraError(
        f'{what} needs {package}, which is not installed: pip install "mmc-gym[{extra}]"'
    )


class MismatchWarning(UserWarning):
    """What was made for one environment acts in another; the command line prints it in one line."""


def require(fine: bool, name: str, value: object, accepted: str) -> None:
    """Raise a `UserError` that names the argument, what is accepted and the value, unless `fine`.

    Example:
        >>> require(False, "damping", -1.0, "positive and finite")
        Traceback (most recent call last):
        ...
        mmc_gym._errors.UserError: damping must be positive and finite, got -1.0
    """
    if not fine:
        raise UserError(f"{name} must be {accepted}, got {_shown(value)}")


def _shown(value: object) -> str:
    """Return how a value is written in code, cut off where that is long."""
    text = repr(value)
    return text if len(text) <= _LONGEST_VALUE else f"{text[:_LONGEST_VALUE]}..."


# Numbers


def is_number(value: object) -> TypeGuard[float]:
    """Tell whether a value is a real number; texts and bools are none."""
    return isinstance(value, Real) and not isinstance(value, bool)


def is_whole(value: object) -> TypeGuard[int]:
    """Tell whether a value is a whole number; bools are none."""
    return isinstance(value, Integral) and not isinstance(value, bool)


def is_point(numbers: tuple[float, ...]) -> bool:
    """Tell whether numbers are a point or vector (x, y), finite."""
    return len(numbers) == 2 and all(map(math.isfinite, numbers))


def is_disc(numbers: tuple[float, ...]) -> bool:
    """Tell whether numbers are a disc (x, y, radius), finite and of positive radius."""
    return len(numbers) == 3 and all(map(math.isfinite, numbers)) and numbers[2] > 0


def require_number(
    name: str, value: Any, accepted: str, fine: Callable[[float], bool] = math.isfinite
) -> float:
    """Return the value as a float; raise a `UserError` unless it is a number and `fine` holds.

    >>> require_number("speed_limit", "fast", "positive", lambda speed: speed > 0)
    Traceback (most recent call last):
    ...
    mmc_gym._errors.UserError: speed_limit must be positive, got 'fast'
    """
    require(is_number(value) and fine(float(value)), name, value, accepted)
    return float(value)


def require_finite(name: str, value: Any) -> float:
    """Return the value as a float; raise a `UserError` unless it is a finite number."""
    return require_number(name, value, "a finite number")


def require_positive(name: str, value: Any) -> float:
    """Return the value as a float; raise a `UserError` unless it is positive and finite."""
    return require_number(name, value, "positive and finite", lambda number: 0 < number < math.inf)


def require_not_negative(**values: Any) -> None:
    """Raise a `UserError` that names the first that is negative, not finite or not a number."""
    for name, value in values.items():
        accepted = "finite and not negative"
        require_number(name, value, accepted, lambda number: 0 <= number < math.inf)


def require_whole(name: str, value: Any, least: int = 1) -> int:
    """Return the value as an int; raise a `UserError` unless it is whole and at least `least`."""
    fine = is_whole(value) and value >= least
    require(fine, name, value, f"a whole number of at least {least}")
    return int(value)


def require_numbers(
    name: str, value: Any, accepted: str, fine: Callable[[tuple[float, ...]], bool]
) -> tuple[float, ...]:
    """Return the value as a tuple of floats; raise a `UserError` unless `fine` holds for it.

    >>> require_numbers("gravity", 9.81, "two values (x, y)", lambda both: len(both) == 2)
    Traceback (most recent call last):
    ...
    mmc_gym._errors.UserError: gravity must be two values (x, y), got 9.81
    """
    numbers = _numbers(value)
    require(numbers is not None and fine(numbers), name, value, accepted)
    return numbers or ()


def require_rows(
    name: str,
    value: Any,
    accepted: str,
    fine: Callable[[tuple[float, ...]], bool],
    counts: Container[int] = range(sys.maxsize),
) -> tuple[tuple[float, ...], ...]:
    """Return the value as tuples of floats, its rows.

    Raises:
        UserError: unless `fine` holds for each row, and their number is one of `counts`.
    """
    items = _items(value)
    rows = [numbers for item in items or () if (numbers := _numbers(item)) and fine(numbers)]
    are_fine = items is not None and len(rows) == len(items) and len(items) in counts
    require(are_fine, name, value, accepted)
    return tuple(rows)


def require_array(
    name: str, value: Any, accepted: str = "an array of numbers"
) -> NDArray[np.floating]:
    """Return the value as an array of floats, of float32 if it is one; or raise a `UserError`."""
    try:
        array = np.asarray(value)
    except ValueError:  # of uneven lengths
        array = np.array(None)
    require(array.dtype.kind in "fiu", name, value, accepted)
    return array if array.dtype == np.float32 else array.astype(np.float64)


def _items(value: Any) -> list[Any] | None:
    """Return the items of a list, tuple or array; None for anything else."""
    if isinstance(value, (str, bytes, Mapping, Set)) or not isinstance(value, Iterable):
        return None
    try:
        return list(value)
    except TypeError:  # an array without axes
        return None


def _numbers(value: Any) -> tuple[float, ...] | None:
    items = _items(value)
    return tuple(map(float, items)) if items is not None and all(map(is_number, items)) else None


# Names


def nearest(value: object, known: Iterable[object]) -> str:
    """Return the one of `known` that is spelt most like a value, or "" if none is near.

    >>> nearest("persuit", ["random", "pursuit"])
    'pursuit'
    """
    names = {name.lower(): name for name in known if isinstance(name, str)}
    near = get_close_matches(value.lower(), names, n=1) if isinstance(value, str) else []
    return names[near[0]] if near else ""


def unknown(
    name: str, value: object, known: Iterable[object], *also: str, guess: str = ""
) -> UserError:
    """Return the error about a value that is none of the known ones.

    Args:
        name: of the argument.
        value: what was given.
        known: the names that it may be, or None.
        also: what else is accepted, in words.
        guess: what may have been meant, instead of the name that is nearest.

    >>> print(unknown("engine", "pymunck", ["pymunk", "analytic"]))
    engine 'pymunck' is not accepted; did you mean 'pymunk'? It may be pymunk or analytic
    """
    known = list(known)
    guess = guess or nearest(value, known)
    *others, last = [*map(str, known), *also]
    choices = f"{', '.join(others)} or {last}" if others else last
    question = _question(guess)
    return UserError(f"{name} {_shown(value)} is not accepted{question} It may be {choices}")


def _question(guess: str) -> str:
    return f"; did you mean {guess!r}?" if guess else "."


def require_choice(name: str, value: object, known: Iterable[object]) -> None:
    """Raise a `UserError` unless the value is one of the known names; or None, if that is one."""
    known = tuple(known)
    if not (value is None or isinstance(value, str)) or value not in known:
        raise unknown(name, value, known)


def require_known(what: str, given: Iterable[str], known: Iterable[str]) -> None:
    """Raise a `UserError` that names the first argument in `given` that is not known.

    >>> require_known("ArmParameters", ["segment_length"], ["segment_lengths", "gravity"])
    Traceback (most recent call last):
    ...
    mmc_gym._errors.UserError: ArmParameters takes no argument 'segment_length'; did you mean \
'segment_lengths'? It takes segment_lengths, gravity
    """
    known = tuple(known)
    for name in given:
        if name not in known:
            guess = _question(nearest(name, known))
            raise UserError(f"{what} takes no argument {name!r}{guess} It takes {', '.join(known)}")


def spelt(cls: Class) -> Class:
    """Let a class tell which of its arguments is misspelt, and what may have been meant."""
    plain: Any = cls.__init__  # type: ignore[misc]
    known = tuple(inspect.signature(cls).parameters)

    @functools.wraps(plain)
    def initialize(self: Any, *args: Any, **arguments: Any) -> None:
        require_known(cls.__name__, arguments, known)
        plain(self, *args, **arguments)

    cls.__init__ = initialize  # type: ignore[misc]
    return cls


# Files, checked by pydantic


_OURS = {
    "Input should be": "must be",
    "greater than or equal to": "at least",
    "less than or equal to": "at most",
}


def explain(error: ValidationError) -> str:
    """Return pydantic's complaints in one line: each entry, what it accepts, and its value.

    A complaint about all entries together has no value, which would be all of them.
    """
    complaints = []
    for each in error.errors(include_url=False):
        entry, value = ".".join(map(str, each["loc"])), each["input"]
        if each["type"] == "missing":
            complaints.append(f"{entry} must be given")
        elif each["type"] in ("extra_forbidden", "unexpected_keyword_argument"):
            complaints.append(f"{entry} is not known")
        else:
            accepted = each["msg"].removeprefix("Value error, ")
            for theirs, ours in _OURS.items():
                accepted = accepted.replace(theirs, ours)
            complaints.append(f"{entry} {accepted}, got {value!r}" if entry else accepted)
    return "; ".join(complaints)
