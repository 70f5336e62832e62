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

import math
import re
import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, FuncFormatter, LogLocator, NullFormatter
from numpy.typing import ArrayLike, NDArray
from rich.console import Console

from mmc_gym._console import cell, make_console, print_columns
from mmc_gym._files import write_atomically
from mmc_gym._plotting import LINES, STYLE
from mmc_gym.agents.policy import (
    EVALUATION_EPISODES,
    FINAL_EPISODES,
    PRETRAINED,
    PolicyCard,
    load_policy,
)
from mmc_gym.benchmark.statistics import CONFIDENCE, Interval, bootstrap_interval
from mmc_gym.measures.catalogue import Direction, Statistic

LEVELS = (0.95, 0.98)

NOTE = (
    f"Means (success, final distance) and medians (the others) over training seeds, with "
    f"{CONFIDENCE:.0%} bootstrap intervals over the seeds, for so few rather too narrow than too "
    f"wide; none for a single seed. Success, final distance, time to target: {FINAL_EPISODES} "
    "fixed episodes of the trained policy, the same for all. Steps and time to 95 % (98 %): of "
    f"the first evaluation in the training, {EVALUATION_EPISODES} fixed episodes each, with at "
    "least so much success; k of n: so many of the seeds got there, the others count as later "
    "(–: half of them or more did not). Time: CPU time of a training, evaluations included; as "
    "each runs on one thread, it is the wall time of one that has a core to itself."
)


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """How a quantity is taken from a training, and how it is shown.

    Attributes:
        name: its column in the data.
        label: its heading in tables.
        unit: of its values.
        best: whether high or low values are good.
        statistic: what a table says about many seeds.
        decimals: at most so many are shown.
        of: the quantity of a training, given the size of its weights in bytes; NaN where there
            is none, infinite where it is a time that never came.
        varies: whether seeds can differ in it, so that it has an interval.
    """

    name: str
    label: str
    unit: str
    best: Direction
    statistic: Statistic
    decimals: int
    of: Callable[[PolicyCard, int], float]
    varies: bool = True


def first_reached(card: PolicyCard, level: float, column: str) -> float:
    """`column` of the first evaluation with at least that much success; infinite if none has."""
    reached = (row[column] for row in card.learning_curve if row["success"] >= level)
    return next(reached, math.inf)


def _to_level(level: float) -> tuple[Quantity, Quantity]:
    percent = round(100 * level)
    return (
        Quantity(
            name=f"steps_to_{percent}",
            label=f"steps to {percent} %",
            unit="1,000 env steps",
            best="low",
            statistic="median",
            decimals=1,
            of=lambda card, _: first_reached(card, level, "steps") / 1_000,
        ),
        Quantity(
            name=f"minutes_to_{percent}",
            label=f"time to {percent} %",
            unit="min, one core",
            best="low",
            statistic="median",
            decimals=2,
            of=lambda card, _: first_reached(card, level, "cpu_seconds") / 60,
        ),
    )


QUANTITIES: tuple[Quantity, ...] = (
    Quantity(
        name="success",
        label="success at the end",
        unit="fraction",
        best="high",
        statistic="mean",
        decimals=3,
        of=lambda card, _: card.scores.get("success", math.nan),
    ),
    Quantity(
        name="final_distance",
        label="final distance",
        unit="lengths",
        best="low",
        statistic="mean",
        decimals=4,
        of=lambda card, _: card.scores.get("final_distance", math.nan),
    ),
    Quantity(
        name="time_to_target",
        label="time to target",
        unit="s",
        best="low",
        statistic="median",
        decimals=2,
        of=lambda card, _: card.scores.get("time_to_target", math.nan),
    ),
    *(quantity for level in LEVELS for quantity in _to_level(level)),
    Quantity(
        name="training_steps",
        label="whole training",
        unit="1,000 env steps",
        best="low",
        statistic="median",
        decimals=1,
        of=lambda card, _: card.training_steps / 1_000,
        varies=False,
    ),
    Quantity(
        name="training_minutes",
        label="whole training",
        unit="min, one core",
        best="low",
        statistic="median",
        decimals=2,
        of=lambda card, _: card.training_cpu_seconds / 60,
    ),
    Quantity(
        name="weights_size",
        label="file of the policy",
        unit="KiB",
        best="low",
        statistic="median",
        decimals=1,
        of=lambda _, size: size / 1_024,
        varies=False,
    ),
)


