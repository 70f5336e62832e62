"""Errors about what a user gave."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pydantic import ValidationError


class UserError(ValueError):
    """An argument, a file or a command is not what is accepted.

    Its message names the argument, the value and what is accepted.  The command line prints it in
    one line.  Any other exception is a defect, and keeps its traceback.
    """


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
        raise UserError(f"{name} must be {accepted}, got {value!r}")


def require_not_negative(**values: float) -> None:
    """Raise a `UserError` that names the first of the arguments that is negative or not finite."""
    for name, value in values.items():
        require(0 <= value < math.inf, name, value, "finite and not negative")


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
