"""The identity of a user's own things: what results depend on beside settings.

    thing  ->  its pickle: what it holds, and code that is in no module (of a script, a notebook)
           ->  the modules that it names, and those that they import  ->  SHA-256 of their files

Files of libraries and of this package do not count.  Files are parsed; no module is imported.
"""

from __future__ import annotations

import ast
import dis
import hashlib
import io
import json
import os
import sys
import warnings
from collections.abc import Iterable, Mapping
from contextlib import suppress
from functools import cache
from importlib.machinery import ModuleSpec, PathFinder
from importlib.util import resolve_name
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any

import cloudpickle

from mmc_gym._errors import MismatchWarning
from mmc_gym._files import look_here

_UNSEEN: dict[str, list[str]] = {}  # what an identity does not cover, in words, by the identity
_SITES = {"site-packages", "dist-packages"}
_BY_VALUE = {"import_module", "__import__"}  # they import what a value names
_CODE = ("co_code", "co_consts", "co_names", "co_varnames", "co_freevars", "co_cellvars")
_PLACES = {"__firstlineno__", "__static_attributes__"}  # Python adds them to a class


class _Pickler(cloudpickle.Pickler):  # type: ignore[misc]
    """Pickle things the same in all processes, code of scripts wherever it stands; note modules."""

    def __init__(self, file: io.BytesIO) -> None:
        super().__init__(file)
        self.modules: set[str] = set()

    def persistent_id(self, thing: Any) -> Any:
        if type(thing) in (set, frozenset):
            return sorted(thing, key=repr)
        return sys.intern(thing) if type(thing) is str else None  # equal texts are one

    def reducer_override(self, thing: Any) -> Any:
        attribute = "__name__" if isinstance(thing, ModuleType) else "__module__"
        self.modules |= {str(getattr(thing, attribute, "")), type(thing).__module__}
        if isinstance(thing, CodeType):
            steps = [step for step in dis.get_instructions(thing) if step.opname == "IMPORT_NAME"]
            self.modules |= _BY_VALUE & {*thing.co_names}
            for module in {step.argval for step in steps}:
                self.modules |= {module, *(f"{module}.{name}" for name in thing.co_names)}
            return str, (thing.co_name,), [getattr(thing, name) for name in _CODE]
        reduced = super().reducer_override(thing)
        if isinstance(thing, type) and reduced is not NotImplemented and len(reduced) > 2:
            # By itself, cloudpickle numbers classes at random.
            entries = {name: reduced[2][0][name] for name in sorted({*reduced[2][0]} - _PLACES)}
            return str, (thing.__qualname__,), [reduced[1][:4], entries]
        return reduced


def identity(*things: Any) -> str:
    """Return a SHA-256 (hex) of what results of functions, classes and other objects depend on.

    A text "module:name" is a thing of that module, which may be of a library.
    """
    digest, unseen, waiting = hashlib.sha256(), list[str](), set[str]()
    named = {thing.partition(":")[0] for thing in things if isinstance(thing, str) and ":" in thing}
    if named:
        look_here()
    for thing in things:
        pickler = _Pickler(pickled := io.BytesIO())
        try:
            pickler.dump(thing)
            digest.update(pickled.getvalue())
        except Exception:  # whatever the user's code raises
            name = getattr(thing, "__qualname__", type(thing).__qualname__)
            digest.update(name.encode())
            unseen.append(f"what {name} holds")
        waiting |= pickler.modules - {"__main__"}  # whose code is pickled
    tried, waiting = {""}, waiting | named
    while names := waiting - tried:
        tried |= names
        for name in sorted(names):
            if not is_own(name, is_named=name in named):
                continue
            spec = _spec(name)
            file, parent = str(spec and spec.origin), name.rpartition(".")[0]
            if os.path.isfile(file):
                package = name if Path(file).stem == "__init__" else parent
                status = os.stat(file)
                code, imports = _source(file, package, status.st_mtime_ns, status.st_size)
                digest.update(f"{name} {code}".encode())
                waiting |= {parent, *imports}
            elif name in {*named, *sys.modules} and not (spec and spec.submodule_search_locations):
                unseen.append(f"the module {name}")
    if not _BY_VALUE.isdisjoint(tried):
        unseen.append("what is imported by a computed name")
    if unseen:
        _UNSEEN[digest.hexdigest()] = unseen
    return digest.hexdigest()


def is_own(module: str, is_named: bool = False) -> bool:
    """Return whether a module is the user's: named by them, or of no library and this package."""
    root = module.partition(".")[0]
    files = [Path(getattr(_spec(name), "origin", None) or "") for name in (root, module)]
    known = root == "mmc_gym" or root in sys.stdlib_module_names
    return not known and (is_named or all(_SITES.isdisjoint(file.parts) for file in files))


def _spec(name: str) -> ModuleSpec | None:
    """Return where a module is, imported or not."""
    if name in sys.modules:
        return getattr(sys.modules[name], "__spec__", None)
    parent = name.rpartition(".")[0]
    places = (getattr(_spec(parent), "submodule_search_locations", None) or []) if parent else None
    return PathFinder.find_spec(name, places)


@cache
def _source(file: str, package: str, modified: int, size: int) -> tuple[str, frozenset[str]]:
    """Return the SHA-256 of a module's file, and names of what it may import; read it once."""
    content, names = Path(file).read_bytes(), set[str]()
    with suppress(SyntaxError, ValueError, ImportError):  # it is no module in Python
        for node in ast.walk(ast.parse(content)):
            if isinstance(node, ast.Import):
                names |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                base = resolve_name("." * node.level + (node.module or ""), package)
                names |= {base, *(f"{base}.{alias.name}" for alias in node.names)}
            elif isinstance(node, ast.Call):
                called = {getattr(node.func, "attr", getattr(node.func, "id", ""))} & _BY_VALUE
                arguments = [first for first in node.args[:1] if isinstance(first, ast.Constant)]
                names |= called and ({str(argument.value) for argument in arguments} or called)
    return hashlib.sha256(content).hexdigest(), frozenset(names)


def warn_of_unseen(reused: Iterable[Mapping[str, Any]]) -> None:
    """Warn, in a line, of what the identities in the settings of reused results do not cover."""
    text = json.dumps([*reused])
    unseen = dict.fromkeys(why for digest in _UNSEEN if digest in text for why in _UNSEEN[digest])
    if unseen:
        changed = f"whether {', '.join(unseen)} changed is not seen; a new folder plays all again"
        warnings.warn(f"kept results are used: {changed}", MismatchWarning, stacklevel=3)