def trainings(
    cards: Mapping[str, Sequence[PolicyCard]], weights_sizes: Mapping[str, int]
) -> pd.DataFrame:
    """One row per training: agent, seed, environment, control, and a column per quantity.

    Args:
        cards: by name, see `learning_curves.read_cards`.
        weights_sizes: bytes, by NAME-SEED.
    """
    rows = []
    for name, group in cards.items():
        for card in group:
            row = {
                "agent": name,
                "seed": card.seed,
                "environment": card.env_id,
                "control": card.control,
            }
            size = weights_sizes[card.file_stem]
            rows.append({**row, **{q.name: float(q.of(card, size)) for q in QUANTITIES}})
    return pd.DataFrame(rows)


def summarize_trainings(rows: pd.DataFrame, quantities: Sequence[Quantity]) -> pd.DataFrame:
    """Each name's statistic and interval over its training seeds of each quantity.

    Args:
        rows: what `trainings` returned.
        quantities: which of its columns to summarize.

    Returns:
        Columns agent, measure, unit, statistic, and the fields of `statistics.Interval`.
    """
    summary = []
    for agent, group in rows.groupby("agent", sort=False):
        for quantity in quantities:
            values = group[quantity.name].to_numpy(np.float64)
            summary.append(
                {
                    "agent": agent,
                    "measure": quantity.name,
                    "unit": quantity.unit,
                    "statistic": quantity.statistic,
                    **vars(_over_seeds(values, quantity)),
                }
            )
    return pd.DataFrame(summary)


def print_trainings(
    console: Console, rows: pd.DataFrame, summary: pd.DataFrame, quantities: Sequence[Quantity]
) -> None:
    """Print the table: a row for each quantity, a column for each name."""
    labels, columns = _columns(rows, summary, quantities)
    print_columns(console, labels, columns, NOTE)


def to_markdown(rows: pd.DataFrame, summary: pd.DataFrame, quantities: Sequence[Quantity]) -> str:
    """The same table as Markdown."""
    labels, columns = _columns(rows, summary, quantities)
    titles = [*labels, *columns]
    lines = [titles, ["---"] * len(labels) + ["---:"] * len(columns)]
    lines += map(list, zip(*labels.values(), *columns.values(), strict=True))
    table = "\n".join("| " + " | ".join(map(_on_one_line, line)) + " |" for line in lines)
    return f"{table}\n\n{NOTE}\n"


def _over_seeds(values: NDArray[np.float64], quantity: Quantity) -> Interval:
    reached = ~np.isinf(values)
    if quantity.varies and reached.all():
        return bootstrap_interval(values, quantity.statistic)
    middle = float(np.median(values))  # also where some are infinite, if most are not
    estimate = middle if math.isfinite(middle) else math.nan
    count = int(reached.sum())
    return Interval(estimate, math.nan, math.nan, count, len(values) - count)


def _columns(
    rows: pd.DataFrame, summary: pd.DataFrame, quantities: Sequence[Quantity]
) -> tuple[dict[str, list[str]], dict[str, list[str]]]:
    """Cells of the columns on the left, and of a column for each name."""
    labels = {
        "": ["environment\ncontrol", "training seeds"]
        + [f"{quantity.label}\n[{quantity.unit}]" for quantity in quantities],
        "best": ["", "", *(quantity.best for quantity in quantities)],
    }
    found = {(row["agent"], row["measure"]): row for row in summary.to_dict("records")}
    columns = {}
    for agent, group in rows.groupby("agent", sort=False):
        first = group.iloc[0]
        columns[str(agent)] = [
            f"{first['environment']}\n{first['control']}",
            str(len(group)),
            *(cell(found[agent, quantity.name], quantity.decimals) for quantity in quantities),
        ]
    return labels, columns


def _on_one_line(content: str) -> str:
    content = content.replace("|", "\\|").replace("\n", " ")
    return re.sub(r"^-(?= |$)", "–", content)


