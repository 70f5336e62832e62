"""Pictures and tables of objects in a notebook: facts as HTML, pictures as PNG."""

from __future__ import annotations

import inspect
import io
from collections.abc import Mapping
from html import escape
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import pandas as pd


def facts_table(thing: object, facts: Mapping[str, str]) -> str:
    """Return HTML with an object's class, its docstring's first line, and a row for each fact."""
    first = (inspect.getdoc(type(thing)) or "").partition("\n")[0]
    rows = "".join(
        f'<tr><th style="text-align: left">{escape(heading)}</th><td>{escape(fact)}</td></tr>'
        for heading, fact in facts.items()
    )
    return f"<p><b>{type(thing).__name__}</b>: {escape(first)}</p><table>{rows}</table>"


def html_table(frame: pd.DataFrame, index: bool = True) -> str:
    """Return a table of texts as HTML, with their line breaks, which pandas escapes since 3.1."""
    import pandas as pd

    def written(text: object) -> str:
        return escape(str(text)).replace("\n", "<br>")

    shown = frame.map(written).rename(index=written, columns=written)
    with pd.option_context("display.max_colwidth", None):
        html: str = shown.to_html(border=0, index=index, escape=False)
    return html


def png(picture: NDArray[np.uint8], shrink: int = 1) -> bytes:
    """Return a picture (height, width, 3) as PNG, with each side divided by `shrink`."""
    from PIL import Image

    file = io.BytesIO()
    Image.fromarray(picture).reduce(shrink).save(file, format="PNG")
    return file.getvalue()
