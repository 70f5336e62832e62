"""Run Python in a process of its own."""

import os
import subprocess
import sys


def run_python(*arguments, folder=None, without=(), **variables):
    """Return what a new interpreter prints; it must succeed.

    The environment has `variables` more, and not those `without`.
    """
    inherited = {name: value for name, value in os.environ.items() if name not in without}
    done = subprocess.run(
        [sys.executable, *map(str, arguments)],
        cwd=folder,
        env={**inherited, **variables},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout
