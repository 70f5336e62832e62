"""The command line.

    mmc-gym compare | reproduce | train | tune | curves | benchmark | report | play

A mistake of the user's ends with one line on stderr and status 2, a cell of a grid that failed with
one line and status 1, Ctrl-C with one line and status 130.  With `MMC_GYM_TRACEBACK=1` in the
environment, all end with the traceback.
"""

from __future__ import annotations

import os
import sys
from typing import Annotated

import tyro

from mmc_gym.cli.benchmark import Benchmark
from mmc_gym.cli.compare import Compare
from mmc_gym.cli.curves import Curves
from mmc_gym.cli.play import Play
from mmc_gym.cli.report import Report
from mmc_gym.cli.reproduce import Reproduce
from mmc_gym.cli.train import Train
from mmc_gym.cli.tune import Tune

TRACEBACK = "MMC_GYM_TRACEBACK"

Command = (
    Annotated[Compare, tyro.conf.subcommand("compare")]
    | Annotated[Reproduce, tyro.conf.subcommand("reproduce")]
    | Annotated[Train, tyro.conf.subcommand("train")]
    | Annotated[Tune, tyro.conf.subcommand("tune")]
    | Annotated[Curves, tyro.conf.subcommand("curves")]
    | Annotated[Benchmark, tyro.conf.subcommand("benchmark")]
    | Annotated[Report, tyro.conf.subcommand("report")]
    | Annotated[Play, tyro.conf.subcommand("play")]
)


def main(arguments: list[str] | None = None) -> None:
    """Run a command."""
    command: Compare | Reproduce | Train | Tune | Curves | Benchmark | Report | Play = tyro.cli(
        Command, prog="mmc-gym", args=arguments
    )
    try:
        command.run()
    except KeyboardInterrupt:
        if os.environ.get(TRACEBACK):
            raise
        print("mmc-gym: interrupted", file=sys.stderr)
        raise SystemExit(130) from None
    except Exception as error:
        from mmc_gym._grid import CellError

        if os.environ.get(TRACEBACK) or not isinstance(error, (ValueError, OSError, CellError)):
            raise
        message, status = str(error), 2
        if isinstance(error, CellError):
            message, status = f"{message.splitlines()[0]} (where, tells {TRACEBACK}=1)", 1
        print(f"mmc-gym: {message}", file=sys.stderr)
        raise SystemExit(status) from error
