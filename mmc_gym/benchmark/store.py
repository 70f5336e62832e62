"""The store of a benchmark: a folder of Parquet files, one for each cell, and a manifest.

    episodes/AGENT--SEED--ENVIRONMENT.parquet    a row per episode: who, where, measures
    paths/AGENT--SEED--ENVIRONMENT.parquet       a row per step of the first episodes, for pictures
    sets/AGENT--SEED--ENVIRONMENT.parquet        a row per measure of all episodes together
    manifest.json                                what all of it was made with

A cell is an agent, a training seed of it (0 if it is not trained) and an environment.  Every file
is written atomically and carries, in its schema's metadata, the settings that it was made with, so
that a run that was interrupted goes on, and what is damaged or outdated is made anew.  Any reader
of Parquet can query the folders as they are.
"""

from __future__ import annotations

import hashlib
import io
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import pyarrow as pa  # type: ignore[import-untyped]
import pyarrow.parquet as pq  # type: ignore[import-untyped]

from mmc_gym._files import write_atomically
from mmc_gym.measures import MEASURES, Episode
from mmc_gym.measures.catalogue import set_measures_in

SCHEMA_VERSION = 1
MANIFEST = "manifest.json"
EPISODES, PATHS, SETS = "episodes", "paths", "sets"
SET_COLUMNS = ("agent", "training_seed", "environment", "measure", "unit", "episodes", "value")
_METADATA = b"mmc_gym"
_CURSOR = ("cursor_x", "cursor_y")
_PLAIN = re.compile(r"[a-z0-9][a-z0-9_.+-]*")


class CellKey(NamedTuple):
    """What a cell is called."""

    agent: str
    training_seed: int
    environment: str

    @property
    def file_name(self) -> str:
        """The name of its files: different for different cells, on any file system.

        Example:
            >>> CellKey("ppo", 3, "random").file_name
            'ppo--3--random.parquet'
        """
        return f"{_slug(self.agent)}--{self.training_seed}--{_slug(self.environment)}.parquet"


def _slug(name: str) -> str:
    if _PLAIN.fullmatch(name) and "--" not in name:
        return name
    plain = "-".join(re.findall(r"[a-z0-9_]+", name.lower()))
    return f"{plain}~{hashlib.sha256(name.encode()).hexdigest()[:8]}"


def episodes_file(
    key: CellKey, episodes: Sequence[Episode], settings: Mapping[str, Any], facts: Mapping[str, Any]
) -> bytes:
    """The content of a cell's file of episodes.

    Columns agent, training_seed, environment, instance (0, 1, …), seed (of the episode), start_x,
    start_y (of the hand), target_x, target_y (both when the episode starts), duration (s), and one
    for each of `MEASURES`, NaN where an episode has no such value.

    Args:
        key: of the cell.
        episodes: of its instances, in order.
        settings: that it was made with, ready for JSON; `is_valid` compares them.
        facts: what else is to be kept about the cell, ready for JSON.
    """
    starts = np.array([episode.hands[0] for episode in episodes]).reshape(-1, 2)
    targets = np.array([episode.target for episode in episodes]).reshape(-1, 2)
    durations = [len(episode.rewards) * episode.control_step for episode in episodes]
    columns: dict[str, Any] = {
        **_key_columns(key, len(episodes)),
        "instance": np.arange(len(episodes), dtype=np.int32),
        "seed": np.array([episode.seed for episode in episodes], dtype=np.int64),
        **dict(zip(("start_x", "start_y"), starts.T)),
        **dict(zip(("target_x", "target_y"), targets.T)),
        "duration": np.array(durations),
        **{
            measure.name: np.array([measure.of(episode) for episode in episodes], np.float64)
            for measure in MEASURES.values()
        },
    }
    return _parquet(columns, {"settings": settings, "facts": facts})


