"""Errors about what a user gave."""

from __future__ import annotations


class UserError(ValueError):
    """An argument, a file or a command is not what is accepted.

    Its message names the argument, the value and what is accepted.  The command line prints it in
    one line.  Any other exception is a defect, and keeps its traceback.
    """


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
