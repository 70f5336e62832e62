"""How the report writes numbers: units, decimals, intervals, and over what they were taken."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from mmc_gym.benchmark.statistics import Estimate
from mmc_gym.measures import Measure
from mmc_gym.report.results import Results

_KINDS = ("correlation", "SPARC", "log dimensionless jerk")
"""What measures have instead of a unit: it says what was computed, and stands with the label."""

_MOST_DECIMALS = 3  # more than usual


def label(measure: Measure) -> str:
    """What a measure is called in a sentence."""
    return f"{measure.label} ({measure.unit})" if measure.unit in _KINDS else measure.label


def unit(measure: Measure) -> str:
    """The unit that values are shown in: fractions as percents."""
    return "%" if measure.unit == "fraction" else measure.unit


def number(measure: Measure, value: float, more: int = 0) -> str:
    """A value of a measure without its unit; always as many decimals, so that columns align.

    Args:
        measure: whose it is.
        value: in the measure's unit.
        more: decimals than usual.

    Example:
        >>> from mmc_gym.measures import MEASURES
        >>> number(MEASURES["success"], 0.975)
        '97.5'
    """
    if not math.isfinite(value):
        return "–"
    scale, decimals = (100, 1) if measure.unit == "fraction" else (1, measure.decimals)
    decimals += more
    text = written(scale * value, decimals)
    is_hidden = value > 0 and float(text) == 0
    return f"<{10.0**-decimals:.{decimals}f}" if is_hidden else text


def written(value: float, decimals: int) -> str:
    """A number with so many decimals, a true minus sign, and none before zero.

    Example:
        >>> written(-0.25, 2), written(-0.001, 2)
        ('−0.25', '0.00')
    """
    text = f"{value:.{decimals}f}"
    return text.removeprefix("-") if float(text) == 0 else text.replace("-", "−")


def resolution(measure: Measure) -> float:
    """The size of the last decimal that is shown of a measure, in its unit.

    Example:
        >>> from mmc_gym.measures import MEASURES
        >>> resolution(MEASURES["success"])
        0.001
    """
    return 0.001 if measure.unit == "fraction" else float(10.0**-measure.decimals)


def quantity(measure: Measure, value: float, more: int = 0) -> str:
    """A value of a measure with its unit, if it has one; arguments as `number` has them."""
    text = number(measure, value, more)
    has_unit = unit(measure) and measure.unit not in _KINDS
    return f"{text} {unit(measure)}" if has_unit and text != "–" else text


def decimals_apart(measure: Measure, one: float, other: float) -> int:
    """How many more decimals than usual it takes to see that two values are not the same.

    Example:
        >>> from mmc_gym.measures import MEASURES
        >>> success = MEASURES["success"]
        >>> decimals_apart(success, 0.97501, 0.97504), decimals_apart(success, 0.9, 0.8)
        (2, 0)
    """
    for more in range(_MOST_DECIMALS):
        if number(measure, one, more) != number(measure, other, more):
            return more
    return 0  # nobody would see it


def interval(measure: Measure, estimate: Estimate) -> str:
    """The ends of an interval, in brackets; empty if there is none."""
    if not math.isfinite(estimate.low):
        return ""
    return f"[{number(measure, estimate.low)}, {number(measure, estimate.high)}]"


def count(number_of: int, noun: str) -> str:
    """A number and its noun.

    Example:
        >>> count(1, "seed"), count(1200, "seed")
        ('1 seed', '1,200 seeds')
    """
    return f"{number_of:,} {noun}{'' if number_of == 1 else 's'}"


def listed(items: Sequence[str]) -> str:
    """Items with commas, the last with "and".

    Example:
        >>> listed(["a", "b", "c"])
        'a, b and c'
    """
    return " and ".join([", ".join(items[:-1]), items[-1]] if len(items) > 1 else items)


def seeds_of(results: Results, agents: Iterable[str], environments: Iterable[str] = ()) -> str:
    """Over how many training seeds the figures of agents are, for captions.

    Args:
        results: of the benchmark.
        agents: in the figure; those that were in none of the environments are left out.
        environments: in the figure; all by default.
    """
    keys = tuple(environments)
    by_count: dict[tuple[int, int], list[str]] = {}
    for agent in agents:
        if (found := results.seeds(agent, keys)) is not None:
            by_count.setdefault(found, []).append(agent)
    trained = [
        f"{listed(names)} {low if low == high else f'{low} to {high}'}"
        for (low, high), names in sorted(by_count.items())
        if high
    ]
    parts = [f"Training seeds: {'; '.join(trained)}"] if trained else []
    if (0, 0) in by_count:
        parts.append(f"{'not trained' if trained else 'Not trained'}: {listed(by_count[0, 0])}")
    return f"{'; '.join(parts)}." if parts else ""


def seeds_in_words(results: Results, agent: str, environment: str) -> str:
    """Over how many training seeds the figure of an agent is, in a sentence."""
    _, number_of = results.seeds(agent, [environment]) or (0, 0)
    return count(number_of, "training seed") if number_of else "not trained"


def instances_of(results: Results, environments: Iterable[str]) -> str:
    """Over how many instances (starts and targets) figures are, for captions."""
    counts = sorted({results.instances(environment) for environment in environments})
    if not counts:
        return "No instances."
    span = str(counts[0]) if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
    each = " in each environment" if len(counts) > 1 else ""
    return f"Instances (starts and targets, the same for all agents): {span}{each}."
