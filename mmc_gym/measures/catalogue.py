"""The registry of measures: a decorator declares label, unit and direction of a function.

Every registered measure has a column in the data of comparisons and benchmarks.  Their tables and
the report show it if it is `shown`.  Register your own in the same way:

    from mmc_gym.measures import Episode, measure

    @measure(label="half-way time", unit="s", best="low", successes_only=True)
    def half_way_time(episode: Episode) -> float:
        half_way = episode.distances <= episode.distances[0] / 2
        return int(half_way.argmax()) * episode.control_step

On the command line name the module: `mmc-gym compare --import my_measures`.

Measures with `successes_only` are reported for the episodes that ended at the target, as is usual
for human movements: a hand that never moves has the shortest path, the least work and no overshoot.
The data hold them for all episodes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, TypeVar, get_args

import numpy as np

from mmc_gym._errors import UserError, require
from mmc_gym._tables import number
from mmc_gym.measures.episode import Episode

if TYPE_CHECKING:
    import pandas as pd

Statistic: TypeAlias = Literal["mean", "median"]
Direction: TypeAlias = Literal["high", "low", "neither"]

OfEpisode = TypeVar("OfEpisode", bound=Callable[[Episode], float])

PEOPLE = "people"  # their name in place of an agent's

# Shown in place of a unit: how a number without a unit is computed.
METHODS = ("correlation", "SPARC")

# Names of other columns of the data; no measure may use them.
_COLUMNS = (
    *("agent", "training_seed", "training_steps", "environment", "episode", "instance", "seed"),
    *("start_x", "start_y", "start_z", "target_x", "target_y", "target_z", "duration", "measure"),
)


def _not_here(episode: object) -> float:
    raise RuntimeError("this measure is known from a store, but its function is not loaded")


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """A number that tables show; its name is that of its column in the data, see `measure`."""

    name: str
    label: str
    unit: str = ""
    best: Direction = "neither"
    decimals: int = 2

    @property
    def facts(self) -> dict[str, Any]:
        """All attributes but the function, ready for JSON; `measures_of` reads them."""
        names = [field.name for field in fields(self) if field.name != "of"]
        return {name: getattr(self, name) for name in names}

    @property
    def shown_unit(self) -> str:
        """The unit that values are written in: fractions in percent."""
        return "%" if self.unit == "fraction" else self.unit

    @property
    def full_label(self) -> str:
        """The label, with the method in brackets where that replaces a unit."""
        return f"{self.label} ({self.unit})" if self.unit in METHODS else self.label

    def number(self, value: float) -> str:
        """Write a value without its unit, a fraction in percent."""
        scale, decimals = (100, 1) if self.unit == "fraction" else (1, self.decimals)
        return number(scale * value, decimals)

    def quantity(self, value: float) -> str:
        """Write a value as `number` does, with its unit if it has one."""
        text = self.number(value)
        has_unit = self.unit and self.unit not in METHODS and text != "–"
        return f"{text} {self.shown_unit}" if has_unit else text

    def interval(self, low: float, high: float) -> str:
        """Write the ends of an interval in brackets; return "" if they are NaN."""
        return f"[{self.number(low)}, {self.number(high)}]" if math.isfinite(low) else ""


@dataclass(frozen=True, kw_only=True)
class Measure(Quantity):
    """A measure, and its function `of` an episode; NaN where there is no value."""

    statistic: Statistic = "median"
    shown: bool = False
    successes_only: bool = False
    of: Callable[[Episode], float] = field(default=_not_here, compare=False)


@dataclass(frozen=True, kw_only=True)
class Published:
    """A published figure of people; see `people.yml` for what an attribute means."""

    quantity: str
    experiment: str = ""
    low: float = math.nan
    high: float = math.nan
    task: str = ""
    source: str = ""
    doi: str = ""
    differs: str = ""

    @property
    def authors(self) -> str:
        """The source's authors in short, and its year: "Day et al. 2016"."""
        names, _, rest = self.source.partition(" (")
        first, *others = names.split(", ")
        return f"{first} et al. {rest[:4]}" if others else f"{names} {rest[:4]}"


@cache
def people(experiment: str = "") -> dict[str, Published]:
    """Return the figures of people by measure: in a family of experiments, or single movements."""
    from mmc_gym._files import read_yaml  # loads YAML

    text = files("mmc_gym.measures").joinpath("people.yml").read_text(encoding="utf-8")
    rows = [Published(**row) for row in read_yaml(text) if "source" in row]
    return {row.quantity: row for row in rows if row.experiment == experiment}


