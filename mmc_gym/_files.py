"""Write files so that a reader sees the old content or the new one, never half of it."""

from __future__ import annotations

import os
import re
import secrets
import socket
from functools import cache
from pathlib import Path

from mmc_gym._errors import UserError, require

_MACHINE = re.sub(r"\W", "_", socket.gethostname())
_TEMPORARY = re.compile(rf"\..+\.{_MACHINE}-(\d+)\.[0-9a-f]+")


def write_atomically(path: Path | str, content: bytes | str) -> Path:
    """Write `content` to a temporary file beside `path`, flush it to disk, and rename it.

    Make missing parent folders.  Write text as UTF-8.  The first write of this process into a
    folder also removes the temporary files that killed processes of this machine left there.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    _remove_orphans(path.parent.absolute())
    data = content.encode() if isinstance(content, str) else content
    temporary = path.parent / f".{path.name}.{_MACHINE}-{os.getpid()}.{secrets.token_hex(4)}"
    try:
        with open(temporary, "xb") as file:  # its mode follows the umask, as of any new file
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    return path


def check_folder(path: Path | str, name: str) -> Path:
    """Return the path; raise a `UserError` that names the argument if it is none of a folder.

    A folder need not exist, but must not be a file, nor lie in one.
    """
    require(isinstance(path, str | Path), name, path, "the path of a folder")
    path = Path(path)
    for part in (path, *path.parents):
        if part.exists():
            if not part.is_dir():
                raise UserError(f"{name} must be a folder, got the file {str(part)!r}")
            break
    return path


@cache
def _remove_orphans(folder: Path) -> None:
    """Remove temporary files whose process on this machine is no more."""
    if os.name != "posix":  # elsewhere, asking for a process can end it
        return
    for name in os.listdir(folder):
        found = _TEMPORARY.fullmatch(name)
        if found and not _lives(int(found[1])):
            (folder / name).unlink(missing_ok=True)


def _lives(process: int) -> bool:
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:  # another user's
        return True
    return True
