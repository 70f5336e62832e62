"""What each agent is told and what it had to learn: the differences that no table of scores shows.

An agent that is told the segment lengths and what its actions mean knows a great deal about its
body; one that learned both by trial and error was told nothing, but was given a great many trials.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

from mmc_gym.agents import AGENTS
from mmc_gym.evaluation.reference import REFERENCE

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
ARM_VIEW = (
    "joint angles but the first, joint speeds, target, and offset from hand to target, all seen "
    "from the arm's first segment"
)
WORLD_VIEW = "all joint angles, joint speeds, target, and offset from hand to target"
_ARM_FRAME = f"{ARM_VIEW}, in every step"


def _told(kind: Kind, senses: str = _ONCE) -> Knowledge:
    return Knowledge(kind, _TOLD, _TOLD, senses)


_MMC = _told("network")
_IK = _told("inverse kinematics")
_PLANNER = _told("planner")
_LEARNED = Knowledge("learned", _NOT_TOLD, _NOT_TOLD, _ARM_FRAME)
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
    "ppo-residual": Knowledge(
        "learned",
        "told to mmc, which it corrects",
        "told to mmc, which it corrects",
        f"{_ARM_FRAME}; and what mmc proposes",
    ),
    "random": Knowledge("baseline", "not told", "not told", "nothing"),
    REFERENCE: Knowledge("ideal", "has no arm", "has no arm", "start and target"),
}
_FAMILIES = {"mmc": _MMC, "ik": _IK, "ppo": _LEARNED, "sac": _LEARNED, "tqc": _LEARNED}
_UNKNOWN = Knowledge("yours", "unknown", "unknown", "unknown")


def knowledge(agent: str) -> Knowledge:
    """What an agent of this name is told.

    Example:
        >>> knowledge("mmc").lengths, knowledge("sac").lengths
        ('told', 'not told: had to learn')
    """
    if agent in _KNOWN:
        return _KNOWN[agent]
    return _FAMILIES.get(agent.partition("-")[0], _UNKNOWN) if ":" not in agent else _UNKNOWN


def kind_of(agent: str) -> Kind:
    """What sort of agent it is."""
    return knowledge(agent).kind


def agent_order(agents: Iterable[str]) -> tuple[str, ...]:
    """Agents by kind, and within a kind as `AGENTS` lists them."""
    listed = list(AGENTS)

    def place(agent: str) -> tuple[int, int, str]:
        position = listed.index(agent) if agent in AGENTS else len(listed)
        return KINDS.index(kind_of(agent)), position, agent

    return tuple(sorted(agents, key=place))


_PREFERRED = (
    "mmc",
    "mmc-closed",
    "mmc-bell",
    "ik-dls",
    "ppo",
    "ppo-smooth",
    "sac",
    "tqc-her",
    "minimum-jerk",
)
SHOWN_AT_MOST = 7


def main_agents(agents: Iterable[str]) -> tuple[str, ...]:
    """The few that figures show: the reader's own, the preferred ones, then what is left."""
    present = agent_order(agents)
    yours = [agent for agent in present if kind_of(agent) == "yours"]
    preferred = [agent for agent in _PREFERRED if agent in present]
    others = [agent for agent in present if kind_of(agent) not in ("baseline", "ideal")]
    chosen = list(dict.fromkeys([*yours, *preferred, *others]))[:SHOWN_AT_MOST]
    return tuple(agent for agent in present if agent in chosen)
