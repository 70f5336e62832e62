"""The figure of the accurate normalizer: angle error by length, and distance over iterations."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mmc_gym._plotting import COLOURS, LINES, STYLE
from mmc_gym.network.chain import Floats


@dataclass(frozen=True, eq=False)
class Curves:
    """Angle errors by length, (lengths,), and distances, (movements, iterations)."""

    mean_error: Floats
    worst_error: Floats
    distance: Floats


def draw_accurate(lengths: Floats, curves: Mapping[str, Curves], exact: str) -> Figure:
    """Draw the errors of all but the exact normalizer, and the distances of all."""
    with rc_context(STYLE):
        figure = Figure(figsize=(7.2, 3.2), layout="constrained")
        left, right = figure.subplots(1, 2)
        for number, (name, curve) in enumerate(curves.items()):
            colour, line = COLOURS[number], LINES[number]
            if name != exact:
                _draw_errors(left, lengths, curve, name, colour, line)
            mean = curve.distance.mean(axis=0)
            iterations = np.arange(1, len(mean) + 1)
            # Wide below, so that curves that coincide are both seen.
            width = 3.5 if name == exact else 1.3
            right.plot(
                *(iterations, mean),
                color="0.75" if name == exact else colour,
                linestyle=line,
                linewidth=width,
                label=name,
            )
        left.set(yscale="log", xlim=(0, 3), xlabel="length of input [segment lengths]")
        left.set_ylabel("angle error [°]")
        left.legend(frameon=False)
        right.set(yscale="log", xlabel="iteration", ylabel="normalized distance to target")
        right.legend(frameon=False)
    return figure


def _draw_errors(
    axes: Axes, lengths: Floats, curve: Curves, name: str, colour: str, line: object
) -> None:
    axes.plot(lengths, curve.worst_error, color=colour, linewidth=0.6, label=f"{name}, worst")
    axes.plot(
        *(lengths, curve.mean_error),
        color=colour,
        linestyle=line,
        linewidth=1.5,
        label=f"{name}, mean",
    )
