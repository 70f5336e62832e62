"""The figure of learning curves: success against environment steps, and against minutes."""

from __future__ import annotations

import textwrap

import pandas as pd
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, FuncFormatter, LogLocator, NullFormatter

from mmc_gym._plotting import LINES, STYLE
from mmc_gym.agents.policy import EVALUATION_EPISODES
from mmc_gym.training.learning_curve_table import LEVELS

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
