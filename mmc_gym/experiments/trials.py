"""Let agents go through an experiment, trial by trial, as several subjects each.

    Experiment  ->  cells (an agent, some subjects)  ->  run_grid  ->  ExperimentResult

A trial depends on the experiment, the agent and the subject's own seed, not on the number of
subjects.  In a folder every cell is one file, written atomically: an interrupted run resumes, and
subjects and agents can be added.

    trials/AGENT--EXPERIMENT.DIGEST.FIRST-LAST.parquet    the trials of some subjects
    trials/AGENT--EXPERIMENT.DIGEST.json                  a plan: the number of subjects

DIGEST is a hash of all settings but the subjects: runs with other settings have other files.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache, partial
from importlib.metadata import version
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
import pandas as pd
import pyarrow as pa  # type: ignore[import-untyped]
from numpy.typing import NDArray

from mmc_gym._cells import Cell, CellFiles, cell_content, list_differences, parse_cell, safe_name
from mmc_gym._errors import UserError, require, require_arguments, require_names, require_whole
from mmc_gym._files import (
    UNSEALED,
    check_folder,
    check_seal,
    digest_of,
    require_path,
    seal,
    write_atomically,
)
from mmc_gym._grid import run_grid
from mmc_gym._identity import warn_of_unseen
from mmc_gym.agents.base import Agent, Predictor
from mmc_gym.agents.body_model.agent import BodyAgent
from mmc_gym.agents.body_model.parts import LEARNED, Parts
from mmc_gym.agents.resolved import ResolvedAgent
from mmc_gym.agents.resolver import Agents, Statistics, Wrappers, resolve_all
from mmc_gym.benchmark.store import TRIALS
from mmc_gym.benchmark.suite import SET_BY_SCENARIOS, make_player
from mmc_gym.envs.scenarios import as_json
from mmc_gym.experiments.adaptation import BEFORE_FEEDBACK
from mmc_gym.experiments.experiment import Condition, Experiment, find_experiment
from mmc_gym.experiments.learning import describe_movements
from mmc_gym.experiments.results import ExperimentResult
from mmc_gym.geometry import turned_back
from mmc_gym.interface import read_attribute
from mmc_gym.measures.rollout import run_trial

RECORDING = 6
"""Version of recordings; when it changes, all cells are played again."""

_OF_PARTS = 1  # last number of the seed that draws a subject's parts
_SUBJECTS = 20  # most subjects in a cell
_TOGETHER = 1_000  # most trials played at once, to bound memory
_PATHS = {"hands": "hands", "cursors": "seen_hands", "targets": "targets"}  # in `Episode`


class Player(NamedTuple):
    """An agent that can act in an experiment, and the facts that its environments need."""

    agent: Any  #: an `Agent`, or your own object with `predict`
    control: str  #: its control mode
    control_step: float  #: s
    tolerance: float  #: distance from the target that counts as success, segment lengths
    has_parts: bool  #: whether `parts` set how it learns; False for agents of your own
    takes_batches: bool  #: whether it plays many trials at once: an `Agent` without a wrapper


@dataclass(frozen=True)
class TrialsCell:
    """Some subjects of an agent in an experiment; see `run_experiment`."""

    agent: ResolvedAgent
    experiment: Experiment
    subjects: range
    seed: int = 0
    keeps_all: bool = False
    parts: Mapping[str, Any] = field(default_factory=dict)  #: how it learns, if it has `Parts`
    env_kwargs: Mapping[str, Any] = field(default_factory=dict)

    @property
    def stem(self) -> str:
        """Start of the names of its files, AGENT--EXPERIMENT.DIGEST."""
        return _stem(self.agent.label, self.settings)

    @property
    def file_name(self) -> str:
        """Name of its file."""
        return _file_name(self.stem, self.subjects)

    @cached_property  # workers need not know what it is taken of
    def settings(self) -> dict[str, Any]:
        """All settings that the cell's result is known to depend on, as JSON types."""
        names = ("seed", "keeps_all", "parts", "env_kwargs")
        settings = {
            "recording": RECORDING,
            "source": self.agent.source_name,
            "fingerprint": self.agent.fingerprint,
            "experiment": self.experiment.settings,
            "perturbations": {change.name: change for change in self.experiment.changes},
            "subjects": list(self.subjects),
            **{name: getattr(self, name) for name in names},
        }
        return cast(dict[str, Any], as_json(settings))

    @property
    def learners(self) -> list[Parts]:
        """The `Parts` of each subject: rate, retention and noise are drawn about `parts`."""
        parts = Parts(**self.parts)
        seeds = [(self.seed, subject, _OF_PARTS) for subject in self.subjects]
        return [parts.drawn(np.random.default_rng(seed)) for seed in seeds]

    @property
    def arguments(self) -> dict[str, Any]:
        """Keyword arguments of all environments of the cell."""
        limit = self.experiment.torque_limit
        return {**({} if limit is None else {"torque_limit": limit}), **self.env_kwargs}

    def player(self) -> Player:
        """Make the agent, and return it with its facts; raise an error if it cannot act."""
        has_parts, entry = False, self.agent.entry
        env, agent = make_player(self.agent, self.experiment.scenario(**self.arguments))
        with closing(env):
            facts = ("control", "parameters", "success_distance")
            control, arm, tolerance = (read_attribute(env, name) for name in facts)
            if entry is not None and isinstance(agent, BodyAgent):
                has_parts = True
                parts = replace(agent.parts, **self.parts, vigour=self.experiment.vigour)
                agent = entry.build(agent.interface, parts=parts, subjects=self.learners)
        takes_batches = isinstance(agent, Agent) and self.agent.wrapper is None
        return Player(agent, control, arm.control_step, tolerance, has_parts, takes_batches)

    def environment(self, player: Player, condition: Condition, arms: int) -> Any:
        """Make the environment for a condition; with `arms` arms if the agent takes batches."""
        steps = round(self.experiment.seconds / player.control_step)
        arguments = {**self.arguments, **self.agent.arguments, "max_episode_steps": steps}
        scenario = self.experiment.scenario(condition, **arguments)
        ends = arguments.get("terminate_on_success", False)
        require(not ends, "terminate_on_success", ends, "False: all trials last equally long")
        if player.takes_batches:
            return scenario.make_vec(arms, player.control)
        return self.agent.wrapped(scenario.make(player.control))


