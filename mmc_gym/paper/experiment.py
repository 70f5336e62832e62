"""What an experiment of the paper is: a name, a description, and a function that gives a result.

A result has rows for the table that sets what was published beside what was measured, figures,
and the data behind them.  A module of this package holds one experiment or more, and `catalogue`
lists them all.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeAlias

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from mmc_gym._files import write_atomically
from mmc_gym._plotting import save_figure

Value: TypeAlias = float | str | None
Data: TypeAlias = "pd.DataFrame | Mapping[str, NDArray[np.generic]]"
Progress: TypeAlias = Callable[[int, int], None]
"""Called with (parts done, their total number)."""


@dataclass(frozen=True)
class Settings:
    """How experiments are run.

    Attributes:
        quick: run a small part of each experiment, to see that everything works.
        seed: of everything random, not negative.
        folder: where long work keeps its finished parts, to go on with after it was
            interrupted; None keeps nothing.
        jobs: number of processes for long work.
    """

    quick: bool = False
    seed: int = 0
    folder: Path | None = None
    jobs: int = 1

    def __post_init__(self) -> None:
        for name, least in (("seed", 0), ("jobs", 1)):
            if getattr(self, name) < least:
                raise ValueError(f"{name} must be {least} or more, got {getattr(self, name)}")


@dataclass(frozen=True)
class Row:
    """One line of the table: a quantity as published and as measured.

    Numbers are shown with four digits; text is shown as it is, None as a dash.

    Attributes:
        quantity: what was measured.
        paper: what the paper's text says.
        data: what the data published with the paper give.
        ours: what was measured here.
        unit: of all three, empty for a plain number.
        note: what must be known to compare them.
    """

    quantity: str
    paper: Value = None
    data: Value = None
    ours: Value = None
    unit: str = ""
    note: str = ""


@dataclass(frozen=True, eq=False)
class Result:
    """What an experiment found.

    Attributes:
        rows: for the table, in order.
        figures: by file stem; each is written as PNG and as SVG.
        data: by file stem; a frame is written as CSV, a mapping of arrays as npz.
        captions: of the figures, by the same stems: what each shows.
        points: what was measured on a point of `points.POINTS`, by its number.
    """

    rows: tuple[Row, ...] = ()
    figures: Mapping[str, Figure] = field(default_factory=dict)
    data: Mapping[str, Data] = field(default_factory=dict)
    captions: Mapping[str, str] = field(default_factory=dict)
    points: Mapping[int, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Experiment:
    """An experiment of the paper.

    Attributes:
        name: what the user calls it by, and the name of its folder.
        description: one line.
        run: makes the result; it writes nothing but its parts under `settings.folder`.
    """

    name: str
    description: str
    run: Callable[[Settings, Progress], Result]


def format_value(value: Value) -> str:
    """A value as the table shows it.

    >>> format_value(0.0226399), format_value(7.0), format_value("2.0×"), format_value(None)
    ('0.02264', '7', '2.0×', '–')
    """
    if value is None:
        return "–"
    return value if isinstance(value, str) else f"{value:.4g}"


def mean_and_deviation(values: ArrayLike, decimals: int = 4) -> str:
    """Mean and standard deviation (of the values themselves, ddof 0), as the table shows them.

    >>> mean_and_deviation([0.1, 0.3])
    '0.2000 ± 0.1000'
    """
    values = np.asarray(values, dtype=np.float64)
    return f"{values.mean():.{decimals}f} ± {values.std():.{decimals}f}"


def write_result(result: Result, folder: Path) -> list[Path]:
    """Write figures and data into `folder`, each file whole or not at all; the files written."""
    written = []
    for stem, figure in result.figures.items():
        written += save_figure(figure, folder / stem)
    for stem, data in result.data.items():
        written.append(_write_data(data, folder / stem))
    return written


def _write_data(data: Data, stem: Path) -> Path:
    if isinstance(data, pd.DataFrame):
        text = data.to_csv(index=False, lineterminator="\n")
        return write_atomically(stem.with_suffix(".csv"), text)
    return write_atomically(stem.with_suffix(".npz"), pack_arrays(data))


def pack_arrays(arrays: Mapping[str, NDArray[np.generic]]) -> bytes:
    """The arrays as the content of an npz file; equal arrays give equal bytes."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, allow_pickle=False, **dict(arrays))
    return buffer.getvalue()
