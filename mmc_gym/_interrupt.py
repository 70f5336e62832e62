"""End the command at Ctrl-C in one line, even while modules are imported.

`mmc_gym/__init__.py` imports this first.  It does nothing where `mmc_gym` is a library.
"""

import os
import signal
import sys
from types import FrameType


def _interrupt(number: int, frame: FrameType | None) -> None:
    """Raise `KeyboardInterrupt`; end at once during an import, which may abort or swallow it."""
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            os.write(2, b"mmc-gym: interrupted\n")
            os._exit(130)
        frame = frame.f_back
    raise KeyboardInterrupt


_is_command = os.path.basename("".join(sys.argv[:1])).removesuffix(".exe") == "mmc-gym"
if _is_command and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
    signal.signal(signal.SIGINT, _interrupt)
