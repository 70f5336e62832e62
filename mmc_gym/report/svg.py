"""Matplotlib figures as SVG that stand in a page beside others: own ids, no style of their own."""

from __future__ import annotations

import io
import re

from markupsafe import Markup, escape
from matplotlib import rc_context
from matplotlib.figure import Figure

from mmc_gym._plotting import STYLE

_ID = re.compile(r'\bid="([^"]+)"')
_REFERENCE = re.compile(r'(url\(#|href="#)([^")]+)')
_DROPPED = re.compile(r"<metadata>.*?</metadata>|<style[^>]*>.*?</style>|<!--.*?-->", re.DOTALL)
_NUMBER = re.compile(r"(?<=[ \"(,])(-?\d+\.\d{2})\d+")
_FONT = re.compile(r"font: (?:[a-z0-9 ]*?)([\d.]+)px [^;\"]*")


def to_svg(figure: Figure, key: str, description: str) -> Markup:
    """The figure as an `svg` element.

    Args:
        figure: what to draw.
        key: unique in the page; all ids begin with it.
        description: what stands for the figure where it cannot be seen.
    """
    buffer = io.StringIO()
    with rc_context({**STYLE, "svg.hashsalt": key}):
        figure.savefig(buffer, format="svg", metadata={"Date": None}, transparent=True)
    text = buffer.getvalue()
    text = _DROPPED.sub("", text[text.index("<svg") :])
    used = {name for _, name in _REFERENCE.findall(text)}
    text = _ID.sub(lambda m: f'id="{key}-{m[1]}"' if m[1] in used else "", text)
    text = _REFERENCE.sub(lambda m: f"{m[1]}{key}-{m[2]}", text)
    text = _FONT.sub(lambda m: f"font-size: {m[1]}px", _NUMBER.sub(r"\1", text))
    text = re.sub(r"\n\s*", "\n", text)
    label = f'role="img" aria-label="{escape(description)}"'
    return Markup(text.replace("<svg ", f"<svg {label} ", 1).strip())
