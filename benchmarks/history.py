"""Read, write and compare the runs of `make speed`, kept as JSON.

    runs/speed/2026-11-22T03-17-00Z.json    one run: the machine, and a row for each timed thing

The speed of a machine changes from day to day.  So runs are compared by each row's ratio to its
peer, which took turns with it.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

LOSS = 0.20
"""Share of its ratio that a row may lose before the check fails."""

EARLIER = 7
"""Number of earlier runs whose median the last run is compared with."""

FEWEST = 3
"""A row in fewer earlier runs is not compared."""


@dataclass(frozen=True)
class SpeedRow:
    """One timed thing.

    Attributes:
        name: of the thing, the same in all runs.
        ours: whether it belongs to this package; only these are compared with earlier runs.
        seconds: per step of one arm, iteration of one arm, or action: the median over the rounds.
        peer: name of the row that it took turns with.
        ratio: how many times as fast as the peer, the median over the rounds.
        low: first quartile of the ratio.
        high: third quartile.
    """

    name: str
    ours: bool
    seconds: float
    peer: str
    ratio: float
    low: float
    high: float


@dataclass(frozen=True)
class Run:
    """One run of `make speed`.

    Attributes:
        time: when it ended, UTC, ISO 8601.
        machine: the machine, and the versions of what was timed.
        rows: in the order of the tables.
    """

    time: str
    machine: str
    rows: tuple[SpeedRow, ...]


def now() -> str:
    """Return the present time, UTC, ISO 8601."""
    return datetime.now(UTC).isoformat(timespec="seconds")


def write_run(run: Run, folder: Path) -> Path:
    """Write a run into the folder of all runs, and return its file."""
    stem = datetime.fromisoformat(run.time).strftime("%Y-%m-%dT%H-%M-%SZ")
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / f"{stem}.json"
    file.write_text(json.dumps(asdict(run), indent=1) + "\n")
    return file


def read_runs(folder: Path) -> list[Run]:
    """Return all runs of a folder, the oldest first."""
    runs = []
    for file in sorted(folder.glob("*.json")):
        content = json.loads(file.read_text())
        rows = tuple(SpeedRow(**row) for row in content.pop("rows"))
        runs.append(Run(**content, rows=rows))
    return sorted(runs, key=lambda run: run.time)


def losses(runs: Sequence[Run]) -> list[str]:
    """Return a line for each row of the last run that lost more than `LOSS` of its ratio.

    The last ratio is compared with the median of the `EARLIER` runs before.  A row that fewer than
    `FEWEST` of them timed with the same peer is left out.
    """
    if not runs:
        return []
    *before, last = runs
    lines = []
    for row in last.rows:
        known = [
            earlier.ratio
            for run in before[-EARLIER:]
            for earlier in run.rows
            if (earlier.name, earlier.peer) == (row.name, row.peer)
        ]
        if not row.ours or len(known) < FEWEST:
            continue
        usual = float(np.median(known))
        if row.ratio < (1 - LOSS) * usual:
            lines.append(
                f"{row.name}: {row.ratio:.3g} times as fast as {row.peer}, "
                f"usually {usual:.3g}: a loss of {1 - row.ratio / usual:.0%}"
            )
    return lines
