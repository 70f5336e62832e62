"""`mmc-gym report`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Report:
    """Write the report of a benchmark: one HTML file that needs nothing beside it."""

    store: Path = Path("runs/benchmark")
    """Folder of the benchmark."""
    out: Path | None = None
    """The file to write (default: report.html in the store)."""

    def run(self) -> None:
        """Write."""
        from mmc_gym.report import write_report

        print(f"wrote {write_report(self.store, self.out or self.store / 'report.html')}")
