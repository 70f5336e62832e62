"""`mmc-gym benchmark`: agents × environments × training seeds, as one grid that can be resumed.

    cells of the grid  ->  run_grid  ->  store  ->  ranking

Cells that are in the store already, made with the same settings, are not played again, so that an
interrupted run goes on, and agents and environments can be added.  An agent whose weights, or whose
module's file, have changed is another one.  Other versions of libraries are no reason to play
again: the manifest names all of them.
"""

from __future__ import annotations

import platform
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal, TypeAlias

import gymnasium as gym
import numpy as np

from mmc_gym._grid import check_cluster, run_grid
from mmc_gym.agents.base import Predictor, RandomAgent
from mmc_gym.benchmark.entries import Contestant, contestants, make_for
from mmc_gym.benchmark.reference import has_reference, minimum_jerk_episodes
from mmc_gym.benchmark.store import (
    MANIFEST,
    CellKey,
    cell_facts,
    episodes_file,
    paths_file,
    read_manifest,
    sets_file,
    what_is_kept,
    write_cell,
    write_manifest,
)
from mmc_gym.benchmark.suite import find_scenarios
from mmc_gym.envs.scenarios import Scenario, scenario
from mmc_gym.measures import MEASURES, SET_MEASURES, Episode, Measure, SetMeasure
from mmc_gym.measures.catalogue import digest, own_measures, register_measures
from mmc_gym.measures.rollout import (
    episode_seeds,
    run_episodes,
)

TIMED = 3
"""Episodes that are played one by one as well: what an action takes is known of them."""

DRAWN = 12
"""Instances whose paths are kept, of the lowest training seed that takes part."""

RECORDING = 2
"""Raised whenever the same episodes would be recorded or measured otherwise: all is played anew."""

_PACKAGES = ("mmc-gym", "gymnasium", "numpy", "scipy", "pandas", "pyarrow", "pymunk")
_SAME = 1e-3  # segment lengths between two rollouts of one episode


@dataclass(frozen=True)
class BatteryCell:
    """What is played.

    Attributes:
        contestant: by whom.
        name: of the environment.
        environment: itself.
        episodes: how many, where the environment does not number its trials.
        seed: that the seeds of the episodes are derived from, the same for all cells.
        fingerprint: of the contestant, which it takes long to find.
        keeps_paths: whether its first paths are kept.
        measures: that the user has registered, for the process that plays it.
    """

    contestant: Contestant
    name: str
    environment: Scenario
    episodes: int
    seed: int
    fingerprint: str = ""
    keeps_paths: bool = True
    measures: tuple[Measure | SetMeasure, ...] = ()

    @property
    def key(self) -> CellKey:
        """What it is called."""
        return CellKey(self.contestant.agent, self.contestant.training_seed, self.name)

    @property
    def settings(self) -> dict[str, Any]:
        """What its results depend on, as far as it can be told, ready for JSON."""
        return {
            "recording": RECORDING,
            "source": self.contestant.source,
            "fingerprint": self.fingerprint,
            "environment": self.environment.settings,
            "episodes": self.episodes,
            "seed": self.seed,
            **(
                {"measures": {one.name: digest(one) for one in self.measures}}
                if self.measures
                else {}
            ),
        }


@dataclass(frozen=True)
class CellOutcome:
    """What came of a cell.

    Attributes:
        status: "skipped" if the agent cannot act in the environment, "failed" if it raised.
        reason: why it was skipped or failed.
        episodes: content of its file of episodes; empty unless played.
        paths: content of its file of paths; None if it keeps none.
        sets: content of its file of set measures; None if none is taken in its environment.
        facts: kept with it: wall_seconds, cpu_seconds, control (the meaning of actions), together
            (whether its episodes were played at once), has_paths, has_sets, `software`.
    """

    status: Literal["played", "skipped", "failed"]
    reason: str = ""
    episodes: bytes = b""
    paths: bytes | None = None
    sets: bytes | None = None
    facts: Mapping[str, Any] | None = None


