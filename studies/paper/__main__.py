"""Run the paper's experiments; write figures, data, and a table beside what was published.

make paper                                  # all of them
python -m studies.paper [EXPERIMENT ...] [--quick] [--out OUT] [--seed SEED] [--jobs JOBS]
"""

from __future__ import annotations

import sys
from pathlib import Path

import tyro
from tyro.conf import Positional

from mmc_gym import UserError
from studies.paper.run import reproduce


def run(
    experiments: Positional[tuple[str, ...]] = (),
    out: Path = Path("runs/reproduce"),
    quick: bool = False,
    seed: int = 0,
    jobs: int | None = None,
) -> None:
    """Run the paper's experiments; write figures, data, and a table beside what was published.

    Args:
        experiments: Names of experiments (default: all).
        out: Folder for figures, data and table; networks found in it are not trained again.
        quick: Run a small part of each experiment, to see that everything works.
        seed: Seed of everything random.
        jobs: Number of processes (default: one per core).
    """
    reproduce(experiments, out, quick, seed, jobs)


def main(arguments: list[str] | None = None) -> None:
    """Run the command; a wrong argument ends it with one line on stderr and status 2."""
    try:
        tyro.cli(run, prog="python -m studies.paper", args=arguments)
    except UserError as error:
        print(f"studies.paper: {error}", file=sys.stderr)
        raise SystemExit(2) from error


if __name__ == "__main__":
    main()