def _stem(agent: str, settings: Mapping[str, Any]) -> str:
    digest = digest_of({**settings, "subjects": None})[:8]
    return f"{safe_name(agent)}--{safe_name(settings['experiment']['name'])}.{digest}"


def _file_name(stem: str, subjects: Sequence[int]) -> str:
    return f"{stem}.{subjects[0]}-{subjects[-1]}.parquet"


def _check_name(cell: Cell, path: Path) -> None:
    if "experiment" not in cell.settings:
        raise ValueError("it holds no trials of an experiment")
    stem = _stem(cell.table["agent"][0].as_py(), cell.settings)
    name = _file_name(stem, cell.settings["subjects"])
    if name != path.name:
        raise ValueError(f"it is {name}")


_FILES = CellFiles(TRIALS, _check_name, "remove it")


def _in_files(subjects: int) -> Iterator[range]:
    """Yield the subjects of each cell, and so of each file."""
    for first in range(0, subjects, _SUBJECTS):
        yield range(first, min(first + _SUBJECTS, subjects))


def _subjects_in(plan: Path) -> int:
    """Return the number of subjects in the file of a plan; 0 if the file is missing."""
    try:
        content = plan.read_bytes()
        entries = json.loads(content)
        check_seal(content, str(entries["sha256"]))
        return require_whole("subjects", entries["subjects"])
    except FileNotFoundError:
        return 0
    except (ValueError, LookupError, TypeError, RecursionError) as error:
        raise UserError(f"{plan} is damaged, remove it: {error}") from error


