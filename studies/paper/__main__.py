"""Run the paper's experiments; write figures, data, and a table with the published values.

make paper                                  # all of them
python -m studies.paper [EXPERIMENT ...] [--quick] [--out OUT] [--seed SEED] [--jobs JOBS]
"""

from __future__ import annotations

from pathlib import Path

import tyro
from tyro.conf import Positional

from studies.paper.run import Name, reproduce


def main(
    experiments: Positional[tuple[Name, ...]] = (),
    out: Path = Path("runs/paper"),
    quick: bool = False,
    seed: int = 0,
    jobs: int | None = None,
) -> None:
    """Run the paper's experiments; write figures, data, and a table with the published values.

    Args:
        experiments: Names of experiments (default: all).
        out: Folder for figures, data and table; networks in it are not trained again.
        quick: Run a small part of each experiment, to see that everything works.
        seed: Seed of everything random.
        jobs: Number of processes that train networks (default: one per core).
    """
    reproduce(experiments, out, quick, seed, jobs)


if __name__ == "__main__":
    tyro.cli(main, prog="python -m studies.paper")