class _CannotActError(Exception):
    """The agent cannot act in the environment."""


def run_cell(cell: BatteryCell) -> CellOutcome:
    """Play a cell.  What an agent raises is a result, and ends nothing."""
    begin, processor_begin = time.perf_counter(), time.process_time()
    register_measures(cell.measures)
    try:
        recorded = _play(cell)
    except _CannotActError as error:
        return CellOutcome("skipped", str(error))
    except Exception as error:
        return CellOutcome("failed", f"{type(error).__name__}: {error}")
    paths = None
    if cell.keeps_paths:
        paths = paths_file(cell.key, recorded.episodes[:DRAWN], recorded.joint_count)
    sets = sets_file(cell.key, recorded.episodes)
    facts = {
        "wall_seconds": round(time.perf_counter() - begin, 3),
        "cpu_seconds": round(time.process_time() - processor_begin, 3),
        "control": recorded.control,
        "together": recorded.together,
        "has_paths": paths is not None,
        "has_sets": sets is not None,
        "software": software(),
    }
    content = episodes_file(cell.key, recorded.episodes, cell.settings, facts)
    return CellOutcome("played", "", content, paths, sets, facts)


@cache
def software() -> dict[str, str]:
    """What results may depend on: versions, by name, and the machine."""
    return {
        **{package: version(package) for package in _PACKAGES},
        "python": platform.python_version(),
        "machine": f"{platform.system()} {platform.machine()}",
    }


@dataclass(frozen=True)
class _Recorded:
    episodes: Sequence[Episode]
    control: str
    together: bool
    joint_count: int


def _play(cell: BatteryCell) -> _Recorded:
    instances = cell.environment.instances(cell.episodes)
    seeds = episode_seeds(cell.seed, len(instances))
    if cell.contestant.is_reference:
        return _play_reference(cell, seeds, instances)
    env, agent = _made(cell)
    control, joints = env.unwrapped.control, env.unwrapped.setup.joint_count  # type: ignore[attr-defined]
    timed = run_episodes(agent, env, seeds[:TIMED], options=instances[:TIMED])
    together = _play_together(cell, env, control, seeds, instances)
    if together is None or not (cell.contestant.is_own or _are_same(timed, together)):
        agent = cell.contestant.factory(env)  # a new one: it may remember what it should not
        alone = run_episodes(agent, env, seeds, options=instances)
        return _Recorded(alone, control, False, joints)
    times = [
        replace(episode, action_times=one.action_times) for episode, one in zip(together, timed)
    ]
    return _Recorded([*times, *together[TIMED:]], control, True, joints)


def _made(cell: BatteryCell) -> tuple[gym.Env[Any, Any], Predictor]:
    """The agent, and the environment that it was made for.

    All act by the same actions, but a policy that was trained for others, which have no meaning
    there, by its own.
    """
    try:
        return make_for(cell.contestant.factory, cell.environment.make)
    except ValueError as refusal:
        raise _CannotActError(str(refusal)) from refusal


def _play_together(
    cell: BatteryCell,
    env: gym.Env[Any, Any],
    control: str,
    seeds: Sequence[int],
    instances: Sequence[Mapping[str, Any]],
) -> tuple[Episode, ...] | None:
    """All episodes at once; None if the agent does not take batches of observations."""
    vector = cell.environment.make_vec(len(seeds), control)
    try:
        return run_episodes(cell.contestant.factory(env), vector, seeds, options=instances)
    except Exception:
        if cell.contestant.is_own:
            raise
        return None
    finally:
        vector.close()


def _are_same(alone: Sequence[Episode], together: Sequence[Episode]) -> bool:
    """Whether an agent plays together as it does alone.

    One that takes batches, and keeps in itself what it should keep in its state, does not.
    """
    return all(
        np.allclose(one.hands, other.hands, rtol=0.0, atol=_SAME)
        for one, other in zip(alone, together)
    )


