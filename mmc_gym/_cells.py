"""Cells of a store: what was computed from some settings, kept in a file of its own.

    STORE/KIND/NAME.parquet    a table; in its metadata settings, facts and the file's SHA-256

A file is written whole or not at all.  Its SHA-256 is checked before anything in it is parsed, and
its name against what it holds.  So an interrupted run resumes: a cell is computed again if its file
is missing, damaged, of an earlier version or of other settings.
"""

from __future__ import annotations

import hashlib
import io
import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import pyarrow as pa  # type: ignore[import-untyped]
import pyarrow.parquet as pq  # type: ignore[import-untyped]

from mmc_gym._errors import UserError, shown
from mmc_gym._files import UNSEALED, check_seal, seal

CONTENT, SEAL = b"mmc_gym", b"mmc_gym_sha256"  # keys in a file's metadata, in this order
_SAFE = re.compile(r"[a-z0-9][a-z0-9_.+-]*")


class Cell(NamedTuple):
    """What the file of a cell holds."""

    table: pa.Table
    settings: Mapping[str, Any]  #: all that the table is known to depend on, as JSON types
    facts: Mapping[str, Any]  #: more about the cell, as JSON types


def safe_name(name: str) -> str:
    """Return a name for files, different for different names on any file system.

    >>> safe_name("rotation-30"), safe_name("Mine!")
    ('rotation-30', 'mine~1a40e9c3')
    """
    if _SAFE.fullmatch(name) and "--" not in name:
        return name
    plain = "-".join(re.findall(r"[a-z0-9_]+", name.lower()))
    return f"{plain}~{hashlib.sha256(name.encode()).hexdigest()[:8]}"


def cell_content(
    columns: Mapping[str, Any],
    settings: Mapping[str, Any] | None = None,
    facts: Mapping[str, Any] | None = None,
) -> bytes:
    """Return the content of a cell's file; settings and facts must be JSON types."""
    metadata = {CONTENT: json.dumps({"settings": settings or {}, "facts": facts or {}})}
    table = pa.table(dict(columns)).replace_schema_metadata({**metadata, SEAL: UNSEALED})
    buffer = io.BytesIO()
    pq.write_table(
        table,
        buffer,
        compression="lz4",
        use_dictionary=["agent", "environment"],  # numbers hardly repeat
        write_statistics=False,
    )
    return seal(buffer.getvalue())


def parse_cell(content: bytes, columns: Sequence[str] | None = None) -> Cell:
    """Return the cell in a file, with all columns or only those that are named.

    Raises:
        ValueError: if the content is not as `cell_content` made it; it is then not parsed.
    """
    # Thrift puts its type and length, two bytes, before the SHA-256.
    check_seal(content, content.rpartition(SEAL)[2][2:66].decode(errors="replace"))
    file = pq.ParquetFile(pa.BufferReader(content))
    try:
        table = file.read(columns, use_threads=False)  # one thread is faster for small files
        cell = Cell(table, **json.loads(file.schema_arrow.metadata[CONTENT]))
        if not (isinstance(cell.settings, dict) and isinstance(cell.facts, dict)):
            raise TypeError("they must be mappings")
        return cell
    except (TypeError, RecursionError) as error:
        raise ValueError(f"its metadata are no settings and facts: {error}") from error


@dataclass(frozen=True)
class CellFiles:
    """The files of one kind in the stores of one command."""

    kind: str  #: name of their folder
    #: raises an error if the cell is not the one that the file is named after
    check_name: Callable[[Cell, Path], None]
    remedy: str  #: what is done about a damaged file, for messages

    def paths(self, store: Path) -> list[Path]:
        """Return the paths of all files in the order of their names."""
        return sorted((store / self.kind).glob("[!.]*.parquet"), key=lambda path: path.name)

    def read(self, path: Path, columns: Sequence[str] | None = None) -> Cell:
        """Return the cell in a file, see `parse_cell`.

        Raises:
            UserError: if the file is damaged, or named after another cell.
        """
        try:
            cell = parse_cell(path.read_bytes(), columns)
            self.check_name(cell, path)
            return cell
        except (FileNotFoundError, PermissionError):
            raise
        except (OSError, pa.ArrowException, LookupError, TypeError, ValueError) as error:
            raise UserError(f"{path} is damaged, {self.remedy}: {error}") from error

    def find(self, path: Path, settings: Mapping[str, Any]) -> Cell | None:
        """Return the cell of these settings; None if it must be computed (again)."""
        try:
            cell = self.read(path)
        except (FileNotFoundError, UserError):
            return None
        is_same = cell.settings == json.loads(json.dumps(settings))  # a file has lists for tuples
        return cell if is_same else None


def list_differences(first: Any, second: Any, name: str = "") -> Iterator[str]:
    """Yield each entry in which two settings differ, as text with both values."""
    are_lists = isinstance(first, list) and isinstance(second, list)
    if are_lists and any(isinstance(entry, dict) for entry in first):
        first, second = dict(enumerate(first)), dict(enumerate(second))
    if isinstance(first, dict) and isinstance(second, dict):
        for key in dict.fromkeys([*first, *second]):
            inner = f"{name}.{key}" if name else str(key)
            yield from list_differences(first.get(key), second.get(key), inner)
    elif first != second:
        yield f"{name} {shown(first)} and {shown(second)}"
