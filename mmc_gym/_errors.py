"""Errors of users' input, and checks that raise them.

Messages name the argument, the value and what is accepted.  Checks of numbers and arrays return the
value converted.
"""

from __future__ import annotations

import functools
import inspect
import math
import sys
import warnings
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from numbers import Integral, Real
from typing import TYPE_CHECKING, Any, TypeGuard, TypeVar, dataclass_transform

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from pydantic import ValidationError

Class = TypeVar("Class", bound=type)
Numbers = tuple[float, ...]
_LONGEST_VALUE = 200  # characters
_MOST = 2**31 - 1  # of anything that is counted
_FEW = 16  # numbers that Python adds sooner than numpy looks at them
SMALLEST_SIZE, LARGEST_SIZE = 1e-9, 1e9  # sizes that physics and rewards are computed with
LONGEST = 1000.0  # s, of a delay


class UserError(ValueError):
    """An argument, a file or a command is not accepted.

    The message names the argument, what is accepted and the value; for a choice among names, the
    value comes first and the names last.  The command line prints it in one line.  Any other
    exception is a defect, and keeps its traceback.
    """


class UnknownArgumentError(UserError, TypeError):
    """An argument is not taken; a `TypeError`, too, by which other libraries try what is taken."""


class MissingExtraError(UserError, ImportError):
    """A package of an extra is needed, and not installed."""


class MismatchWarning(UserWarning):
    """An agent acts in an environment that it was not made for."""


def warn_of_mismatch(message: str) -> None:
    """Issue a `MismatchWarning` at the line of the user's code that led here."""
    frame, level = inspect.currentframe(), 1
    while frame is not None and frame.f_globals.get("__name__", "").startswith("mmc_gym."):
        frame, level = frame.f_back, level + 1
    warnings.warn(message, MismatchWarning, stacklevel=level)


def missing(what: str, package: str, extra: str) -> MissingExtraError:
    """Return the error that `what` needs a package of an extra."""
    return MissingExtraError(
        f'{what} needs {package}, which is not installed: pip install "mmc-gym[{extra}]"'
    )


def require(is_accepted: bool, name: str, value: object, accepted: str) -> None:
    """Raise a `UserError` with argument, what is accepted and value, unless it `is_accepted`.

    >>> require(False, "damping", -1.0, "positive and finite")
    Traceback (most recent call last):
    ...
    mmc_gym._errors.UserError: damping must be positive and finite, got -1.0
    """
    if not is_accepted:
        raise UserError(f"{name} must be {accepted}, got {shown(value)}")


def shown(value: object) -> str:
    """Return the `repr` of a value, cut off after `_LONGEST_VALUE` characters."""
    text = repr(value)
    return text if len(text) <= _LONGEST_VALUE else f"{text[:_LONGEST_VALUE]}..."


def is_whole(value: object) -> TypeGuard[int]:
    """Return whether a value is a whole number; bools are not."""
    # The first comparison is for speed.
    return type(value) is int or (isinstance(value, Integral) and not isinstance(value, bool))


def is_point(numbers: Numbers) -> bool:
    """Return whether numbers are a finite point or vector (x, y)."""
    return len(numbers) == 2 and all(map(math.isfinite, numbers))


def is_disc(numbers: Numbers) -> bool:
    """Return whether numbers are a finite disc (x, y, radius) of positive radius."""
    return len(numbers) == 3 and all(map(math.isfinite, numbers)) and numbers[2] > 0


def require_number(
    name: str, value: Any, accepted: str, is_accepted: Callable[[float], bool] = math.isfinite
) -> float:
    """Return a real number that `is_accepted`, as a float; bools are not numbers."""
    is_number = isinstance(value, Real) and not isinstance(value, bool)
    try:
        number = float(value) if is_number else math.nan
    except OverflowError:  # a whole number beyond floats
        number = math.nan
    require(is_number and is_accepted(number), name, value, accepted)
    return number


def require_finite(name: str, value: object) -> float:
    """Return a finite number."""
    return require_number(name, value, "a finite number")


def require_positive(name: str, value: object) -> float:
    """Return a positive, finite number."""
    return require_number(name, value, "positive and finite", lambda number: 0 < number < math.inf)


