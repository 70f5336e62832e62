"""Reading a benchmark's store: episodes, paths, environments, and who the agents are."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pandas as pd

from mmc_gym._errors import UserError
from mmc_gym.agents import AGENTS, Knowledge, resolve
from mmc_gym.agents.policy import PolicyCard
from mmc_gym.agents.registry import UNKNOWN, Kind
from mmc_gym.benchmark.ranking import read_ranking
from mmc_gym.benchmark.reference import REFERENCE
from mmc_gym.benchmark.store import (
    CellKey,
    Manifest,
    read_episodes,
    read_manifest,
    read_paths,
    read_sets,
)
from mmc_gym.envs.scenarios import BASELINE
from mmc_gym.measures import Measure, SetMeasure, leave_out_failures
from mmc_gym.measures.catalogue import measures_of, set_measures_of

_KINDS: tuple[Kind, ...] = get_args(Kind)
"""In the order of the report, the reader's own agents first."""

_IDEAL = Knowledge("ideal", "has no arm", "has no arm", "start and target")

_PREFERRED = (
    "mmc-body",
    "mmc",
    "mmc-bell",
    "ik-dls",
    "ppo",
    "ppo-smooth",
    "sac",
    "tqc-her",
    "minimum-jerk",
)
_SHOWN_AT_MOST = 7

_USED = ("success", "time_to_target", "final_distance", "duration")
"""Columns of episodes that the report needs, whatever its tables show."""


@dataclass(frozen=True)
class Identity:
    """Who an agent is.

    Attributes:
        name: its key in `AGENTS`, or `REFERENCE`; empty for an agent that is not of this package.
        knowledge: its kind, what it is told, and what it senses.
        cards: of all its trainings in the benchmark; empty if any is not there.
        damaged: why a card cannot be read, a line each.
    """

    name: str = ""
    knowledge: Knowledge = UNKNOWN
    cards: tuple[PolicyCard, ...] = ()
    damaged: tuple[str, ...] = ()

    @property
    def description(self) -> str:
        """A line; empty if it does not ship with the package."""
        return AGENTS[self.name].description if self.name in AGENTS else ""


def identify(sources: Iterable[str]) -> Identity:
    """Find out who an agent is from what its trainings were made of, as the manifest has it."""
    found = [_identify(source) for source in sources]
    damaged = tuple(line for one in found for line in one.damaged)
    if len({(one.name, one.knowledge) for one in found}) != 1:
        return Identity(damaged=damaged)
    cards = tuple(card for one in found for card in one.cards)
    return replace(found[0], cards=cards if len(cards) == len(found) else (), damaged=damaged)


def _identify(source: str) -> Identity:
    if source == REFERENCE:
        return Identity(REFERENCE, _IDEAL)
    try:
        agent = resolve(source)
    except UserError:
        return Identity()  # it was there when it was played
    try:
        return Identity(agent.name, agent.knowledge, (agent.card,) if agent.card else ())
    except (FileNotFoundError, UserError) as error:
        known = agent.entry.knowledge if agent.entry else UNKNOWN
        return Identity(agent.name, known, damaged=(str(error),))


