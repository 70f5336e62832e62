"""Write files whole or not at all; seal and check them; read YAML as data; import modules."""

from __future__ import annotations

import hashlib
import importlib
import json
import os
import pkgutil
import secrets
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import yaml
from typing_extensions import override

from mmc_gym._errors import UserError, require

YAML_MOST = 200_000
"""Characters of a YAML file, and values in it with all aliases written out, at most."""

UNSEALED = "0" * 64
"""Stands in a file's metadata for the SHA-256 of the file, see `seal`."""


def write_atomically(path: Path | str, content: bytes | str) -> Path:
    """Write `content` to a temporary file in the same folder, flush it to disk, and rename it.

    Missing parent folders are made.  A text is written as UTF-8.  An `OSError` names the file.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    data = content.encode() if isinstance(content, str) else content
    temporary = path.parent / f".{path.name}.{secrets.token_hex(4)}"
    try:
        with open(temporary, "xb") as file:  # its mode follows the umask, as of any new file
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except OSError as error:  # it may name no file, or the temporary one
        raise OSError(error.errno, error.strerror, str(path)) from error
    finally:
        temporary.unlink(missing_ok=True)
    return path


def require_path(name: str, value: Any) -> Path:
    """Return the path of a file or folder, which need not exist."""
    is_path = isinstance(value, str | Path) and "\0" not in str(value)
    require(is_path, name, value, "a path")
    return Path(value)


def check_folder(path: Path | str, name: str) -> Path:
    """Return the path of a folder, which need not exist but must not be a file or lie in one."""
    path = require_path(name, path)
    existing = next((part for part in (path, *path.parents) if part.exists()), Path())
    if not existing.is_dir():
        raise UserError(f"{name} must be a folder, got the file {str(existing)!r}")
    return path


def digest_of(entries: Mapping[str, Any]) -> str:
    """Return the SHA-256 (hex) of entries of JSON types, in whatever order."""
    return hashlib.sha256(json.dumps(entries, sort_keys=True).encode()).hexdigest()


def digest_files(folder: Path, *patterns: str) -> str:
    """Return the SHA-256 (hex) of the files that match, with their paths in the folder."""
    digest = hashlib.sha256()
    for path in sorted(path for pattern in patterns for path in folder.glob(pattern)):
        content = hashlib.sha256(path.read_bytes()).hexdigest()
        digest.update(f"{path.relative_to(folder).as_posix()} {content}".encode())
    return digest.hexdigest()


def seal(content: bytes) -> bytes:
    """Return the content of a file with its SHA-256 in place of the last `UNSEALED` in it."""
    before, _, after = content.rpartition(UNSEALED.encode())
    return before + hashlib.sha256(content).hexdigest().encode() + after


def check_seal(content: bytes, digest: str) -> None:
    """Raise a `ValueError` unless `seal` made the content and its `digest`."""
    blank = content.replace(digest.encode(), UNSEALED.encode(), 1) if digest else b""
    if hashlib.sha256(blank).hexdigest() != digest:
        raise ValueError("it is not as it was written, or is of an earlier version")


class YamlLoader(yaml.SafeLoader):
    """Read YAML, run no code, and refuse what is no plain data of `YAML_MOST` values.

    A key must be a text, and occur once in its mapping.
    """

    @override
    def compose_mapping_node(self, anchor: Any) -> yaml.MappingNode:
        node = super().compose_mapping_node(anchor)
        keys = [key.value for key, _ in node.value]
        for key, _ in node.value:
            if key.tag not in ("tag:yaml.org,2002:str", "tag:yaml.org,2002:merge"):
                raise yaml.YAMLError(f"the key {key.value} must be a text")
            if keys.count(key.value) > 1:
                raise yaml.YAMLError(f"the key {key.value!r} occurs twice")
        return node

    @override
    def get_single_node(self) -> Any:
        node = super().get_single_node()
        _require_few(1 if node is None else _count(node, {}), "values")
        return node


def _count(node: yaml.Node, counted: dict[int, int]) -> int:
    """Return the number of values in a node, those behind an alias each time that it is used."""
    if id(node) not in counted:
        parts = node.value if isinstance(node, yaml.CollectionNode) else []
        if isinstance(node, yaml.MappingNode):
            parts = [part for pair in parts for part in pair]
        counted[id(node)] = 1 + sum(_count(part, counted) for part in parts)
    return counted[id(node)]


def _require_few(count: int, what: str) -> None:
    if count > YAML_MOST:
        raise ValueError(f"it must have at most {YAML_MOST:,} {what}, got {count:,}")


def read_yaml_file(path: Path) -> Any:
    """Return what a YAML file holds, see `read_yaml`."""
    _require_few(path.stat().st_size, "characters")
    return read_yaml(path.read_text(encoding="utf-8"))


def read_yaml(text: str) -> Any:
    """Return what a YAML text holds; no code in it is run.

    Raises:
        ValueError: if it is not YAML, has a key that is no text or occurs twice, is nested too
            deeply, or has more than `YAML_MOST` values.
    """
    try:
        return yaml.load(text, Loader=YamlLoader)
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error
    except Exception as error:  # whatever "!!float 5e" or a date that cannot be raises
        raise ValueError(" ".join(str(error).split())) from error


def look_here() -> None:
    """Let modules in the working directory be imported, as under `python -m`."""
    here = str(Path.cwd())
    if here not in sys.path:
        sys.path.append(here)


IMPORTED: dict[str, None] = {}
"""Names of the modules that the user had imported, in their order; workers import them, too."""


def import_modules(names: Iterable[str]) -> None:
    """Import modules that register environments, tasks, perturbations or measures.

    An error of a module's own code keeps its traceback.
    """
    look_here()
    for name in names:
        try:
            require("" not in name.split("."), "import", name, "the name of a module")
            importlib.import_module(name)
            IMPORTED[name] = None
        except ImportError as error:
            raise UserError(f"module {name!r} cannot be imported: {error}") from error


def import_object(path: str, what: str) -> Any:
    """Return the object that is named by `path`, "module:name"; errors begin with `what`."""
    look_here()
    try:
        return pkgutil.resolve_name(path)
    except (ImportError, AttributeError, ValueError) as error:
        raise UserError(f"{what} {path!r} cannot be imported: {error}") from error
