"""Learning curves: success over the course of trainings, with intervals over training seeds.

The cards of trained policies hold about 25 evaluations of each training, all of the same 200
episodes.  At a point x the curve of a name, such as "ppo", is the mean over its training seeds s,

    mean_s success_s(max {x_e ≤ x}),

where x_e are the points of the evaluations of s.  The curve begins where all seeds have been
evaluated, and ends with the shortest training.

Time is the CPU time of the training process, because wall time depends on what else the machine
does.  A training runs on one thread: on an idle core its wall time is the same.
"""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import pandas as pd
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import (
    EngFormatter,
    FuncFormatter,
    LogLocator,
    NullFormatter,
    PercentFormatter,
)
from numpy.typing import NDArray

from mmc_gym._console import cell, make_console, print_columns, print_written
from mmc_gym._errors import UserError
from mmc_gym._files import check_folder, write_atomically
from mmc_gym._plotting import LINES, STYLE, save_figure
from mmc_gym.agents.policy import (
    EVALUATION_EPISODES,
    FINAL_EPISODES,
    PRETRAINED,
    PolicyCard,
    load_policy,
)
from mmc_gym.benchmark.statistics import (
    CONFIDENCE,
    Interval,
    bootstrap_interval,
    success_interval,
)
from mmc_gym.measures.catalogue import Statistic

LEVELS = (0.95, 0.98)

NOTE = (
    "Means (success, final distance) and medians (the others) over training seeds, with "
    f"{CONFIDENCE:.0%} bootstrap intervals over the seeds, which are too narrow for few seeds; "
    "none for a single seed. The interval of success also covers other episodes. Success, final "
    f"distance, time to target: {FINAL_EPISODES} fixed episodes of the trained policy, the same "
    "for all. Steps and time to 95 % (98 %): of the first evaluation in the training, "
    f"{EVALUATION_EPISODES} fixed episodes each, with at least that success; k of n: only k seeds "
    "reached it, the others count as later (–: half of them or more did not). Time: CPU time of a "
    "training on one thread, evaluations included."
)


class TrainingQuantity(NamedTuple):
    """A number that the table of trainings shows; `_numbers` computes it.

    Attributes:
        name: its column in the data.
        label: its heading in tables.
        decimals: the largest number that is shown.
        statistic: over training seeds.
        varies: whether seeds can differ in it; only then it has an interval.
    """

    name: str
    label: str
    unit: str
    decimals: int
    statistic: Statistic = "median"
    varies: bool = True


_STEPS, _MINUTES = "1,000 env steps", "min, one core"
_PERCENTS = {f"{100 * level:.0f}": level for level in LEVELS}

QUANTITIES = (
    TrainingQuantity("success", "success at the end", "fraction", 3, "mean"),
    TrainingQuantity("final_distance", "final distance", "lengths", 4, "mean"),
    TrainingQuantity("time_to_target", "time to target", "s", 2),
    *(
        quantity
        for percent in _PERCENTS
        for quantity in (
            TrainingQuantity(f"steps_to_{percent}", f"steps to {percent} %", _STEPS, 1),
            TrainingQuantity(f"minutes_to_{percent}", f"time to {percent} %", _MINUTES, 2),
        )
    ),
    TrainingQuantity("training_steps", "whole training", _STEPS, 1, varies=False),
    TrainingQuantity("training_minutes", "whole training", _MINUTES, 2),
)


def _numbers(card: PolicyCard) -> dict[str, float]:
    """Return the `QUANTITIES` of a training by name; infinite if a level is never reached."""
    scores = ("success", "final_distance", "time_to_target")
    numbers = {name: card.scores.get(name, math.nan) for name in scores}
    for percent, level in _PERCENTS.items():
        numbers[f"steps_to_{percent}"] = first_reached(card, level, "steps") / 1_000
        numbers[f"minutes_to_{percent}"] = first_reached(card, level, "cpu_seconds") / 60
    numbers["training_steps"] = card.training_steps / 1_000
    numbers["training_minutes"] = card.training_cpu_seconds / 60
    return numbers


def first_reached(card: PolicyCard, level: float, column: str) -> float:
    """Return `column` of the first evaluation with success ≥ `level`; infinite if there is none."""
    reached = (row[column] for row in card.learning_curve if row["success"] >= level)
    return next(reached, math.inf)


