"""Writing files so that a reader sees the old content or the new one, never half of it."""

from __future__ import annotations

import os
import re
import socket
import tempfile
from pathlib import Path

_MACHINE = re.sub(r"\W", "_", socket.gethostname())


def write_atomically(path: Path | str, content: bytes | str) -> Path:
    """Write `content` to a temporary file beside `path`, flush it to disk, and rename it.

    Missing parent folders are made.  Text is written as UTF-8.  Temporary files that killed
    processes have left of the same `path` are removed.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    _remove_orphans(path)
    data = content.encode() if isinstance(content, str) else content
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=_prefix(path, os.getpid()))
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.chmod(temporary, 0o644)  # mkstemp makes it private; results are for sharing
        os.replace(temporary, path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise
    return path


def check_folder(path: Path, name: str) -> None:
    """Raise a `ValueError` that names the argument if `path` is a file, or lies in one."""
    for part in (path, *path.parents):
        if part.exists():
            if not part.is_dir():
                raise ValueError(f"{name} must be a folder, got the file {str(part)!r}")
            return


def _prefix(path: Path, process: int | str) -> str:
    """What the temporary files of a process on this machine begin with."""
    return f".{path.name}.{_MACHINE}-{process}."


def _remove_orphans(path: Path) -> None:
    """Remove temporary files whose process on this machine is no more."""
    if os.name != "posix":  # elsewhere, asking for a process can end it
        return
    beginning = _prefix(path, "")[:-1]
    for name in os.listdir(path.parent):
        if name.startswith(beginning):
            process = name[len(beginning) :].partition(".")[0]
            if process.isdecimal() and not _lives(int(process)):
                (path.parent / name).unlink(missing_ok=True)


def _lives(process: int) -> bool:
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:  # another user's
        return True
    return True
