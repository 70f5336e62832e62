"""The style of the studies' figures, and their files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from matplotlib import rc_context
from matplotlib.figure import Figure

LINES = ("-", "--", "-.", (0, (1, 1)))  # so that curves differ without colour too
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


def save_figure(figure: Figure, stem: Path) -> None:
    """Write a figure as `stem`.png and `stem`.svg."""
    stem.parent.mkdir(parents=True, exist_ok=True)
    with rc_context(STYLE):
        figure.savefig(stem.with_suffix(".png"), dpi=150)
        figure.savefig(stem.with_suffix(".svg"), metadata={"Date": None})