class _Session:
    """Play the trials of a cell; hold its seeds, targets, environments and recorded paths."""

    def __init__(self, cell: TrialsCell, player: Player) -> None:
        self.cell, self.schedule = cell, cell.experiment.schedule
        self.shape = len(cell.subjects), len(self.schedule)
        sequences = [np.random.SeedSequence((cell.seed, subject)) for subject in cell.subjects]
        self.seeds = [sequence.generate_state(self.shape[1] + 1).tolist() for sequence in sequences]
        self.angles = [cell.experiment.targets_of(seeds[-1]).tolist() for seeds in self.seeds]
        self.paths: dict[str, NDArray[np.float32]] = {}
        self.channel_shares = np.full(self.shape, np.nan)
        self.environment = lru_cache(maxsize=8)(partial(cell.environment, player))

    def play(self, agent: Predictor, pairs: Sequence[tuple[int, int]], state: Any = None) -> Any:
        """Play (subject, trial) pairs of one condition at once; return the agent's last state."""
        env = self.environment(self.schedule[pairs[0][1]].condition, len(pairs))
        directions = self.cell.experiment.directions
        turns = [
            (self.angles[subject][trial] + self.schedule[trial].aim) % 360
            for subject, trial in pairs
        ]
        options = [{"trial": directions.index(turn)} for turn in turns]
        seeds = [self.seeds[subject][trial] for subject, trial in pairs]
        if state is None and isinstance(agent, Agent):
            state = agent.begin(seeds)
        episodes, state = run_trial(agent, env, seeds, options, state)
        for pair, episode in zip(pairs, episodes, strict=True):
            self.channel_shares[pair] = episode.channel_share
            if aim := self.schedule[pair[1]].aim:  # it reached for the aim; record the target
                start, turn = episode.hands[0], math.radians(aim)
                x, y = (episode.targets - start).T
                to_target = turned_back(x, y, math.cos(turn), math.sin(turn))
                episode = replace(episode, targets=start + np.transpose(to_target))
            for name, attribute in _PATHS.items():
                path = getattr(episode, attribute)
                if name not in self.paths:
                    self.paths[name] = np.empty((*self.shape, *path.shape), np.float32)
                self.paths[name][pair] = path
        return state

    def play_in_turn(self, agent: Any, subjects: Iterable[int]) -> None:
        """Play all trials of some subjects in order, with what the agent keeps between trials."""
        keep = getattr(agent, "between_trials", lambda state, rest: None)
        state, subjects = None, list(subjects)
        for trial in self.schedule:
            if trial.trial and not self.cell.keeps_all:
                state = keep(state, trial.rest)
            state = self.play(agent, [(subject, trial.trial) for subject in subjects], state)

    def play_by_condition(self, agent: Predictor) -> None:
        """Play the trials of each condition together, for an agent that keeps no state."""
        alike: dict[Condition, list[int]] = {}
        for trial in self.schedule:
            alike.setdefault(trial.condition, []).append(trial.trial)
        for trials in alike.values():
            pairs = list(product(range(self.shape[0]), trials))
            for first in range(0, len(pairs), _TOGETHER):
                self.play(agent, pairs[first : first + _TOGETHER])

    def columns(self, control_step: float) -> dict[str, Any]:
        """Return the columns of a cell's file: paths, and those of `ExperimentResult.trials`.

        The columns that `describe_movements` adds are not among them.
        """
        table = pd.DataFrame(self.schedule)[["trial", "block", "phase", "strength", "probe", "aim"]]
        conditions = [trial.condition for trial in self.schedule]
        table["perturbation"] = [
            "+".join(c.name for c in condition.perturbations) for condition in conditions
        ]
        table["go_step"] = [round(condition.go_cue / control_step) for condition in conditions]
        subjects, trials = self.shape
        starts = self.paths["hands"][:, :, 0].reshape(-1, 2)
        learners = self.cell.learners if self.cell.parts else [None] * subjects

        def text(learner: Parts | None, name: str) -> str:  # several states after commas
            return ", ".join(f"{number:g}" for number in np.atleast_1d(getattr(learner, name, ())))

        learned = {name: [text(learner, name) for learner in learners] for name in LEARNED}
        rows = len(starts)
        return {
            "agent": [self.cell.agent.label] * rows,
            "subject": np.repeat(np.array(self.cell.subjects), trials),
            **pd.concat([table] * subjects),
            "target_angle": np.ravel(self.angles),
            "start_x": starts[:, 0],
            "start_y": starts[:, 1],
            "channel_force": self.channel_shares.ravel(),
            **{name: np.repeat(values, trials) for name, values in learned.items()},
            "keeps_all": [self.cell.keeps_all] * rows,
            "noise": ["+".join(change.name for change in self.cell.experiment.noise)] * rows,
            "seed": [self.cell.seed] * rows,
            "version": [version("mmc-gym")] * rows,
            "run": [self.cell.stem.rsplit(".", 1)[-1]] * rows,
            **{name: _lists(values) for name, values in self.paths.items()},
        }


def run_cell(cell: TrialsCell) -> bytes:
    """Play a cell, and return the content of its Parquet file."""
    player = cell.player()
    session, subjects = _Session(cell, player), range(len(cell.subjects))
    if not player.takes_batches:
        for subject in subjects:
            session.play_in_turn(cell.player().agent, [subject])
    elif cell.keeps_all or player.agent.learns:
        session.play_in_turn(player.agent, subjects)
    else:
        session.play_by_condition(player.agent)
    facts = {"control_step": player.control_step, "tolerance": player.tolerance}
    return cell_content(session.columns(player.control_step), cell.settings, facts)


