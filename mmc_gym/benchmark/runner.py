"""`mmc-gym benchmark`: agents × environments × training seeds, as one grid that can be resumed.

    cells of the grid  ->  run_grid  ->  store  ->  ranking

Cells that are in the store already, made with the same settings, are not played again: so an
interrupted run resumes, and agents and environments can be added.  Cells are played again if the
weights of their agent or its code change (`mmc_gym._identity`), not if versions of libraries
change: the manifest names all versions.
"""

from __future__ import annotations

import math
import platform
import time
import warnings
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import cache, cached_property, partial
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal, NamedTuple

from mmc_gym._errors import MismatchWarning, UserError, require_arguments, warn_of_mismatch
from mmc_gym._files import check_folder
from mmc_gym._grid import CellError, check_workers, run_grid
from mmc_gym._identity import identity, warn_of_unseen
from mmc_gym.agents.base import RandomAgent
from mmc_gym.agents.resolved import ResolvedAgent
from mmc_gym.agents.resolver import Agents, Statistics, Wrappers, resolve_all
from mmc_gym.benchmark.store import (
    EPISODES,
    PATHS,
    CellKey,
    Manifest,
    NotPlayed,
    Policy,
    cell_facts,
    episodes_file,
    kept_cells,
    paths_file,
    update_manifest,
    write_cell,
)
from mmc_gym.benchmark.suite import (
    Arms,
    Environments,
    find_scenarios,
    has_reference,
    make_player,
    minimum_jerk_episodes,
    play_episodes,
)
from mmc_gym.envs.scenarios import Playable
from mmc_gym.interface import CannotActError, ReachInterface, read_attribute
from mmc_gym.measures import MEASURES, Episode, Measure, episode_seeds, run_episodes
from mmc_gym.measures.catalogue import own_measures, register
from mmc_gym.measures.reaching import success

PATHS_KEPT, FAILURES_KEPT = 12, 6
"""The paths of so many first instances, and of so many first failures, are kept of the lowest
training seed that takes part."""

RECORDING = 4
"""Version of recordings and measures; when it changes, all cells are played again."""

_PACKAGES = ("mmc-gym", "gymnasium", "numpy", "scipy", "pandas", "pyarrow", "pymunk")


@dataclass(frozen=True)
class BenchmarkCell:
    """An agent in a scenario."""

    agent: ResolvedAgent
    scenario: Playable
    episodes: int  #: how many, where the scenario does not number its trials
    seed: int  #: that the seeds of the episodes are derived from, the same for all cells
    control: str | None = None  #: the control mode that the user asks for, see `make_player`
    keeps_paths: bool = True  #: whether the paths of its first episodes are written, too
    measures: tuple[Measure, ...] = ()  #: the user's own, which a worker does not know

    @property
    def key(self) -> CellKey:
        """Name of the cell."""
        return CellKey(self.agent.label, self.agent.training_seed, self.scenario.name)

    def not_played(self, status: Literal["skipped", "failed"], reason: str) -> NotPlayed:
        """Return the entry of the manifest if it has no episodes."""
        return NotPlayed(**self.key._asdict(), status=status, reason=reason)

    @cached_property  # workers need not know what it is taken of
    def settings(self) -> dict[str, Any]:
        """Everything that its results are known to depend on, ready for JSON."""
        return {
            "recording": RECORDING,
            "source": self.agent.source_name,
            "fingerprint": self.agent.fingerprint,
            "environment": self.scenario.settings,
            "episodes": self.episodes,
            "seed": self.seed,
            "measures": {
                measure.name: identity(measure.facts, measure.of) for measure in self.measures
            },
            **({"control": self.control} if self.control else {}),
        }


class Outcome(NamedTuple):
    """The result of a cell."""

    not_played: NotPlayed | None = None  #: why it was skipped or failed; None if it was played
    files: Mapping[str, bytes] = {}  #: by kind; none unless played
    warned: tuple[str, ...] = ()  #: texts of each `MismatchWarning`, which workers do not show


