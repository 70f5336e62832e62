"""The figures of the report, as images that the page holds: movements and learning curves.

Each function returns None where there is nothing to show.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd
from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from mmc_gym._plotting import (
    EXAMPLES,
    STYLE,
    PlottedMovement,
    draw_paths,
    draw_speed,
    speed_quartiles,
)
from mmc_gym.measures.episode import hand_speed
from mmc_gym.report.results import Results, count, listed
from mmc_gym.training.curves import curve_rows, draw_learning_curves, mean_curves

_STYLE = {**STYLE, "text.parse_math": False}  # users choose the names of agents
_MOVEMENT_SIZE = (2.6, 4.3)  # inches


class Image(NamedTuple):
    """An image: its title, a description for screen readers, and its data URL."""

    title: str
    description: str
    source: str


class ImageGroup(NamedTuple):
    """A figure of the report: images, and the caption of all of them."""

    images: tuple[Image, ...]
    caption: str


def movements(results: Results) -> ImageGroup | None:
    """Draw hand paths and speed profile of the main agents in the base environment."""
    if results.paths.empty:
        return None
    rows = results.paths[results.paths["environment"] == results.base]
    fastest, shown, seeds = 0.0, {}, []
    for agent in results.main_agents:
        mine = rows[rows["agent"] == agent]
        if mine.empty:
            continue
        lowest = mine["training_seed"].min()  # missing without training
        if not np.isnan(lowest):
            mine = mine[mine["training_seed"] == lowest]
            seeds.append(f"seed {lowest:.0f} of {agent}")
        shown[agent] = _movements_of(mine, results.environments[results.base].control_step)
        fastest = max(fastest, float(np.nanmax(speed_quartiles(shown[agent])[2])))
    if not shown:
        return None
    images = tuple(
        Image(
            agent,
            f"Hand paths of {agent} to the first targets, and its hand speed over time",
            _data_url(_draw_movements(mine, results, fastest)),
        )
        for agent, mine in shown.items()
    )
    instances = int(rows["instance"].nunique())
    trainings = f"Training seeds: {listed(seeds)}." if seeds else "Not trained: all agents."
    return ImageGroup(
        images,
        f"Environment: {results.base}. Above: hand paths in instances 1 to "
        f"{min(instances, EXAMPLES)}, from the open circle to the dot; the cross is the target, "
        "the ring around it the distance that counts as success; dotted: reach. Below: hand "
        f"speed, median and quartiles over {count(instances, 'instance')}. {trainings}",
    )


def _movements_of(rows: pd.DataFrame, control_step: float) -> list[PlottedMovement]:
    found = []
    for _, steps in rows.sort_values("step").groupby("instance"):
        hands = steps[["hand_x", "hand_y"]].to_numpy(np.float64)
        target = steps[["target_x", "target_y"]].to_numpy(np.float64)[-1]
        found.append(PlottedMovement(hands, target, hand_speed(hands, control_step)))
    return found


def _draw_movements(drawn: Sequence[PlottedMovement], results: Results, fastest: float) -> Figure:
    with rc_context(_STYLE):
        figure = Figure(figsize=_MOVEMENT_SIZE, layout="constrained")
        FigureCanvasAgg(figure)
        above, below = figure.subplots(2, 1, height_ratios=(1.45, 1))
        reach = sum(results.environments[results.base].segment_lengths)
        draw_paths(above, drawn, reach, results.environments[results.base].tolerance)
        above.set(xlabel="x [segment lengths]", ylabel="y [segment lengths]")
        quartiles = speed_quartiles(drawn)
        draw_speed(below, quartiles, results.environments[results.base].control_step)
        below.set(xlabel="time [s]", ylabel="hand speed [lengths/s]")
        below.set(
            xlim=(0, (quartiles.shape[1] - 0.5) * results.environments[results.base].control_step)
        )
        below.set(ylim=(0, 1.05 * fastest))
    return figure


def learning(results: Results) -> ImageGroup | None:
    """Draw success over the course of training, of the agents whose learning curves are known."""
    if not results.curves:
        return None
    curves = curve_rows(results.curves)
    with rc_context(_STYLE):
        figure = draw_learning_curves(
            mean_curves(curves, "steps"), mean_curves(curves, "cpu_seconds")
        )
    image = Image(
        "Learning curves",
        "Success during training against environment steps, and against time",
        _data_url(figure),
    )
    counts = "; ".join(f"{name} {len(cards)}" for name, cards in results.curves.items())
    return ImageGroup((image,), f"Instances: the same for all agents. Training seeds: {counts}.")


def _data_url(figure: Figure) -> str:
    buffer = io.BytesIO()
    with rc_context(_STYLE):
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    return f"data:image/svg+xml;base64,{base64.b64encode(buffer.getvalue()).decode()}"