def _checked(cells: Iterable[TrialsCell]) -> Iterator[TrialsCell]:
    """Yield cells, without `parts` if the agent has none; raise if one cannot be played."""
    tried = set()
    for cell in cells:
        player, experiment = cell.player(), cell.experiment
        phases = {trial.condition: trial.phase for trial in experiment.schedule}
        for condition, phase in phases.items() if player.control not in tried else ():
            try:
                experiment.scenario(condition, **cell.arguments).make(player.control).close()
            except UserError as error:
                where = f"{phase!r} of the experiment {experiment.name}"
                raise UserError(f"{where} cannot be played: {error}") from error
        tried.add(player.control)
        yield cell if player.has_parts else replace(cell, parts={})


def _lists(paths: NDArray[np.float32]) -> pa.Array:
    """Return paths, (subjects, trials, steps + 1, 2), as a column with a flat list per trial."""
    size = paths[0, 0].size
    kind = pa.list_(pa.field("element", pa.float32()), size)  # Parquet's name for it
    return pa.FixedSizeListArray.from_arrays(pa.array(paths.ravel()), type=kind)


def run_experiment(
    experiment: str | Path | Experiment,
    agents: Agents,
    subjects: int = 20,
    seed: int = 0,
    out: Path | str | None = None,
    *,
    rate: float | Sequence[float] = 0.2,
    retention: float | Sequence[float] = 0.98,
    learners: Mapping[str, Mapping[str, Any]] | None = None,
    keep: Sequence[str] = (),
    jobs: int | None = None,
    env_kwargs: Mapping[str, Any] | None = None,
    allow_pickle: bool = False,
    wrapper: Wrappers = (),
    statistics: Statistics = (),
    on_progress: Callable[[int, int], None] = lambda done, total: None,
) -> ExperimentResult:
    """Let agents go through an experiment, each as several subjects.

    Args:
        experiment: a name such as "rotation-30", a YAML file, or an `Experiment`.
        agents: as in `compare`; a trained agent takes part with its training of seed 0.
        subjects: number of subjects; each has an order of targets and noise of its own.
        seed: root seed, from which the subjects' seeds are derived.
        out: folder in which the trials are kept; None keeps nothing.
        rate: learning rate of `mmc-body` and `ik-body`: share of what a movement shows that is
            learned; a sequence has one rate per state, such as a fast and a slow one.  1 learns all
            within the movement.
        retention: of the same agents: share of a state that is left at the next trial.
        learners: settings that differ for some agents, by label, as in
            `{"slow": {"rate": 0.05}}`, see `mmc_gym.agents.body_model.parts.Parts`.
        keep: labels of agents whose whole state lasts from trial to trial, in place of what their
            `between_trials` keeps.
        jobs: number of cells played at once, see `run_grid`.
        env_kwargs: arguments of the environment, as in `compare`.
        allow_pickle: as in `compare`.
        wrapper: as in `compare`.
        statistics: as in `compare`.
        on_progress: called with the number of finished cells and the number of all cells.

    >>> run_experiment("rotation-30", ["ik-dls"], subjects=1, jobs=1)
    <rotation-30: ik-dls, 1 subjects each>
    """
    experiment = find_experiment(experiment)
    arguments = require_arguments("env_kwargs", env_kwargs)
    subjects, seed = require_whole("subjects", subjects), require_whole("seed", seed, least=0)
    for name in SET_BY_SCENARIOS:
        if name in arguments:
            raise UserError(f"{name} must be left out of env_kwargs: the experiment sets it")
    of_models: Any = {"allow_pickle": allow_pickle, "wrapper": wrapper, "statistics": statistics}
    resolved_agents = resolve_all(agents, every_training=False, **of_models)
    labels = [agent.label for agent in resolved_agents]
    folder = None if out is None else check_folder(out, "out") / TRIALS
    shared = {"rate": rate, "retention": retention}
    of_each = require_arguments("learners", learners).items()
    parts_by_agent = {
        label: require_arguments(f"learners of {label}", parts) for label, parts in of_each
    }
    keep = require_names("keep", keep, labels)
    require_names("learners", parts_by_agent, labels)
    whole = [
        TrialsCell(
            agent=agent,
            experiment=experiment,
            subjects=range(subjects),
            seed=seed,
            keeps_all=agent.label in keep,
            parts=_checked_parts({**shared, **parts_by_agent.get(agent.label, {})}),
            env_kwargs=arguments,
        )
        for agent in resolved_agents
    ]
    whole = list(_checked(whole))
    for cell in whole if folder else ():  # before play, so that a file lost later is noticed
        plan = cast(Path, folder) / f"{cell.stem}.json"
        if _subjects_in(plan) < subjects:
            entries = {"subjects": subjects, "sha256": UNSEALED}
            write_atomically(plan, seal(json.dumps(entries).encode()))
    cells = [replace(cell, subjects=part) for cell in whole for part in _in_files(subjects)]
    stored = [folder and _FILES.find(folder / cell.file_name, cell.settings) for cell in cells]
    missing = [number for number, content in enumerate(stored) if content is None]
    warn_of_unseen(cell.settings for cell, content in zip(cells, stored) if content)
    on_progress(len(cells) - len(missing), len(cells))

    def keep_file(index: int, content: bytes) -> None:
        number = missing[index]
        stored[number] = parse_cell(content)
        if folder:
            write_atomically(folder / cells[number].file_name, content)
        on_progress(len(cells) - stored.count(None), len(cells))

    run_grid(run_cell, [cells[number] for number in missing], jobs=jobs, on_result=keep_file)
    return _result([cell for cell in stored if cell])


