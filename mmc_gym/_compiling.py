"""Compiling by numba, which the extra `fast` installs; only this file imports it.

numba keeps what it has compiled between processes, until the file of the function that Python calls
changes: functions that call each other belong in one file, but for `sine_cosine`.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Callable
from typing import Any

import numpy as np

from mmc_gym._errors import missing

try:
    import numba
    from numba.core import event
except ModuleNotFoundError as error:
    if error.name != "numba":
        raise
    raise missing("HingeNetwork or engine 'analytic'", "numba", "fast") from error


def _fingerprint(record: Any) -> tuple[str, tuple[str]]:
    """Return the part of a compiled function's name that is a record type: a hash of its fields.

    numba counts the types of a process.  Two processes give the same number to different types, and
    a third one that loads the code of both from disk runs the one in place of the other.
    """
    return "Record", (hashlib.sha256(record.name.encode()).hexdigest()[:16],)


numba.types.Record.mangling_args = property(_fingerprint)  # type: ignore[method-assign,assignment]

inner = numba.njit(nogil=True, error_model="numpy", forceinline=True)
"""Compile a function that others in its file call; a loop is no vector if it holds a call to it."""

shared = numba.njit(nogil=True, error_model="numpy")
"""Compile a long function once, for several places in its file that call it."""


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a function that Python calls, at the first call, and keep the result on disk."""
    try:
        dispatcher = numba.njit(cache=True, nogil=True, error_model="numpy")(function)
    except RuntimeError:  # there is nowhere to write the cache
        return inner(function)
    _CACHED.add(dispatcher)
    return dispatcher


class _Announcer(event.Listener):
    """Says in a terminal, on stderr, that numba compiles what it has not kept from earlier."""

    def on_start(self, event: Any) -> None:
        if event.data["dispatcher"] in _CACHED and sys.stderr.isatty():
            print("numba compiles, once on this machine: some seconds", file=sys.stderr)

    def on_end(self, event: Any) -> None:
        pass


_CACHED: set[Any] = set()  # what `compiled` has made
event.register("numba:compile", _Announcer())


@inner
def sine_cosine(angle):
    """Return sine and cosine to about an ulp.

    It is arithmetic alone, so that a loop over angles can become vector instructions, which return
    the same bits.  The polynomials and the three parts of π/2 are those of fdlibm (Sun
    Microsystems, 1993), good for angles up to 1e6.
    """
    quarter = np.floor(angle * 0.6366197723675814 + 0.5)
    x = angle - quarter * 1.57079632673412561417
    x = (x - quarter * 6.07710050630396597660e-11) - quarter * 2.02226624879595063154e-21
    z = x * x
    s = -2.50507602534068634195e-08 + z * 1.58969099521155010221e-10
    s = 2.75573137070700676789e-06 + z * s
    s = -1.98412698298579493134e-04 + z * s
    s = 8.33333333332248946124e-03 + z * s
    s = -1.66666666666666324348e-01 + z * s
    s = x + x * z * s
    c = 2.08757232129817482790e-09 + z * -1.13596475577881948265e-11
    c = -2.75573143513906633035e-07 + z * c
    c = 2.48015872894767294178e-05 + z * c
    c = -1.38888888888741095749e-03 + z * c
    c = 4.16666666666666019037e-02 + z * c
    c = (1.0 - 0.5 * z) + z * z * c
    # s and c are sine and cosine of x = angle − quarter · π/2; an odd quarter exchanges them.
    quarter -= 4.0 * np.floor(0.25 * quarter)
    odd = quarter - 2.0 * np.floor(0.5 * quarter) > 0.5
    sine = c if odd else s
    cosine = s if odd else c
    sine = -sine if quarter > 1.5 else sine
    cosine = -cosine if abs(quarter - 1.5) < 1.0 else cosine
    return sine, cosine