def _play_reference(
    cell: BatteryCell, seeds: Sequence[int], instances: Sequence[Mapping[str, Any]]
) -> _Recorded:
    """The ideal hand, which no perturbation touches; starts and targets are anybody's."""
    env = cell.environment.make()
    if cell.environment.family or not has_reference(env):
        raise _CannotActError("targets wait for the hand, and an ideal one has no arm to perturb")
    joints = env.unwrapped.setup.joint_count  # type: ignore[attr-defined]
    vector = cell.environment.make_vec(len(seeds))
    anybody = run_episodes(RandomAgent(joints), vector, seeds, options=instances)
    vector.close()
    return _Recorded(minimum_jerk_episodes(anybody), "", True, joints)


Manifest: TypeAlias = dict[str, Any]


@dataclass(frozen=True)
class Progress:
    """Where a benchmark is.

    Attributes:
        done: cells that are finished, those of earlier runs included.
        total: cells that there are.
        key: of the last cell that was finished; None at the start.
        outcome: what came of it.
    """

    done: int
    total: int
    key: CellKey | None = None
    outcome: CellOutcome | None = None


def benchmark(
    agents: Iterable[str],
    out: Path,
    environments: Iterable[str] = (),
    episodes: int = 100,
    seed: int = 0,
    *,
    jobs: int | None = None,
    cluster: str | None = None,
    on_progress: Callable[[Progress], None] = lambda progress: None,
) -> Manifest:
    """Let agents play a battery of environments, and keep all in a store.

    Args:
        agents: names, see `contestants`.
        out: folder of the store; one that is there is added to.
        environments: names of scenarios; all of the benchmark by default.
        episodes: in each environment; where trials are numbered each is played once instead.
        seed: decides on starts and targets, which are the same for all agents.
        jobs: how many cells are played at once, see `run_grid`.
        cluster: where, see `run_grid`.
        on_progress: called at the start, and whenever a cell is finished.

    Returns:
        The manifest of the store.

    Raises:
        ValueError: for unknown names, or a store that was made with other settings.
    """
    found = find_scenarios(environments)
    players = contestants(agents)
    episode_seeds(seed, episodes)
    check_cluster(cluster)
    manifest = _joined_manifest(out, found, players, episodes, seed)
    fingerprints = {one: one.fingerprint for one in players}
    lowest: dict[str, int] = {}
    for one in players:
        lowest[one.agent] = min(one.training_seed, lowest.get(one.agent, one.training_seed))
    cells = [
        BatteryCell(
            *(one, name, environment, episodes, seed, fingerprints[one]),
            keeps_paths=one.training_seed == lowest[one.agent],
            measures=own_measures(),
        )
        for one in players
        for name, environment in found.items()
        if not (one.is_reference and environment.family)  # no perturbation touches it
    ]
    write_manifest(out, manifest)
    missing, begin = [], time.perf_counter()
    for cell in cells:
        facts = cell_facts(out, cell.key, cell.settings)
        if facts is None:
            missing.append(cell)
        else:
            _note(manifest, cell.key, CellOutcome("played", facts=facts))
    manifest["reused"] = done = len(cells) - len(missing)
    on_progress(Progress(done, len(cells)))

    def keep(index: int, outcome: CellOutcome) -> None:
        nonlocal done
        key = missing[index].key
        if outcome.status == "played":
            write_cell(out, key, outcome.episodes, outcome.paths, outcome.sets)
        _note(manifest, key, outcome)
        done += 1
        on_progress(Progress(done, len(cells), key, outcome))

    try:
        run_grid(run_cell, missing, jobs=jobs, cluster=cluster, on_result=keep)
    finally:
        manifest["elapsed_seconds"] += round(time.perf_counter() - begin, 1)
        manifest.update(_found(out))
        write_manifest(out, manifest)
    return read_manifest(out)


def not_played(manifest: Manifest) -> list[CellKey]:
    """The cells of a store that were skipped or failed."""
    return [
        CellKey(entry["agent"], entry["training_seed"], entry["environment"])
        for entry in (*manifest["skipped"], *manifest["failed"])
    ]