def _checked_parts(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return all of an agent's `LEARNED` settings; raise a `UserError` for a wrong one."""
    require_names("learners", settings, LEARNED)
    shares = {name: settings[name] for name in LEARNED[:2]}  # per state
    of_states = {name: share if np.iterable(share) else (share,) for name, share in shares.items()}
    parts = Parts(**{**settings, **of_states})
    return {name: getattr(parts, name) for name in LEARNED}


def _result(cells: Sequence[Cell]) -> ExperimentResult:
    first = cells[0]
    table = pa.concat_tables(cell.table.replace_schema_metadata(None) for cell in cells)
    paths = {
        name: table[name].combine_chunks().flatten().to_numpy().reshape(len(table), -1, 2)
        for name in _PATHS
    }
    trials = table.drop_columns(list(_PATHS)).to_pandas()
    described = describe_movements(
        **paths, go_steps=trials["go_step"], early=BEFORE_FEEDBACK, **first.facts
    )
    return ExperimentResult(
        experiment=Experiment(**first.settings["experiment"]),
        trials=trials.assign(**described),
        **paths,
        control_step=first.facts["control_step"],
    )


def read_experiments(folder: Path | str) -> list[ExperimentResult]:
    """Return the results of all experiments that a store holds, in the order of their names.

    Raises:
        UserError: if a file is missing or damaged, or files of the same agent or experiment have
            different settings.
    """
    cells: dict[str, list[Cell]] = {}
    first_cells: dict[tuple[str, ...], tuple[str, Mapping[str, Any]]] = {}
    for path in _planned_files(require_path("folder", folder)):
        cell = _FILES.read(path)
        name, agent = cell.settings["experiment"]["name"], cell.table["agent"][0].as_py()
        stem, parts = _stem(agent, cell.settings), cell.settings["parts"]
        # Parts are named as users know them: rate, not parts.rate.
        settings = {**cell.settings, "subjects": None, "parts": None, **parts}
        shared_settings = {key: settings[key] for key in ("experiment", "seed", "env_kwargs")}
        for scope, cell_settings in (((agent, name), settings), ((name,), shared_settings)):
            first_stem, first_settings = first_cells.setdefault(scope, (stem, cell_settings))
            if differences := "; ".join(list_differences(first_settings, cell_settings)):
                raise UserError(
                    f"{path.parent} must hold {' in '.join(scope)} of the same settings, got "
                    f"{differences}: remove {first_stem}.* or {stem}.*, and play it into another "
                    "folder or under another name (LABEL=...)"
                )
        cells.setdefault(name, []).append(cell)
    return [_result(cells[name]) for name in sorted(cells)]


def _planned_files(folder: Path) -> Iterator[Path]:
    """Yield the files that plans ask for; raise a `UserError` for a missing file or plan."""
    plans = sorted((folder / TRIALS).glob("[!.]*.json"))
    for path in _FILES.paths(folder):
        plan = path.with_name(f"{path.name.rsplit('.', 2)[0]}.json")
        if plan not in plans:
            raise UserError(f"{path} must have its {plan.name}, as this version writes it")
    for plan in plans:
        for subjects in _in_files(_subjects_in(plan)):
            path = plan.with_name(_file_name(plan.stem, subjects))
            if not path.is_file():
                raise UserError(
                    f"{path} is missing: the same `mmc-gym adapt` makes it anew; to leave these "
                    f"trials out remove {plan.stem}.*"
                )
            yield path
