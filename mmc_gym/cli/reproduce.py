"""`mmc-gym reproduce`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro


@dataclass(frozen=True)
class Reproduce:
    """Run the paper's experiments; write figures, data, and a table beside what was published."""

    experiments: Annotated[tuple[str, ...], tyro.conf.Positional] = ()
    """Names of experiments (default: all)."""
    out: Path = Path("runs/reproduce")
    """Folder for figures, data and table; trained networks found in it are not trained again."""
    quick: bool = False
    """Run a small part of each experiment, to see that everything works."""
    seed: int = 0
    """Seed of everything random."""
    jobs: int | None = None
    """Number of processes (default: one per core)."""

    def run(self) -> None:
        """Reproduce."""
        from mmc_gym.paper.run import reproduce

        reproduce(self.experiments, self.out, self.quick, self.seed, self.jobs)
