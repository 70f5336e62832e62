"""The store of a benchmark: a folder of Parquet files, one for each cell, and a manifest.

    episodes/AGENT--SEED--ENVIRONMENT.parquet    a row per episode: who, where, measures
    paths/AGENT--SEED--ENVIRONMENT.parquet       a row per step of some episodes, for pictures
    manifest.json                                the settings that all of it was made with

A cell is an agent, one of its training seeds (none if it is not trained: AGENT--ENVIRONMENT), and
an environment.  Damaged or outdated cells are played again (`mmc_gym._cells`).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import pandas as pd
import pyarrow as pa  # type: ignore[import-untyped]
from filelock import FileLock
from pydantic import BaseModel, ConfigDict, ValidationError, with_config
from typing_extensions import TypedDict

from mmc_gym._cells import Cell, CellFiles, cell_content, safe_name
from mmc_gym._errors import UserError, explain
from mmc_gym._files import digest_of, require_path, write_atomically
from mmc_gym.agents.registry import UNKNOWN, Knowledge
from mmc_gym.measures import MEASURES, Episode, measure_all

MANIFEST = "manifest.json"
EPISODES, PATHS, TRIALS = "episodes", "paths", "trials"
_DIGEST = "sha256"  # key in the manifest: the digest of its other entries
_KEY = ("agent", "training_seed", "environment")  # columns that name a cell
_SHARED = ("episodes", "seed", "environment")  # settings that all cells of a scenario share
_CURSOR = ("cursor_x", "cursor_y")


class CellKey(NamedTuple):
    """Name of a cell; the training seed is None if the agent was not trained."""

    agent: str
    training_seed: int | None
    environment: str

    @property
    def stem(self) -> str:
        """Name of the cell's files without suffix, unique to the cell on any file system.

        >>> CellKey("ppo", 3, "random").stem, CellKey("mmc", None, "random").stem
        ('ppo--3--random', 'mmc--random')
        """
        seed = () if self.training_seed is None else (str(self.training_seed),)
        return "--".join([safe_name(self.agent), *seed, safe_name(self.environment)])

    @property
    def file_name(self) -> str:
        """Name of the cell's files."""
        return f"{self.stem}.parquet"


def _check_name(cell: Cell, path: Path) -> None:
    stem = CellKey(*(cell.table[name][0].as_py() for name in _KEY)).stem if len(cell.table) else ""
    if stem not in ("", path.stem):
        raise ValueError(f"it is a copy of {stem}{path.suffix}")


_FILES = {
    kind: CellFiles(kind, _check_name, "the benchmark makes it anew") for kind in (EPISODES, PATHS)
}


def episode_columns(episodes: Sequence[Episode]) -> dict[str, Any]:
    """Return the columns of a table with a row for each episode.

    They are seed, start_x, start_y (of the hand), target_x, target_y (at the start), start_z and
    target_z (only in space), duration (s), and each of `MEASURES` (NaN without a value).
    """
    measured = [measure_all(episode) for episode in episodes]
    size = episodes[0].target.size if episodes else 2
    starts = np.array([episode.hands[0] for episode in episodes]).reshape(-1, size)
    targets = np.array([episode.target for episode in episodes]).reshape(-1, size)
    return {
        "seed": np.array([episode.seed for episode in episodes], dtype=np.int64),
        **dict(zip(("start_x", "start_y", "start_z"), starts.T)),
        **dict(zip(("target_x", "target_y", "target_z"), targets.T)),
        "duration": np.array([len(episode.rewards) * episode.control_step for episode in episodes]),
        **{name: np.array([row[name] for row in measured], np.float64) for name in MEASURES},
    }


def episodes_file(
    key: CellKey, episodes: Sequence[Episode], settings: Mapping[str, Any], facts: Mapping[str, Any]
) -> bytes:
    """Return the content of a cell's file of episodes, a row per episode, in order of instances.

    Columns agent, training_seed (missing without training), environment, instance (0, 1, …), and
    those of `episode_columns`.  The file's metadata hold the cell's `settings`, which `cell_facts`
    compares, and other `facts` about the cell; both must be JSON types.
    """
    columns = {
        **_key_columns(key, len(episodes)),
        "instance": np.arange(len(episodes), dtype=np.int32),
        **episode_columns(episodes),
    }
    return cell_content(columns, settings, facts)


