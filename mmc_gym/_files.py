"""Write files so that a reader sees the old content or the new one; read YAML; import modules."""

from __future__ import annotations

import importlib
import os
import pkgutil
import secrets
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import yaml
from typing_extensions import override

from mmc_gym._errors import UserError, require


def write_atomically(path: Path | str, content: bytes | str) -> Path:
    """Write `content` to a temporary file beside `path`, flush it to disk, and rename it.

    Missing parent folders are made.  A text is written as UTF-8.

    Raises:
        OSError: if it cannot be written, as on a full disk; it names the file.
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


def check_folder(path: Path | str, name: str) -> Path:
    """Return the path of a folder, which need not exist but must not be a file or lie in one."""
    require(isinstance(path, str | Path), name, path, "the path of a folder")
    path = Path(path)
    existing = next((part for part in (path, *path.parents) if part.exists()), Path())
    if not existing.is_dir():
        raise UserError(f"{name} must be a folder, got the file {str(existing)!r}")
    return path


class _YamlLoader(yaml.SafeLoader):
    """Read YAML, run no code, and refuse a key that occurs twice in a mapping."""

    @override
    def compose_mapping_node(self, anchor: Any) -> yaml.MappingNode:
        node = super().compose_mapping_node(anchor)
        keys = [(key.tag, key.value) for key, _ in node.value if isinstance(key, yaml.ScalarNode)]
        if twice := next((key for key in keys if keys.count(key) > 1), None):
            raise yaml.YAMLError(f"the key {twice[1]!r} occurs twice")
        return node


def read_yaml(text: str) -> Any:
    """Return what a YAML text holds; no code in it is run.

    Raises:
        ValueError: if it is not YAML, a key occurs twice, or it is nested too deeply.
    """
    try:
        return yaml.load(text, Loader=_YamlLoader)
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error
    except Exception as error:  # whatever "!!float 5e" or a date that cannot be raises
        raise ValueError(" ".join(str(error).split())) from error


def look_here() -> None:
    """Let modules in the working directory be imported, as under `python -m`."""
    here = str(Path.cwd())
    if here not in sys.path:
        sys.path.append(here)


def import_modules(names: Iterable[str]) -> None:
    """Import modules that register environments, tasks, perturbations or measures.

    An error of a module's own code keeps its traceback.
    """
    look_here()
    for name in names:
        try:
            require("" not in name.split("."), "import", name, "the name of a module")
            importlib.import_module(name)
        except ImportError as error:
            raise UserError(f"module {name!r} cannot be imported: {error}") from error


def import_object(path: str, what: str) -> Any:
    """Return the object that is named by `path`, "module:name"; errors begin with `what`."""
    look_here()
    try:
        return pkgutil.resolve_name(path)
    except (ImportError, AttributeError, ValueError) as error:
        raise UserError(f"{what} {path!r} cannot be imported: {error}") from error
