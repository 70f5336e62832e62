"""How the report writes numbers: units, decimals, intervals, and over what they were taken."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from mmc_gym.evaluation.measures import Measure
from mmc_gym.evaluation.replication import Estimate
from mmc_gym.evaluation.report.data import Results

_KINDS = ("correlation", "SPARC", "log dimensionless jerk")
"""What measures have instead of a unit: it says what was computed, and stands with the label."""


def label(measure: Measure) -> str:
    """What a measure is called in a sentence."""
    return f"{measure.label} ({measure.unit})" if measure.unit in _KINDS else measure.label


def unit(measure: Measure) -> str:
    """The unit that values are shown in: fractions as percents."""
    return "%" if measure.unit == "fraction" else measure.unit


def number(measure: Measure, value: float) -> str:
    """A value of a measure without its unit; always as many decimals, so that columns align.

    Example:
        >>> from mmc_gym.evaluation.measures import MEASURES
        >>> number(MEASURES[0], 0.975)
        '97.5'
    """
    if not math.isfinite(value):
        return "–"
    scale, decimals = (100, 1) if measure.unit == "fraction" else (1, measure.decimals)
    text = f"{scale * value:.{decimals}f}"
    if float(text) == 0:
        text = text.removeprefix("-")
        if value > 0:
            return f"<{10.0**-decimals:.{decimals}f}"
    return text.replace("-", "−")


def quantity(measure: Measure, value: float) -> str:
    """A value of a measure with its unit, if it has one."""
    text = number(measure, value)
    has_unit = unit(measure) and measure.unit not in _KINDS
    return f"{text} {unit(measure)}" if has_unit and text != "–" else text


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


def seeds_of(results: Results, agents: Iterable[str]) -> str:
    """Over how many training seeds the figures of agents are, for captions."""
    by_count: dict[int, list[str]] = {}
    for agent in agents:
        by_count.setdefault(results.seeds(agent), []).append(agent)
    trained = [
        f"{listed(names)} {number_of}" for number_of, names in sorted(by_count.items()) if number_of
    ]
    parts = [f"Training seeds: {'; '.join(trained)}"] if trained else []
    if 0 in by_count:
        parts.append(f"{'not trained' if trained else 'Not trained'}: {listed(by_count[0])}")
    return "; ".join(parts) + "."


def instances_of(results: Results, environments: Iterable[str]) -> str:
    """Over how many instances (starts and targets) figures are, for captions."""
    counts = sorted({results.instances(environment) for environment in environments})
    if not counts:
        return "No instances."
    span = str(counts[0]) if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
    each = " in each environment" if len(counts) > 1 else ""
    return f"Instances (starts and targets, the same for all agents): {span}{each}."
