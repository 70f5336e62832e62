"""The table of trainings: how well, and after how many steps and minutes, over training seeds.

How long a training takes to 95 % is told by the first of its evaluations with at least 95 %
success.  That evaluations come at intervals makes it late rather than early; a training that
never got there counts as later than all others.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from rich.console import Console

from mmc_gym._console import cell, print_columns
from mmc_gym.agents.policy import EVALUATION_EPISODES, FINAL_EPISODES, PolicyCard
from mmc_gym.benchmark.statistics_part import CONFIDENCE, Interval, bootstrap_interval
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
