"""Let agents go through an experiment, trial by trial, as several subjects each.

    Experiment  ->  cells (an agent, some subjects)  ->  run_grid  ->  ExperimentResult

What a trial holds depends on the experiment, the agent and the subject's own seed, not on how many
subjects there are.  An agent that keeps nothing from trial to trial plays all its trials at once.
In a folder every cell is one file, written atomically: an interrupted run resumes, and subjects and
agents can be added.

    trials/AGENT--EXPERIMENT.DIGEST.FIRST-LAST.parquet    the trials of some subjects
    trials/AGENT--EXPERIMENT.DIGEST.json                  how many subjects there must be

The digest is that of all settings but the subjects, so no run overwrites one of other settings.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, field, replace
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import Any, TypeAlias, cast

import gymnasium as gym
import numpy as np
import pandas as pd
import pyarrow as pa  # type: ignore[import-untyped]
from numpy.typing import NDArray

from mmc_gym._errors import UserError, require_choice, require_whole, shown
from mmc_gym._files import check_folder, write_atomically
from mmc_gym._grid import run_grid
from mmc_gym.agents.base import Agent, Predictor
from mmc_gym.agents.body_model.agent import BodyAgent
from mmc_gym.agents.body_model.parts import Parts
from mmc_gym.agents.resolver import Agents, ResolvedAgent, resolve_all
from mmc_gym.benchmark.store import TRIALS, CellKey, Kept, read_table, to_parquet
from mmc_gym.benchmark.suite import SET_BY_SCENARIOS, make_player
from mmc_gym.envs.names import TaskEntry
from mmc_gym.envs.reach import MMCReachEnv
from mmc_gym.envs.scenarios import Scenario
from mmc_gym.envs.vector import MMCReachVectorEnv
from mmc_gym.experiments.experiment import Experiment, PlannedTrial, find_experiment
from mmc_gym.experiments.results import ExperimentResult
from mmc_gym.interface import read_attribute
from mmc_gym.measures.rollout import run_trial

RECORDING = 2
"""Version of recordings; when it changes, all cells are played again."""

_SUBJECTS = 20  # in a cell, at most
_TOGETHER = 1_000  # trials that are played at once, at most: bounds the memory
_PATHS = ("hands", "cursors", "targets")
_Cell: TypeAlias = tuple[pa.Table, Kept]


@dataclass(frozen=True)
class TrialsCell:
    """Some subjects of an agent in an experiment; see `run_experiment`."""

    agent: ResolvedAgent
    experiment: Experiment
    subjects: range
    seed: int = 0
    keeps_all: bool = False
    parts: Mapping[str, Any] = field(default_factory=dict)
    env_kwargs: Mapping[str, Any] = field(default_factory=dict)

    @property
    def stem(self) -> str:
        """First part of the names of its files, another one for other settings."""
        return _stem(self.agent.label, self.settings)

    @property
    def file_name(self) -> str:
        """Name of its file."""
        return _file_name(self.stem, self.subjects)

    @property
    def settings(self) -> dict[str, Any]:
        """Everything that its result is known to depend on, ready for JSON."""
        names = ("subjects", "seed", "keeps_all", "parts", "env_kwargs")
        settings = {
            "recording": RECORDING,
            "source": self.agent.source_name,
            "fingerprint": self.agent.fingerprint,
            "experiment": asdict(cast(Any, self.experiment)),
            **{name: getattr(self, name) for name in names},
        }
        found: dict[str, Any] = json.loads(json.dumps(settings, default=_plain))
        return found

    def checked(self, known: set[str]) -> TrialsCell:
        """Return the cell without parts that its agent lacks; refuse what cannot be played.

        Arguments of environments that are `known` to be playable are not tried again.
        """
        player, arguments = self.player()
        phases = {_condition(one): one.phase for one in self.experiment.schedule}
        for condition, phase in phases.items() if repr(arguments) not in known else ():
            try:
                MMCReachEnv(**_world(self.experiment, condition, arguments)).close()
            except UserError as error:
                where = f"{phase!r} of the experiment {self.experiment.name}"
                raise UserError(f"{where} cannot be played: {error}") from error
        known.add(repr(arguments))
        return self if self.has_parts(player) else replace(self, parts={})

    def has_parts(self, player: Any) -> bool:
        """Return whether the parts are those of its agent; yours stay as you made them."""
        return isinstance(player, BodyAgent) and bool(self.agent.name)

    def player(self) -> tuple[Any, Mapping[str, Any]]:
        """Return the agent, and the arguments of its environments; refuse one that cannot act."""
        limit = self.experiment.torque_limit
        given = {} if limit is None else {"torque_limit": limit}
        given |= self.env_kwargs
        scenario = Scenario(TaskEntry("centre-out", self.experiment.task()), arguments=given)
        player: Any
        made, player = make_player(self.agent, scenario)
        with closing(made):
            given["control"] = read_attribute(made, "control")
        if self.has_parts(player):
            player.parts = replace(player.parts, **self.parts, vigour=self.experiment.vigour)
        return player, given


def _stem(agent: str, settings: Mapping[str, Any]) -> str:
    """Return the first part of the names of an agent's files."""
    shared = json.dumps({**settings, "subjects": None}, sort_keys=True)
    digest = hashlib.sha256(shared.encode()).hexdigest()[:8]
    return f"{CellKey(agent, None, settings['experiment']['name']).stem}.{digest}"


