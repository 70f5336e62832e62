"""Learning curves: success over the course of trainings, with intervals over training seeds.

The cards of trained policies hold about 25 evaluations of each training, all of the same 200
episodes.  At a point x the curve of a name, such as "ppo", is the mean over its training seeds s,

    mean_s success_s(max {x_e ≤ x}),

where x_e are the points of the evaluations of s.  The curve begins where all seeds have been
evaluated, and ends with the shortest training.

Time is the CPU time of the training process, which on an idle core is its wall time.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

import pandas as pd
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, LogLocator, NullFormatter, PercentFormatter

from mmc_gym._errors import UserError, require
from mmc_gym._plotting import LINES, PLAIN_STYLE
from mmc_gym._tables import count
from mmc_gym.agents import AGENTS
from mmc_gym.agents.policy import EVALUATION_EPISODES, PolicyCard
from mmc_gym.agents.resolver import Agents, resolve_all
from mmc_gym.benchmark.statistics import success_interval
from mmc_gym.envs.names import BASELINE
from mmc_gym.envs.perturbations import FAMILIES
from mmc_gym.measures import words
from mmc_gym.report.results import Results


def read_cards(agents: Agents = ()) -> dict[str, list[PolicyCard]]:
    """Return the cards of trained policies by label, in the order of their seeds.

    The agents are names, files, folders or patterns, such as "runs/mine-*", see
    `mmc_gym.agents.resolve`; by default those of a benchmark that ship.
    """
    entries = AGENTS.items()
    shipped = sorted(name for name, entry in entries if entry.training_seeds and entry.is_ranked)
    cards: dict[str, list[PolicyCard]] = {}
    for agent in resolve_all(agents or shipped):
        if agent.card is None:
            raise UserError(f"agents must be trained policies with a card, got {agent.label!r}")
        card = replace(agent.card, seed=agent.training_seed or 0)
        cards.setdefault(agent.label, []).append(card)
    return cards


def curve_rows(cards: Mapping[str, Sequence[PolicyCard]]) -> pd.DataFrame:
    """Return all learning curves: a row for each evaluation of a training.

    Columns agent, seed, steps (of the environment), seconds (wall time), cpu_seconds, success (part
    of the episodes), and the other scores; NaN where one is missing.
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

    The `curves` are those of `curve_rows`.  Columns agent, `against`, success, low, high and seeds.
    The points are the evaluations of the longest training between the last seed's first evaluation
    and the end of the shortest training, and that end; names whose seeds do not overlap have none.
    """
    rows = []
    for agent, group in curves.groupby("agent", sort=False):
        known = group.pivot_table("success", against, "seed", aggfunc="last").ffill().dropna()
        ends = group.groupby("seed")[against].max()
        points = [*group.loc[group["seed"] == ends.idxmax(), against], ends.min()]
        known = known[known.index.isin(points) & (known.index <= ends.min())]
        for position, successes in zip(known.index, known.to_numpy(), strict=True):
            interval = success_interval(successes, EVALUATION_EPISODES)
            row = {"agent": agent, against: position, "success": interval.estimate}
            row |= {"low": interval.low, "high": interval.high, "seeds": interval.count}
            rows.append(row)
    return pd.DataFrame(rows, columns=["agent", against, "success", "low", "high", "seeds"])


# Okabe and Ito's colours without yellow; with four kinds of lines no two curves look alike.
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")
_MARKERS = "osD^vPX<*"


def draw_learning_curves(against_steps: pd.DataFrame, against_time: pd.DataFrame) -> Figure:
    """Draw `mean_curves` against environment steps, left, and against minutes, right."""
    with rc_context(PLAIN_STYLE):
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
        caption = words.LEARNING_CURVES.format(episodes=EVALUATION_EPISODES)
        figure.supxlabel(textwrap.fill(caption, 150), fontsize=7, linespacing=1.4)
    return figure


def _look(number: int) -> dict[str, Any]:
    return {
        "color": _COLOURS[number % len(_COLOURS)],
        "linestyle": LINES[number % len(LINES)],
        "marker": _MARKERS[number % len(_MARKERS)],
    }


def _draw_curves(axes: Axes, curves: pd.DataFrame, along: pd.Series[float]) -> None:
    for level in (0.95, 0.98):
        axes.axhline(level, color="0.4", linestyle=":", linewidth=0.6, zorder=0)
    groups = curves.assign(along=along).groupby("agent", sort=False)
    for number, (agent, curve) in enumerate(groups):
        look = _look(number)
        band = curve["along"], curve["low"], curve["high"]
        axes.fill_between(*band, color=look["color"], alpha=0.18, linewidth=0)
        axes.plot(
            curve["along"],
            curve["success"],
            **look,
            linewidth=1.2,
            markersize=3.5,
            markerfacecolor="white",
            markevery=(0.01 * (number % 9), 0.09),  # of the panel's diagonal
            label=f"{agent} ({count(curve['seeds'].iloc[0], 'seed')})",
        )
    axes.set_xscale("log")
    axes.xaxis.set_major_locator(LogLocator(subs=(1, 3)))
    axes.xaxis.set_minor_formatter(NullFormatter())


def draw_generalisation(results: Results) -> Figure | None:
    """Draw success against strength, a panel for each family, with the trained ranges shaded.

    A family has none if it was played at one strength only.
    """
    panels = {}
    for family in results.ranges:
        judged = (item for item in results.judged.items() if item[1].family == family)
        scenarios = {place.strength: name for name, place in judged}
        if len(scenarios) > 1 and not FAMILIES[family].whole:  # a joint's number is no strength
            panels[family] = scenarios
    if not panels:
        return None
    rows = math.ceil(len(panels) / 4)
    with rc_context(PLAIN_STYLE):
        figure = Figure(figsize=(8.6, 1.9 * rows + 0.8), layout="constrained")
        grid = figure.subplots(rows, 4, sharey=True, squeeze=False)
        for axes in grid.flat[len(panels) :]:
            axes.axis("off")
        for axes, (family, scenarios) in zip(grid.flat, panels.items(), strict=False):
            if BASELINE in results.successes:
                scenarios[0.0] = BASELINE
            for trained in results.ranges[family]:
                axes.axvspan(*trained.support(), color="0.9", linewidth=0)
            _draw_successes(axes, results, scenarios)
            axes.set(xlabel=f"{family} [{FAMILIES[family].unit}]", ylim=(-0.02, 1.02))
            axes.yaxis.set_major_formatter(PercentFormatter(1, decimals=0, symbol=" %"))
        for row in grid:
            row[0].set_ylabel("success")
        handles, labels = grid.flat[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=5, frameon=False)
    return figure


def _draw_successes(axes: Axes, results: Results, scenarios: Mapping[float, str]) -> None:
    """Draw the success of each agent against the strength in scenarios."""
    agents = (name for name in results.agents if results.kind(name) not in ("ideal", "baseline"))
    for number, agent in enumerate(agents):
        successes = {
            strength: results.successes[name].estimate(agent).estimate
            for strength, name in sorted(scenarios.items())
            if agent in results.successes[name].scores.values
        }
        axes.plot([*successes], [*successes.values()], markersize=3, label=agent, **_look(number))
