"""`mmc-gym benchmark`: agents × environments × training seeds, as one grid that can be resumed.

    cells of the grid  ->  run_grid  ->  store  ->  ranking

Cells that are in the store already, made with the same settings, are not played again: so an
interrupted run resumes, and agents and environments can be added.  An agent whose weights, or whose
module's file, have changed is another one.  Other versions of libraries are no reason to play
again: the manifest names all of them.
"""

from __future__ import annotations

import platform
import time
import warnings
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from mmc_gym._errors import MismatchWarning, UserError
from mmc_gym._files import check_folder
from mmc_gym._grid import CellError, check_workers, run_grid
from mmc_gym.agents.base import RandomAgent
from mmc_gym.agents.resolver import Agents, ResolvedAgent, resolve_all
from mmc_gym.benchmark.store import (
    EPISODES,
    PATHS,
    SETS,
    CellKey,
    Manifest,
    NotPlayed,
    Policy,
    cell_facts,
    episodes_file,
    kept_cells,
    paths_file,
    sets_file,
    update_manifest,
    write_cell,
)
from mmc_gym.benchmark.suite import (
    Environments,
    find_scenarios,
    has_reference,
    make_player,
    minimum_jerk_episodes,
)
from mmc_gym.envs.scenarios import Scenario
from mmc_gym.envs.scenarios import scenario as find_scenario
from mmc_gym.interface import CannotActError
from mmc_gym.measures import (
    MEASURES,
    SET_MEASURES,
    Episode,
    Measure,
    SetMeasure,
    episode_seeds,
    run_episodes,
)
from mmc_gym.measures.catalogue import digest, own_measures, register

TIMED = 1
"""Episodes that are played one by one as well, to time single actions."""

COMPARED = 3
"""The same for agents that may not act on batches: they must do the same alone and together."""

PATHS_KEPT = 12
"""Instances whose paths are kept, of the lowest training seed that takes part."""

RECORDING = 3
"""Version of recordings and measures: another one plays all cells again."""

_PACKAGES = ("mmc-gym", "gymnasium", "numpy", "scipy", "pandas", "pyarrow", "pymunk")
_SAME = 1e-3  # segment lengths between two rollouts of one episode


@dataclass(frozen=True)
class BenchmarkCell:
    """An agent in a scenario.

    Attributes:
        episodes: how many, where the scenario does not number its trials.
        seed: that the seeds of the episodes are derived from, the same for all cells.
        control: that the user asks for, see `make_player`.
        measures: the user's own, which a worker does not know.
    """

    agent: ResolvedAgent
    scenario: Scenario
    episodes: int
    seed: int
    control: str | None = None
    keeps_paths: bool = True
    measures: tuple[Measure | SetMeasure, ...] = ()

    @property
    def key(self) -> CellKey:
        """Name of the cell."""
        return CellKey(self.agent.label, self.agent.training_seed, self.scenario.name)

    @property
    def settings(self) -> dict[str, Any]:
        """Everything that its results depend on, as far as is known; ready for JSON."""
        return {
            "recording": RECORDING,
            "source": self.agent.source_name,
            "fingerprint": self.agent.fingerprint,
            "environment": self.scenario.settings,
            "episodes": self.episodes,
            "seed": self.seed,
            "measures": {one.name: digest(one) for one in self.measures},
            **({"control": self.control} if self.control else {}),
        }


@dataclass(frozen=True)
class Outcome:
    """The result of a cell.

    Attributes:
        status: "skipped" if the agent cannot act in the scenario, "failed" if it raised.
        reason: why it was skipped or failed.
        files: its files, see `write_cell`; none unless played.
        warned: texts of its `MismatchWarning`s, which a worker's terminal would not show.
    """

    status: Literal["played", "skipped", "failed"]
    reason: str = ""
    files: Mapping[str, bytes] = field(default_factory=dict)
    warned: tuple[str, ...] = ()


