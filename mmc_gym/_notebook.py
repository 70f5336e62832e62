"""Pictures and tables of objects in a notebook: facts as HTML, pictures as PNG."""

from __future__ import annotations

import inspect
import io
from collections.abc import Mapping
from html import escape

import numpy as np
from numpy.typing import NDArray

from mmc_gym._tables import text_table, to_html


def facts_table(thing: object, facts: Mapping[str, str]) -> str:
    """Return HTML with an object's class, its docstring's first line, and a row for each fact."""
    first = (inspect.getdoc(type(thing)) or "").partition("\n")[0]
    return (
        f"<p><b>{type(thing).__name__}</b>: {escape(first)}</p>{to_html(text_table(facts.items()))}"
    )


def png(picture: NDArray[np.uint8], shrink: int = 1) -> bytes:
    """Return a picture (height, width, 3) as PNG, with each side divided by `shrink`."""
    from PIL import Image

    file = io.BytesIO()
    Image.fromarray(picture).reduce(shrink).save(file, format="PNG")
    return file.getvalue()
