"""PyTorch's threads, of whoever has loaded it: who has not does not use it."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


def set_torch_threads(threads: int) -> int | None:
    """Set the number of torch's threads, if it is loaded, and return what it was."""
    torch: Any = sys.modules.get("torch")
    if torch is None:
        return None
    before: int = torch.get_num_threads()
    torch.set_num_threads(threads)
    return before


@contextmanager
def one_torch_thread() -> Iterator[None]:
    """Torch on one thread: small networks run faster so, and the same with any number of cores."""
    threads = set_torch_threads(1)
    try:
        yield
    finally:
        if threads is not None:
            set_torch_threads(threads)
