"""Print how many steps and minutes trainings take until their policies reach; draw learning curves.

    python -m studies.learners.trainings                     # the policies that ship
    python -m studies.learners.trainings --agents ppo 'runs/mine-*'    # with your own
    python -m studies.learners.trainings --out runs/trainings

The numbers come from the cards of the policies, so that nothing is trained.  With --out they are
also written: trainings.csv has a row for each training, table.csv the statistics over seeds,
curves.csv a row for each evaluation, and learning_curves.png and .svg show these.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
import tyro
from numpy.typing import NDArray
from rich.console import Console

from mmc_gym.agents.policy import EVALUATION_EPISODES, FINAL_EPISODES, PolicyCard
from mmc_gym.benchmark.statistics import (
    CONFIDENCE,
    Interval,
    sample_interval,
    success_interval,
)
from mmc_gym.measures.catalogue import Statistic
from mmc_gym.report.curves import curve_rows, draw_learning_curves, mean_curves, read_cards
from studies.drawing import save_figure
from studies.tables import table_of

LEVELS = {"95": 0.95, "98": 0.98}

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
    """A number that the table shows; `numbers` computes it.

    Attributes:
        name: its column in the data.
        label: its heading in the table.
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


STEPS, MINUTES = "1,000 env steps", "min, one core"
QUANTITIES = (
    TrainingQuantity("success", "success at the end", "fraction", 3, "mean"),
    TrainingQuantity("final_distance", "final distance", "lengths", 4, "mean"),
    TrainingQuantity("time_to_target", "time to target", "s", 2),
    TrainingQuantity("steps_to_95", "steps to 95 %", STEPS, 1),
    TrainingQuantity("minutes_to_95", "time to 95 %", MINUTES, 2),
    TrainingQuantity("steps_to_98", "steps to 98 %", STEPS, 1),
    TrainingQuantity("minutes_to_98", "time to 98 %", MINUTES, 2),
    TrainingQuantity("training_steps", "whole training", STEPS, 1, varies=False),
    TrainingQuantity("training_minutes", "whole training", MINUTES, 2),
)


def numbers(card: PolicyCard) -> dict[str, float]:
    """Return the `QUANTITIES` of a training by name; infinite if a level is never reached."""
    scores = ("success", "final_distance", "time_to_target")
    quantities = {name: card.scores.get(name, math.nan) for name in scores}
    for percent, level in LEVELS.items():
        quantities[f"steps_to_{percent}"] = first_reached(card, level, "steps") / 1_000
        quantities[f"minutes_to_{percent}"] = first_reached(card, level, "cpu_seconds") / 60
    quantities["training_steps"] = card.training_steps / 1_000
    quantities["training_minutes"] = card.training_cpu_seconds / 60
    return quantities


def first_reached(card: PolicyCard, level: float, column: str) -> float:
    """Return `column` of the first evaluation with success ≥ `level`; infinite if there is none."""
    reached = (row[column] for row in card.learning_curve if row["success"] >= level)
    return next(reached, math.inf)


def trainings(cards: Mapping[str, Sequence[PolicyCard]]) -> pd.DataFrame:
    """Return a row for each training: agent, seed, environment, control, and all `QUANTITIES`."""
    return pd.DataFrame(
        {
            "agent": name,
            "seed": card.seed,
            "environment": card.env_id,
            "control": card.control,
            **numbers(card),
        }
        for name, group in cards.items()
        for card in group
    )


def summarize(rows: pd.DataFrame) -> pd.DataFrame:
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
            **asdict(over_seeds(group[quantity.name].to_numpy(np.float64), quantity)),
        }
        for agent, group in rows.groupby("agent", sort=False)
        for quantity in QUANTITIES
    )


def over_seeds(values: NDArray[np.float64], quantity: TrainingQuantity) -> Interval:
    """Return the statistic of a quantity over training seeds, with its interval."""
    if quantity.name == "success":
        return success_interval(values, FINAL_EPISODES)
    reached = ~np.isinf(values)
    if quantity.varies and reached.all():
        return sample_interval(values, quantity.statistic)
    middle = float(np.median(values))  # finite if most of the values are
    estimate = middle if math.isfinite(middle) else math.nan
    count = int(reached.sum())
    return Interval(estimate, math.nan, math.nan, count, len(values) - count)


def cells(rows: pd.DataFrame, summary: pd.DataFrame) -> list[dict[str, str]]:
    """Return the table: a row for each quantity, a column for each name."""
    agents = rows.groupby("agent", sort=False)
    first = agents.first()
    statistics = {(row["agent"], row["measure"]): row for row in summary.to_dict("records")}
    table = [
        {"": "environment\ncontrol", **(first["environment"] + "\n" + first["control"])},
        {"": "training seeds", **agents.size().astype(str)},
    ]
    for quantity in QUANTITIES:
        row = {"": f"{quantity.label}\n({quantity.unit})"}
        for agent in first.index:
            row[agent] = cell(statistics[agent, quantity.name], quantity.decimals)
        table.append(row)
    return table


def cell(row: Mapping[str, float], at_most: int) -> str:
    """Return an estimate in three digits, its interval, and the number of seeds, if not all.

    Numbers below 1 have `at_most` decimals.
    """
    estimate, low, high = row["estimate"], row["low"], row["high"]
    decimals = at_most if estimate <= 1 else max(0, min(at_most, 3 - len(f"{estimate:.0f}")))
    lines = ["–" if math.isnan(estimate) else f"{estimate:.{decimals}f}"]
    if not math.isnan(low):
        lines.append(f"[{low:.{decimals}f}, {high:.{decimals}f}]")
    if row["missing"]:
        lines.append(f"{row['count']} of {row['count'] + row['missing']}")
    return "\n".join(lines)


def main(agents: tuple[str, ...] = (), out: Path | None = None) -> None:
    """Print the table of trainings.

    Args:
        agents: Trained policies, see `mmc_gym.agents.resolve` (default: all that ship).
        out: Folder for the numbers as CSV, and for the figure; none by default.
    """
    cards = read_cards(agents)
    rows = trainings(cards)
    summary = summarize(rows)
    console = Console(width=170)  # eight names side by side
    console.print(table_of(cells(rows, summary)))
    console.print(NOTE, highlight=False)
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        rows.to_csv(out / "trainings.csv", index=False)
        summary.to_csv(out / "table.csv", index=False)
        curves = curve_rows(cards)
        curves.to_csv(out / "curves.csv", index=False)
        against = mean_curves(curves, "steps"), mean_curves(curves, "cpu_seconds")
        save_figure(draw_learning_curves(*against), out / "learning_curves")


if __name__ == "__main__":
    tyro.cli(main)
