"""`mmc-gym curves`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Curves:
    """Learning curves over training seeds; print a table, write it with data and figure."""

    folder: Path | None = None
    """Folder of trained policies (default: those that ship with the package)."""
    out: Path = Path("runs/curves")
    """Folder for curves.csv, trainings.csv, the table and the figure."""

    def run(self) -> None:
        """Draw."""
        from mmc_gym.training.curves import learning_curves

        learning_curves(self.folder, self.out)
