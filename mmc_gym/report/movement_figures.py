"""The figures of movements: hand paths to the same targets, and speed profiles below them."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from numpy.typing import NDArray

from mmc_gym._plotting import COLOURS, EXAMPLES, LINES
from mmc_gym.measures.speed import hand_speed
from mmc_gym.report.numbers import count, listed
from mmc_gym.report.panels import Block, Look, Panel, drawn
from mmc_gym.report.results import Results
from mmc_gym.report.svg import to_svg

_SIZE = (2.6, 4.3)  # inches


def movements(results: Results, environment: str, look: Mapping[str, Look]) -> Block:
    """Hand paths and speed profile of each agent in an environment: a panel an agent."""
    if results.paths.empty:
        return Block((), "")
    rows = results.paths[results.paths["environment"] == environment]
    fastest, shown, seeds = 0.0, {}, []
    for agent in look:
        mine = rows[rows["agent"] == agent]
        if not mine.empty:
            lowest = mine["training_seed"].min()  # missing without training
            if not np.isnan(lowest):
                mine = mine[mine["training_seed"] == lowest]
                seeds.append(f"{agent} seed {lowest:.0f}")
            shown[agent] = mine
            speeds = _quartiles(mine, results.control_step)
            fastest = max(fastest, float(np.nanmax(speeds[2])))
    panels = tuple(
        Panel(agent, to_svg(_draw(mine, results, fastest), f"movement-{number}", _alt(agent)))
        for number, (agent, mine) in enumerate(shown.items())
    )
    instances = int(rows["instance"].nunique())
    return Block(
        panels,
        f"Environment: {environment}. Above: hand paths in instances 1 to "
        f"{min(instances, EXAMPLES)}, from the open "
        "circle to the dot; the cross is the target, the ring around it the distance that counts "
        "as success; dotted: reach. Below: hand speed, median (line) and quartiles (grey) over "
        f"{count(instances, 'instance')}; all panels have the same scales. {_trainings(seeds)}",
    )


def _trainings(seeds: Sequence[str]) -> str:
    """Of which training the movements are, where there may be several."""
    if not seeds:
        return "Not trained: all of these agents."
    return f"Training seeds: of trained agents, one training: {listed(seeds)}."


def _alt(agent: str) -> str:
    return f"Hand paths of {agent} to the first targets, and its hand speed over time"


def _draw(rows: pd.DataFrame, results: Results, fastest: float) -> Figure:
    with drawn(*_SIZE) as (figure, axes):
        axes.remove()
        above, below = figure.subplots(2, 1, height_ratios=(1.45, 1))
        _draw_paths(above, rows, results)
        low, median, high = _quartiles(rows, results.control_step)
        times = (np.arange(len(median)) + 0.5) * results.control_step
        below.fill_between(times, low, high, color="0.8", linewidth=0)
        below.plot(times, median, color="black", linewidth=1.2)
        below.set(xlabel="time [s]", ylabel="hand speed [lengths/s]")
        below.set(xlim=(0, times[-1]), ylim=(0, 1.05 * fastest))
    return figure


def _draw_paths(axes: Axes, rows: pd.DataFrame, results: Results) -> None:
    reach = sum(results.segment_lengths)
    axes.add_patch(Circle((0, 0), reach, fill=False, color="0.6", linestyle=":", linewidth=0.8))
    numbers = sorted(rows["instance"].unique())[:EXAMPLES]
    for number, instance in enumerate(numbers):
        steps = rows[rows["instance"] == instance].sort_values("step")
        hands = steps[["hand_x", "hand_y"]].to_numpy(np.float64)
        target = steps[["target_x", "target_y"]].to_numpy(np.float64)[-1]
        colour = COLOURS[number]
        axes.plot(*hands.T, color=colour, linestyle=LINES[number], linewidth=1.1)
        axes.plot(*target, "+", color="black", markersize=8, markeredgewidth=0.6)
        axes.add_patch(Circle((target[0], target[1]), results.tolerance, fill=False, linewidth=0.8))
        axes.plot(*hands[0], "o", color=colour, markersize=5, markerfacecolor="white")
        axes.plot(*hands[-1], "o", color=colour, markersize=2.5)
        axes.annotate(
            *(str(number + 1), (target[0], target[1]), (5, 4)),
            textcoords="offset points",
            color=colour,
        )
    border = 1.05 * reach
    axes.set(xlim=(-border, border), ylim=(-border, border), aspect="equal")
    axes.set(xlabel="x [segment lengths]", ylabel="y [segment lengths]")


def _quartiles(rows: pd.DataFrame, control_step: float) -> NDArray[np.float64]:
    """Speed over time, the quartiles over all movements, (3, steps)."""
    speeds = [
        hand_speed(steps.sort_values("step")[["hand_x", "hand_y"]].to_numpy(), control_step)
        for _, steps in rows.groupby("instance")
    ]
    padded = np.full((len(speeds), max(map(len, speeds))), np.nan)
    for line, speed in zip(padded, speeds, strict=True):
        line[: len(speed)] = speed
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a time that no movement reaches
        quartiles: NDArray[np.float64] = np.nanpercentile(padded, (25, 50, 75), axis=0)
    return quartiles
