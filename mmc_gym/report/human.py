"""Is learning as human-like as the network?  Said only where the data can tell.

Each measure of being like people's movements is compared by the 95 % interval of the difference,
paired by instance, with a margin m within which two agents count as the same:

    within ±m                  the same
    else above 0               clearly more human-like
    else below 0               clearly less
    else                       cannot be told apart: on more instances they might be

The margins are as large as what lies between two models of how people reach, minimum jerk and
minimum acceleration: a hand that differs less from another than these two from each other is not
further from people in a way that those models, and the data that they were made for, could show.
Both bells, τ²(1 − τ)² and τ(1 − τ), went through the same measures; of strokes, half a stroke.

Source:
    Flash and Hogan (1985), J. Neurosci. 5(7), 1688–1703; minimum acceleration, jerk and snap beside
    each other: Richardson and Flash (2002), J. Neurosci. 22(18), 8201–8211.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from mmc_gym.benchmark.replication import Estimate
from mmc_gym.measures.catalogue import MEASURES, Measure
from mmc_gym.report.numbers import count, interval, label, number, seeds_in_words
from mmc_gym.report.scores import Estimates
from mmc_gym.report.sentences import base_of

LEARNED = "ppo-smooth"
NETWORKS = ("mmc", "mmc-bell")

MARGINS: Mapping[str, float] = {
    "minimum_jerk_correlation": 0.01,
    "velocity_peaks": 0.5,
    "sparc": 0.18,
}
HUMAN: tuple[Measure, ...] = tuple(
    next(measure for measure in MEASURES if measure.name == name) for name in MARGINS
)
"""Measures of being like people's movements: bell-shaped, of one stroke, smooth."""

Finding = Literal["same", "more", "less", "unclear"]


@dataclass(frozen=True)
class Likeness:
    """Two agents beside each other in one measure.

    Attributes:
        measure: what is compared.
        learned: figure of the one.
        network: of the other.
        difference: of the two, paired by instance.
        finding: for the first of them.
    """

    measure: Measure
    learned: Estimate
    network: Estimate
    difference: Estimate
    finding: Finding


def human_likeness(estimates: Estimates) -> list[str]:
    """Whether learning with a reward for smoothness moves as people do, beside the network."""
    results = estimates.results
    environment = base_of(results)
    learned = results.labelled(LEARNED)
    if learned is None:
        return ["No agent that was trained with a reward for smoothness took part."]
    sentences = []
    for name in NETWORKS:
        network = results.labelled(name)
        found = likeness(estimates, environment, learned, network) if network else []
        if network and found:
            details = "; ".join(_detail(one) for one in found)
            instances = count(min(one.difference.instances for one in found), "instance")
            seeds = seeds_in_words(results, learned, environment)
            sentences.append(
                f"{verdict([one.finding for one in found], learned, network)} "
                f"({environment}, {instances}, {learned}: {seeds}; {details})"
            )
    return sentences or [f"There are too few movements to compare {learned} and the network by."]


def likeness(estimates: Estimates, environment: str, learned: str, network: str) -> list[Likeness]:
    """Two agents beside each other, in every measure where both have enough values."""
    compared = []
    for measure in HUMAN:
        if measure not in estimates.results.measures:
            continue
        figures = estimates.taking_part(environment, measure, [learned, network])
        difference = None
        if len(figures) == 2:
            difference = estimates.scores(environment).difference(learned, network, measure)
        if difference is not None:
            compared.append(
                Likeness(
                    measure,
                    figures[learned],
                    figures[network],
                    difference,
                    find(difference, measure),
                )
            )
    return compared


def find(difference: Estimate, measure: Measure) -> Finding:
    """What the interval of a difference says, beside the measure's margin."""
    low, high = difference.low, difference.high
    if measure.best == "low":
        low, high = -high, -low
    margin = MARGINS[measure.name]
    if -margin <= low and high <= margin:
        return "same"
    return "more" if low > 0 else "less" if high < 0 else "unclear"


def verdict(findings: Sequence[Finding], learned: str, network: str) -> str:
    """What the findings of all measures come to."""
    number_of = {one: findings.count(one) for one in ("same", "more", "less", "unclear")}
    total = count(len(findings), "measure")
    who = f"Reinforcement learning with a reward for smoothness ({learned})"
    if number_of["more"] and number_of["less"]:
        return (
            f"{who} is more human-like than {network} by {number_of['more']} of {total} and less "
            f"by {number_of['less']}"
        )
    if number_of["less"]:
        said = f"{who} is less human-like than {network} by {number_of['less']} of {total}"
    elif number_of["more"]:
        said = f"{who} is more human-like than {network} by {number_of['more']} of {total}"
    elif number_of["unclear"] == 0:
        return f"{who} is as human-like as {network}: the same within the margin by {total}"
    else:
        said = f"{who} and {network} cannot be told apart by {number_of['unclear']} of {total}"
        same = f", and are the same within the margin by {number_of['same']}"
        return f"{said}{same if number_of['same'] else ''}"
    rest = [f"the same within the margin by {number_of['same']}"] * (number_of["same"] > 0)
    rest += [f"not to be told apart by {number_of['unclear']}"] * (number_of["unclear"] > 0)
    return ", ".join([said, *rest])


def margins() -> str:
    """The margins, and why, for the reader."""
    each = "; ".join(f"{label(one)} {MARGINS[one.name]:g}" for one in HUMAN)
    return (
        "Two agents count as the same in a measure where the 95 % interval of their difference, "
        f"paired by instance, lies within a margin to both sides ({each}). The margins of the "
        "first and the last are what lies between two models of how people reach, minimum jerk "
        "and minimum acceleration, sent through the same measures; that of velocity peaks is half "
        "a stroke. Where the interval includes both 0 and more than the margin, the instances "
        "cannot tell two agents apart, which does not make them the same."
    )


def _detail(one: Likeness) -> str:
    said = {
        "same": "the same within the margin",
        "more": "clearly more human-like",
        "less": "clearly less human-like",
        "unclear": "cannot be told apart",
    }[one.finding]
    measure = one.measure
    return (
        f"{label(measure)} {number(measure, one.learned.estimate)} against "
        f"{number(measure, one.network.estimate)}, difference "
        f"{number(measure, one.difference.estimate)} {interval(measure, one.difference)}: {said}"
    )
