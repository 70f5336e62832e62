"""Compiling by numba, which the extra `fast` installs; only this file imports it.

numba keeps what it has compiled between processes, until the file of the function that Python calls
changes: functions that call each other belong in one file.
"""

from __future__ import annotations

from typing import Any

from mmc_gym._errors import missing

try:
    import numba
except ModuleNotFoundError as error:
    if error.name != "numba":
        raise
    raise missing("HingeNetwork or engine 'analytic'", "numba", "fast") from error

inner = numba.njit(nogil=True, error_model="numpy", forceinline=True)
"""Compile a function that others in its file call; a loop is no vector if it holds a call to it."""


def compiled(function: Any) -> Any:
    """Compile a function that Python calls, at the first call, and keep the result on disk."""
    try:
        return numba.njit(cache=True, nogil=True, error_model="numpy")(function)
    except RuntimeError:  # there is nowhere to write the cache
        return inner(function)