def run_cell(cell: BenchmarkCell) -> Outcome:
    """Play a cell.  An error of the agent is a result, and does not end the benchmark."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", MismatchWarning)
        outcome = _outcome(cell)
    warned: dict[str, None] = {}
    for warning in caught:
        if issubclass(warning.category, MismatchWarning):
            warned[str(warning.message)] = None
        else:
            warnings.warn_explicit(
                warning.message, warning.category, warning.filename, warning.lineno
            )
    return outcome._replace(warned=tuple(warned))


def _outcome(cell: BenchmarkCell) -> Outcome:
    for measure in cell.measures:
        register(measure)
    begin = time.process_time()
    try:
        episodes, control = _play(cell)
    except CannotActError as error:
        return Outcome(cell.not_played("skipped", str(error)))
    except (Exception, SystemExit) as error:
        return Outcome(cell.not_played("failed", f"{type(error).__name__}: {error}"))
    files = {}
    if cell.keeps_paths:
        failed = [number for number, episode in enumerate(episodes) if not success(episode)]
        shown = sorted({*range(min(PATHS_KEPT, len(episodes))), *failed[:FAILURES_KEPT]})
        files[PATHS] = paths_file(cell.key, {number: episodes[number] for number in shown})
    facts = {
        "cpu_seconds": round(time.process_time() - begin, 3),
        "control": control,
        "has_paths": PATHS in files,
        "software": software(),
    }
    files[EPISODES] = episodes_file(cell.key, episodes, cell.settings, facts)
    return Outcome(files=files)


@cache
def software() -> dict[str, str]:
    """Return the versions and the machine, by name, that results may depend on."""
    return {
        **{package: version(package) for package in _PACKAGES},
        "python": platform.python_version(),
        "machine": f"{platform.system()} {platform.machine()}",
    }


def _play(cell: BenchmarkCell) -> tuple[Sequence[Episode], str]:
    instances = cell.scenario.instances(cell.episodes)
    seeds = episode_seeds(cell.seed, len(instances))
    if cell.agent.is_reference:
        env: Any = cell.scenario.make()
        if cell.scenario.family or not has_reference(env):
            raise CannotActError(
                "targets wait for the hand, and an ideal one has no arm to perturb"
            )
        anybody = RandomAgent(ReachInterface.of(env))  # for the starts and targets
        with closing(cell.scenario.make_vec(len(seeds)) or env) as arms:
            episodes = run_episodes(anybody, arms, seeds, options=instances)
        return minimum_jerk_episodes(episodes), ""
    asked = {} if cell.control is None else {"control": cell.control}
    env, player = make_player(cell.agent, cell.scenario.with_arguments(**asked))
    with closing(Arms(cell.scenario)) as arms:
        episodes = play_episodes(arms, env, player, seeds, instances)
    return episodes, str(read_attribute(env, "control"))


class Progress(NamedTuple):
    """The progress of a benchmark."""

    done: int  #: number of cells that are finished, those of earlier runs included
    total: int
    key: CellKey | None = None  #: name of the cell that was finished last; None at the start
    failed: NotPlayed | None = None  #: why that cell failed; None if it did not


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
    interface: Any = None,
    allow_pickle: bool = False,
    wrapper: Wrappers = (),
    statistics: Statistics = (),
    on_progress: Callable[[Progress], None] = lambda progress: None,
) -> Manifest:
    """Let agents play the benchmark's environments; keep all in a store, and return its manifest.

    Args:
        agents: names, functions, classes and objects, see `mmc_gym.agents.resolver`.
        out: folder of the store; an existing one is added to, also by several benchmarks at once.
        environments: names of scenarios or of your own environments; or a mapping of names to
            environments, which may be functions or classes; all of the benchmark's by default.
        episodes: in each environment; where trials are numbered each is played once instead.
        seed: of the starts and targets, which are the same for all agents.
        jobs: how many cells are played at once, see `run_grid`.
        cluster: where, see `run_grid`.
        env_kwargs: arguments of all environments.  A `control` among them is for agents that act
            by several control modes, or do not declare one.
        interface: of your own environments, see `compare`.
        allow_pickle: whether files that hold pickles may be loaded, see `compare`.
        wrapper: of models, see `compare`.
        statistics: of models, see `compare`.
        on_progress: called at the start, and whenever a cell is finished.

    Raises:
        UserError: also if the store was made with other settings.
    """
    arguments = require_arguments("env_kwargs", env_kwargs)
    asked = arguments.pop("control", None)
    scenarios = find_scenarios(environments, arguments, interface)
    resolved_agents = resolve_all(
        agents, allow_pickle=allow_pickle, wrapper=wrapper, statistics=statistics
    )
    episodes, seed = len(episode_seeds(seed, episodes)), int(seed)
    check_workers(jobs, cluster)
    settings = {name: _settings(scenario) for name, scenario in scenarios.items()}
    store = check_folder(out, "out")
    begun = update_manifest(
        store, partial(_joined, store, settings, resolved_agents, episodes, seed)
    )
    first: dict[str, int | None] = {}  # of each agent the first training keeps paths
    for agent in sorted(resolved_agents, key=lambda agent: agent.training_seed or 0):
        first.setdefault(agent.label, agent.training_seed)
    cells = [
        BenchmarkCell(
            agent=agent,
            scenario=scenario,
            episodes=episodes,
            seed=seed,
            control=asked,
            keeps_paths=agent.training_seed == first[agent.label],
            measures=own_measures(),
        )
        for scenario in scenarios.values()
        for agent in resolved_agents
        if not (agent.is_reference and scenario.family)  # no perturbation touches it
    ]
    finished: dict[CellKey, NotPlayed | None] = {
        cell.key: None for cell in cells if cell_facts(store, cell.key, cell.settings) is not None
    }
    missing = [cell for cell in cells if cell.key not in finished]
    warn_of_unseen(cell.settings for cell in cells if cell.key in finished)
    reused = len(finished)
    on_progress(Progress(reused, len(cells)))

    def keep(index: int, outcome: Outcome) -> None:
        key = missing[index].key
        write_cell(store, key, outcome.files)  # or remove it, if it was played by a former agent
        finished[key] = why = outcome.not_played
        for text in outcome.warned:
            warn_of_mismatch(text)
        failed = why if why is not None and why.status == "failed" else None
        on_progress(Progress(len(finished), len(cells), key, failed))

    def bury(index: int, error: CellError) -> None:
        keep(index, Outcome(missing[index].not_played("failed", str(error.__cause__))))

    def updated(manifest: Manifest | None) -> Manifest:
        manifest = manifest or begun  # it may have been removed meanwhile
        not_played = [cell for cell in manifest.not_played if cell.key not in finished]
        not_played += [reason for reason in finished.values() if reason is not None]
        known = {"not_played": not_played, "reused": reused}
        return manifest.model_copy(update=known | _facts_of_cells(store))

    try:
        run_grid(run_cell, missing, jobs=jobs, cluster=cluster, on_result=keep, on_failure=bury)
    finally:
        manifest = update_manifest(store, updated)
    return manifest


def _joined(
    out: Path,
    scenarios: Mapping[str, dict[str, Any]],
    resolved_agents: Sequence[ResolvedAgent],
    episodes: int,
    seed: int,
    manifest: Manifest | None,
) -> Manifest:
    """Return the manifest of the store, with these scenarios and agents added."""
    manifest = manifest or Manifest(episodes=episodes, seed=seed)
    _require_same(out, "episodes", manifest.episodes, episodes)
    _require_same(out, "seed", manifest.seed, seed)
    environments: dict[str, Any] = {**manifest.environments}
    for name, asked in scenarios.items():
        settings = environments.setdefault(name, asked)
        _require_same(out, f"environment {name}", settings, asked)
    agents = {**manifest.agents}
    for agent in resolved_agents:
        policies = {policy.training_seed: policy for policy in agents.get(agent.label, [])}
        former = policies.pop(agent.training_seed, None)  # it may have been trained further
        if former is not None:
            _require_same(out, f"agent {agent.label}", former.source, agent.source_name)
        policies[agent.training_seed] = Policy(
            training_seed=agent.training_seed,
            source=agent.source_name,
            name=agent.name,
            knowledge=agent.knowledge,
            training_steps=agent.training_steps,
        )
        agents[agent.label] = [*policies.values()]
    # Measures that only earlier runs knew keep their columns, and so their facts.
    measures = manifest.measures | {name: measure.facts for name, measure in MEASURES.items()}
    known = {"environments": environments, "agents": agents, "measures": measures}
    return manifest.model_copy(update=known)


def _settings(scenario: Playable) -> dict[str, Any]:
    """Return the settings of a scenario and its environment, which is refused if impossible."""
    with closing(scenario.make()) as env:
        world: Any = env.unwrapped
        tolerance = getattr(world, "success_distance", math.nan)
        facts = {
            "control_step": getattr(world.parameters, "control_step", None),
            "segment_lengths": list(getattr(world.parameters, "segment_lengths", ())),
            "tolerance": None if math.isnan(tolerance) else tolerance,
        }
    return {**scenario.settings, **facts}


def _require_same(out: Path, name: str, stored: Any, asked: Any) -> None:
    if stored != asked:
        raise UserError(
            f"out must be a store of the same settings, or a new folder: in {str(out)!r} {name} is "
            f"{stored!r}, asked for is {asked!r}"
        )


def _facts_of_cells(out: Path) -> dict[str, Any]:
    """Return the fields of `Manifest` that follow from all cells of a store, of other runs, too."""
    versions, fingerprints, controls = defaultdict(set), defaultdict(set), defaultdict(set)
    cells = kept_cells(out)
    for _, settings, facts in cells.values():
        for library, number in facts["software"].items():
            versions[library].add(number)
        fingerprints[settings["source"]].add(settings["fingerprint"])
        controls[settings["source"]].add(facts.get("control", ""))
    return {
        "cpu_seconds": {stem: cell.facts["cpu_seconds"] for stem, cell in cells.items()},
        "versions": {name: ", ".join(sorted(values)) for name, values in versions.items()},
        "controls": {source: ", ".join(sorted(modes)) for source, modes in controls.items()},
        "changed": [source for source, digests in fingerprints.items() if len(digests) > 1],
    }