def paths_file(key: CellKey, episodes: Mapping[int, Episode]) -> bytes:
    """Return the content of a cell's file of paths, a row per step of `episodes`, by instance.

    Columns agent, training_seed, environment, instance, step (0 is the start), joint_angle_1 to
    joint_angle_N (radians, not wrapped; missing for a hand without an arm), hand_x, hand_y,
    target_x, target_y (segment lengths), in space hand_z and target_z; all but the first five are
    float32.  Under a visuomotor rotation also cursor_x, cursor_y; elsewhere the cursor is the hand
    and is not stored; `read_paths` fills it in.
    """
    movements = list(episodes.values())
    hands = np.concatenate([episode.hands for episode in movements])
    targets = np.concatenate([episode.targets for episode in movements])
    postures = np.concatenate([episode.joint_angles for episode in movements])
    cursors = [episode.cursors for episode in movements if episode.cursors is not None]
    counts = [len(episode.hands) for episode in movements]
    numbers = {
        **{f"joint_angle_{joint}": angles for joint, angles in enumerate(postures.T, start=1)},
        **dict(zip(("hand_x", "hand_y", "hand_z"), hands.T)),
        **dict(zip(("target_x", "target_y", "target_z"), targets.T)),
        **dict(zip(_CURSOR, np.concatenate(cursors).T if cursors else ())),
    }
    columns = {
        **_key_columns(key, len(hands)),
        "instance": np.repeat(np.array(list(episodes), dtype=np.int32), counts),
        "step": np.concatenate([np.arange(count, dtype=np.int32) for count in counts]),
        **{name: values.astype(np.float32) for name, values in numbers.items()},
    }
    return cell_content(columns)


def _key_columns(key: CellKey, rows: int) -> dict[str, Any]:
    return {
        "agent": pa.array([key.agent] * rows, pa.string()),
        "training_seed": pa.array([key.training_seed] * rows, pa.int64()),
        "environment": pa.array([key.environment] * rows, pa.string()),
    }


def write_cell(folder: Path, key: CellKey, files: Mapping[str, bytes]) -> None:
    """Write a cell's files from their contents by kind; delete its old file of any other kind."""
    for kind in (PATHS, EPISODES):  # episodes last: they say that the cell is complete
        path = folder / kind / key.file_name
        if kind in files:
            write_atomically(path, files[kind])
        else:
            path.unlink(missing_ok=True)


def cell_facts(folder: Path, key: CellKey, settings: Mapping[str, Any]) -> Mapping[str, Any] | None:
    """Return the facts kept about a cell; None if it must be played (again).

    That is so if it is missing or damaged, has other settings, or lacks one of the measures.
    """
    cell = _FILES[EPISODES].find(folder / EPISODES / key.file_name, settings)
    if cell is None or not MEASURES.keys() <= set(cell.table.column_names):
        return None
    paths = folder / PATHS / key.file_name  # of no settings
    is_whole = not cell.facts.get("has_paths") or _FILES[PATHS].find(paths, {}) is not None
    return cell.facts if is_whole else None


def kept_cells(folder: Path) -> dict[str, Cell]:
    """Return all cells that are not damaged, without their episodes, by the stem of their files."""
    cells = {}
    for path in _FILES[EPISODES].paths(folder):
        with suppress(OSError, UserError):
            cell = _FILES[EPISODES].read(path, _KEY)
            if {"software", "cpu_seconds"} <= cell.facts.keys():  # else it is no cell
                cells[path.stem] = cell
    return cells


def read_episodes(folder: Path | str, columns: Sequence[str] | None = None) -> pd.DataFrame:
    """Return all episodes of the store in a folder, with the columns of `episodes_file`.

    Unless `columns` is None, read only agent, training_seed, environment, instance and `columns`.

    Raises:
        UserError: if there are none, or a file is damaged, missing, or of other settings.
    """
    folder = require_path("folder", folder)
    names = None if columns is None else list(dict.fromkeys([*_KEY, "instance", *columns]))
    has_paths = bool(_FILES[PATHS].paths(folder))  # they may be left out as a whole
    tables = []
    first_files: dict[str, tuple[Path, Mapping[str, Any]]] = {}  # of each scenario
    for path in _FILES[EPISODES].paths(folder):
        cell = _FILES[EPISODES].read(path, names)
        if has_paths and cell.facts.get("has_paths"):
            _require_file(folder / PATHS / path.name)
        shared = {name: cell.settings.get(name) for name in _SHARED}
        scenario = path.stem.rpartition("--")[2]
        first_path, first_shared = first_files.setdefault(scenario, (path, shared))
        if shared != first_shared:
            raise UserError(f"{path} must be of the same settings as {first_path}: play it again")
        tables.append(cell.table)
    frame = _joined(tables)
    if frame.empty:
        why = "".join(f"; {line}" for line in reasons(read_manifest(folder).not_played))
        raise UserError(f"folder must hold a benchmark's episodes, got {str(folder)!r}{why}")
    return frame


def require_all_cells(folder: Path, manifest: Manifest) -> None:
    """Raise a `UserError` if the file of episodes of any cell in the manifest is missing."""
    for stem in manifest.cpu_seconds:
        _require_file(folder / EPISODES / f"{stem}.parquet")


def _require_file(path: Path) -> None:
    if not path.is_file():
        raise UserError(f"{path} is missing: the same benchmark makes it anew, and nothing else")


def read_paths(folder: Path | str, cells: Iterable[CellKey] | None = None) -> pd.DataFrame:
    """Return the stored paths of `cells` (all if None), see `paths_file`; cursors are filled in."""
    files = _FILES[PATHS].paths(require_path("folder", folder))
    if cells is not None:
        names = {cell.file_name for cell in cells}
        files = [path for path in files if path.name in names]
    frame = _joined([_FILES[PATHS].read(path).table for path in files])
    for cursor, hand in zip(_CURSOR, ("hand_x", "hand_y")) if len(frame) else ():
        frame[cursor] = frame[cursor].fillna(frame[hand]) if cursor in frame else frame[hand]
    return frame