def _file_name(stem: str, subjects: range) -> str:
    return f"{stem}.{subjects.start}-{subjects.stop - 1}.parquet"


def _in_files(subjects: int) -> Iterator[range]:
    """Return which subjects are in one file, and in one cell."""
    for first in range(0, subjects, _SUBJECTS):
        yield range(first, min(first + _SUBJECTS, subjects))


def _subjects_in(plan: Path) -> int:
    """Return how many subjects a plan asks for, 0 without one."""
    try:
        return require_whole("subjects", json.loads(plan.read_bytes())["subjects"])
    except FileNotFoundError:
        return 0
    except (ValueError, LookupError, TypeError, RecursionError) as error:
        raise UserError(f"{plan} is damaged, remove it: {error}") from error


def _plain(value: Any) -> Any:
    """Return a value for JSON."""
    return value.item() if isinstance(value, np.generic) else list(value)


def _condition(one: PlannedTrial) -> tuple[Any, ...]:
    return one.perturbations, one.go_cue, one.target_jump


def _world(
    experiment: Experiment, condition: tuple[Any, ...], arguments: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the arguments of the environment of a condition."""
    perturbations, go_cue, jump = condition
    given: dict[str, Any] = {**arguments, "task": experiment.task(go_cue, jump)}
    return {**given, "perturbations": [*experiment.noise, *perturbations]}


def run_cell(cell: TrialsCell) -> bytes:
    """Play a cell, and return its file."""
    experiment, schedule = cell.experiment, cell.experiment.schedule
    player, arguments = cell.player()
    is_agent, trials, count = isinstance(player, Agent), range(len(schedule)), len(cell.subjects)
    sequences = [np.random.SeedSequence((cell.seed, subject)) for subject in cell.subjects]
    seeds = [one.generate_state(len(schedule) + 1).tolist() for one in sequences]
    angles = [experiment.targets_of(of[-1]).tolist() for of in seeds]
    paths: dict[str, Any] = {}

    @lru_cache(maxsize=8)
    def world(condition: tuple[Any, ...], arms: int) -> Any:
        """Return the environment of a condition."""
        given = _world(experiment, condition, arguments)
        env = MMCReachEnv(**given)
        seconds = experiment.trial_seconds + max(one.go_cue for one in experiment.blocks)
        steps = round(seconds / env.parameters.control_step)
        if not is_agent:  # it may take no batches
            return gym.wrappers.TimeLimit(env, steps)
        return MMCReachVectorEnv(arms, max_episode_steps=steps, autoreset_mode="Disabled", **given)

    def play(player: Predictor, pairs: Sequence[tuple[int, int]], state: Any = None) -> Any:
        """Play trials (subject, trial) of one condition; return the agent's state at the end."""
        env = world(conditions[pairs[0][1]], len(pairs))
        options = [{"trial": experiment.directions.index(angles[of][at])} for of, at in pairs]
        own = [seeds[subject][trial] for subject, trial in pairs]
        if state is None and isinstance(player, Agent):
            state = player.begin(own)
        episodes, state = run_trial(player, env, own, options, state)
        for pair, one in zip(pairs, episodes, strict=True):
            each = {"hands": one.hands, "cursors": one.seen_hands, "targets": one.targets}
            for name, path in each.items():
                if name not in paths:
                    paths[name] = np.empty((count, len(trials), *path.shape), np.float32)
                paths[name][pair] = path
        return state

    def play_in_turn(player: Any, subjects: Sequence[int]) -> None:
        """Play all trials of some subjects in their order, with what the agent keeps."""
        state, keep = None, getattr(player, "between_trials", lambda state, rest: None)
        for one in schedule:
            if one.trial and not cell.keeps_all:
                state = keep(state, one.rest)
            state = play(player, [(subject, one.trial) for subject in subjects], state)

    conditions = [_condition(one) for one in schedule]
    if not is_agent:
        for subject in range(count):
            play_in_turn(cell.player()[0], [subject])
    elif cell.keeps_all or player.learns:
        play_in_turn(player, range(count))
    else:
        for condition in dict.fromkeys(conditions):
            alike = [trial for trial in trials if conditions[trial] == condition]
            pairs = list(product(range(count), alike))
            for first in range(0, len(pairs), _TOGETHER):
                play(player, pairs[first : first + _TOGETHER])
    step = world(conditions[0], count).unwrapped.parameters.control_step
    table = pd.DataFrame(schedule)[["trial", "block", "phase", "strength", "probe"]]
    table["perturbation"] = ["+".join(one.perturbations) for one in schedule]
    table["go_step"] = [round(one.go_cue / step) for one in schedule]
    starts = paths["hands"][:, :, 0].reshape(-1, 2)
    columns = {
        "agent": [cell.agent.label] * count * len(trials),
        "subject": np.repeat(np.array(cell.subjects), len(trials)),
        **pd.concat([table] * count),
        "target_angle": np.ravel(angles),
        "start_x": starts[:, 0],
        "start_y": starts[:, 1],
        **{name: [one] * len(starts) for name, one in _settings_shown(cell).items()},
        **{name: _lists(values) for name, values in paths.items()},
    }
    return to_parquet(columns, Kept(cell.settings, {"control_step": step}))


def _settings_shown(cell: TrialsCell) -> dict[str, Any]:
    """Return how an agent goes through an experiment, as columns of its trials."""
    shares = {name: cell.parts.get(name, ()) for name in ("rate", "retention")}
    texts = {name: ", ".join(f"{one:g}" for one in shares[name]) for name in shares}
    return {**texts, "keeps_all": cell.keeps_all}


def _lists(paths: NDArray[np.float32]) -> pa.Array:
    """Return paths (subjects, trials, steps + 1, 2) as a column of lists."""
    size = paths[0, 0].size
    kind = pa.list_(pa.field("element", pa.float32()), size)  # as Parquet calls it
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
    keep: Sequence[str] = (),
    jobs: int | None = None,
    env_kwargs: Mapping[str, Any] | None = None,
    allow_pickle: bool = False,
    on_progress: Callable[[int, int], None] = lambda done, total: None,
) -> ExperimentResult:
    """Let agents go through an experiment, each as several subjects.

    Args:
        experiment: name, such as "rotation-30", YAML file, or experiment.
        agents: as in `compare`; of a trained one, its training of seed 0.
        subjects: number of subjects; each has an order of targets and noise of its own.
        seed: that the subjects' seeds are derived from.
        out: folder that keeps what was played; None keeps nothing.
        rate: of `mmc-body` and `ik-body`: share of what a movement shows that is learned; several
            for several states, as a fast and a slow one.  1 learns all within the movement.
        retention: of these: share of what is learned that lasts to the next trial; 0 keeps nothing.
        keep: labels of agents whose whole state lasts from trial to trial, in place of what their
            `between_trials` keeps.
        jobs: how many cells are played at once, see `run_grid`.
        env_kwargs: arguments of the environment, as in `compare`.
        allow_pickle: as in `compare`.
        on_progress: called with the number of cells that are done, and of all.

    >>> run_experiment("rotation-30", ["ik-dls"], subjects=1, jobs=1)
    <rotation-30: ik-dls, 1 subjects each>
    """
    experiment, given = find_experiment(experiment), dict(env_kwargs or {})
    subjects, seed = require_whole("subjects", subjects), require_whole("seed", seed, least=0)
    Scenario(TaskEntry(experiment.name, experiment.task())).refuse(given, *SET_BY_SCENARIOS)
    found = resolve_all(agents, allow_pickle=allow_pickle, every_training=False)
    for label in keep:
        require_choice("keep", label, [agent.label for agent in found])
    folder = None if out is None else check_folder(out, "out") / TRIALS
    shares: Any = [one if np.iterable(one) else (one,) for one in (rate, retention)]
    parts = Parts(rate=shares[0], retention=shares[1])  # checks them, and makes them floats
    known: set[str] = set()
    checked = [
        TrialsCell(
            agent=agent,
            experiment=experiment,
            subjects=range(subjects),
            seed=seed,
            keeps_all=agent.label in keep,
            parts={"rate": parts.rate, "retention": parts.retention},
            env_kwargs=given,
        ).checked(known)  # what cannot be played is refused before anything is
        for agent in found
    ]
    cells = [replace(one, subjects=some) for one in checked for some in _in_files(subjects)]
    for one in checked if folder else ():  # before play: a file that is missing later is noticed
        plan = cast(Path, folder) / f"{one.stem}.json"
        if _subjects_in(plan) < subjects:
            write_atomically(plan, json.dumps({"subjects": subjects}) + "\n")
    kept = [_content(folder / cell.file_name, cell) if folder else None for cell in cells]
    missing = [number for number, content in enumerate(kept) if content is None]
    on_progress(len(cells) - len(missing), len(cells))

    def keep_file(index: int, content: bytes) -> None:
        kept[missing[index]] = content
        if folder is not None:
            write_atomically(folder / cells[missing[index]].file_name, content)
        on_progress(len(cells) - kept.count(None), len(cells))

    played = [cells[number] for number in missing]
    run_grid(run_cell, played, jobs=jobs, on_result=keep_file)
    return _result([read_table(content) for content in kept if content is not None])