def require_between(least: float, most: float, **values: object) -> None:
    """Check that all values are numbers from `least` to `most`."""
    for name, value in values.items():
        accepted = f"from {least:g} to {most:g}"
        require_number(name, value, accepted, lambda number: least <= number <= most)


def require_whole(name: str, value: Any, least: int = 1, most: float = _MOST) -> int:
    """Return a whole number of at least `least` and at most `most`."""
    if not (is_whole(value) and least <= value <= most):  # to tell what is accepted takes a while
        too_many = is_whole(value) and value > most
        accepted = f"at most {most}" if too_many else f"a whole number of at least {least}"
        require(False, name, value, accepted)
    return int(value)


def require_numbers(
    name: str, value: object, accepted: str, is_accepted: Callable[[Numbers], bool]
) -> Numbers:
    """Return a sequence or array of numbers that `is_accepted`, as a tuple of floats."""
    array = _array(value)
    numbers = tuple(array.astype(np.float64).tolist()) if array.ndim == 1 else ()
    require(array.ndim == 1 and is_accepted(numbers), name, value, accepted)
    return numbers


def require_rows(
    name: str,
    value: object,
    accepted: str,
    is_accepted: Callable[[Numbers], bool],
    counts: Container[int] = range(sys.maxsize),
) -> tuple[Numbers, ...]:
    """Return rows of numbers, as many as `counts` allows and each accepted, as tuples of floats."""
    array = _array(value)
    rows = tuple(map(tuple, array.astype(np.float64).tolist())) if array.ndim == 2 else ()
    are_rows = (array.ndim == 2 or array.shape == (0,)) and len(rows) in counts
    require(are_rows and all(map(is_accepted, rows)), name, value, accepted)
    return rows


def require_array(
    name: str, value: object, accepted: str = "an array of numbers"
) -> NDArray[np.floating]:
    """Return an array of floats: float32 stays float32, everything else becomes float64."""
    array = _array(value)
    require(array.dtype.kind != "O", name, value, accepted)
    return array if array.dtype.char == "f" else array.astype(np.float64)


def require_floats(name: str, value: object, trailing: tuple[int, ...]) -> NDArray[np.floating]:
    """Return a finite array of floats, as `require_array` does, whose last axes are `trailing`."""
    array = require_array(name, value)
    if array.shape[max(0, array.ndim - len(trailing)) :] != trailing:  # to tell it takes a while
        accepted = f"of shape (..., {', '.join(map(str, trailing))})"
        require(False, name, array.shape, accepted)
    # Of few numbers the sum is told sooner; it may be infinite where they are not.
    if array.size > _FEW or not math.isfinite(sum(array.ravel().tolist())):
        require(all_true(np.isfinite(array)), name, value, "finite")
    return array


def all_true(values: NDArray[Any]) -> bool:
    """Return whether no value is 0; of few values two to ten times as fast as `all`."""
    if values.dtype.char == "?":
        return 0 not in values.tobytes()
    return bool(np.count_nonzero(values) == values.size)


def any_true(values: NDArray[Any]) -> bool:
    """Return whether any value is not 0; of few values three to ten times as fast as `any`."""
    if values.dtype.char == "?":
        return 1 in values.tobytes()
    return bool(np.count_nonzero(values))


def require_batch(name: str, shapes: Sequence[tuple[int, ...]]) -> tuple[int, ...]:
    """Return the shape to which all shapes broadcast."""
    if len(set(shapes)) == 1:  # to broadcast takes a while
        return shapes[0]
    try:
        return np.broadcast_shapes(*shapes)
    except ValueError as error:
        raise UserError(f"{name} must have batch axes that fit, got {shapes}") from error


def _array(value: object) -> NDArray[Any]:
    """Return a value as an array of numbers, or an array of None if it is not numeric."""
    try:
        array = np.asarray(value)
    except ValueError:  # of uneven lengths
        return np.array(None)
    return array if array.dtype.kind in "fiu" else np.array(None)


