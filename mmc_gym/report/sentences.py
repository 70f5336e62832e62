"""The sentences of the report, computed from the figures: no result is written here.

What the network does best and where it is beaten are told by the same rule, in the same form.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Literal

from mmc_gym.benchmark.statistics import Estimate
from mmc_gym.benchmark.suite import BASELINE
from mmc_gym.measures import MEASURES, Measure
from mmc_gym.report.numbers import (
    count,
    decimals_apart,
    interval,
    label,
    listed,
    number,
    quantity,
    seeds_in_words,
)
from mmc_gym.report.results import Results
from mmc_gym.report.scores import COMMON, Comparison, Estimates, Outcome, rivals_of
from mmc_gym.training.curves import LEVELS, first_reached

EXAMPLES = 3
"""Environments that a sentence names, those of the largest differences."""

SUCCESS = MEASURES["success"]


@dataclass(frozen=True)
class Standing:
    """Where an agent stands among its rivals.

    Attributes:
        agent: its name.
        counts: comparisons by outcome.
        better: sentences, one for each measure, of where it is clearly better than all rivals.
        worse: sentences of the same form, of where the best rival is clearly better.
    """

    agent: str
    counts: dict[Outcome, int]
    better: tuple[str, ...]
    worse: tuple[str, ...]

    @property
    def total(self) -> int:
        """Number of comparisons."""
        return sum(self.counts.values())


def scope(results: Results) -> str:
    """How much was played."""
    policies = results.episodes[["agent", "training_seed"]].drop_duplicates()
    return (
        f"{count(len(results.agents), 'agent')}, {len(policies):,} policies "
        f"with all training seeds, {count(len(results.environments), 'environment')}, "
        f"{count(len(results.episodes), 'episode')}."
    )


def overview(estimates: Estimates) -> list[str]:
    """The success of the best of each kind, without perturbation."""
    results = estimates.results
    environment = base_of(results)
    figures = estimates.taking_part(environment, SUCCESS, results.agents)
    best: dict[str, str] = {}
    for agent in figures:
        kind = results.kind(agent)
        if kind in ("ideal", "baseline"):
            continue
        if kind not in best or figures[agent].estimate > figures[best[kind]].estimate:
            best[kind] = agent
    if not best:
        return []
    parts = [
        f"{agent} ({kind}, {seeds_in_words(results, agent, environment)}) "
        f"{quantity(SUCCESS, figures[agent].estimate)} {interval(SUCCESS, figures[agent])}"
        for kind, agent in best.items()
    ]
    instances = count(results.instances(environment), "instance")
    return [
        f"Success in {environment}, the best of each kind of agent: {'; '.join(parts)} "
        f"({instances}; 95 % intervals)."
    ]


def standing(board: Sequence[Comparison], agent: str) -> Standing:
    """Where an agent stands, from what `estimates.scoreboard` returned."""
    outcomes: tuple[Outcome, ...] = ("better", "worse", "unclear", "equal")
    return Standing(
        agent,
        {one: sum(entry.outcome == one for entry in board) for one in outcomes},
        tuple(_sentences(board, "better")),
        tuple(_sentences(board, "worse")),
    )


def _sentences(board: Sequence[Comparison], outcome: Outcome) -> list[str]:
    sentences = []
    for measure in dict.fromkeys(entry.measure for entry in board):
        compared = [entry for entry in board if entry.measure == measure]
        found = sorted((e for e in compared if e.outcome == outcome), key=_gap, reverse=True)
        if not found:
            continue
        examples = [
            f"{entry.environment} ({' against '.join(_both(entry))} of {entry.rival})"
            for entry in found[:EXAMPLES]
        ]
        more = [f"{len(found) - EXAMPLES} more"] if len(found) > EXAMPLES else []
        sentences.append(
            f"{label(measure)}: in {len(found)} of {count(len(compared), 'environment')}: "
            f"{listed([*examples, *more])}"
        )
    return sentences


def _both(entry: Comparison) -> tuple[str, str]:
    """The two figures, with as many decimals as it takes to tell them apart."""
    mine, theirs = entry.mine.estimate, entry.theirs.estimate
    more = decimals_apart(entry.measure, mine, theirs)
    return number(entry.measure, mine, more), quantity(entry.measure, theirs, more)


def _gap(entry: Comparison) -> float:
    mine, theirs = entry.mine.estimate, entry.theirs.estimate
    return abs(mine - theirs) / max(abs(mine), abs(theirs), 1e-12)


def sample_cost(results: Results) -> list[str]:
    """What learning costs, in steps of the environment and in minutes of one core."""
    sentences = []
    for name, cards in results.curves.items():
        parts = []
        for level in LEVELS:
            steps = median(first_reached(card, level, "steps") for card in cards)
            minutes = median(first_reached(card, level, "cpu_seconds") for card in cards) / 60
            when = "never" if math.isinf(steps) else f"after {steps:,.0f} steps ({minutes:.1f} min)"
            parts.append(f"{100 * level:.0f} % success {when}")
        sentences.append(f"{name}: {listed(parts)}; median of {count(len(cards), 'training seed')}")
    return sentences


def robustness(estimates: Estimates, agent: str) -> list[str]:
    """At the hardest of each family of perturbations: who succeeds most, and the agent."""
    results = estimates.results
    sentences = []
    for family, keys in families(results).items():
        key = hardest(estimates, keys)
        figures = estimates.taking_part(key, SUCCESS, results.agents)
        if agent not in figures:
            continue
        best = max(figures, key=lambda name: figures[name].estimate)
        own = quantity(SUCCESS, figures[agent].estimate)
        most = quantity(SUCCESS, figures[best].estimate)
        equal = figures[best].estimate == figures[agent].estimate
        seeds = seeds_in_words(results, best, key)
        who = "none more" if equal else f"{best} ({seeds}), the most of all, in {most}"
        about = results.environments[key].description or family
        instances = count(results.instances(key), "instance")
        sentences.append(f"{key} ({about}; {instances}): {agent} succeeds in {own}; {who}")
    return sentences


def hardest(estimates: Estimates, keys: Sequence[str]) -> str:
    """The environment with the least success over all agents; of equal ones the last."""

    def success(key: str) -> float:
        figures = estimates.of(key, SUCCESS).values()
        return round(sum(estimate.estimate for estimate in figures) / len(figures), 9)

    return min(reversed(keys), key=success)


def families(results: Results) -> dict[str, list[str]]:
    """Keys of the perturbed environments by family, weakest first."""
    found: dict[str, list[str]] = {}
    for key, environment in results.environments.items():
        if environment.family:
            found.setdefault(environment.family, []).append(key)
    strength = {key: environment.strength for key, environment in results.environments.items()}
    return {family: sorted(keys, key=lambda key: strength[key]) for family, keys in found.items()}


def nothing_compared(results: Results, networks: Sequence[str]) -> str:
    """Why there are no comparisons, if there are none."""
    if not networks:
        return "The network did not take part in this benchmark."
    if not any(rivals_of(results, agent) for agent in networks):
        return "The network has no rival in this benchmark."
    return f"There are fewer than {COMMON} instances in common to compare agents on."


def not_played(results: Results) -> list[str]:
    """What could not be played, by agent and reason."""
    groups: dict[tuple[str, str], dict[str, None]] = {}
    for cell, reason in results.not_played:
        groups.setdefault((cell.agent, reason), {})[cell.environment] = None
    return [
        f"{agent} in {listed(list(environments))}: {reason}"
        for (agent, reason), environments in groups.items()
    ]


def base_of(results: Results) -> str:
    """The environment without perturbation, or another task without any, or else the first."""
    plain = [key for key, one in results.environments.items() if not one.family]
    return BASELINE if BASELINE in plain else next(iter([*plain, *results.environments]))


def base_title(results: Results) -> str:
    """What to call `base_of`: it is perturbed itself where nothing else was played."""
    base = base_of(results)
    return f"Only {base}" if results.environments[base].family else f"Without perturbation ({base})"


LEARNED = "ppo-smooth"
NETWORKS = ("mmc", "mmc-bell")

MARGINS: Mapping[str, float] = {
    "minimum_jerk_correlation": 0.01,
    "velocity_peaks": 0.5,
    "sparc": 0.18,
}
HUMAN: tuple[Measure, ...] = tuple(MEASURES[name] for name in MARGINS)
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