@dataclass(frozen=True)
class Environment:
    """An environment of the benchmark, as the manifest describes it.

    Attributes:
        family: of the perturbation; empty without one.
        strength: of the perturbation, in `unit`; NaN without one.
        baseline: key of the environment that differs from this one only in the perturbation.
    """

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
        manifest: how they were made, and which cells could not be played.
        episodes: as `read_episodes` returns them, without measures that tables do not show; NaN
            where `leave_out_failures` says so.
        paths: of the `main_agents`, as `read_paths` returns them.
        environments: by key, in the order of the manifest.
        identities: who each agent is.
        agents: by kind, and within a kind as `AGENTS` lists them.
        measures: that tables show, and some episode has a value of.
        set_measures: of all episodes of a policy together, by name.
        sets: their values, as `read_sets` returns them.
        ranking: as `rank_agents` returns it; empty if the store has none of its present cells.
    """

    manifest: Manifest
    episodes: pd.DataFrame
    paths: pd.DataFrame
    environments: Mapping[str, Environment]
    identities: Mapping[str, Identity]
    agents: tuple[str, ...]
    measures: tuple[Measure, ...]
    set_measures: Mapping[str, SetMeasure]
    sets: pd.DataFrame
    ranking: pd.DataFrame

    def kind(self, agent: str) -> Kind:
        """Return what sort of agent it is."""
        return self.identities[agent].knowledge.kind

    def label_of(self, name: str) -> str | None:
        """Return what an agent of this package is called here; None if it did not take part."""
        labels = [label for label, one in self.identities.items() if one.name == name]
        return name if name in labels else next(iter(labels), None)

    @property
    def main_agents(self) -> tuple[str, ...]:
        """The few agents that figures show: the reader's own, the preferred, then the others."""
        played = [agent for agent in self.agents if self.seeds(agent) is not None]
        yours = [agent for agent in played if self.kind(agent) == "yours"]
        preferred = [found for name in _PREFERRED if (found := self.label_of(name)) in played]
        others = [agent for agent in played if self.kind(agent) not in ("baseline", "ideal")]
        chosen = list(dict.fromkeys([*yours, *preferred, *others]))[:_SHOWN_AT_MOST]
        return tuple(agent for agent in played if agent in chosen)

    def rivals(self, agent: str) -> tuple[str, ...]:
        """Return agents of other kinds, but not the random one, nor the hand without an arm."""
        apart = {self.kind(agent), "baseline", "ideal"}
        return tuple(other for other in self.agents if self.kind(other) not in apart)

    @property
    def cards(self) -> dict[str, tuple[PolicyCard, ...]]:
        """Cards of the policies that took part, by agent; only of agents whose cards are known."""
        return {agent: one.cards for agent, one in self.identities.items() if one.cards}

    @property
    def curves(self) -> dict[str, tuple[PolicyCard, ...]]:
        """The cards of those agents whose learning curves are known."""
        return {
            agent: cards
            for agent, cards in self.cards.items()
            if all(card.learning_curve for card in cards)
        }

    @property
    def damaged(self) -> list[str]:
        """Why cards cannot be read, a line each."""
        return [
            f"{agent}: {line}" for agent, one in self.identities.items() for line in one.damaged
        ]

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
    def cells_not_played(self) -> list[CellKey]:
        """Cells without episodes, but for those of the hand without an arm."""
        return [one.key for one in self.manifest.not_played if one.agent != REFERENCE]

    def seeds(self, agent: str, environments: Iterable[str] = ()) -> tuple[int, int] | None:
        """Return the least and the most training seeds of an agent in any environment, or in these.

        (0, 0) is the answer for one without training, None if it was in none of them.
        """
        keys = tuple(environments) or tuple(self.environments)
        counts = [found for key in keys if (found := self._seeds.get((agent, key))) is not None]
        return (min(counts), max(counts)) if counts else None

    def sample_sizes(self, agents: Iterable[str], environments: Iterable[str]) -> str:
        """Return over how many instances and training seeds figures are, as a sentence.

        Agents that were in none of the environments are left out.
        """
        keys = tuple(environments)
        counts = sorted({self._instances.get(key, 0) for key in keys}) or [0]
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
        return dict(zip(map(str, counts.index), counts.tolist()))


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


def read_results(store: Path) -> Results:
    """Read the store in a folder.

    Raises:
        UserError: if there is no store, it is damaged, or it has no episodes; the message then
            says why its cells were not played.
    """
    manifest = read_manifest(store)
    measures = measures_of(manifest.measures)
    shown = [one.name for one in measures.values() if one.shown]
    played = read_episodes(store, [*shown, *_USED])
    episodes = leave_out_failures(_plain_seeds(played), measures.values())
    present = set(episodes["environment"])
    identities = {
        agent: identify([policy.source for policy in manifest.agents.get(agent, ())])
        for agent in dict.fromkeys([*manifest.agents, *map(str, episodes["agent"].unique())])
    }
    results = Results(
        manifest=manifest,
        episodes=episodes,
        paths=pd.DataFrame(),
        environments={
            key: _environment(manifest.environments.get(key, {}))
            for key in dict.fromkeys([*manifest.environments, *sorted(present)])
            if key in present
        },
        identities=identities,
        agents=_ordered(identities),
        measures=tuple(
            one
            for name, one in measures.items()
            if one.shown and name in episodes and episodes[name].notna().any()
        ),
        set_measures=set_measures_of(manifest.set_measures),
        sets=_plain_seeds(read_sets(store)),
        ranking=read_ranking(store),
    )
    return replace(results, paths=_paths(store, results))


def _ordered(identities: Mapping[str, Identity]) -> tuple[str, ...]:
    listed = list(AGENTS)

    def place(agent: str) -> tuple[int, int, str]:
        one = identities[agent]
        position = listed.index(one.name) if one.name in AGENTS else len(listed)
        return _KINDS.index(one.knowledge.kind), position, agent

    return tuple(sorted(identities, key=place))


def _environment(settings: Mapping[str, Any]) -> Environment:
    names = {one.name for one in fields(Environment)} & settings.keys()
    return Environment(**{name: settings[name] for name in names if settings[name] is not None})


def _paths(store: Path, results: Results) -> pd.DataFrame:
    paths = read_paths(
        store,
        [
            CellKey(agent, policy.training_seed, environment)
            for agent in results.main_agents
            for policy in results.manifest.agents.get(agent, ())
            for environment in results.environments
        ],
    )
    if paths.empty:
        return paths  # the report can do without
    # Categories are quick to compare.
    return _plain_seeds(paths).astype({"agent": "category", "environment": "category"})


def _plain_seeds(frame: pd.DataFrame) -> pd.DataFrame:
    """Return training seeds as plain numbers, NaN where nothing was trained."""
    return frame.assign(training_seed=frame["training_seed"].astype(np.float64))
