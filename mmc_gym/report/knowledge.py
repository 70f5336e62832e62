"""What each agent is told and what it had to learn: the differences that no table of scores shows.

An agent that is told the segment lengths and what its actions mean knows a great deal about its
body; one that learned both by trial and error was told nothing, but was given a great many trials.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from mmc_gym.agents.policy import PolicyCard
from mmc_gym.agents.views import View
from mmc_gym.benchmark.reference import REFERENCE

Kind = Literal["network", "inverse kinematics", "planner", "learned", "yours", "baseline", "ideal"]

KINDS: tuple[Kind, ...] = (
    "yours",
    "network",
    "inverse kinematics",
    "planner",
    "learned",
    "baseline",
    "ideal",
)
"""In the order of the report; an agent that does not ship with the package is the reader's own."""


@dataclass(frozen=True)
class Knowledge:
    """What an agent knows of its body, and how.

    Attributes:
        kind: what sort of agent it is.
        lengths: whether it is told the segment lengths.
        actions: whether it is told what its actions do (the servo and its limits).
        senses: what it looks at, and when.
    """

    kind: Kind
    lengths: str
    actions: str
    senses: str


_TOLD = "told"
_NOT_TOLD = "not told: had to learn"
_ONCE = "posture once, at the start; the target in every step"
_LOOP = "posture, seen hand and target in every step"
VIEWS: dict[View, str] = {
    "arm": "joint angles but the first, joint speeds, target, and offset from hand to target, all "
    "seen from the arm's first segment",
    "target": "all joint angles, joint speeds, the target's distance, and offset from hand to "
    "target, all seen as if the target lay straight ahead, whence its actions are turned back",
    "world": "all joint angles, joint speeds, target, and offset from hand to target",
}


def _told(kind: Kind, senses: str = _ONCE) -> Knowledge:
    return Knowledge(kind, _TOLD, _TOLD, senses)


_MMC = _told("network")
_IK = _told("inverse kinematics")
_PLANNER = _told("planner")
_LEARNED = Knowledge("learned", _NOT_TOLD, _NOT_TOLD, f"{VIEWS['arm']}, in every step")


def _correcting(learned: Knowledge, base: str) -> Knowledge:
    told = f"told to {base}, which it corrects"
    senses = f"{learned.senses}; and what {base} proposes"
    return replace(learned, lengths=told, actions=told, senses=senses)


_KNOWN: dict[str, Knowledge] = {
    "mmc-feedback": _told("network", _LOOP),
    "mmc-delay": _told("network", f"{_LOOP}; estimates their delay"),
    "mmc-lengths": Knowledge("network", "told, then identified", _TOLD, _LOOP),
    "mmc-lock": _told("network", f"{_LOOP}; detects locked joints"),
    "mmc-closed": Knowledge(
        "network", "told, then identified", _TOLD, f"{_LOOP}; estimates delay, detects locks"
    ),
    "ik-dls-feedback": _told("inverse kinematics", _LOOP),
    "minimum-jerk": _PLANNER,
    "pmp": _PLANNER,
    "ppo-residual": _correcting(_LEARNED, "mmc"),
    "random": Knowledge("baseline", "not told", "not told", "nothing"),
    REFERENCE: Knowledge("ideal", "has no arm", "has no arm", "start and target"),
}
_FAMILIES = {"mmc": _MMC, "ik": _IK, "ppo": _LEARNED, "sac": _LEARNED, "tqc": _LEARNED}
UNKNOWN = Knowledge("yours", "unknown", "unknown", "unknown")


def knowledge_of(name: str) -> Knowledge:
    """What an agent of this package is told, by its name in `AGENTS`.

    Example:
        >>> knowledge_of("mmc").lengths, knowledge_of("sac").lengths
        ('told', 'not told: had to learn')
    """
    if name in _KNOWN:
        return _KNOWN[name]
    return _FAMILIES.get(name.partition("-")[0], UNKNOWN)


def knowledge_of_policy(card: PolicyCard) -> Knowledge:
    """What a policy was told, and sees, as its card has it."""
    learned = replace(_LEARNED, senses=f"{VIEWS[card.view]}, in every step")
    return _correcting(learned, card.base_agent) if card.base_agent else learned
