"""Learning curves: success over the course of trainings, with intervals over training seeds.

What is read are the cards of trained policies (see `agents.reinforcement`): every training was
evaluated at about 25 times, on the same 200 episodes.  The curve of a name, such as "ppo", is the
mean over its seeds at a point x that all of them have passed,

    mean_s success_s(max {x_e ≤ x}),

the last evaluation e that was known then: nothing is interpolated upwards between evaluations,
nothing said before the first evaluation of every seed, or after the last one of the shortest.

Against time, x is the CPU time of the training process.  Trainings run on one thread each, but
several of them at once, on a machine that does other things, too: their wall time tells how busy
it was.  The CPU time is the wall time of a training that has a core to itself.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from rich.console import Console

from mmc_gym._console import make_console
from mmc_gym._files import write_atomically
from mmc_gym.agents.policy import PRETRAINED, PolicyCard, load_policy
from mmc_gym.benchmark.statistics_part import bootstrap_interval
from mmc_gym.training.learning_curve_table import (
    QUANTITIES,
    print_trainings,
    summarize_trainings,
    to_markdown,
    trainings,
)

Axis = Literal["steps", "cpu_seconds"]
REQUIRED = ("steps", "seconds", "cpu_seconds", "success")

_CARD = re.compile(r".+-\d+\.json")


def learning_curves(
    folder: Path | None, out: Path, console: Console | None = None
) -> dict[str, list[PolicyCard]]:
    """Print a table of trainings, and write it, their learning curves and a figure.

    Written are curves.csv (a row for each evaluation), trainings.csv (for each training),
    table.csv and table.md (over seeds), and learning_curves.png and .svg.

    Args:
        folder: of trained policies, see `read_cards`; None for those that ship with the package.
        out: folder for the files.
        console: to print the table to; standard output if None.

    Returns:
        What `read_cards` returned.

    Raises:
        ValueError: if the folder holds no policies, or damaged ones, or `out` is a file.
    """
    from mmc_gym._plotting import save_figure
    from mmc_gym.training.learning_curve_figure import draw_learning_curves

    if out.exists() and not out.is_dir():
        raise ValueError(f"out must be a folder, got the file {str(out)!r}")
    folder = PRETRAINED if folder is None else folder
    cards = read_cards(folder)
    curves = curve_rows(cards)
    rows = trainings(cards, weights_sizes(folder))
    summary = summarize_trainings(rows, QUANTITIES)
    written = [
        write_atomically(out / "curves.csv", _csv(curves)),
        write_atomically(out / "trainings.csv", _csv(rows)),
        write_atomically(out / "table.csv", _csv(summary)),
        write_atomically(out / "table.md", to_markdown(rows, summary, QUANTITIES)),
    ]
    figure = draw_learning_curves(mean_curves(curves, "steps"), mean_curves(curves, "cpu_seconds"))
    written += save_figure(figure, out / "learning_curves")
    console = console or make_console()
    print_trainings(console, rows, summary, QUANTITIES)
    for path in written:
        name = str(path).encode(console.encoding, "replace").decode(console.encoding)
        console.print(f"wrote {name}", highlight=False, markup=False, soft_wrap=True)
    return cards


def read_cards(folder: Path) -> dict[str, list[PolicyCard]]:
    """The cards of all policies in a folder, by name, in the order of their seeds.

    Policies are the files NAME-SEED.json in the folder, each with its NAME-SEED.safetensors, or,
    if there are none, those in the folders right below it, as single trainings leave them.

    Raises:
        ValueError: if there are none, one is damaged, or policies of the same name are of the
            same seed, or of different environments or hyperparameters.
    """
    cards: dict[str, list[PolicyCard]] = {}
    for path in _card_files(folder):
        try:
            _, card = load_policy(path)
        except FileNotFoundError as error:
            raise ValueError(f"{path} must lie beside its weights: {error}") from error
        if path.stem != card.file_stem:
            raise ValueError(f"{path} must be called {card.file_stem}.json, as its card says")
        cards.setdefault(card.name, []).append(card)
    for group in cards.values():
        group.sort(key=lambda card: card.seed)
        for card, other in pairwise(group):
            _check_alike(folder, card, other)
    return dict(sorted(cards.items()))


def weights_sizes(folder: Path) -> dict[str, int]:
    """The size of the weights of each policy that `read_cards` reads, bytes, by NAME-SEED."""
    files = _card_files(folder)
    return {path.stem: path.with_suffix(".safetensors").stat().st_size for path in files}


def curve_rows(cards: Mapping[str, Sequence[PolicyCard]]) -> pd.DataFrame:
    """All learning curves: one row per evaluation of a training.

    Returns:
        Columns agent, seed, steps (environment steps), seconds (wall time), cpu_seconds, success
        (part of the episodes), and what else the evaluations tell; NaN where one does not.

    Raises:
        ValueError: if a card has no curve, or one that goes back.
    """
    rows: list[dict[str, Any]] = []
    for name, group in cards.items():
        for card in group:
            _check_curve(card)
            start = {"agent": name, "seed": card.seed}
            rows += [{**start, **evaluation} for evaluation in card.learning_curve]
    return pd.DataFrame(rows)


def mean_curves(curves: pd.DataFrame, against: Axis) -> pd.DataFrame:
    """Success of each name over its training seeds, with 95 % bootstrap intervals over the seeds.

    The points are where the longest training was evaluated, from where all seeds have been, up
    to the end of the shortest, and that end.  The intervals have no ends where there is but one
    seed.

    Args:
        curves: what `curve_rows` returned.
        against: its column that the curves run along.

    Returns:
        Columns agent, `against`, success, low, high, seeds; names whose seeds have no stretch in
        common are missing.
    """
    rows = []
    for agent, group in curves.groupby("agent", sort=False):
        seeds = [
            (seed[against].to_numpy(np.float64), seed["success"].to_numpy(np.float64))
            for _, seed in group.groupby("seed")
        ]
        grid = _common_points([positions for positions, _ in seeds])
        known = np.array([last_known(grid, *seed) for seed in seeds])
        for position, successes in zip(grid, known.T, strict=True):
            interval = bootstrap_interval(successes, "mean")
            rows.append(
                {
                    "agent": agent,
                    against: position,
                    "success": interval.estimate,
                    "low": interval.low,
                    "high": interval.high,
                    "seeds": interval.count,
                }
            )
    return pd.DataFrame(rows, columns=["agent", against, "success", "low", "high", "seeds"])


def last_known(at: ArrayLike, positions: ArrayLike, values: ArrayLike) -> NDArray[np.float64]:
    """The value of the last position (n,), ascending, up to each of `at`; NaN before the first.

    Example:
        >>> last_known([0.5, 1.0, 1.9, 2.0, 9.0], [1.0, 2.0], [0.25, 0.75])
        array([ nan, 0.25, 0.25, 0.75, 0.75])
    """
    known = np.concatenate(([np.nan], np.asarray(values, np.float64)))
    found: NDArray[np.float64] = known[np.searchsorted(positions, at, side="right")]
    return found


def _common_points(positions: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
    first = max(seed[0] for seed in positions)
    last = min(seed[-1] for seed in positions)
    points = np.append(max(positions, key=lambda seed: seed[-1]), last)
    return np.unique(points[(points >= first) & (points <= last)])


def _card_files(folder: Path) -> list[Path]:
    for pattern in ("*.json", "*/*.json"):
        found = sorted(path for path in folder.glob(pattern) if _CARD.fullmatch(path.name))
        if found:
            return found
    raise ValueError(
        "folder must hold trained policies (NAME-SEED.json and NAME-SEED.safetensors), "
        f"found none in {str(folder)!r}"
    )


def _check_alike(folder: Path, card: PolicyCard, other: PolicyCard) -> None:
    """Only replications of the same training tell how much a seed matters."""
    if card.seed == other.seed:
        raise ValueError(f"{folder} must hold one policy {card.file_stem}, got two")
    keys = card.hyperparameters.keys() | other.hyperparameters.keys()
    different = sorted(
        key for key in keys if card.hyperparameters.get(key) != other.hyperparameters.get(key)
    )
    if card.env_id != other.env_id:
        different.insert(0, "environment")
    if different:
        raise ValueError(
            f"policies of the same name must have the same hyperparameters, but {card.file_stem} "
            f"and {other.file_stem} in {folder} differ in {', '.join(different)}"
        )


def _check_curve(card: PolicyCard) -> None:
    curve = card.learning_curve
    if not curve:
        raise ValueError(f"learning_curve of {card.file_stem} must have evaluations, got none")
    for row in curve:
        if not (
            isinstance(row, dict)
            and all(isinstance(row.get(name), int | float) for name in REQUIRED)
        ):
            raise ValueError(
                f"learning_curve of {card.file_stem} must have numbers for {', '.join(REQUIRED)} "
                f"in every row, got {row!r}"
            )
    for name in ("steps", "cpu_seconds"):
        if any(np.diff([row[name] for row in curve]) < 0):
            raise ValueError(f"learning_curve of {card.file_stem} must ascend in {name}")


def _csv(frame: pd.DataFrame) -> str:
    return frame.to_csv(index=False, lineterminator="\n")
