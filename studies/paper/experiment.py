"""Settings and result of an experiment: rows of published beside measured, figures, data."""

from __future__ import annotations

import io
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple, TypeAlias, TypeVar

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from mmc_gym._errors import require
from mmc_gym._files import write_atomically
from mmc_gym._plotting import save_figure

Value: TypeAlias = float | str | None
Data: TypeAlias = "pd.DataFrame | Mapping[str, NDArray[np.generic]]"
Part = TypeVar("Part")


@dataclass(frozen=True)
class Settings:
    """Settings of the experiments, and functions that take their reports.

    Attributes:
        quick: run a small part of each experiment, to see that everything works.
        seed: seed of everything random, not negative.
        folder: keeps the finished parts of long work, to go on from; None keeps nothing.
        jobs: number of processes for long work.
        version: version of the package; parts that another version kept are made anew.
        on_progress: takes the number of parts done, and of all.
        on_note: takes a line that the user should read.

    Raises:
        UserError: if the seed or the number of processes is out of range.
    """

    quick: bool = False
    seed: int = 0
    folder: Path | None = None
    jobs: int = 1
    version: str = version("mmc-gym")
    on_progress: Callable[[int, int], None] = lambda done, total: None
    on_note: Callable[[str], None] = warnings.warn

    def __post_init__(self) -> None:
        require(self.seed >= 0, "seed", self.seed, "0 or more")
        require(self.jobs >= 1, "jobs", self.jobs, "1 or more")

    def tracked(self, parts: Sequence[Part]) -> Iterator[Part]:
        """Yield the parts, and report how many are done before each and after the last."""
        for done, part in enumerate(parts):
            self.on_progress(done, len(parts))
            yield part
        self.on_progress(len(parts), len(parts))


@dataclass(frozen=True)
class Row:
    """One line of the table: a quantity as published and as measured.

    Numbers are shown with four digits, text as it is, None as a dash.

    Attributes:
        quantity: name of what was measured.
        paper: value in the paper's text.
        data: value from the data published with the paper.
        ours: value measured here.
        unit: of all three; empty for a plain number.
        note: anything a reader must know to compare them.
    """

    quantity: str
    paper: Value = None
    data: Value = None
    ours: Value = None
    unit: str = ""
    note: str = ""


class Captioned(NamedTuple):
    """A figure, and a caption that says what it shows."""

    figure: Figure
    caption: str


@dataclass(frozen=True, eq=False)
class Result:
    """Findings of an experiment.

    Attributes:
        rows: lines of the table, in order.
        figures: figures by file stem; each is written as PNG and as SVG.
        data: data by file stem; a frame is written as CSV, a mapping of arrays as npz.
        points: findings by number of a point of `published.POINTS`.
    """

    rows: Sequence[Row] = ()
    figures: Mapping[str, Captioned] = field(default_factory=dict)
    data: Mapping[str, Data] = field(default_factory=dict)
    points: Mapping[int, str] = field(default_factory=dict)


def format_value(value: Value) -> str:
    """Return a value as the table shows it.

    >>> format_value(0.0226399), format_value(7.0), format_value("2.0×"), format_value(None)
    ('0.02264', '7', '2.0×', '–')
    """
    if value is None:
        return "–"
    return value if isinstance(value, str) else f"{value:.4g}"


def mean_and_deviation(values: ArrayLike, decimals: int = 4) -> str:
    """Return mean ± standard deviation (of the values themselves, ddof 0).

    >>> mean_and_deviation([0.1, 0.3])
    '0.2000 ± 0.1000'
    """
    values = np.asarray(values, dtype=np.float64)
    return f"{values.mean():.{decimals}f} ± {values.std():.{decimals}f}"


def over_runs(values: ArrayLike, digits: str = ".4f") -> str:
    """Return the mean over runs and, if there are several, the smallest and the largest.

    >>> over_runs([0.0625]), over_runs([0.05, 0.04, 0.09])
    ('0.0625', '0.0600 (0.0400 to 0.0900)')
    """
    values = np.asarray(values, dtype=np.float64)
    extremes = f" ({values.min():{digits}} to {values.max():{digits}})" if values.size > 1 else ""
    return f"{values.mean():{digits}}{extremes}"


def how_many(networks: int) -> str:
    """Return the note on a value `over_runs` of several networks; "" for a single one."""
    return f"{networks} networks: mean (least to most)" if networks > 1 else ""


def write_result(result: Result, folder: Path) -> list[Path]:
    """Write figures and data into `folder`, each file whole or not at all; return the files."""
    written = []
    for stem, (figure, _) in result.figures.items():
        written += save_figure(figure, folder / stem)
    for stem, data in result.data.items():
        if isinstance(data, pd.DataFrame):
            text = data.to_csv(index=False, lineterminator="\n")
            written.append(write_atomically(folder / f"{stem}.csv", text))
        else:
            written.append(write_atomically(folder / f"{stem}.npz", pack_arrays(data)))
    return written


def pack_arrays(arrays: Mapping[str, NDArray[np.generic]]) -> bytes:
    """Return the content of an npz file of arrays; equal arrays give equal bytes."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, allow_pickle=False, **dict(arrays))
    return buffer.getvalue()
