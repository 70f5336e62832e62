"""Time the training of the paper's normalization networks, five runs together and one by one.

Only a few epochs are trained, and their time is extrapolated: all epochs cost the same.  Seconds
are processor time on one thread, so that other work on the machine hardly disturbs them.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import tyro
from rich.console import Console
from rich.table import Table

from studies.network.fitting import PAPER, train_normalizers
from studies.paper.networks import ARCHITECTURES, RUNS, Units, architecture_name


@dataclass
class Arguments:
    """Time the training of the normalization networks."""

    epochs: int = 20  # number of epochs to train
    widest: int = 128  # leave out architectures with larger layers


def seconds(units: Units, runs: int, epochs: int) -> float:
    """Return the seconds of the paper's 400 epochs, without what a training does only once."""
    times = []
    for count in (2, 2 + epochs):
        start = time.process_time()
        train_normalizers(units, replace(PAPER, epochs=count), runs)
        times.append(time.process_time() - start)
    return (times[1] - times[0]) * PAPER.epochs / epochs


def main(arguments: Arguments) -> None:
    """Print a table of all architectures and their sum."""
    table = Table(title=f"{RUNS} runs of {PAPER.epochs} epochs, seconds of one core")
    for heading in ("hidden units", "together", "one at a time", "ratio"):
        table.add_column(heading, justify="right")
    train_normalizers((2,), replace(PAPER, epochs=1))  # the first use of torch is slow
    sums = [0.0, 0.0]
    for units in ARCHITECTURES:
        if max(units) > arguments.widest:
            continue
        together = seconds(units, RUNS, arguments.epochs)
        alone = RUNS * seconds(units, 1, arguments.epochs)
        sums = [sums[0] + together, sums[1] + alone]
        name = architecture_name(units)
        table.add_row(name, f"{together:.1f}", f"{alone:.1f}", f"{alone / together:.1f}")
    table.add_row("all", f"{sums[0]:.0f}", f"{sums[1]:.0f}", f"{sums[1] / sums[0]:.1f}")
    Console().print(table)


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
