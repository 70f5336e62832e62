"""`mmc-gym benchmark`: agents × environments × training seeds, as one grid that can be resumed.

    cells of the grid  ->  run_grid  ->  store  ->  ranking

Cells that are in the store already, made with the same settings, are not played again, so that an
interrupted run goes on, and agents and environments can be added.  An agent whose weights, or whose
module's file, have changed is another one.  Other versions of libraries are no reason to play
again: the manifest names all of them.
"""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

from mmc_gym._grid import check_cluster, run_grid
from mmc_gym.benchmark.battery_cell import BatteryCell, CellOutcome, run_cell
from mmc_gym.benchmark.entries import Contestant, contestants
from mmc_gym.benchmark.store import (
    MANIFEST,
    CellKey,
    cell_facts,
    read_manifest,
    what_is_kept,
    write_cell,
    write_manifest,
)
from mmc_gym.benchmark.suite import BatteryEnvironment, find_environments
from mmc_gym.measures.catalogue import MEASURES
from mmc_gym.measures.rollout import episode_seeds

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
        environments: names in `battery.ENVIRONMENTS`; all by default.
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
    found = find_environments(environments)
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
    environments: dict[str, BatteryEnvironment],
    players: Sequence[Contestant],
    episodes: int,
    seed: int,
) -> Manifest:
    """The manifest of the store, with these environments and agents added."""
    if out.exists() and not out.is_dir():
        raise ValueError(f"out must be a folder, got the file {str(out)!r}")
    manifest = fresh = _fresh_manifest(episodes, seed)
    if (out / MANIFEST).exists():
        manifest = {**fresh, **read_manifest(out), "measures": fresh["measures"]}
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
    plain: Any = BatteryEnvironment("").make().unwrapped
    return {
        "episodes": episodes,
        "seed": seed,
        "control_step": plain.parameters.control_step,
        "segment_lengths": list(plain.parameters.segment_lengths),
        "tolerance": plain.success_distance,
        "control": plain.control,
        "measures": {measure.name: measure.unit for measure in MEASURES},
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
