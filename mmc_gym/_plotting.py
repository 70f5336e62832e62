"""The figure of a comparison: hand paths above, speed profiles below, a column per agent."""

from __future__ import annotations

import io
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from mmc_gym._files import write_atomically
from mmc_gym.measures.episode import Episode, hand_speed

EXAMPLES = 4  # paths shown per agent
LINES = ("-", "--", "-.", (0, (1, 1)))  # so that episodes differ without colour too
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#7f3b8c")  # Okabe and Ito: safe for colour blindness
STYLE: Any = {
    "font.size": 8,
    "axes.titlesize": 9,
    "legend.fontsize": 7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "svg.fonttype": "none",  # text stays text
    "svg.hashsalt": "mmc-gym",  # the same figure gives the same file
}


def paths_and_profiles(episodes: Mapping[str, Sequence[Episode]], reach: float) -> Figure:
    """Draw the hand paths of the first episodes, and the speed profile over all of them.

    Args:
        episodes: of each agent, by the name to stand above its column.
        reach: radius of the disc that the hand can reach, segment lengths.
    """
    columns = len(episodes)
    width = max(2.3 * columns, 5.0)
    with rc_context(STYLE):
        figure = Figure(figsize=(width, 5.2), layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.subplots(
            2, columns, squeeze=False, sharex="row", sharey="row", height_ratios=(1.3, 1)
        )
        for (above, below), (name, recorded) in zip(axes.T, episodes.items(), strict=True):
            above.set_title(name)
            _draw_paths(above, recorded[:EXAMPLES], reach)
            _draw_profile(below, recorded)
        axes[0, 0].set_ylabel("y [segment lengths]")
        axes[1, 0].set_ylabel("hand speed\n[segment lengths/s]")
        axes[1, 0].set_ylim(bottom=0)
        axes[1, 0].legend(frameon=False, loc="upper right")
        caption = _caption(len(next(iter(episodes.values()))))
        figure.supxlabel(textwrap.fill(caption, round(18 * width)), fontsize=7, linespacing=1.4)
    return figure


def save_figure(figure: Figure, stem: Path) -> list[Path]:
    """Write `figure` as `stem`.png and `stem`.svg."""
    written = []
    for suffix, metadata in ((".png", {}), (".svg", {"Date": None})):
        buffer = io.BytesIO()
        with rc_context(STYLE):
            figure.savefig(buffer, format=suffix[1:], dpi=150, metadata=metadata)
        written.append(write_atomically(stem.with_suffix(suffix), buffer.getvalue()))
    return written


def _caption(count: int) -> str:
    return (
        f"Above: hand paths in episodes 1 to {min(count, EXAMPLES)}, from the open circle to the "
        "dot; the cross is the target, the ring around it the distance that counts as success; "
        f"dotted: reach. Below: hand speed, median and quartiles over {count} episodes (starts "
        "and targets, the same for all agents; not training seeds: one training run each)."
    )


def _draw_paths(axes: Axes, episodes: Sequence[Episode], reach: float) -> None:
    axes.add_patch(Circle((0, 0), reach, fill=False, color="0.6", linestyle=":", linewidth=0.8))
    for number, episode in enumerate(episodes):
        colour, target = COLOURS[number], tuple(episode.target)
        axes.plot(*episode.seen_hands.T, color=colour, linestyle=LINES[number], linewidth=1.1)
        axes.plot(*target, "+", color="black", markersize=8, markeredgewidth=0.6)
        axes.add_patch(Circle(target, episode.tolerance, fill=False, linewidth=0.8))
        axes.plot(*episode.seen_hands[0], "o", color=colour, markersize=5, markerfacecolor="white")
        axes.plot(*episode.seen_hands[-1], "o", color=colour, markersize=2.5)
        axes.annotate(
            str(number + 1),
            target,
            (5, 4),
            textcoords="offset points",
            color=colour,
            zorder=5,
            path_effects=[withStroke(linewidth=2, foreground="white")],
        )
    border = 1.05 * reach
    axes.set(xlim=(-border, border), ylim=(-border, border), aspect="equal")
    axes.set_xlabel("x [segment lengths]")


def _draw_profile(axes: Axes, episodes: Sequence[Episode]) -> None:
    control_step = episodes[0].control_step
    speeds = _padded([hand_speed(episode.hands, control_step) for episode in episodes])
    # A difference quotient is the speed in the middle of its step.
    times = (np.arange(speeds.shape[1]) + 0.5) * control_step
    low, median, high = np.nanpercentile(speeds, (25, 50, 75), axis=0)
    axes.fill_between(times, low, high, color="0.8", linewidth=0, label="quartiles")
    axes.plot(times, median, color="black", linewidth=1.2, label="median")
    axes.set_xlabel("time [s]")


def _padded(profiles: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Profiles (episodes, longest); shorter ones end in NaN, and drop out of the quartiles."""
    padded = np.full((len(profiles), max(map(len, profiles))), np.nan)
    for row, profile in zip(padded, profiles, strict=True):
        row[: len(profile)] = profile
    return padded