def _content(path: Path, cell: TrialsCell) -> bytes | None:
    """Return a cell's file; None if it is missing, damaged, or of other settings."""
    try:
        content = path.read_bytes()
        _, found = _read(path, content)
    except (FileNotFoundError, UserError):
        return None
    return content if found.settings == cell.settings else None


def _read(path: Path, content: bytes) -> _Cell:
    """Return the table and the settings in a file of trials; one of another name is damaged."""
    try:
        table, kept = read_table(content)
        if "experiment" not in kept.settings:
            raise ValueError("it holds no trials of an experiment")
        first, *_, last = kept.settings["subjects"] * 2
        name = _file_name(_stem(table["agent"][0].as_py(), kept.settings), range(first, last + 1))
        if name != path.name:
            raise ValueError(f"it is {name}")
    except (OSError, pa.ArrowException, ValueError, LookupError, TypeError) as error:
        raise UserError(f"{path} is damaged, remove it: {error}") from error
    return table, kept


def _result(cells: Sequence[_Cell]) -> ExperimentResult:
    """Return the result that some cells of one experiment hold."""
    tables, kept = zip(*cells, strict=True)
    table = pa.concat_tables(one.replace_schema_metadata(None) for one in tables)
    flat = {name: table[name].combine_chunks().flatten().to_numpy() for name in _PATHS}
    return ExperimentResult(
        experiment=Experiment(**kept[0].settings["experiment"]),
        trials=table.drop_columns(list(_PATHS)).to_pandas(),
        **{name: values.reshape(len(table), -1, 2) for name, values in flat.items()},
        control_step=kept[0].facts["control_step"],
    )


