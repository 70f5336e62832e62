"""The sentences of the report, computed from the figures: no result is written here.

What the network does best and where it is beaten are told by the same rule, in the same form.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median

from mmc_gym.evaluation.battery import BASELINE
from mmc_gym.evaluation.learning_curve_table import LEVELS, first_reached
from mmc_gym.evaluation.measures import MEASURES, Measure
from mmc_gym.evaluation.report.data import Results
from mmc_gym.evaluation.report.estimates import Comparison, Estimates, Outcome
from mmc_gym.evaluation.report.knowledge import kind_of
from mmc_gym.evaluation.report.wording import count, interval, label, listed, number, quantity

EXAMPLES = 3
"""Environments that a sentence names, those of the largest differences."""

_BY_NAME = {measure.name: measure for measure in MEASURES}
SUCCESS = _BY_NAME["success"]
HUMAN = tuple(_BY_NAME[name] for name in ("minimum_jerk_correlation", "velocity_peaks", "sparc"))
"""Measures of being like people's movements: bell-shaped, of one stroke, smooth."""


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
    trained = sum(max(results.seeds(agent), 1) for agent in results.agents)
    return (
        f"{count(len(results.agents), 'agent')}, {trained:,} policies "
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
        kind = kind_of(agent)
        if kind in ("ideal", "baseline"):
            continue
        if kind not in best or figures[agent].estimate > figures[best[kind]].estimate:
            best[kind] = agent
    if not best:
        return []
    parts = [
        f"{agent} ({kind}) {quantity(SUCCESS, figures[agent].estimate)} "
        f"{interval(SUCCESS, figures[agent])}"
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
            f"{entry.environment} ({number(measure, entry.mine.estimate)} against "
            f"{quantity(measure, entry.theirs.estimate)} of {entry.rival})"
            for entry in found[:EXAMPLES]
        ]
        more = [f"{len(found) - EXAMPLES} more"] if len(found) > EXAMPLES else []
        sentences.append(
            f"{label(measure)}: in {len(found)} of {count(len(compared), 'environment')}: "
            f"{listed([*examples, *more])}"
        )
    return sentences


def _gap(entry: Comparison) -> float:
    mine, theirs = entry.mine.estimate, entry.theirs.estimate
    return abs(mine - theirs) / max(abs(mine), abs(theirs), 1e-12)


def human_likeness(estimates: Estimates) -> list[str]:
    """Whether learning with a reward for smoothness moves as people do, beside the network."""
    results = estimates.results
    environment = base_of(results)
    learned = "ppo-smooth"
    if learned not in results.agents:
        return ["No agent that was trained with a reward for smoothness took part."]
    measures = [measure for measure in HUMAN if measure in results.measures]
    sentences = []
    for network in ("mmc", "mmc-bell"):
        compared = [
            (measure, entry)
            for measure in measures
            if (entry := estimates.against(environment, measure, learned, [network])) is not None
        ]
        if compared:
            details = "; ".join(_detail(measure, entry) for measure, entry in compared)
            verdict = _verdict([entry.outcome for _, entry in compared], network)
            sentences.append(f"{verdict} ({environment}: {details})")
    return sentences or ["There are too few movements to compare ppo-smooth and the network by."]


def _detail(measure: Measure, entry: Comparison) -> str:
    outcome = {
        "better": "clearly more human-like",
        "worse": "clearly less human-like",
        "unclear": "no clear difference",
        "equal": "no difference",
    }[entry.outcome]
    return (
        f"{label(measure)} {number(measure, entry.mine.estimate)} against "
        f"{quantity(measure, entry.theirs.estimate)}, {outcome}"
    )


def _verdict(outcomes: Sequence[Outcome], network: str) -> str:
    better, worse = outcomes.count("better"), outcomes.count("worse")
    learned = "Reinforcement learning with a reward for smoothness (ppo-smooth)"
    if better and worse:
        return (
            f"{learned} is neither as human-like as {network} nor less so: of "
            f"{count(len(outcomes), 'measure')} {better} speak for it and {worse} against it"
        )
    if better:
        return f"{learned} is as human-like as {network}, and clearly more by {better} of " + count(
            len(outcomes), "measure"
        )
    if worse:
        return f"{learned} is less human-like than {network} by {worse} of " + count(
            len(outcomes), "measure"
        )
    return f"{learned} is as human-like as {network}: no measure clearly tells them apart"


def sample_cost(results: Results) -> list[str]:
    """What learning costs, in steps of the environment and in minutes of one core."""
    sentences = []
    for name, cards in results.cards.items():
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
        who = "none more" if equal else f"{best}, the most of all, in {most}"
        about = results.environments[key].description or family
        sentences.append(f"{key} ({about}): {agent} succeeds in {own}; {who}")
    return sentences


def hardest(estimates: Estimates, keys: Sequence[str]) -> str:
    """The environment with the least success over all agents."""

    def success(key: str) -> float:
        figures = estimates.of(key, SUCCESS).values()
        return sum(estimate.estimate for estimate in figures) / len(figures)

    return min(keys, key=success)


def families(results: Results) -> dict[str, list[str]]:
    """Keys of the perturbed environments by family, weakest first."""
    found: dict[str, list[str]] = {}
    for key, environment in results.environments.items():
        if environment.family:
            found.setdefault(environment.family, []).append(key)
    strength = {key: environment.strength for key, environment in results.environments.items()}
    return {family: sorted(keys, key=lambda key: strength[key]) for family, keys in found.items()}


def base_of(results: Results) -> str:
    """The environment without perturbation, or else the first."""
    return BASELINE if BASELINE in results.environments else next(iter(results.environments))
