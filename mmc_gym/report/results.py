"""Read a benchmark's store: episodes, paths, environments, and the identity of agents."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pandas as pd

from mmc_gym._errors import UserError
from mmc_gym.agents import AGENTS, Knowledge, resolve
from mmc_gym.agents.policy import PolicyCard
from mmc_gym.agents.registry import REFERENCE, UNKNOWN, Kind
from mmc_gym.benchmark.ranking import rank_agents
from mmc_gym.benchmark.statistics import RESAMPLES
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

_SHOWN_AT_MOST = 7

_USED = ("success", "time_to_target", "duration")
"""Columns of episodes that the ranking needs, whatever the tables show."""


@dataclass(frozen=True)
class AgentIdentity:
    """Who an agent is.

    Attributes:
        name: its key in `AGENTS`, or `REFERENCE`; empty for an agent that is not of this package.
        knowledge: its kind, what it is given, and what it senses.
        cards: one for each of its trainings in the benchmark; empty if a card is missing.
        damaged: for each card that cannot be read, the reason.
    """

    name: str = ""
    knowledge: Knowledge = UNKNOWN
    cards: tuple[PolicyCard, ...] = ()
    damaged: tuple[str, ...] = ()

    @property
    def description(self) -> str:
        """One line of description; empty if the agent does not ship with the package."""
        return AGENTS[self.name].description if self.name in AGENTS else ""


def identify(sources: Iterable[str]) -> AgentIdentity:
    """Identify an agent by the sources of its trainings in the manifest."""
    found = [_identify(source) for source in sources]
    damaged = tuple(line for one in found for line in one.damaged)
    if len({(one.name, one.knowledge) for one in found}) != 1:
        return AgentIdentity(damaged=damaged)
    cards = tuple(card for one in found for card in one.cards)
    return replace(found[0], cards=cards if len(cards) == len(found) else (), damaged=damaged)


def _identify(source: str) -> AgentIdentity:
    try:
        agent = resolve(source)
    except UserError:
        return AgentIdentity()  # its file or module has gone since it was played
    try:
        return AgentIdentity(agent.name, agent.knowledge, (agent.card,) if agent.card else ())
    except (FileNotFoundError, UserError) as error:
        known = agent.entry.knowledge if agent.entry else UNKNOWN
        return AgentIdentity(agent.name, known, damaged=(str(error),))


@dataclass(frozen=True)
class Environment:
    """An environment of the benchmark, as the manifest describes it.

    Attributes:
        family: of the perturbation; empty without one.
        strength: of the perturbation, in `unit`; NaN without one.
        kwargs: arguments that made it.
        control_step: seconds.
        segment_lengths: of the arm that agents are given.
        tolerance: distance from the target that counts as success, segment lengths.
    """

    id: str = ""
    description: str = ""
    family: str = ""
    strength: float = math.nan
    unit: str = ""
    kwargs: Mapping[str, Any] = field(default_factory=dict)
    control_step: float = math.nan
    segment_lengths: tuple[float, ...] = ()
    tolerance: float = math.nan


@dataclass(frozen=True, eq=False)
class Results:
    """The results of a benchmark.

    Attributes:
        manifest: how they were made, and which cells could not be played.
        episodes: with the measures that tables show, after `leave_out_failures`.
        paths: of the `main_agents`, as `read_paths` returns them.
        environments: by key, in the order of the manifest.
        identities: who each agent is.
        agents: by kind, and within a kind as `AGENTS` lists them.
        measures: those that tables show and that have a value in some episode.
        set_measures: measures of all episodes of a policy together, by name.
        sets: values of the `set_measures`, as `read_sets` returns them.
        ranking: as `rank_agents` returns it; empty if no environment was attempted by all agents.
    """

    manifest: Manifest
    episodes: pd.DataFrame
    paths: pd.DataFrame
    environments: Mapping[str, Environment]
    identities: Mapping[str, AgentIdentity]
    agents: tuple[str, ...]
    measures: tuple[Measure, ...]
    set_measures: Mapping[str, SetMeasure]
    sets: pd.DataFrame
    ranking: pd.DataFrame

    def kind(self, agent: str) -> Kind:
        """Return the kind of an agent."""
        return self.identities[agent].knowledge.kind

    @property
    def ranked(self) -> list[str]:
        """All agents except the ideal hand: the ranked ones, best first, then the others."""
        best_first = [] if self.ranking.empty else map(str, self.ranking["agent"])
        return [one for one in dict.fromkeys([*best_first, *self.agents]) if one != REFERENCE]

    @property
    def main_agents(self) -> tuple[str, ...]:
        """Agents that figures show: yours, the best of each kind, then the next best."""
        played = set(self.episodes["agent"])
        shown = [one for one in self.ranked if one in played and self.kind(one) != "baseline"]
        yours = [one for one in shown if self.kind(one) == "yours"]
        best: dict[str, str] = {}
        for one in shown:
            best.setdefault(self.kind(one), one)
        return tuple(dict.fromkeys([*yours, *best.values(), *shown]))[:_SHOWN_AT_MOST]

    @property
    def cards(self) -> dict[str, tuple[PolicyCard, ...]]:
        """Cards of the policies that took part, by agent, for agents whose cards are known."""
        return {agent: one.cards for agent, one in self.identities.items() if one.cards}

    @property
    def curves(self) -> dict[str, tuple[PolicyCard, ...]]:
        """Cards by agent, for agents whose learning curves are known."""
        return {
            agent: cards
            for agent, cards in self.cards.items()
            if all(card.learning_curve for card in cards)
        }

    @property
    def damaged(self) -> list[str]:
        """A line for each card that cannot be read: the agent and the reason."""
        return [
            f"{agent}: {line}" for agent, one in self.identities.items() for line in one.damaged
        ]

    @property
    def base(self) -> str:
        """The baseline environment, else another without perturbation, else the first."""
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
        """Cells without episodes, except those of the ideal hand."""
        return [one.key for one in self.manifest.not_played if one.agent != REFERENCE]

    def sample_sizes(self, agents: Iterable[str], environments: Iterable[str]) -> str:
        """Return the number of instances, and of training seeds of each agent, as a sentence."""
        keys, names = tuple(environments), tuple(agents)
        rows = self.episodes
        rows = rows[rows["environment"].isin(keys) & rows["agent"].isin(names)]
        instances = rows.groupby("environment")["instance"].nunique()
        each = " in each environment" if instances.nunique() > 1 else ""
        seeds = rows.groupby(["agent", "environment"])["training_seed"].nunique().groupby("agent")
        spans = {str(agent): _span(of) for agent, of in seeds if of.any()}
        by_span = {
            span: [name for name in names if spans.get(name) == span]
            for span in sorted(set(spans.values()))
        }
        trained = "; ".join(f"{listed(found)} {span}" for span, found in by_span.items())
        training = f"Training seeds: {trained}." if trained else "Not trained: all agents."
        return f"Instances: {_span(instances)}{each}. {training}"


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


def _span(counts: pd.Series[int]) -> str:
    least, most = (counts.min(), counts.max()) if len(counts) else (0, 0)
    return str(least) if least == most else f"{least} to {most}"


def read_results(store: Path, resamples: int = RESAMPLES) -> Results:
    """Read the store in a folder, and rank its agents with so many `resamples`.

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
        ranking=pd.DataFrame(),
    )
    with suppress(UserError):  # no environment was attempted by all
        ranking = rank_agents(results.episodes, results.cells_not_played, resamples=resamples)
        results = replace(results, ranking=ranking)
    return replace(results, paths=_paths(store, results))


def _ordered(identities: Mapping[str, AgentIdentity]) -> tuple[str, ...]:
    names = list(AGENTS)

    def place(agent: str) -> tuple[int, int, str]:
        one = identities[agent]
        position = names.index(one.name) if one.name in AGENTS else len(names)
        return _KINDS.index(one.knowledge.kind), position, agent

    return tuple(sorted(identities, key=place))


def _environment(settings: Mapping[str, Any]) -> Environment:
    names = {one.name for one in fields(Environment)} & settings.keys()
    return Environment(**{name: settings[name] for name in names if settings[name] is not None})


def _paths(store: Path, results: Results) -> pd.DataFrame:
    keys = [
        CellKey(agent, policy.training_seed, environment)
        for agent in results.main_agents
        for policy in results.manifest.agents.get(agent, ())
        for environment in results.environments
    ]
    paths = read_paths(store, keys)
    if paths.empty:
        return paths  # the report can do without
    # Categories are quick to compare.
    return _plain_seeds(paths).astype({"agent": "category", "environment": "category"})


def _plain_seeds(frame: pd.DataFrame) -> pd.DataFrame:
    """Return training seeds as plain numbers, NaN where nothing was trained."""
    return frame.assign(training_seed=frame["training_seed"].astype(np.float64))
