"""Settings and results of an experiment: rows of published and measured values, figures, data."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple, TypeAlias, TypeVar

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray
from rich.console import Console
from rich.progress import track

from studies.drawing import save_figure

Value: TypeAlias = float | str | None
Data: TypeAlias = "pd.DataFrame | Mapping[str, NDArray[np.generic]]"
Part = TypeVar("Part")


@dataclass(frozen=True)
class ExperimentSettings:
    """Settings of the experiments.

    Attributes:
        quick: run a small part of each experiment, to see that everything works.
        seed: seed of everything random, not negative.
        folder: keeps trained networks, so that an interrupted run resumes.
        jobs: number of processes that train networks.
    """

    quick: bool = False
    seed: int = 0
    folder: Path = Path("runs/paper")
    jobs: int = 1


def tracked(parts: Iterable[Part], what: str, total: int | None = None) -> Iterable[Part]:
    """Yield the parts, with a progress bar on stderr if that is a terminal."""
    console = Console(stderr=True)
    return track(
        parts,
        what,
        total,
        console=console,
        transient=True,
        disable=not console.is_terminal,
    )


@dataclass(frozen=True)
class ResultRow:
    """One line of the table: a quantity as published and as measured.

    Numbers are shown with four digits, text unchanged, None as a dash.

    Attributes:
        quantity: name of the measured quantity.
        paper: value in the paper's text.
        data: value from the data published with the paper.
        ours: value measured here.
        unit: of all three; empty for a plain number.
        note: what a reader needs to know to compare them.
    """

    quantity: str
    paper: Value = None
    data: Value = None
    ours: Value = None
    unit: str = ""
    note: str = ""


class Captioned(NamedTuple):
    """A figure and its caption."""

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

    rows: Sequence[ResultRow] = ()
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
    """Return the mean over runs and, with several runs, the smallest and largest value.

    >>> over_runs([0.0625]), over_runs([0.05, 0.04, 0.09])
    ('0.0625', '0.0600 (0.0400 to 0.0900)')
    """
    values = np.asarray(values, dtype=np.float64)
    extremes = f" ({values.min():{digits}} to {values.max():{digits}})" if values.size > 1 else ""
    return f"{values.mean():{digits}}{extremes}"


def how_many(networks: int) -> str:
    """Return the note on a value of `over_runs`; empty for a single network."""
    return f"{networks} networks: mean (least to most)" if networks > 1 else ""


def write_result(result: Result, folder: Path) -> None:
    """Write figures and data into `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    for stem, (figure, _) in result.figures.items():
        save_figure(figure, folder / stem)
    for stem, data in result.data.items():
        if isinstance(data, pd.DataFrame):
            data.to_csv(folder / f"{stem}.csv", index=False, lineterminator="\n")
        else:
            np.savez_compressed(folder / f"{stem}.npz", allow_pickle=False, **dict(data))
