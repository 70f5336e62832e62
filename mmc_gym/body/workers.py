"""Threads that help to step many arms."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from typing import Any


class Workers:
    """Helper threads, begun when they are first asked for, and begun anew in a forked process."""

    def __init__(self, threads: int) -> None:
        """Be ready for `threads` threads, the caller's among them."""
        self._threads = threads
        self._pool: ThreadPoolExecutor | None = None
        self._process = 0

    def executor(self) -> ThreadPoolExecutor:
        """The threads of this process; a forked one has inherited none."""
        if self._pool is None or self._process != os.getpid():
            self._pool = ThreadPoolExecutor(self._threads - 1, "arms")
            self._process = os.getpid()
        return self._pool

    def close(self) -> None:
        """End the threads; who asks for them later begins new ones."""
        if self._pool is not None and self._process == os.getpid():
            self._pool.shutdown()
        self._pool = None

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_pool": None}  # threads belong to a process
