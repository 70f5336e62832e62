"""Who an agent of a benchmark is: what it was made of counts, not what it is called.

    source in the manifest       who it is
    name of this package         that agent
    NAME-SEED, such as ppo-3     a training of it, with its card
    a policy's file              the reader's own, with its card
    module:function              the reader's own; nothing is known of it

An agent whose trainings are of different kinds is the reader's own, and nothing is known of it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from mmc_gym.agents import AGENTS, is_policy_path
from mmc_gym.agents.policy import PolicyCard, load_policy
from mmc_gym.benchmark.reference import REFERENCE
from mmc_gym.report.knowledge import (
    KINDS,
    UNKNOWN,
    Kind,
    Knowledge,
    knowledge_of,
    knowledge_of_policy,
)


@dataclass(frozen=True)
class Identity:
    """Who an agent is.

    Attributes:
        own: its name in `AGENTS`, or `REFERENCE`; empty for an agent that is not of this package.
        knowledge: what it is told.
        cards: of its trainings in the benchmark, all of them; empty if any is not there.
    """

    own: str = ""
    knowledge: Knowledge = UNKNOWN
    cards: tuple[PolicyCard, ...] = ()

    @property
    def kind(self) -> Kind:
        """What sort of agent it is."""
        return self.knowledge.kind

    @property
    def description(self) -> str:
        """What it is, in a line; empty if that is not known."""
        return AGENTS[self.own].description if self.own in AGENTS else ""


def identify(sources: Iterable[str], shipped: Mapping[str, Sequence[PolicyCard]]) -> Identity:
    """Who an agent is.

    Args:
        sources: what each of its trainings was made of, as the manifest has it.
        shipped: cards of this package's policies, by name.
    """
    found = [_identify(source, shipped) for source in sources]
    if not found or any(_unlike(found[0], other) for other in found[1:]):
        return Identity()
    cards = tuple(card for one in found for card in one.cards)
    return replace(found[0], cards=cards if len(cards) == len(found) else ())


def _unlike(one: Identity, other: Identity) -> bool:
    return (one.own, one.knowledge) != (other.own, other.knowledge)


def _identify(source: str, shipped: Mapping[str, Sequence[PolicyCard]]) -> Identity:
    if is_policy_path(source):
        return _policy(source)
    if source in AGENTS or source == REFERENCE:
        return Identity(source, knowledge_of(source))
    name, _, seed = source.rpartition("-")
    if ":" in source or name not in AGENTS or not seed.isdecimal():
        return Identity()
    cards = tuple(card for card in shipped.get(name, ()) if card.seed == int(seed))
    knowledge = knowledge_of_policy(cards[0]) if cards else knowledge_of(name)
    return Identity(name, knowledge, cards)


def _policy(path: str) -> Identity:
    try:
        card = load_policy(path)[1]
    except (OSError, ValueError):
        return Identity()  # it was there when it was played
    return Identity("", replace(knowledge_of_policy(card), kind="yours"), (card,))


def agent_order(identities: Mapping[str, Identity]) -> tuple[str, ...]:
    """Agents by kind, and within a kind as `AGENTS` lists them."""
    listed = list(AGENTS)

    def place(agent: str) -> tuple[int, int, str]:
        one = identities[agent]
        position = listed.index(one.own) if one.own in AGENTS else len(listed)
        return KINDS.index(one.kind), position, agent

    return tuple(sorted(identities, key=place))


def labelled(identities: Mapping[str, Identity], name: str) -> str | None:
    """What an agent of this package is called in the benchmark; None if it did not take part."""
    labels = [label for label, one in identities.items() if one.own == name]
    return name if name in labels else next(iter(labels), None)


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


def main_agents(identities: Mapping[str, Identity]) -> tuple[str, ...]:
    """The few that figures show: the reader's own, the preferred ones, then what is left."""
    present = agent_order(identities)
    yours = [agent for agent in present if identities[agent].kind == "yours"]
    named = [labelled(identities, name) for name in _PREFERRED]
    preferred = [agent for agent in named if agent is not None]
    others = [agent for agent in present if identities[agent].kind not in ("baseline", "ideal")]
    chosen = list(dict.fromkeys([*yours, *preferred, *others]))[:SHOWN_AT_MOST]
    return tuple(agent for agent in present if agent in chosen)
