"""Ctrl-C ends the command line in one line and with status 130, while it imports, too."""

import os
import signal
import sys
from pathlib import Path

is_running = False  # a command, which has things to put away
has_come = False  # Ctrl-C, which an import may turn into another error


def _interrupt(*_: object) -> None:
    global has_come
    has_come = True
    if is_running:
        raise KeyboardInterrupt
    os.write(2, b"mmc-gym: interrupted\n")
    os._exit(130)


_STARTED = sys.orig_argv[1:3]
_IS_COMMAND = Path(*_STARTED[:1]).stem == "mmc-gym" or _STARTED == ["-m", "mmc_gym.cli"]
if _IS_COMMAND and signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # no nohup
    signal.signal(signal.SIGINT, _interrupt)
