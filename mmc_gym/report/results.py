"""Read a benchmark's store: episodes, scenarios, agents, and the agents in the report's focus."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, fields
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pandas as pd

from mmc_gym._errors import UserError, require_choice, require_names
from mmc_gym.agents import AGENTS, Knowledge
from mmc_gym.agents.policy import PolicyCard
from mmc_gym.agents.registry import REFERENCE, UNKNOWN, Kind
from mmc_gym.agents.resolver import read_card
from mmc_gym.benchmark.generalisation import (
    PLACES,
    Judged,
    Place,
    Ranges,
    place_of,
    trained_ranges,
)
from mmc_gym.benchmark.kinds import group_of
from mmc_gym.benchmark.ranking import attempted_scores, rank_agents, ranked_scores
from mmc_gym.benchmark.statistics import COLUMNS, RESAMPLES, Bootstrap
from mmc_gym.benchmark.store import (
    CellKey,
    Manifest,
    Policy,
    read_episodes,
    read_manifest,
    read_paths,
    require_all_cells,
)
from mmc_gym.envs.names import BASELINE
from mmc_gym.envs.perturbations import GROUPS
from mmc_gym.measures import Measure, leave_out_failures, words
from mmc_gym.measures.catalogue import measures_of

REPLAYED_AGENTS, REPLAYED_SCENARIOS, REPLAYED_INSTANCES = 7, 8, 6

SCORE_RESAMPLES = 500  # upper limit for single scenarios, whose tables have thousands of intervals

ALL = "all scenarios"
Sort = TypeVar("Sort", bound=str)


@dataclass(frozen=True)
class AgentIdentity:
    """Who an agent is."""

    name: str = ""  #: its key in `AGENTS`, or `REFERENCE`; empty for an agent of yours
    knowledge: Knowledge = UNKNOWN  #: its kind, what it is given, and what it senses
    #: environment steps of each training, 0 if it was not trained; None where unknown
    training_steps: tuple[int | None, ...] = ()
    sources: tuple[str, ...] = ()  #: of its trainings, see `Policy.source`

    def about(self, label: str) -> str:
        """Return a description of the agent, with its name if that differs from `label`."""
        if self.name in AGENTS:
            about = AGENTS[self.name].description
            return about if self.name == label else f"{self.name}: {about}"
        return self.knowledge.kind.replace("yours", "your own")

    @property
    def training(self) -> str:
        """The length of its training in environment steps, in words."""
        if self.knowledge.kind not in ("learned", "yours"):
            return "not trained"
        known = sorted(steps for steps in self.training_steps if steps)
        if not known or len(known) < len(self.training_steps):
            return "unknown"
        span = f"{known[0]:,}" + (f" to {known[-1]:,}" if known[-1] > known[0] else "")
        each = f", each of {len(known)} trainings" if len(known) > 1 else ""
        return f"{span} environment steps{each}"

    @property
    def cards(self) -> tuple[PolicyCard, ...]:
        """The cards of its trainings; empty unless every card has a learning curve."""
        cards = []
        for source in self.sources:
            with suppress(UserError, OSError):  # its file may have gone since it was played
                card = read_card(source)
                cards += [card] if card and len(card.learning_curve) > 1 else []
        return tuple(cards) if len(cards) == len(self.sources) else ()


def identify(policies: Iterable[Policy]) -> AgentIdentity:
    """Return who an agent is, by its trainings; unknown if their names or knowledge differ."""
    trainings = list(policies)
    facts = {(policy.name, policy.knowledge) for policy in trainings}
    name, knowledge = facts.pop() if len(facts) == 1 else ("", UNKNOWN)
    steps = tuple(policy.training_steps for policy in trainings)
    return AgentIdentity(name, knowledge, steps, tuple(policy.source for policy in trainings))


@dataclass(frozen=True)
class Environment:
    """A scenario of the benchmark, as the manifest describes it."""

    description: str = ""
    family: str = ""  #: of the perturbation; empty without one
    kwargs: Mapping[str, Any] = field(default_factory=dict)  #: arguments that made the environment
    control_step: float = math.nan  #: seconds
    segment_lengths: tuple[float, ...] = ()  #: of the arm that agents are given
    tolerance: float = math.nan  #: distance from the target that counts as success, segment lengths

    @classmethod
    def of(cls, settings: Mapping[str, Any]) -> Environment:
        """Make the scenario of an entry in the manifest; missing settings get their defaults."""
        names = {field.name for field in fields(cls)}
        known = {name: settings[name] for name in names & settings.keys()}
        return cls(**{name: value for name, value in known.items() if value is not None})


@dataclass(frozen=True, eq=False)
class Results:
    """The results of a benchmark."""

    manifest: Manifest  #: how they were made, and which cells could not be played
    episodes: pd.DataFrame  #: with the measures that tables show, after `leave_out_failures`
    environments: Mapping[str, Environment]  #: the scenarios by name, in the order of the manifest
    identities: Mapping[str, AgentIdentity]  #: who each agent is
    focus: tuple[str, ...]  #: the agents that the report is about
    measures: tuple[Measure, ...]  #: those that tables show and that have a value in some episode
    ranking: pd.DataFrame  #: of `rank_agents`; empty if no scenario was attempted by all
    resamples: int  #: number of bootstrap resamples in the tables of single scenarios
    ranking_resamples: int  #: number of bootstrap resamples in the ranking
    store: Path  #: the folder
    yardstick: str  #: the agent relative to which regret is computed; empty without one

    @cached_property
    def ranges(self) -> Ranges:
        """The ranges of the first agent that was trained on ranges; empty if none was."""
        cards = [card for agent in self.agents for card in self.identities[agent].cards[:1]]
        return trained_ranges(cards)

    @cached_property
    def judged(self) -> dict[str, Judged]:
        """The place of each scenario, such as inside or beyond `ranges`, by name, if it has one."""
        places = {name: place_of(name, self.ranges) for name in self.environments}
        return {name: place for name, place in places.items() if place is not None}

    @cached_property
    def controls(self) -> dict[str, str]:
        """The control mode of each agent, except the ideal hand."""
        return {agent: self.manifest.control(agent) for agent in self.agents if agent != REFERENCE}

    def kind(self, agent: str) -> Kind:
        """Return the kind of an agent."""
        return self.identities[agent].knowledge.kind

    @cached_property
    def agents(self) -> tuple[str, ...]:
        """The agents in the order of tables: those in focus, the others by rank, the ideal hand."""
        best_first = [] if self.ranking.empty else map(str, self.ranking["agent"])
        names = dict.fromkeys([*self.focus, *best_first, *self.identities])
        return tuple(sorted(names, key=lambda agent: agent == REFERENCE))

    @cached_property
    def by_scenario(self) -> dict[str, pd.DataFrame]:
        """The episodes of each scenario."""
        return {str(name): rows for name, rows in self.episodes.groupby("environment", sort=False)}

    @cached_property
    def replayed(self) -> tuple[str, ...]:
        """Agents that the replay shows: those in focus, then the best of the others."""
        names = {*self.episodes["agent"].unique()} - {REFERENCE}
        return tuple(agent for agent in self.agents if agent in names)[:REPLAYED_AGENTS]

    @property
    def base(self) -> str:
        """The baseline scenario, else another without perturbation, else the first."""
        plain = [name for name, scenario in self.environments.items() if not scenario.family]
        return BASELINE if BASELINE in plain else next(iter([*plain, *self.environments]))

    @cached_property
    def replayed_scenarios(self) -> list[str]:
        """The scenarios that the replay shows, by the focus's share of success, lowest first."""
        mine = self.episodes[self.episodes["agent"].isin(self.focus)]
        success = mine.groupby("environment")["success"].mean()
        order = sorted(self.environments, key=lambda key: (success.get(key, 1.0), key != self.base))
        return order[:REPLAYED_SCENARIOS]

    @cached_property
    def paths(self) -> pd.DataFrame:
        """Paths of the replayed agents and scenarios, as `read_paths` returns them."""
        keys = [
            CellKey(agent, policy.training_seed, environment)
            for agent in self.replayed
            for policy in self.manifest.agents.get(agent, ())
            for environment in self.replayed_scenarios
        ]
        paths = read_paths(self.store, keys)
        return paths if paths.empty else _compact(paths)  # the report can do without

    @cached_property
    def replayed_failures(self) -> dict[tuple[str, str], list[int]]:
        """The instances of failed episodes that the replay shows, by (agent, scenario)."""
        if self.paths.empty:
            return {}
        texts = {"agent": str, "environment": str}
        failed = self.episodes.loc[self.episodes["success"] == 0, COLUMNS].astype(texts)
        both = failed.merge(self.paths[COLUMNS].drop_duplicates().astype(texts))
        groups: Any = both.groupby(["agent", "environment"])["instance"]
        return {key: sorted(instances)[:REPLAYED_INSTANCES] for key, instances in groups}

    @cached_property
    def successes(self) -> dict[str, Bootstrap]:
        """The bootstrap of the agents' success, for `ALL` and each scenario that was attempted."""
        groups = self._attempted.groupby("environment", sort=False)
        frames = {str(name): rows for name, rows in groups}
        if not self.ranking.empty and len(frames) > 1:
            frames[ALL] = ranked_scores(self._attempted)
        # As many resamples for `ALL` as for the ranking, so that both have the same intervals.
        resamples = {ALL: self.ranking_resamples}
        return {
            name: Bootstrap.of(frames[name], "success", resamples.get(name, self.resamples))
            for name in (ALL, *self.environments)
            if name in frames
        }

    @cached_property
    def places(self) -> dict[Place, Bootstrap]:
        """The bootstrap of the agents' success in each place, over scenarios that all attempted."""
        places = {name: judged.place for name, judged in self.judged.items()}
        return self._successes_by(PLACES, places)

    @cached_property
    def groups(self) -> dict[str, Bootstrap]:
        """The bootstrap of the agents' success in each group of perturbations."""
        return self._successes_by(GROUPS, {name: group_of(name) for name in self.environments})

    def _successes_by(self, sorts: Iterable[Sort], of: Mapping[str, Sort]) -> dict[Sort, Bootstrap]:
        """Return the bootstrap of success for each sort of scenarios that all attempted."""
        scores, successes = self._attempted, {}
        for sort in sorts:
            names = [name for name in of if of[name] == sort]
            with suppress(UserError):  # no such scenario
                ranked = ranked_scores(scores[scores["environment"].isin(names)])
                successes[sort] = Bootstrap.of(ranked, "success", self.resamples)
        return successes

    @cached_property
    def _attempted(self) -> pd.DataFrame:
        return attempted_scores(self.episodes, [cell.key for cell in self.manifest.not_played])

    @property
    def sample_sizes(self) -> str:
        """The number of episodes, and of trainings where an agent has several, in words."""
        instances = self.episodes.groupby("environment")["instance"].nunique()
        seeds = self.episodes.groupby("agent")["training_seed"].nunique()
        several = ", ".join(f"{agent} {number}" for agent, number in seeds.items() if number > 1)
        return words.SAMPLE_SIZES.format(
            each=" in each scenario" if len(instances) > 1 else "",
            span=" to ".join(map(str, sorted({instances.min(), instances.max()}))),
            trainings=several and f" Trainings: {several}; of the others one or none.",
        )

    @property
    def settings(self) -> list[str]:
        """The settings that the scenarios were played with, one line per setting."""
        texts: dict[str, dict[str, str]] = {name: {} for name in words.SETTINGS}
        for name, scenario in self.environments.items():
            tolerance, lengths = scenario.tolerance, scenario.segment_lengths
            others = {**scenario.kwargs}
            others.pop("task", None)
            others.pop("perturbations", None)
            values = (
                "as it says" if math.isnan(tolerance) else f"{tolerance:g}",
                f"{scenario.control_step:g} s",
                ", ".join(f"{length:g}" for length in lengths),
                words.arguments(others),
            )
            for setting, value in zip(words.SETTINGS, values, strict=True):
                texts[setting][name] = value
        return [
            f"{setting}: {_alike(by_scenario)}."
            for setting, by_scenario in texts.items()
            if any(by_scenario.values())
        ]