def paths_file(key: CellKey, episodes: Sequence[Episode], joint_count: int) -> bytes:
    """The content of a cell's file of paths: all steps of some episodes, its first instances.

    Columns agent, training_seed, environment, instance, step (0 is the start), joint_angle_1 to
    joint_angle_N (radians, not wrapped; NaN for a hand without an arm), hand_x, hand_y, target_x,
    target_y (segment lengths); all numbers but the first three float32.  Under a visuomotor
    rotation also cursor_x, cursor_y: distance and success are the cursor's; elsewhere it is the
    hand itself and not written twice, and `read_paths` repeats it.
    """
    hands = np.concatenate([episode.hands for episode in episodes])
    targets = np.concatenate([episode.targets for episode in episodes])
    postures = np.full((len(hands), joint_count), np.nan)
    if all(episode.joint_angles.shape[-1] == joint_count for episode in episodes):
        postures = np.concatenate([episode.joint_angles for episode in episodes])
    cursors = [episode.cursors for episode in episodes if episode.cursors is not None]
    counts = [len(episode.hands) for episode in episodes]
    columns: dict[str, Any] = {
        **_key_columns(key, len(hands)),
        "instance": np.repeat(np.arange(len(counts), dtype=np.int32), counts),
        "step": np.concatenate([np.arange(count, dtype=np.int32) for count in counts]),
        **{
            name: values.astype(np.float32)
            for name, values in (
                *((f"joint_angle_{joint + 1}", postures[:, joint]) for joint in range(joint_count)),
                *zip(("hand_x", "hand_y"), hands.T),
                *zip(("target_x", "target_y"), targets.T),
                *zip(_CURSOR, np.concatenate(cursors).T if cursors else ()),
            )
        },
    }
    return _parquet(columns, {})


def sets_file(key: CellKey, episodes: Sequence[Episode]) -> bytes | None:
    """The content of a cell's file of set measures; None where the environment suits none.

    A row for each of `SET_MEASURES` that is taken in this environment: agent, training_seed,
    environment, measure, unit, episodes (their number), value (NaN if they have none).
    """
    measures = set_measures_in(key.environment)
    if not measures:
        return None
    columns = {
        **_key_columns(key, len(measures)),
        "measure": [measure.name for measure in measures],
        "unit": [measure.unit for measure in measures],
        "episodes": np.full(len(measures), len(episodes), dtype=np.int32),
        "value": np.array([measure.of(episodes) for measure in measures], np.float64),
    }
    return _parquet(columns, {})


def _key_columns(key: CellKey, rows: int) -> dict[str, Any]:
    return {
        "agent": pa.array([key.agent] * rows, pa.string()),
        "training_seed": np.full(rows, key.training_seed, dtype=np.int32),
        "environment": pa.array([key.environment] * rows, pa.string()),
    }


def _parquet(columns: Mapping[str, Any], metadata: Mapping[str, Any]) -> bytes:
    table = pa.table(dict(columns)).replace_schema_metadata({_METADATA: json.dumps(metadata)})
    buffer = io.BytesIO()
    pq.write_table(table, buffer, compression="zstd", write_page_checksum=True)
    return buffer.getvalue()


def write_cell(
    folder: Path, key: CellKey, episodes: bytes, paths: bytes | None, sets: bytes | None = None
) -> None:
    """Write a cell's files; that of its episodes, which says that it is there, is the last."""
    for kind, content in ((PATHS, paths), (SETS, sets)):
        if content is not None:
            write_atomically(folder / kind / key.file_name, content)
    write_atomically(folder / EPISODES / key.file_name, episodes)