def _joined(tables: Sequence[pa.Table]) -> pd.DataFrame:
    if not tables:
        return pd.DataFrame()
    plain = [table.replace_schema_metadata(None) for table in tables]
    # A store may be older than a measure, or hold arms of different numbers of joints.
    frame: pd.DataFrame = pa.concat_tables(plain, promote_options="permissive").to_pandas()
    return frame.astype({"training_seed": "Int64"})


class _Frozen(BaseModel):
    model_config = ConfigDict(frozen=True, ser_json_inf_nan="constants")


class Policy(_Frozen):
    """One training of an agent, or the agent itself if it was not trained."""

    training_seed: int | None
    source: str  #: text from which the policy can be made again, else a name for it
    name: str = ""  #: its key in `AGENTS`, or `REFERENCE`; empty for an agent of the user
    knowledge: Knowledge = UNKNOWN  #: its kind, what it is given, and what it senses
    training_steps: int | None = None  #: environment steps; 0 if not trained, None if unknown


class NotPlayed(_Frozen):
    """A cell without episodes, and why: the agent cannot act there, or it failed."""

    agent: str
    training_seed: int | None
    environment: str
    status: Literal["skipped", "failed"]
    reason: str

    @property
    def key(self) -> CellKey:
        """Name of the cell."""
        return CellKey(self.agent, self.training_seed, self.environment)


@with_config(ConfigDict(extra="allow"))
class EnvironmentSettings(TypedDict, total=False):
    """Settings of an environment, and facts of it as it was played."""

    description: str
    family: str
    kwargs: dict[str, Any]
    control_step: float | None  #: seconds
    segment_lengths: list[float]  #: of the arm that agents are given
    tolerance: float | None  #: the distance from the target that counts as success


class Manifest(_Frozen):
    """Everything that a store was made with."""

    schema_version: Literal[4] = 4
    episodes: int  #: number of episodes in each environment without numbered trials
    seed: int  #: of the starts and targets
    measures: dict[str, dict[str, Any]] = {}  #: by name, see `Quantity.facts`
    environments: dict[str, EnvironmentSettings] = {}  #: by name
    agents: dict[str, list[Policy]] = {}  #: policies by name of the agent
    not_played: list[NotPlayed] = []
    controls: dict[str, str] = {}  #: control modes of an agent's cells, by its source
    cpu_seconds: dict[str, float] = {}  #: processor time of each cell, by the stem of its files
    reused: int = 0  #: number of cells that the last run did not have to play
    versions: dict[str, str] = {}  #: by library; several versions are separated by commas
    changed: list[str] = []  #: sources of agents whose weights or code differ between cells

    def control(self, agent: str) -> str:
        """Return an agent's control modes, separated by commas; empty for the ideal hand."""
        modes = (self.controls.get(policy.source) for policy in self.agents.get(agent, ()))
        return ", ".join(dict.fromkeys(filter(None, modes)))


def reasons(not_played: Iterable[NotPlayed]) -> list[str]:
    """Return a line for each agent and reason, with the environments it did not play."""
    groups: dict[tuple[str, str, str], dict[str, None]] = {}
    for cell in not_played:
        groups.setdefault((cell.status, cell.agent, cell.reason), {})[cell.environment] = None
    return [
        f"{status}: {agent} in {', '.join(environments)}: {reason}"
        for (status, agent, reason), environments in groups.items()
    ]


def read_manifest(folder: Path | str) -> Manifest:
    """Return the manifest of a store; raise a `UserError` if it is missing, damaged or changed."""
    path = require_path("folder", folder) / MANIFEST
    try:
        manifest = Manifest.model_validate_json(content := path.read_bytes())
    except FileNotFoundError as error:
        raise UserError(
            f"folder must hold a benchmark's or an experiment's store, got {str(folder)!r}"
        ) from error
    except ValidationError as error:
        raise UserError(f"{path} cannot be read: {explain(error)}") from error
    entries = json.loads(content)
    if entries.pop(_DIGEST, None) != digest_of(entries):
        raise UserError(
            f"{path} has been changed since the benchmark wrote it: remove it, and run the same "
            "benchmark again, which plays no cell twice"
        )
    return manifest


def update_manifest(folder: Path, update: Callable[[Manifest | None], Manifest]) -> Manifest:
    """Call `update` with the store's manifest (None without one); write and return its result.

    Other benchmarks that use the same store wait meanwhile.
    """
    path = folder / MANIFEST
    folder.mkdir(parents=True, exist_ok=True)
    with FileLock(folder / ".lock"):  # released when the process dies, too
        manifest = update(read_manifest(folder) if path.exists() else None)
        entries = manifest.model_dump(mode="json")
        content = {**entries, _DIGEST: digest_of(entries)}
        write_atomically(path, json.dumps(content, indent=1, ensure_ascii=False) + "\n")
        return manifest
