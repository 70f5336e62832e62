"""What the report is made of: episodes, paths and settings, read from a benchmark's store."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from mmc_gym.agents.reinforcement import PRETRAINED, PolicyCard
from mmc_gym.evaluation.battery import BASELINE
from mmc_gym.evaluation.benchmark import untrained
from mmc_gym.evaluation.learning_curves import read_cards
from mmc_gym.evaluation.measures import MEASURES, Measure
from mmc_gym.evaluation.report.knowledge import agent_order
from mmc_gym.evaluation.store import read_episodes, read_manifest, read_paths


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
            and those of `MEASURES`.
        paths: columns agent, training_seed, environment, instance, step, joint_angle_1 to _N,
            hand_x, hand_y, target_x, target_y; empty if none were kept.
        environments: by key, in the order of the manifest.
        agents: in the order of the report.
        control_step: seconds.
        segment_lengths: of the arm that agents are told of.
        tolerance: distance that counts as reached, segment lengths.
        versions: of the libraries.
        cell_seconds: that all cells together took.
        not_played: agent, environment and reason of the cells without episodes.
        cards: of the trained policies, by the name of the agent.
    """

    episodes: pd.DataFrame
    paths: pd.DataFrame
    environments: Mapping[str, Environment]
    agents: tuple[str, ...]
    control_step: float
    segment_lengths: tuple[float, ...]
    tolerance: float
    versions: Mapping[str, str]
    cell_seconds: float
    not_played: tuple[tuple[str, str, str], ...]
    cards: Mapping[str, Sequence[PolicyCard]]

    def seeds(self, agent: str) -> int:
        """Number of training seeds of an agent; 0 without training."""
        rows = self.episodes.loc[self.episodes["agent"] == agent, "training_seed"]
        return int(rows.nunique(dropna=True))

    def instances(self, environment: str) -> int:
        """Number of starts and targets in an environment."""
        rows = self.episodes["environment"] == environment
        return int(self.episodes.loc[rows, "instance"].nunique())

    @property
    def measures(self) -> tuple[Measure, ...]:
        """The measures that the report shows: those of `mmc-gym compare` that were stored."""
        return tuple(
            measure
            for measure in MEASURES
            if measure.shown
            and measure.name in self.episodes
            and self.episodes[measure.name].notna().any()
        )


def read_results(store: Path, cards: Path = PRETRAINED) -> Results:
    """Read a store.

    Args:
        store: its folder.
        cards: folder of the policies that took part, for their learning curves.

    Raises:
        ValueError: if there is no store, or it is damaged.
    """
    manifest = read_manifest(store)
    not_trained = untrained(manifest)
    episodes = _without_seeds(read_episodes(store), not_trained)
    present = set(episodes["environment"])
    agents = agent_order(map(str, dict.fromkeys(episodes["agent"])))
    missing = (*manifest["skipped"], *manifest["failed"])
    return Results(
        episodes=episodes,
        paths=_paths(store, not_trained),
        environments={
            key: _environment(key, entry)
            for key, entry in manifest["environments"].items()
            if key in present
        },
        agents=agents,
        control_step=float(manifest["control_step"]),
        segment_lengths=tuple(map(float, manifest["segment_lengths"])),
        tolerance=float(manifest["tolerance"]),
        versions=manifest["versions"],
        cell_seconds=float(sum(manifest["wall_seconds"].values())),
        not_played=tuple((e["agent"], e["environment"], e["reason"]) for e in missing),
        cards=_cards(cards, agents),
    )


def _environment(key: str, entry: Mapping[str, Any]) -> Environment:
    strength = entry["strength"]
    return Environment(
        key,
        id=entry["id"],
        description=entry["description"],
        family=entry["family"],
        strength=math.nan if strength is None else float(strength),
        unit=entry["unit"],
        baseline=entry["baseline"] or BASELINE,
    )


def _paths(store: Path, not_trained: Collection[str]) -> pd.DataFrame:
    try:
        paths = _without_seeds(read_paths(store), not_trained)
        return paths.astype({"agent": "category", "environment": "category"})  # quick to compare
    except ValueError:
        return pd.DataFrame()  # the report can do without


def _cards(folder: Path, agents: Collection[str]) -> dict[str, Sequence[PolicyCard]]:
    try:
        cards = read_cards(folder)
    except ValueError:
        return {}  # nothing was trained
    return {name: group for name, group in cards.items() if name in agents}


def _without_seeds(frame: pd.DataFrame, not_trained: Collection[str]) -> pd.DataFrame:
    """The training seed is missing, rather than 0, where nothing was trained."""
    seeds = frame["training_seed"].astype(np.float64)
    return frame.assign(training_seed=seeds.mask(frame["agent"].isin(list(not_trained))))