def untrained(manifest: Manifest) -> list[str]:
    """The agents of a store that were not trained."""
    return [agent for agent, entry in manifest["agents"].items() if not entry["trained"]]


def _joined_manifest(
    out: Path,
    environments: dict[str, Scenario],
    players: Sequence[Contestant],
    episodes: int,
    seed: int,
) -> Manifest:
    """The manifest of the store, with these environments and agents added."""
    if out.exists() and not out.is_dir():
        raise ValueError(f"out must be a folder, got the file {str(out)!r}")
    manifest = fresh = _fresh_manifest(episodes, seed)
    if (out / MANIFEST).exists():
        kept = read_manifest(out)
        # Of a measure that is known to an earlier run alone, its columns are kept as well.
        measures = {
            kind: {**kept.get(kind, {}), **fresh[kind]} for kind in ("measures", "set_measures")
        }
        manifest = {**fresh, **kept, **measures}
    _require_same(out, "episodes", manifest["episodes"], episodes)
    _require_same(out, "seed", manifest["seed"], seed)
    for name, environment in environments.items():
        settings = environment.settings
        kept = manifest["environments"].setdefault(name, settings)
        _require_same(out, f"environment {name}", kept, settings)
    for one in players:
        entry = manifest["agents"].setdefault(one.agent, {"trained": False, "sources": {}})
        kept = entry["sources"].setdefault(str(one.training_seed), one.source)
        _require_same(out, f"agent {one.agent}", kept, one.source)
        entry["trained"] |= one.is_trained
    return manifest


def _fresh_manifest(episodes: int, seed: int) -> Manifest:
    plain: Any = scenario("random").make().unwrapped
    return {
        "episodes": episodes,
        "seed": seed,
        "control_step": plain.parameters.control_step,
        "segment_lengths": list(plain.parameters.segment_lengths),
        "tolerance": plain.success_distance,
        "control": plain.control,
        "measures": {name: one.facts for name, one in MEASURES.items()},
        "set_measures": {name: one.facts for name, one in SET_MEASURES.items()},
        "environments": {},
        "agents": {},
        "skipped": [],
        "failed": [],
        "wall_seconds": {},
        "cpu_seconds": {},
        "elapsed_seconds": 0.0,
        "reused": 0,
        "versions": {},
        "changed": [],
    }


def _found(out: Path) -> Manifest:
    """What the cells of a store, of this run and of earlier ones, were played with.

    Returns:
        versions: all of each package, separated by commas.
        changed: sources of agents whose cells are not all of the same weights or code.
    """
    versions, fingerprints = defaultdict(set), defaultdict(set)
    for kept in what_is_kept(out):
        for name, one in kept["facts"].get("software", {}).items():
            versions[name].add(one)
        settings = kept["settings"]
        fingerprints[settings.get("source")].add(settings.get("fingerprint"))
    return {
        "versions": {name: ", ".join(sorted(found)) for name, found in versions.items()},
        "changed": [source for source, found in fingerprints.items() if len(found) > 1],
    }


def _require_same(out: Path, name: str, kept: Any, asked: Any) -> None:
    if kept != asked:
        raise ValueError(
            f"out must be a store of the same settings, or a new folder: in {str(out)!r} {name} is "
            f"{kept!r}, asked for is {asked!r}"
        )


def _note(manifest: Manifest, key: CellKey, outcome: CellOutcome) -> None:
    """Write down what came of a cell, in place of what came of it before."""
    for status in ("skipped", "failed"):
        manifest[status] = [
            entry
            for entry in manifest[status]
            if (entry["agent"], entry["training_seed"], entry["environment"]) != key
        ]
    if outcome.status != "played":
        manifest[outcome.status].append({**key._asdict(), "reason": outcome.reason})
        return
    assert outcome.facts is not None
    for name in ("wall_seconds", "cpu_seconds"):
        manifest[name][key.file_name.removesuffix(".parquet")] = outcome.facts[name]
