"""Generalisation: how good an agent is at strengths of perturbations that its training never had.

A policy that was trained on ranges of strengths is judged inside these ranges, between them, beyond
them, and in combinations of perturbations that it only met one at a time.

Sources: Kirk, Zhang, Grefenstette & Rocktäschel (2023), A survey of zero-shot generalisation in
deep reinforcement learning, JAIR 76:201, https://arxiv.org/abs/2111.09794.  Benjamins et al.
(2023), Contextualize me – the case for context in reinforcement learning, TMLR,
https://arxiv.org/abs/2202.04500.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from contextlib import closing, suppress
from itertools import pairwise
from typing import TYPE_CHECKING, Literal, NamedTuple, get_args

from mmc_gym._errors import UserError
from mmc_gym.envs.changes import Change, OneOf, Range
from mmc_gym.envs.names import BASELINE, as_changes
from mmc_gym.envs.perturbations import FAMILIES
from mmc_gym.envs.scenarios import Scenario, parse_scenario

if TYPE_CHECKING:
    from mmc_gym.agents.policy import PolicyCard

Place = Literal["inside", "between", "beyond", "combined"]
PLACES: tuple[Place, ...] = get_args(Place)
BEYOND = (1.25, 1.5)
"""Strengths beyond a range, as multiples of its end."""

Ranges = Mapping[str, Sequence[Range]]
"""Ranges of strengths by the name of their family, in order; no change is strength 0 of all."""


class Judged(NamedTuple):
    """The place of a scenario among the strengths of a training."""

    place: Place
    family: str = ""  #: empty for a combination
    strength: float = 0.0


def trained_ranges(cards: Iterable[PolicyCard | None]) -> Ranges:
    """Return the ranges of the first training that had any; empty if none had."""
    ranges: dict[str, list[Range]] = defaultdict(list)
    for card in filter(None, cards):
        arguments = card.hyperparameters.get("env_kwargs") or {}
        for change in as_changes(arguments.get("perturbations", ())):
            for option in change.options if isinstance(change, OneOf) else (change,):
                if option is not None and option.range is not None:
                    ranges[option.family.name].append(option.range)
        if ranges:
            break
    return {name: sorted(spans, key=lambda span: span.low) for name, spans in ranges.items()}


def place_of(scenario: str, ranges: Ranges) -> Judged | None:
    """Return where a scenario is; None if it has a perturbation without a range."""
    with suppress(UserError):  # an environment of yours
        changes = parse_scenario(scenario).changes
        families = [change.family.name for change in changes]
        if not changes or not ranges.keys() >= {*families}:
            return None
        if len(changes) > 1:
            return Judged("combined")
        strength, spans = changes[0].number or 0.0, ranges[families[0]]
        if any(span.low <= strength <= span.high for span in spans):
            return Judged("inside", families[0], strength)
        within = min(0.0, spans[0].low) < strength < max(span.high for span in spans)
        return Judged("between" if within else "beyond", families[0], strength)
    return None


def protocol(cards: Iterable[PolicyCard | None]) -> list[str]:
    """Return the scenarios of the protocol: no change, each family's strengths, and pairs.

    Of the first card with ranges.  Strengths are the ends and the middle of each range, the middle
    of each gap, and `BEYOND`.  Each family is combined with the next one, both in the middle of
    their last ranges.
    """
    ranges = trained_ranges(cards)
    if not ranges:
        raise UserError(
            "agents must have one that was trained on ranges of strengths, such as ppo-drawn, or "
            "yours of mmc-gym train ppo --on 'rotation--60..60'"
        )
    singles: list[Scenario] = []
    middles: list[Change] = []
    for name, spans in ranges.items():
        known = sorted({0.0, *(end for span in spans for end in span.support())})
        strengths = {*known, *((low + high) / 2 for low, high in pairwise(known))}
        strengths |= {share * end for share in BEYOND for end in (known[0], known[-1])}
        middle = (spans[-1].low + spans[-1].high) / 2
        if spans[0].whole:
            strengths = {*range(int(spans[0].low), int(spans[-1].high) + 1)}
            middle = int(middle)
        for strength in sorted(strengths - {0}):
            with suppress(UserError):  # there is no such strength
                change = FAMILIES[name](float(f"{strength:.3g}"))
                singles.append(parse_scenario(change.name))
        middles.append(FAMILIES[name](middle))
    pairs = zip(middles, [*middles[1:], *middles[:1]], strict=True)
    combined = [parse_scenario(f"{a.name}+{b.name}") for a, b in pairs if a != b]
    names = [BASELINE]
    for scenario in (*singles, *combined):
        with suppress(UserError), closing(scenario.make()):  # there may be no such environment
            names.append(scenario.name)
    return names