def nearest(value: object, known: Iterable[object]) -> str:
    """Return the name in `known` whose spelling is closest to `value`, or "" if none is close.

    >>> nearest("persuit", ["random", "pursuit"])
    'pursuit'
    """
    names = {name.lower(): name for name in known if isinstance(name, str)}
    near = get_close_matches(value.lower(), names, n=1) if isinstance(value, str) else []
    return names[near[0]] if near else ""


def unknown(
    name: str, value: object, known: Iterable[object], *also: str, guess: str = ""
) -> UserError:
    """Return the error that the value of an argument `name` is not among the known values.

    It names the known ones and what is `also` accepted, in words.  It suggests `guess`, or else the
    closest name.

    >>> print(unknown("engine", "pymunck", ["pymunk", "analytic"]))
    engine 'pymunck' is not accepted; did you mean 'pymunk'? It may be pymunk or analytic
    """
    known = list(known)
    *others, last = [*map(str, known), *also] or ["none, as there are none"]
    choices = f"{', '.join(others)} or {last}" if others else last
    question = _question(guess or nearest(value, known))
    return UserError(f"{name} {shown(value)} is not accepted{question} It may be {choices}")


def _question(guess: str) -> str:
    return f"; did you mean {guess!r}?" if guess else "."


def require_choice(name: str, value: object, known: Iterable[object]) -> None:
    """Raise a `UserError` unless the value is in `known`: names, and None where it is accepted."""
    known = tuple(known)
    if not (value is None or isinstance(value, str)) or value not in known:
        raise unknown(name, value, known)


def require_names(name: str, value: Any, known: Iterable[object]) -> tuple[str, ...]:
    """Return one name, or several, as a tuple; all must be among the known ones."""
    require(isinstance(value, Iterable), name, value, "a name, or several")
    names, known = (value,) if isinstance(value, str) else tuple(value), tuple(known)
    for choice in names:
        require_choice(name, choice, known)
    return names


def require_arguments(name: str, value: Any) -> dict[str, Any]:
    """Return arguments by name as a dict; None are none."""
    value = {} if value is None else value
    is_named = isinstance(value, Mapping) and all(isinstance(key, str) for key in value)
    require(is_named, name, value, "a mapping of names to values")
    return dict(value)


@dataclass_transform(frozen_default=True)
def frozen(cls: Class) -> Class:
    """Make a class a frozen dataclass that refuses unknown arguments, see `spelt`."""
    return spelt(dataclass(frozen=True)(cls))  # type: ignore[return-value]


def spelt(cls: Class) -> Class:
    """Make a class refuse unknown arguments with a `UserError` that suggests the closest name."""
    plain: Any = cls.__init__  # type: ignore[misc]
    known = tuple(inspect.signature(cls).parameters)

    @functools.wraps(plain)
    def initialize(self: Any, *args: Any, **arguments: Any) -> None:
        require_known(cls.__name__, arguments, known)
        plain(self, *args, **arguments)

    cls.__init__ = initialize  # type: ignore[misc]
    return cls


def require_known(what: str, names: Iterable[str], known: Iterable[str]) -> None:
    """Raise an `UnknownArgumentError` for the first of the names that is not in `known`."""
    known = tuple(known)
    for name in names:
        if name not in known:
            guess = _question(nearest(name, known))
            message = f"{what} got an unexpected keyword argument {name!r}{guess}"
            raise UnknownArgumentError(f"{message} It takes {', '.join(known)}")


def explain(error: ValidationError) -> str:
    """Return pydantic's errors in one line: each entry, what it accepts, and its value.

    An error about all entries together is shown without a value.
    """
    complaints = []
    for detail in error.errors(include_url=False):
        entry, kind = ".".join(map(str, detail["loc"])), detail["type"]
        accepted = detail["msg"].removeprefix("Value error, ").replace("Input should be", "must be")
        accepted = accepted.replace("greater than or equal to", "at least")
        if kind == "missing":
            accepted = "must be given"
        elif kind in ("extra_forbidden", "unexpected_keyword_argument"):
            accepted = "is not known"
        elif entry:
            accepted += f", got {shown(detail['input'])}"
        complaints.append(f"{entry} {accepted}".strip())
    return "; ".join(complaints)