def read_experiments(folder: Path | str) -> list[ExperimentResult]:
    """Return the results of all experiments that a store holds, in the order of their names.

    Raises:
        UserError: if a file is missing or damaged; if agents went through experiments of one name
            that differ, or one agent did with different settings.
    """
    found: dict[str, list[_Cell]] = {}
    first: dict[tuple[str, ...], tuple[str, Mapping[str, Any]]] = {}
    for path in _planned_files(Path(folder) / TRIALS):
        table, kept = cell = _read(path, path.read_bytes())
        name, agent = kept.settings["experiment"]["name"], table["agent"][0].as_py()
        stem, settings = _stem(agent, kept.settings), {**kept.settings, "subjects": None}
        shared = {one: settings[one] for one in ("experiment", "seed", "env_kwargs")}
        for who, own in (((agent, name), settings), ((name,), shared)):
            other, theirs = first.setdefault(who, (stem, own))
            if differences := "; ".join(_differences(theirs, own)):
                raise UserError(
                    f"{path.parent} must hold {' in '.join(who)} of the same settings, got "
                    f"{differences}: remove {other}.* or {stem}.*, and play it into another folder "
                    "or under another name (LABEL=...)"
                )
        found.setdefault(name, []).append(cell)
    return [_result(found[name]) for name in sorted(found)]


def _planned_files(folder: Path) -> Iterator[Path]:
    """Return the files of trials that a store must hold; refuse one without a plan."""
    plans = sorted(folder.glob("[!.]*.json"))
    for path in sorted(folder.glob("[!.]*.parquet")):
        beside = f"{path.name.rsplit('.', 2)[0]}.json"
        if folder / beside not in plans:
            raise UserError(f"{path} must have its {beside} beside it, as this version writes it")
    for plan in plans:
        for some in _in_files(_subjects_in(plan)):
            path = plan.with_name(_file_name(plan.stem, some))
            if not path.is_file():
                raise UserError(
                    f"{path} is missing: the same `mmc-gym adapt` makes it anew; to leave these "
                    f"trials out remove {plan.stem}.*"
                )
            yield path


def _differences(one: Any, other: Any, name: str = "") -> Iterator[str]:
    """Return the entries in which settings differ, with both values."""
    if isinstance(one, list) and any(isinstance(each, dict) for each in one):
        one, other = dict(enumerate(one)), dict(enumerate(other))
    if isinstance(one, dict) and isinstance(other, dict):
        for key in dict.fromkeys([*one, *other]):
            inner = f"{name}.{key}" if name not in ("", "parts") else str(key)
            yield from _differences(one.get(key), other.get(key), inner)
    elif one != other:
        yield f"{name} {shown(one)} and {shown(other)}"