def learning_curves(folder: Path | None, out: Path) -> None:
    """Print a table of trainings, and write it, their learning curves and a figure.

    Writes curves.csv (a row for each evaluation), trainings.csv (for each training), table.csv
    (over training seeds), and learning_curves.png and .svg.

    Args:
        folder: of trained policies, see `read_cards`; None for those that ship with the package.
        out: folder for the files.

    Raises:
        UserError: if the folder holds no policies, or damaged ones, or `out` is a file.
    """
    check_folder(out, "out")
    cards = read_cards(PRETRAINED if folder is None else folder)
    curves, rows = curve_rows(cards), trainings(cards)
    summary = summarize_trainings(rows)
    tables = {"curves": curves, "trainings": rows, "table": summary}
    written = [
        write_atomically(out / f"{name}.csv", table.to_csv(index=False, lineterminator="\n"))
        for name, table in tables.items()
    ]
    figure = draw_learning_curves(mean_curves(curves, "steps"), mean_curves(curves, "cpu_seconds"))
    written += save_figure(figure, out / "learning_curves")
    console = make_console()
    print_columns(console, *_columns(rows, summary), NOTE)
    print_written(console, written)


def read_cards(folder: Path | str = PRETRAINED) -> dict[str, list[PolicyCard]]:
    """Read the cards of all policies in a folder: by name, in the order of their seeds.

    The default is those that ship with the package.  A policy is a file NAME-SEED.json with its
    NAME-SEED.safetensors.  If the folder has none, the folders in it are searched, since single
    trainings write into such.

    Raises:
        FileNotFoundError: if a policy lacks its weights.
        UserError: if there are no policies, one is damaged, or policies of the same name have the
            same seed, or different environments or hyperparameters.
    """
    folder, cards = Path(folder), dict[str, list[PolicyCard]]()
    for path in _card_files(folder):
        _, card = load_policy(path)
        cards.setdefault(card.name, []).append(card)
    for group in cards.values():
        group.sort(key=lambda card: card.seed)
        for card, other in pairwise(group):
            _check_alike(folder, card, other)
    return dict(sorted(cards.items()))


def _card_files(folder: Path) -> list[Path]:
    for pattern in ("*.json", "*/*.json"):
        paths = sorted(folder.glob(pattern))
        if found := [path for path in paths if re.fullmatch(r".+-\d+", path.stem)]:
            return found
    raise UserError(
        "folder must hold trained policies (NAME-SEED.json and NAME-SEED.safetensors), "
        f"found none in {str(folder)!r}"
    )


def _check_alike(folder: Path, card: PolicyCard, other: PolicyCard) -> None:
    """Raise a `UserError` unless two cards differ in their seeds only."""
    if card.seed == other.seed:
        raise UserError(f"{folder} must hold one policy {card.file_stem}, got two")
    one, another = ({"environment": each.env_id, **each.hyperparameters} for each in (card, other))
    keys = sorted(one.keys() | another.keys(), key=lambda key: (key != "environment", key))
    if different := [key for key in keys if one.get(key) != another.get(key)]:
        raise UserError(
            f"policies of the same name must have the same hyperparameters, but {card.file_stem} "
            f"and {other.file_stem} in {folder} differ in {', '.join(different)}"
        )


def curve_rows(cards: Mapping[str, Sequence[PolicyCard]]) -> pd.DataFrame:
    """Return all learning curves: a row for each evaluation of a training.

    Returns:
        Columns agent, seed, steps (environment steps), seconds (wall time), cpu_seconds, success
        (part of the episodes), and the other scores of the evaluations; NaN where one is missing.

    Raises:
        UserError: if a card has no curve.
    """
    rows: list[dict[str, Any]] = []
    for name, group in cards.items():
        for card in group:
            if not card.learning_curve:
                raise UserError(
                    f"learning_curve of {card.file_stem} must have evaluations, got none"
                )
            start = {"agent": name, "seed": card.seed}
            rows += [{**start, **evaluation} for evaluation in card.learning_curve]
    return pd.DataFrame(rows)


Axis = Literal["steps", "cpu_seconds"]


def mean_curves(curves: pd.DataFrame, against: Axis) -> pd.DataFrame:
    """Return the mean success of each name over its training seeds, with 95 % intervals.

    Its points are the evaluations of the longest training between the last seed's first evaluation
    and the end of the shortest training, and that end.  One seed has no interval.

    Args:
        curves: of `curve_rows`.
        against: the column of the horizontal axis.

    Returns:
        Columns agent, `against`, success, low, high, seeds; names whose seeds do not overlap are
        missing.
    """
    rows = []
    for agent, group in curves.groupby("agent", sort=False):
        known = group.pivot_table("success", against, "seed", aggfunc="last").ffill().dropna()
        ends = group.groupby("seed")[against].max()
        points = [*group.loc[group["seed"] == ends.idxmax(), against], ends.min()]
        known = known[known.index.isin(points) & (known.index <= ends.min())]
        for position, successes in zip(known.index, known.to_numpy(), strict=True):
            found = success_interval(successes, EVALUATION_EPISODES)
            row = {"agent": agent, against: position, "success": found.estimate}
            rows.append({**row, "low": found.low, "high": found.high, "seeds": found.count})
    return pd.DataFrame(rows, columns=["agent", against, "success", "low", "high", "seeds"])