def span(low: float, high: float) -> str:
    """Return a published range, a single figure, or a bound from below, as text.

    >>> span(0.1, 0.25), span(18.0, 18.0), span(1.0, float("nan"))
    ('0.1 to 0.25', '18', 'above 1')
    """
    if math.isnan(high):
        return f"above {low:g}"
    return f"{low:g}" if low == high else f"{low:g} to {high:g}"


MEASURES: dict[str, Measure] = {}
"""All measures of an episode by name, in the order of the columns."""


def measure(
    function: None = None,
    /,
    *,
    label: str = "",
    unit: str = "",
    best: Direction = "neither",
    statistic: Statistic = "median",
    decimals: int = 2,
    shown: bool = False,
    successes_only: bool = False,
) -> Callable[[OfEpisode], OfEpisode]:
    """Register a function `Episode -> float` as a measure, under the function's name.

    Args:
        function: none; so that `@measure` without brackets is noticed.
        label: heading in tables.
        unit: of the values; "fraction" is shown in percent, "" is a plain number.
        best: "high" or "low" if such values are good, else "neither".
        statistic: what tables show for many episodes, "mean" or "median".
        decimals: number of decimals shown; a fraction always has one, in percent.
        shown: whether tables show it; files hold all measures.
        successes_only: whether it is reported only for episodes that ended at the target.

    Raises:
        UserError: without a label or brackets, if the name is taken, or a value is not accepted.
    """
    accepted = 'used as @measure(label="..."), with its brackets'
    require(function is None, "@measure", function, accepted)
    require(isinstance(label, str) and bool(label), "@measure", label, accepted)
    facts: Any = {"label": label, "unit": unit, "best": best, "decimals": decimals}
    facts |= {"statistic": statistic, "shown": shown, "successes_only": successes_only}

    def decorate(function: OfEpisode) -> OfEpisode:
        register(Measure(name=function.__name__, of=function, **facts))
        return function

    return decorate


def register(new: Measure) -> None:
    """Register a measure; raise a `UserError` if its name is taken or a value is not accepted."""
    for name, accepted in (("best", get_args(Direction)), ("statistic", get_args(Statistic))):
        value = getattr(new, name)
        require(value in accepted, f"{name} of {new.name!r}", value, f"one of {accepted}")
    known = MEASURES.get(new.name)
    # The same function may be registered again: a notebook's cell runs twice, a worker imports it.
    if new.name in _COLUMNS or (known and _origin(known) != _origin(new)):
        owner = _origin(known) if known else "a column of the data"
        raise UserError(f"a measure must have a new name, got {new.name!r}: {owner} has it")
    MEASURES[new.name] = new


def _origin(known: Measure) -> str:
    return f"{known.of.__module__}.{known.of.__qualname__}"


def own_measures() -> tuple[Measure, ...]:
    """Return the measures that users have registered; workers must `register` them as well."""
    known = MEASURES.values()
    return tuple(measure for measure in known if not measure.of.__module__.startswith("mmc_gym."))


def measures_of(facts: Mapping[str, Any]) -> dict[str, Measure]:
    """Return all registered measures by name, then those that only a store has `facts` of."""
    return MEASURES | {key: Measure(**facts[key]) for key in facts if key not in MEASURES}


def shown_measures() -> tuple[Measure, ...]:
    """Return the measures that tables show."""
    return tuple(measure for measure in MEASURES.values() if measure.shown)


def measure_all(episode: Episode) -> dict[str, float]:
    """Return the values of all measures of an episode, by name; refuse what is no number."""
    values = {}
    for name, measure in MEASURES.items():
        value: Any = measure.of(episode)
        if not isinstance(value, float):
            is_single = np.asarray(value, dtype=object).ndim == 0
            is_number = is_single and np.asarray(value).dtype.kind in "fiub"
            require(is_number, f"what measure {name!r} returns", value, "a number")
        values[name] = float(value)
    return values


def leave_out_failures(
    episodes: pd.DataFrame, measures: Iterable[Measure] | None = None
) -> pd.DataFrame:
    """Set the columns of `successes_only` measures (of `MEASURES`, if None) to NaN in failures."""
    known = MEASURES.values() if measures is None else measures
    names = [row.name for row in known if row.successes_only and row.name in episodes]
    arrived = episodes["success"] == 1.0
    return episodes.assign(**episodes[names].astype(np.float64).where(arrived))