class _Recorded(NamedTuple):
    """The episodes of a cell.

    Attributes:
        control: the control mode, "" of the ideal hand.
        together: whether all episodes were played at once.
    """

    episodes: Sequence[Episode]
    control: str
    together: bool
    joint_count: int


def run_cell(cell: BenchmarkCell) -> Outcome:
    """Play a cell.  An error of the agent is a result, and ends nothing."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", MismatchWarning)
        outcome = _outcome(cell)
    warned = []
    for one in caught:
        if issubclass(one.category, MismatchWarning):
            warned.append(str(one.message))
        else:
            warnings.warn_explicit(one.message, one.category, one.filename, one.lineno)
    return replace(outcome, warned=tuple(dict.fromkeys(warned)))


def _outcome(cell: BenchmarkCell) -> Outcome:
    for measure in cell.measures:
        register(measure)
    begin, processor_begin = time.perf_counter(), time.process_time()
    try:
        recorded = _play(cell)
    except CannotActError as error:
        return Outcome("skipped", str(error))
    except (Exception, SystemExit) as error:
        return Outcome("failed", f"{type(error).__name__}: {error}")
    files = {}
    if cell.keeps_paths:
        files[PATHS] = paths_file(cell.key, recorded.episodes[:PATHS_KEPT], recorded.joint_count)
    if (sets := sets_file(cell.key, recorded.episodes)) is not None:
        files[SETS] = sets
    facts = {
        "wall_seconds": round(time.perf_counter() - begin, 3),
        "cpu_seconds": round(time.process_time() - processor_begin, 3),
        "control": recorded.control,
        "together": recorded.together,
        "has_paths": PATHS in files,
        "has_sets": SETS in files,
        "software": software(),
    }
    files[EPISODES] = episodes_file(cell.key, recorded.episodes, cell.settings, facts)
    return Outcome("played", files=files)


@cache
def software() -> dict[str, str]:
    """Return versions and machine by name: results may depend on them."""
    return {
        **{package: version(package) for package in _PACKAGES},
        "python": platform.python_version(),
        "machine": f"{platform.system()} {platform.machine()}",
    }


def _play(cell: BenchmarkCell) -> _Recorded:
    instances = cell.scenario.instances(cell.episodes)
    seeds = episode_seeds(cell.seed, len(instances))
    if cell.agent.is_reference:
        return _play_reference(cell, seeds, instances)
    factory = cell.agent.factory
    env, agent = make_player(cell.agent, cell.scenario, {"control": cell.control})
    world: Any = env.unwrapped
    control, joints = world.control, len(world.parameters.segment_lengths)
    vector = cell.scenario.make_vec(len(seeds), control)
    acts_on_batches = cell.agent.acts_on_batches and vector is not None
    alone_first = TIMED if acts_on_batches else COMPARED
    timed = run_episodes(agent, env, seeds[:alone_first], options=instances[:alone_first])
    together: tuple[Episode, ...] = ()
    if vector is not None:
        try:
            together = run_episodes(factory(env), vector, seeds, options=instances)
        except Exception:
            if acts_on_batches:
                raise
        finally:
            vector.close()
    if not acts_on_batches and not _are_same(timed, together):
        agent = factory(env)  # a new one: it may remember what it should not
        alone = run_episodes(agent, env, seeds, options=instances)
        return _Recorded(alone, control, False, joints)
    times = [
        replace(episode, action_times=one.action_times) for episode, one in zip(together, timed)
    ]
    return _Recorded([*times, *together[len(times) :]], control, True, joints)


def _are_same(alone: Sequence[Episode], together: Sequence[Episode]) -> bool:
    """Return whether an agent plays together as it does alone.

    An agent does not if it takes no batches, or keeps in itself what belongs in its state.
    """
    return len(together) >= len(alone) and all(
        np.allclose(one.hands, other.hands, rtol=0.0, atol=_SAME)
        for one, other in zip(alone, together)
    )


def _play_reference(
    cell: BenchmarkCell, seeds: Sequence[int], instances: Sequence[Mapping[str, Any]]
) -> _Recorded:
    """Play the ideal hand, which no perturbation touches, with the starts and targets of all."""
    env = cell.scenario.make()
    if cell.scenario.family or not has_reference(env):
        raise CannotActError("targets wait for the hand, and an ideal one has no arm to perturb")
    joints = len(env.unwrapped.parameters.segment_lengths)  # type: ignore[attr-defined]
    vector = cell.scenario.make_vec(len(seeds))
    anybody = run_episodes(RandomAgent(joints), vector or env, seeds, options=instances)
    (vector or env).close()
    return _Recorded(minimum_jerk_episodes(anybody), "", True, joints)


@dataclass(frozen=True)
class Progress:
    """The progress of a benchmark.

    Attributes:
        done: number of cells that are finished, those of earlier runs included.
        total: number of cells.
        key: name of the cell that was finished last; None at the start.
    """

    done: int
    total: int
    key: CellKey | None = None


def benchmark(
    agents: Agents,
    out: Path | str,
    environments: Environments = (),
    episodes: int = 100,
    seed: int = 0,
    *,
    jobs: int | None = None,
    cluster: str | None = None,
    env_kwargs: Mapping[str, Any] | None = None,
    allow_pickle: bool = False,
    on_progress: Callable[[Progress], None] = lambda progress: None,
) -> Manifest:
    """Let agents play the benchmark's environments; keep all in a store, and return its manifest.

    Args:
        agents: names, functions, classes and objects, see `mmc_gym.agents.resolver`.
        out: folder of the store; one that is there is added to, also by several benchmarks at once.
        environments: names of scenarios or of your own environments; or a mapping of names to
            environments, which may be functions or classes; all of the benchmark's by default.
        episodes: in each environment; where trials are numbered each is played once instead.
        seed: of the starts and targets, which are the same for all agents.
        jobs: how many cells are played at once, see `run_grid`.
        cluster: where, see `run_grid`.
        env_kwargs: arguments of all environments.  A `control` among them is for agents that act
            by several control modes, or do not tell theirs.
        allow_pickle: whether files that hold pickles may be loaded, see `compare`.
        on_progress: called at the start, and whenever a cell is finished.

    Raises:
        UserError: if an argument is not accepted, or the store was made with other settings.
    """
    given = dict(env_kwargs or {})
    asked = given.pop("control", None)
    scenarios = find_scenarios(environments, given)
    found = resolve_all(agents, allow_pickle=allow_pickle)
    episode_seeds(seed, episodes)
    check_workers(jobs, cluster)
    store = check_folder(out, "out")
    begun = update_manifest(store, partial(_joined, store, scenarios, found, episodes, seed))
    cells = [replace(one, control=asked) for one in _cells(scenarios, found, episodes, seed)]
    begin = time.perf_counter()
    missing: list[BenchmarkCell] = []
    finished: dict[CellKey, NotPlayed | None] = {}
    for cell in cells:
        if cell_facts(store, cell.key, cell.settings) is None:
            missing.append(cell)
        else:
            finished[cell.key] = None
    reused = len(finished)
    on_progress(Progress(reused, len(cells)))

    def keep(index: int, outcome: Outcome) -> None:
        key = missing[index].key
        write_cell(store, key, outcome.files)  # or remove it, if it was played by a former agent
        finished[key] = None
        if outcome.status != "played":
            finished[key] = NotPlayed.of(key, outcome.status, outcome.reason)
        for text in outcome.warned:
            warnings.warn(text, MismatchWarning, stacklevel=1)
        on_progress(Progress(len(finished), len(cells), key))

    def bury(index: int, error: CellError) -> None:
        keep(index, Outcome("failed", str(error.__cause__)))

    def updated(manifest: Manifest | None) -> Manifest:
        manifest = manifest or begun  # it may have been removed meanwhile
        not_played = [one for one in manifest.not_played if one.key not in finished]
        not_played += [one for one in finished.values() if one is not None]
        seconds = manifest.elapsed_seconds + round(time.perf_counter() - begin, 1)
        known = {"not_played": not_played, "elapsed_seconds": seconds, "reused": reused}
        return manifest.model_copy(update={**known, **_found(store)})

    try:
        run_grid(run_cell, missing, jobs=jobs, cluster=cluster, on_result=keep, on_failure=bury)
    finally:
        manifest = update_manifest(store, updated)
    return manifest


def _cells(
    scenarios: Mapping[str, Scenario], agents: Sequence[ResolvedAgent], episodes: int, seed: int
) -> list[BenchmarkCell]:
    """Return all cells; of each agent, the first of its trainings keeps paths."""
    first: dict[str, int | None] = {}
    for one in sorted(agents, key=lambda one: one.training_seed or 0):
        first.setdefault(one.label, one.training_seed)
    return [
        BenchmarkCell(
            agent=one,
            scenario=scenario,
            episodes=episodes,
            seed=seed,
            keeps_paths=one.training_seed == first[one.label],
            measures=own_measures(),
        )
        for one in agents
        for scenario in scenarios.values()
        if not (one.is_reference and scenario.family)  # no perturbation touches it
    ]


def _joined(
    out: Path,
    scenarios: Mapping[str, Scenario],
    found: Sequence[ResolvedAgent],
    episodes: int,
    seed: int,
    manifest: Manifest | None,
) -> Manifest:
    """Return the manifest of the store, with these scenarios and agents added."""
    if manifest is None:
        plain: Any = find_scenario("random").make().unwrapped
        manifest = Manifest(
            episodes=episodes,
            seed=seed,
            control_step=plain.parameters.control_step,
            segment_lengths=plain.parameters.segment_lengths,
            tolerance=plain.success_distance,
            control=plain.control,
        )
    _require_same(out, "episodes", manifest.episodes, episodes)
    _require_same(out, "seed", manifest.seed, seed)
    environments = dict(manifest.environments)
    for name, scenario in scenarios.items():
        settings = environments.setdefault(name, scenario.settings)
        _require_same(out, f"environment {name}", settings, scenario.settings)
    agents = {name: list(policies) for name, policies in manifest.agents.items()}
    for one in found:
        policies = agents.setdefault(one.label, [])
        asked = Policy(training_seed=one.training_seed, source=one.source_name)
        same = [policy for policy in policies if policy.training_seed == asked.training_seed]
        policies += [] if same else [asked]
        for kept in same:
            _require_same(out, f"agent {one.label}", kept.source, asked.source)
    # A measure that only another run knew keeps its columns, and so its facts.
    measures = {name: one.facts for name, one in MEASURES.items()}
    set_measures = {name: one.facts for name, one in SET_MEASURES.items()}
    return manifest.model_copy(
        update={
            "environments": environments,
            "agents": agents,
            "measures": manifest.measures | measures,
            "set_measures": manifest.set_measures | set_measures,
        }
    )


def _require_same(out: Path, name: str, kept: Any, asked: Any) -> None:
    if kept != asked:
        raise UserError(
            f"out must be a store of the same settings, or a new folder: in {str(out)!r} {name} is "
            f"{kept!r}, asked for is {asked!r}"
        )


def _found(out: Path) -> dict[str, Any]:
    """Return the fields of `Manifest` that follow from all cells of a store, of other runs, too."""
    versions, fingerprints = defaultdict(set), defaultdict(set)
    seconds: dict[str, dict[str, float]] = {"wall_seconds": {}, "cpu_seconds": {}}
    for stem, (settings, facts) in kept_cells(out).items():
        for name, one in facts["software"].items():
            versions[name].add(one)
        fingerprints[settings["source"]].add(settings["fingerprint"])
        for name, by_cell in seconds.items():
            by_cell[stem] = facts[name]
    return {
        **seconds,
        "versions": {name: ", ".join(sorted(found)) for name, found in versions.items()},
        "changed": [source for source, found in fingerprints.items() if len(found) > 1],
    }
