"""Published figures of people; `people.yml` has tasks, sources, and how our tasks differ."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import yaml


@dataclass(frozen=True, kw_only=True)
class Published:
    """A figure of people for a measure of this package, in its unit; None for what is not known."""

    quantity: str  #: name of the measure
    low: float | None = None
    high: float | None = None  #: equal to `low` for a single figure
    task: str = ""
    source: str = ""
    doi: str = ""
    differs: str = ""  #: how the task differs from ours
    missing: str = ""  #: what was looked for and not found

    @property
    def figure(self) -> str:
        """The figure as a number, a range or a bound; "–" without one."""
        low, high = ("" if end is None else f"{end:g}" for end in (self.low, self.high))
        if low and high:
            return low if low == high else f"{low} to {high}"
        return f"above {low}" if low else f"below {high}" if high else "–"

    @property
    def authors(self) -> str:
        """The source's authors in short, and its year: "Day et al. 2016"."""
        names, _, rest = self.source.partition(" (")
        first, *others = names.split(", ")
        return f"{first} et al. {rest[:4]}" if others else f"{names} {rest[:4]}".strip()


@cache
def people() -> dict[str, Published]:
    """Return the published figures by measure."""
    text = (Path(__file__).parents[1] / "people.yml").read_text(encoding="utf-8")
    return {row["quantity"]: Published(**row) for row in yaml.safe_load(text)}