def cell_facts(folder: Path, key: CellKey, settings: Mapping[str, Any]) -> dict[str, Any] | None:
    """What a cell's file keeps about it; None if it is missing, damaged, or of other settings."""
    path = folder / EPISODES / key.file_name
    try:
        table = _read(path)
        kept = json.loads((table.schema.metadata or {})[_METADATA])
        facts: dict[str, Any] = kept["facts"]
        fine = kept["settings"] == json.loads(json.dumps(settings))
        fine &= MEASURES.keys() <= set(table.column_names)
        if facts["has_paths"]:
            _read(folder / PATHS / key.file_name)
        if facts.get("has_sets"):
            _read(folder / SETS / key.file_name)
    except (OSError, pa.ArrowException, ValueError, KeyError, TypeError):
        return None
    return facts if fine else None


def what_is_kept(folder: Path) -> Iterator[dict[str, Any]]:
    """Settings and facts of each cell of a store; damaged ones are passed over."""
    for path in _files(folder, EPISODES):
        try:
            kept: dict[str, Any] = json.loads((pq.read_schema(path).metadata or {})[_METADATA])
        except (OSError, pa.ArrowException, ValueError, KeyError, TypeError):
            continue
        yield {"settings": {}, "facts": {}, **kept}


def read_episodes(folder: Path | str) -> pd.DataFrame:
    """All episodes of a store; the columns stand at `episodes_file`.

    Raises:
        ValueError: if there are none, or a file is damaged.
    """
    return _read_all(Path(folder), EPISODES)


def read_paths(folder: Path | str) -> pd.DataFrame:
    """All paths of a store; the columns stand at `paths_file`, cursor_x and cursor_y everywhere.

    Raises:
        ValueError: if there are none, or a file is damaged.
    """
    frame = _read_all(Path(folder), PATHS)
    for cursor, hand in zip(_CURSOR, ("hand_x", "hand_y")):
        frame[cursor] = frame[cursor].fillna(frame[hand]) if cursor in frame else frame[hand]
    return frame


def read_sets(folder: Path | str) -> pd.DataFrame:
    """All set measures of a store, in a row each; the columns stand at `sets_file`.

    No rows if no agent was in an environment that suits any.

    Raises:
        ValueError: if a file is damaged.
    """
    if not _files(Path(folder), SETS):
        return pd.DataFrame(columns=SET_COLUMNS)
    return _read_all(Path(folder), SETS)


def read_manifest(folder: Path | str) -> dict[str, Any]:
    """What a store was made with.

    Raises:
        ValueError: if there is no manifest, or it is damaged, or of another version.
    """
    path = Path(folder) / MANIFEST
    try:
        manifest: dict[str, Any] = json.loads(path.read_bytes())
        version = manifest["schema_version"]
    except FileNotFoundError as error:
        raise ValueError(f"folder must hold a benchmark's store, got {str(folder)!r}") from error
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(f"{path} is damaged: {error}") from error
    if version != SCHEMA_VERSION:
        raise ValueError(f"{path} must be of version {SCHEMA_VERSION}, got {version}")
    return manifest


def write_manifest(folder: Path, manifest: Mapping[str, Any]) -> None:
    """Write the manifest of a store."""
    content = {"schema_version": SCHEMA_VERSION, **manifest}
    write_atomically(folder / MANIFEST, json.dumps(content, indent=1) + "\n")


def _read(path: Path) -> pa.Table:
    return pq.ParquetFile(path, page_checksum_verification=True).read()


def _files(folder: Path, kind: str) -> list[Path]:
    return sorted((folder / kind).glob("[!.]*.parquet"))


def _read_all(folder: Path, kind: str) -> pd.DataFrame:
    files = _files(folder, kind)
    if not files:
        raise ValueError(f"folder must hold a benchmark's {kind}, got {str(folder)!r}")
    tables = []
    for path in files:
        try:
            tables.append(_read(path).replace_schema_metadata(None))
        except (OSError, pa.ArrowException) as error:
            raise ValueError(f"{path} is damaged, and is made anew by the benchmark") from error
    # A store may have been begun before a measure was there, or hold arms of different joints.
    frame: pd.DataFrame = pa.concat_tables(tables, promote_options="permissive").to_pandas()
    return frame