def trainings(cards: Mapping[str, Sequence[PolicyCard]]) -> pd.DataFrame:
    """Return a row for each training: agent, seed, environment, control, and all `QUANTITIES`."""
    return pd.DataFrame(
        {
            "agent": name,
            "seed": card.seed,
            "environment": card.env_id,
            "control": card.control,
            **_numbers(card),
        }
        for name, group in cards.items()
        for card in group
    )


def summarize_trainings(rows: pd.DataFrame) -> pd.DataFrame:
    """Return the statistic of each quantity over each name's rows of `trainings`.

    Returns:
        Columns agent, measure, unit, statistic, and the fields of `Interval`.
    """
    return pd.DataFrame(
        {
            "agent": agent,
            "measure": quantity.name,
            "unit": quantity.unit,
            "statistic": quantity.statistic,
            **vars(_over_seeds(group[quantity.name].to_numpy(np.float64), quantity)),
        }
        for agent, group in rows.groupby("agent", sort=False)
        for quantity in QUANTITIES
    )


def _over_seeds(values: NDArray[np.float64], quantity: TrainingQuantity) -> Interval:
    if quantity.name == "success":
        return success_interval(values, FINAL_EPISODES)
    reached = ~np.isinf(values)
    if quantity.varies and reached.all():
        return bootstrap_interval(values, quantity.statistic)
    middle = float(np.median(values))  # finite if most of the values are
    estimate = middle if math.isfinite(middle) else math.nan
    count = int(reached.sum())
    return Interval(estimate, math.nan, math.nan, count, len(values) - count)


def _columns(
    rows: pd.DataFrame, summary: pd.DataFrame
) -> tuple[dict[str, list[str]], dict[str, list[str]]]:
    """Return the cells of the table: a column of labels, and a column for each name."""
    quantities = [f"{quantity.label}\n[{quantity.unit}]" for quantity in QUANTITIES]
    labels = {"": ["environment\ncontrol", "training seeds", *quantities]}
    found = {(row["agent"], row["measure"]): row for row in summary.to_dict("records")}
    columns = {}
    for agent, group in rows.groupby("agent", sort=False):
        first = group.iloc[0]
        columns[str(agent)] = [
            f"{first['environment']}\n{first['control']}",
            str(len(group)),
            *(cell(found[agent, quantity.name], quantity.decimals) for quantity in QUANTITIES),
        ]
    return labels, columns


# Okabe and Ito's colours without yellow; with four kinds of lines no two curves look alike.
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")
_MARKERS = "osD^vPX<*"
_BETWEEN_MARKERS = 0.09  # of the panel's diagonal
_CAPTION = (
    f"Success: part of {EVALUATION_EPISODES} fixed episodes that end at the target, of the policy "
    "as it was then, without exploration. Lines: mean over training seeds; bands: 95 % bootstrap "
    "intervals over seeds and episodes (none for one seed). Minutes: CPU time of a training, "
    "evaluations included, which is its wall time with a core to itself. Thin dotted lines: 95 % "
    "and 98 %."
)


def draw_learning_curves(against_steps: pd.DataFrame, against_time: pd.DataFrame) -> Figure:
    """Draw `mean_curves` against environment steps, left, and against minutes, right."""
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
            for level in LEVELS:
                axes.axhline(level, color="0.4", linestyle=":", linewidth=0.6, zorder=0)
            for number, (agent, curve) in enumerate(curves.groupby("agent", sort=False)):
                _draw_curve(axes, str(agent), curve, column, number)
            axes.set(xlabel=label, xscale="log")
            axes.xaxis.set_major_locator(LogLocator(subs=(1, 3)))
            axes.xaxis.set_minor_formatter(NullFormatter())
        row[0].set(ylabel="success", ylim=(0, 1.02))
        row[0].yaxis.set_major_formatter(PercentFormatter(1, decimals=0, symbol=" %"))
        row[0].xaxis.set_major_formatter(EngFormatter(sep=""))
        row[1].xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        handles, labels = row[0].get_legend_handles_labels()
        figure.legend(
            handles, labels, loc="outside upper center", ncols=4, frameon=False, handlelength=4
        )
        figure.supxlabel(textwrap.fill(_CAPTION, 150), fontsize=7, linespacing=1.4)
    return figure


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
