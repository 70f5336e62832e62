"""Modules of users: where they are found, and how they are imported."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from mmc_gym._errors import UserError


def look_here() -> None:
    """Let modules in the working directory be found, as `python -m` does but no console script."""
    here = str(Path.cwd())
    if here not in sys.path:
        sys.path.append(here)


def import_modules(names: Iterable[str]) -> None:
    """Import modules that register environments, tasks, perturbations or measures.

    Raises:
        UserError: if one cannot be imported; any error of its own code keeps its traceback.
    """
    look_here()
    for name in names:
        try:
            importlib.import_module(name)
        except (ImportError, ValueError, TypeError) as error:  # ValueError: an empty name
            if not isinstance(error, ImportError) and name:
                raise
            raise UserError(f"module {name!r} cannot be imported: {error}") from error


def import_object(path: str, what: str) -> Any:
    """Return what `path`, "module:name", stands for.

    Raises:
        UserError: if the module cannot be imported or has no such name; it says `what` it is.
    """
    module_name, _, name = path.partition(":")
    look_here()
    try:
        return getattr(importlib.import_module(module_name), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise UserError(f"{what} {path!r} cannot be imported: {error}") from error
