"""Reading a benchmark's store: episodes, paths, environments, and who the agents are."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd

from mmc_gym._errors import UserError
from mmc_gym.agents import AGENTS
from mmc_gym.agents.policy import PRETRAINED, PolicyCard, is_policy_path, load_policy
from mmc_gym.agents.views import VIEWS
from mmc_gym.benchmark.ranking import RANKING
from mmc_gym.benchmark.reference import REFERENCE
from mmc_gym.benchmark.runner import untrained
from mmc_gym.benchmark.store import (
    EPISODES,
    MANIFEST,
    PATHS,
    CellKey,
    read_episodes,
    read_manifest,
    read_paths,
    read_sets,
)
from mmc_gym.envs.scenarios import BASELINE
from mmc_gym.measures import MEASURES, Measure, leave_out_failures
from mmc_gym.training.curves import curve_rows, read_cards

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


@dataclass(frozen=True)
class Environment:
    """An environment of the benchmark.

    Attributes:
        key: its short name.
        id: Gymnasium's.
        description: one line.
        family: of the perturbation; empty without one.
        strength: of the perturbation, in `unit`; NaN without one.
        unit: of the strength.
        baseline: key of the environment that differs from this one only in the perturbation.
    """

    key: str
    id: str = ""
    description: str = ""
    family: str = ""
    strength: float = math.nan
    unit: str = ""
    baseline: str = BASELINE


@dataclass(frozen=True, eq=False)
class Results:
    """The results of a benchmark.

    Attributes:
        episodes: columns agent, training_seed (missing without training), environment, instance,
            and those of `MEASURES`, NaN where `leave_out_failures` says so.
        paths: columns agent, training_seed, environment, instance, step, joint_angle_1 to _N,
            hand_x, hand_y, cursor_x, cursor_y, target_x, target_y; empty if none were kept.
        environments: by key, in the order of the manifest.
        identities: who each agent is.
        agents: in the order of the report.
        control_step: seconds.
        segment_lengths: of the arm that agents are told of.
        tolerance: distance that counts as reached, segment lengths.
        versions: of the libraries.
        cell_seconds: computing time of all cells together.
        not_played: the cells without episodes, with the reason.
        sets: columns agent, training_seed, environment, measure, unit, episodes, value: one for
            all episodes of a policy together; empty if there is none.
        ranking: of the agents, as `summarize_battery` returns it; empty if the store has none that
            is as new as itself.
        curves: cards of the agents whose learning curves are known, by name.
        damaged: why a card or a learning curve cannot be used, a line each.
    """

    episodes: pd.DataFrame
    paths: pd.DataFrame
    environments: Mapping[str, Environment]
    identities: Mapping[str, Identity]
    agents: tuple[str, ...]
    control_step: float
    segment_lengths: tuple[float, ...]
    tolerance: float
    versions: Mapping[str, str]
    cell_seconds: float
    not_played: tuple[tuple[CellKey, str], ...]
    sets: pd.DataFrame
    ranking: pd.DataFrame
    curves: Mapping[str, tuple[PolicyCard, ...]] = field(default_factory=dict)
    damaged: tuple[str, ...] = ()

    def kind(self, agent: str) -> Kind:
        """Return what sort of agent it is."""
        return self.identities[agent].kind

    def labelled(self, name: str) -> str | None:
        """Return what an agent of this package is called here; None if it did not take part."""
        return labelled(self.identities, name)

    def rivals(self, agent: str) -> tuple[str, ...]:
        """Return agents of other kinds, but not the random one, nor the hand without an arm."""
        apart = {self.kind(agent), "baseline", "ideal"}
        return tuple(other for other in self.agents if self.kind(other) not in apart)

    @property
    def cards(self) -> dict[str, tuple[PolicyCard, ...]]:
        """Cards of the policies that took part, by agent; only of agents whose cards are known."""
        return {agent: one.cards for agent, one in self.identities.items() if one.cards}

    @property
    def base(self) -> str:
        """The environment without perturbation, or another task without any, or else the first."""
        plain = [key for key, one in self.environments.items() if not one.family]
        return BASELINE if BASELINE in plain else next(iter([*plain, *self.environments]))

    @property
    def families(self) -> dict[str, list[str]]:
        """Keys of the perturbed environments by family, the weakest first."""
        found: dict[str, list[str]] = {}
        for key, environment in self.environments.items():
            if environment.family:
                found.setdefault(environment.family, []).append(key)
        return {
            family: sorted(keys, key=lambda key: self.environments[key].strength)
            for family, keys in found.items()
        }

    @property
    def measures(self) -> tuple[Measure, ...]:
        """The measures that the report shows: those of `mmc-gym compare` that were stored."""
        return tuple(
            measure
            for measure in MEASURES.values()
            if measure.shown
            and measure.name in self.episodes
            and self.episodes[measure.name].notna().any()
        )

    @property
    def numbered_episodes(self) -> pd.DataFrame:
        """Episodes as they are stored, with training seed 0 for agents without training."""
        seeds = self.episodes["training_seed"].fillna(0).astype(int)
        return self.episodes.assign(training_seed=seeds)

    @property
    def cells_not_played(self) -> list[CellKey]:
        """Cells without episodes, but for those of the hand without an arm."""
        return [cell for cell, _ in self.not_played if cell.agent != REFERENCE]

    def seeds(self, agent: str, environments: Iterable[str] = ()) -> tuple[int, int] | None:
        """Return the least and the most training seeds of an agent in any of some environments.

        Args:
            agent: its name; (0, 0) is the answer for one without training.
            environments: keys; all by default.

        Returns:
            None if it was in none of them.
        """
        keys = tuple(environments) or tuple(self.environments)
        counts = [found for key in keys if (found := self._seeds.get((agent, key))) is not None]
        return (min(counts), max(counts)) if counts else None

    def instances(self, environment: str) -> int:
        """Return the number of starts and targets in an environment."""
        return self._instances.get(environment, 0)

    def sample(self, agents: Iterable[str], environments: Iterable[str]) -> str:
        """Return over how many instances and training seeds the figures of agents are.

        Args:
            agents: in the figure; those that were in none of the environments are left out.
            environments: keys, in the figure.
        """
        keys = tuple(environments)
        counts = sorted({self.instances(key) for key in keys}) or [0]
        each = " in each environment" if len(counts) > 1 else ""
        by_count: dict[tuple[int, int], list[str]] = {}
        for agent in agents:
            if (found := self.seeds(agent, keys)) is not None:
                by_count.setdefault(found, []).append(agent)
        trained = [
            f"{listed(names)} {_span(numbers)}"
            for numbers, names in sorted(by_count.items())
            if numbers[1]
        ]
        seeds = f"Training seeds: {'; '.join(trained)}." if trained else "Not trained: all agents."
        return f"Instances: {_span((counts[0], counts[-1]))}{each}. {seeds}"

    @cached_property
    def _seeds(self) -> dict[tuple[str, str], int]:
        rows = self.episodes[["agent", "environment", "training_seed"]].drop_duplicates()
        counts = dict.fromkeys(zip(rows["agent"], rows["environment"]), 0)
        for agent, key, seed in rows.itertuples(index=False):
            counts[agent, key] += not math.isnan(seed)
        return counts

    @cached_property
    def _instances(self) -> dict[str, int]:
        counts = self.episodes.groupby("environment")["instance"].nunique()
        return {str(key): int(number) for key, number in counts.items()}


def count(number_of: int, noun: str) -> str:
    """Return a number and its noun.

    Example:
        >>> count(1, "seed"), count(1200, "seed")
        ('1 seed', '1,200 seeds')
    """
    return f"{number_of:,} {noun}{'' if number_of == 1 else 's'}"


def listed(items: Sequence[str]) -> str:
    """Return items with commas, the last with "and".

    Example:
        >>> listed(["a", "b", "c"])
        'a, b and c'
    """
    return " and ".join([", ".join(items[:-1]), items[-1]] if len(items) > 1 else items)


def _span(ends: tuple[int, int]) -> str:
    return str(ends[0]) if ends[0] == ends[1] else f"{ends[0]} to {ends[1]}"


def read_results(store: Path, cards: Path = PRETRAINED) -> Results:
    """Read a store.

    Args:
        store: its folder.
        cards: folder of this package's policies, for what they learned from.

    Raises:
        UserError: if there is no store, it is damaged, or it has no episodes; the message then
            says why its cells were not played.
    """
    manifest = read_manifest(store)
    not_played = tuple(
        (CellKey(one["agent"], one["training_seed"], one["environment"]), str(one["reason"]))
        for one in (*manifest["skipped"], *manifest["failed"])
    )
    if not_played and not _has(store, EPISODES):
        raise UserError(
            f"store {str(store)!r} must have episodes, got none: {'; '.join(reasons(not_played))}"
        )
    not_trained = untrained(manifest)
    episodes = leave_out_failures(_without_seeds(read_episodes(store), not_trained))
    present = set(episodes["environment"])
    shipped = _cards(cards)
    identities = {
        agent: identify(manifest["agents"].get(agent, {"sources": {}})["sources"].values(), shipped)
        for agent in map(str, dict.fromkeys(episodes["agent"]))
    }
    curves, damaged = _curves(identities)
    return Results(
        episodes=episodes,
        paths=_paths(store, not_trained),
        environments={
            key: _environment(key, manifest["environments"].get(key, {}))
            for key in dict.fromkeys([*manifest["environments"], *sorted(present)])
            if key in present
        },
        identities=identities,
        agents=agent_order(identities),
        control_step=float(manifest["control_step"]),
        segment_lengths=tuple(map(float, manifest["segment_lengths"])),
        tolerance=float(manifest["tolerance"]),
        versions=manifest["versions"],
        cell_seconds=float(sum(manifest["wall_seconds"].values())),
        not_played=not_played,
        sets=_without_seeds(read_sets(store), not_trained),
        ranking=_ranking(store),
        curves=curves,
        damaged=damaged,
    )


def reasons(not_played: Iterable[tuple[CellKey, str]]) -> list[str]:
    """Return a line for each agent and reason, with the environments that were not played."""
    groups: dict[tuple[str, str], dict[str, None]] = {}
    for cell, reason in not_played:
        groups.setdefault((cell.agent, reason), {})[cell.environment] = None
    return [
        f"{agent} in {', '.join(environments)}: {reason}"
        for (agent, reason), environments in groups.items()
    ]


def _environment(key: str, entry: Mapping[str, Any]) -> Environment:
    strength = entry.get("strength")
    return Environment(
        key,
        id=entry.get("id", ""),
        description=entry.get("description", ""),
        family=entry.get("family", ""),
        strength=math.nan if strength is None else float(strength),
        unit=entry.get("unit", ""),
        baseline=entry.get("baseline") or BASELINE,
    )


def _has(store: Path, kind: str) -> bool:
    return any((store / kind).glob("[!.]*.parquet"))


def _paths(store: Path, not_trained: Collection[str]) -> pd.DataFrame:
    if not _has(store, PATHS):
        return pd.DataFrame()  # the report can do without
    paths = _without_seeds(read_paths(store), not_trained)
    return paths.astype({"agent": "category", "environment": "category"})  # quick to compare


def _curves(
    identities: Mapping[str, Identity],
) -> tuple[dict[str, tuple[PolicyCard, ...]], tuple[str, ...]]:
    """Return the cards with learning curves, and why others have none that can be used."""
    curves, damaged = {}, []
    for agent, one in identities.items():
        if one.cards and all(card.learning_curve for card in one.cards):
            try:
                curve_rows({agent: one.cards})
                curves[agent] = one.cards
            except ValueError as error:
                damaged.append(f"{agent}: {error}")
    return curves, tuple(damaged)


def _ranking(store: Path) -> pd.DataFrame:
    file = store / RANKING
    try:
        if file.stat().st_mtime < (store / MANIFEST).stat().st_mtime:
            return pd.DataFrame()  # of a benchmark that went on
        return pd.read_csv(file)
    except (OSError, ValueError):
        return pd.DataFrame()


def _cards(folder: Path) -> Mapping[str, Sequence[PolicyCard]]:
    try:
        return read_cards(folder)
    except ValueError:
        return {}  # nothing was trained


def _without_seeds(frame: pd.DataFrame, not_trained: Collection[str]) -> pd.DataFrame:
    """The training seed is missing, rather than 0, where nothing was trained."""
    seeds = frame["training_seed"].astype(np.float64)
    return frame.assign(training_seed=seeds.mask(frame["agent"].isin(list(not_trained))))