Axis = Literal["steps", "cpu_seconds"]
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
            if not card.learning_curve:
                raise ValueError(
                    f"learning_curve of {card.file_stem} must have evaluations, got none"
                )
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


def _csv(frame: pd.DataFrame) -> str:
    return frame.to_csv(index=False, lineterminator="\n")


# Okabe and Ito's, but for yellow: seven, and four kinds of lines, so that no two curves share both.
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")
_MARKERS = "osD^vPX<*"
_BETWEEN_MARKERS = 0.09  # of the panel's diagonal
_WIDE = 1.7  # decades
_CAPTION = (
    f"Success: part of {EVALUATION_EPISODES} fixed episodes that end at the target, of the policy "
    "as it was then, without exploration. Lines: mean over training seeds; bands: 95 % bootstrap "
    "intervals over the seeds (none for one seed). Minutes: CPU time of a training, evaluations "
    "included, which is its wall time with a core to itself. Thin dotted lines: 95 % and 98 %."
)


def draw_learning_curves(against_steps: pd.DataFrame, against_time: pd.DataFrame) -> Figure:
    """Draw success against environment steps, left, and against minutes, right.

    Args:
        against_steps: columns agent, steps, success, low, high, seeds, see
            `learning_curves.mean_curves`.
        against_time: the same with cpu_seconds.
    """
    minutes = against_time.assign(minutes=against_time["cpu_seconds"] / 60)
    panels = (
        (against_steps, "steps", "environment steps"),
        (minutes, "minutes", "time on one core [min]"),
    )
    with rc_context(STYLE):
        figure = Figure(figsize=(8.6, 5.2), layout="constrained")
        FigureCanvasAgg(figure)
        row = figure.subplots(1, 2, sharey=True)
        for axes, (curves, column, label) in zip(row, panels, strict=True):
            _draw_levels(axes)
            for number, (agent, curve) in enumerate(curves.groupby("agent", sort=False)):
                _draw_curve(axes, str(agent), curve, column, number)
            axes.set_xlabel(label)
            _scale_logarithmically(axes)
        row[0].set(ylabel="success", ylim=(0, 1.02))
        row[0].yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{100 * value:.0f} %"))
        row[0].xaxis.set_major_formatter(EngFormatter(sep=""))
        row[1].xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        for level in LEVELS:
            row[1].text(
                1.01, level, f"{level:.0%}", transform=row[1].get_yaxis_transform(), va="center"
            )
        handles, labels = row[0].get_legend_handles_labels()
        figure.legend(
            handles, labels, loc="outside upper center", ncols=4, frameon=False, handlelength=4
        )
        figure.supxlabel(textwrap.fill(_CAPTION, 150), fontsize=7, linespacing=1.4)
    return figure


def _scale_logarithmically(axes: Axes) -> None:
    axes.set_xscale("log")
    low, high = axes.get_xlim()
    subs = (1, 3) if high > 10**_WIDE * low else (1, 2, 5)
    axes.xaxis.set_major_locator(LogLocator(subs=subs))
    axes.xaxis.set_minor_formatter(NullFormatter())


def _draw_levels(axes: Axes) -> None:
    for level in LEVELS:
        axes.axhline(level, color="0.4", linestyle=":", linewidth=0.6, zorder=0)


def _draw_curve(axes: Axes, agent: str, curve: pd.DataFrame, column: str, number: int) -> None:
    colour = _COLOURS[number % len(_COLOURS)]
    count = int(curve["seeds"].iloc[0])
    along = curve[column]
    axes.fill_between(along, curve["low"], curve["high"], color=colour, alpha=0.18, linewidth=0)
    axes.plot(
        along,
        curve["success"],
        color=colour,
        linestyle=LINES[number % len(LINES)],
        linewidth=1.2,
        marker=_MARKERS[number % len(_MARKERS)],
        markersize=3.5,
        markerfacecolor="white",
        markevery=(0.01 * (number % 9), _BETWEEN_MARKERS),
        label=f"{agent} ({count} seed{'s' if count > 1 else ''})",
    )