def _alike(texts: Mapping[str, str]) -> str:
    """Return the most frequent text, then each other text with the names of its scenarios."""
    most, *others = [text for text, _ in Counter(texts.values()).most_common()]
    rest = [
        f"{other or 'none'} in {words.listed([name for name in texts if texts[name] == other])}"
        for other in others
    ]
    return "; ".join([most or "none", *rest])


def read_results(
    store: Path, resamples: int = RESAMPLES, focus: Sequence[str] = (), yardstick: str = ""
) -> Results:
    """Read the store in a folder, and rank its agents with `resamples` bootstrap resamples.

    Single scenarios get at most `SCORE_RESAMPLES`.  For `focus` and `yardstick` see `write_report`.
    """
    manifest = read_manifest(store)
    require_all_cells(store, manifest)
    measures = measures_of(manifest.measures)
    shown = [name for name, measure in measures.items() if measure.shown]
    used = ("success", "time_to_target", "duration", "final_distance")  # whatever the tables show
    episodes = _compact(read_episodes(store, [*shown, *used]))
    episodes = leave_out_failures(episodes, measures.values())
    names = dict.fromkeys([*manifest.agents, *map(str, episodes["agent"].unique())])
    identities = {agent: identify(manifest.agents.get(agent, ())) for agent in names}
    # Without a focus it is all your own, or else the first agent.
    named = require_names("focus", focus, identities)
    yours = [name for name in identities if identities[name].knowledge.kind == "yours"]
    first = sorted(identities, key=lambda name: name == REFERENCE)[:1]
    focus = tuple(dict.fromkeys(named or yours or first))
    if yardstick:
        require_choice("yardstick", yardstick, identities)
    ranking, best, present = pd.DataFrame(), "", set(episodes["environment"].unique())
    with suppress(UserError):  # no scenario was attempted by all
        lost = [cell.key for cell in manifest.not_played]
        controls = {agent: manifest.control(agent) for agent in names}
        ranking = rank_agents(episodes, lost, focus[0], resamples, controls=controls)
        best = str(ranking["agent"].iloc[0])
    return Results(
        manifest=manifest,
        episodes=episodes,
        environments={
            name: Environment.of(manifest.environments.get(name, {}))
            for name in dict.fromkeys([*manifest.environments, *sorted(present)])
            if name in present
        },
        identities=identities,
        focus=focus,
        measures=tuple(
            measures[name] for name in shown if name in episodes and episodes[name].notna().any()
        ),
        ranking=ranking,
        resamples=min(resamples, SCORE_RESAMPLES),
        ranking_resamples=resamples,
        store=store,
        yardstick=yardstick or best,
    )


def _compact(frame: pd.DataFrame) -> pd.DataFrame:
    """Return a table with names as categories, for speed, and seeds as floats (NaN if none)."""
    names = frame.astype({"agent": "category", "environment": "category"})
    return names.assign(training_seed=frame["training_seed"].astype(np.float64))
