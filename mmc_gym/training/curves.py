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

import re
import textwrap
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import pandas as pd
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, LogLocator, NullFormatter, PercentFormatter

from mmc_gym._console import interval, make_console, print_list, print_written
from mmc_gym._errors import UserError, require
from mmc_gym._files import check_folder, write_atomically
from mmc_gym._plotting import LINES, STYLE, save_figure
from mmc_gym.agents.policy import EVALUATION_EPISODES, PRETRAINED, PolicyCard, load_policy
from mmc_gym.benchmark.statistics import success_interval


def learning_curves(folder: Path | None, out: Path) -> None:
    """Print where learning curves end; write curves.csv (a row for each evaluation) and a figure.

    Policies are those of `folder`, see `read_cards`, or those that ship.
    """
    check_folder(out, "out")
    curves = curve_rows(read_cards(folder or PRETRAINED))
    against_steps, against_time = mean_curves(curves, "steps"), mean_curves(curves, "cpu_seconds")
    content = curves.to_csv(index=False, lineterminator="\n")
    written = [write_atomically(out / "curves.csv", content)]
    figure = draw_learning_curves(against_steps, against_time)
    written += save_figure(figure, out / "learning_curves")
    ends = against_steps.groupby("agent", sort=False).tail(1).to_dict("records")
    rows = [
        (
            end["agent"],
            f"{end['seeds']}",
            f"{end['steps']:,}",
            f"{end['success']:.3f} {interval(end['low'], end['high'], 3)}",
        )
        for end in ends
    ]
    console = make_console()
    print_list(console, rows, ("agent", "training seeds", "steps", "success at the end"))
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
    for pattern in ("*.json", "*/*.json"):
        paths = sorted(folder.glob(pattern))
        if found := [path for path in paths if re.fullmatch(r".+-\d+", path.stem)]:
            break
    else:
        raise UserError(
            "folder must hold trained policies (NAME-SEED.json and NAME-SEED.safetensors), "
            f"found none in {str(folder)!r}"
        )
    for path in found:
        _, card = load_policy(path)
        cards.setdefault(card.name, []).append(card)
    for group in cards.values():
        group.sort(key=lambda card: card.seed)
        for card, other in pairwise(group):
            _check_alike(folder, card, other)
    return dict(sorted(cards.items()))


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

    Columns agent, seed, steps (environment steps), seconds (wall time), cpu_seconds, success (part
    of the episodes), and the other scores of the evaluations; NaN where one is missing.
    """
    rows: list[dict[str, Any]] = []
    for name, group in cards.items():
        for card in group:
            curve = card.learning_curve
            require(bool(curve), f"learning_curve of {card.file_stem}", curve, "of evaluations")
            rows += [{"agent": name, "seed": card.seed, **evaluation} for evaluation in curve]
    return pd.DataFrame(rows)


def mean_curves(curves: pd.DataFrame, against: Literal["steps", "cpu_seconds"]) -> pd.DataFrame:
    """Return the mean success of each name over its training seeds, with 95 % intervals.

    Its points `against` steps or time are the evaluations of the longest training between the last
    seed's first evaluation and the end of the shortest training, and that end.  One seed has no
    interval.  From `curves` of `curve_rows` return the columns agent, `against`, success, low, high
    and seeds; names whose seeds do not overlap are missing.
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


# Okabe and Ito's colours without yellow; with four kinds of lines no two curves look alike.
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")
_MARKERS = "osD^vPX<*"
_CAPTION = (
    f"Success: part of {EVALUATION_EPISODES} fixed episodes that end at the target, of the policy "
    "as it was then, without exploration. Lines: mean over training seeds; bands: 95 % bootstrap "
    "intervals over seeds and episodes (none for one seed). Minutes: CPU time of a training, "
    "evaluations included, which is its wall time with a core to itself. Thin dotted lines: 95 % "
    "and 98 %."
)


def draw_learning_curves(against_steps: pd.DataFrame, against_time: pd.DataFrame) -> Figure:
    """Draw `mean_curves` against environment steps, left, and against minutes, right."""
    with rc_context(STYLE):
        figure = Figure(figsize=(8.6, 5.2), layout="constrained")
        left, right = figure.subplots(1, 2, sharey=True)
        _draw_curves(left, against_steps, against_steps["steps"])
        _draw_curves(right, against_time, against_time["cpu_seconds"] / 60)
        left.set(xlabel="environment steps", ylabel="success", ylim=(0, 1.02))
        left.yaxis.set_major_formatter(PercentFormatter(1, decimals=0, symbol=" %"))
        left.xaxis.set_major_formatter(EngFormatter(sep=""))
        right.set(xlabel="time on one core [min]")
        right.xaxis.set_major_formatter("{x:g}")
        handles, labels = left.get_legend_handles_labels()
        figure.legend(
            handles, labels, loc="outside upper center", ncols=4, frameon=False, handlelength=4
        )
        figure.supxlabel(textwrap.fill(_CAPTION, 150), fontsize=7, linespacing=1.4)
    return figure


def _draw_curves(axes: Axes, curves: pd.DataFrame, along: pd.Series[float]) -> None:
    for level in (0.95, 0.98):
        axes.axhline(level, color="0.4", linestyle=":", linewidth=0.6, zorder=0)
    groups = curves.assign(along=along).groupby("agent", sort=False)
    for number, (agent, curve) in enumerate(groups):
        colour = _COLOURS[number % len(_COLOURS)]
        count = curve["seeds"].iloc[0]
        band = curve["along"], curve["low"], curve["high"]
        axes.fill_between(*band, color=colour, alpha=0.18, linewidth=0)
        axes.plot(
            curve["along"],
            curve["success"],
            color=colour,
            linestyle=LINES[number % len(LINES)],
            linewidth=1.2,
            marker=_MARKERS[number % len(_MARKERS)],
            markersize=3.5,
            markerfacecolor="white",
            markevery=(0.01 * (number % 9), 0.09),  # of the panel's diagonal
            label=f"{agent} ({count} seed{'s' if count > 1 else ''})",
        )
    axes.set_xscale("log")
    axes.xaxis.set_major_locator(LogLocator(subs=(1, 3)))
    axes.xaxis.set_minor_formatter(NullFormatter())
