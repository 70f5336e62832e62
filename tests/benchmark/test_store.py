"""What is written to a store is read back, and what is damaged is noticed."""

import json

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

from mmc_gym import UserError
from mmc_gym._cells import parse_cell
from mmc_gym.benchmark.store import (
    EPISODES,
    PATHS,
    CellKey,
    Manifest,
    cell_facts,
    episodes_file,
    kept_cells,
    paths_file,
    read_episodes,
    read_manifest,
    read_paths,
    require_all_cells,
    update_manifest,
    write_cell,
)
from mmc_gym.measures.catalogue import MEASURES

KEY, OTHER = CellKey("ppo", 3, "random"), CellKey("ppo", 4, "random")
SETTINGS = {"seed": 0, "arguments": [1, 2]}
MANIFEST = Manifest(episodes=3, seed=1)
READ = {EPISODES: read_episodes, PATHS: read_paths}
FACTS = {"has_paths": True, "wall_seconds": 0.5}


@pytest.fixture
def episodes(make_episode):
    line = np.linspace([0.0, 1.0], [2.0, 1.0], 41)
    joints = np.linspace([0.0, 0.1, 0.2], [1.0, 1.1, 1.2], 41)
    away = make_episode(line, [2.0, 2.0], joint_angles=joints, seed=11)
    return make_episode(line, line[-1], joint_angles=joints, seed=7), away


def write(folder, key, episodes, facts):
    files = {EPISODES: episodes_file(key, episodes, SETTINGS, facts)}
    if facts.get("has_paths"):
        files[PATHS] = paths_file(key, {0: episodes[0]})
    write_cell(folder, key, files)


@pytest.fixture
def store(episodes, tmp_path):
    write(tmp_path, KEY, episodes, FACTS)
    return tmp_path


def test_episodes_are_read_back(store, episodes):
    frame = read_episodes(store)
    identity = {"agent": "ppo", "training_seed": 3, "environment": "random", "instance": [0, 1]}
    where = {"start_x": 0.0, "start_y": 1.0, "target_x": 2.0, "target_y": [1.0, 2.0]}
    expected = pd.DataFrame({**identity, "seed": [7, 11], **where, "duration": 0.8})
    assert list(frame.columns) == [*expected, *MEASURES]
    pd.testing.assert_frame_equal(frame[list(expected)], expected, check_dtype=False)
    for measure in MEASURES.values():
        np.testing.assert_array_equal(frame[measure.name], [measure.of(e) for e in episodes])
    assert np.isnan(frame["time_to_target"][1])


def test_paths_of_hands_with_and_without_an_arm_and_of_cursors_are_read_back(
    store, episodes, make_episode
):
    hands, episode = np.linspace([0.0, 1.0], [2.0, 1.0], 5), episodes[0]
    turned = make_episode(hands, [2, 2], cursors=hands + 1, joint_angles=np.zeros((5, 0)))
    write(store, KEY._replace(environment="rotation-30"), [turned], FACTS)
    frame = read_paths(store)
    assert list(frame.columns[:5]) == ["agent", "training_seed", "environment", "instance", "step"]
    assert frame["step"].tolist() == [*range(41), *range(5)]
    assert frame["hand_x"].dtype == np.float32
    columns = ["joint_angle_1", "joint_angle_2", "joint_angle_3", "hand_x", "hand_y"]
    columns += ["target_x", "target_y", "cursor_x", "cursor_y"]
    known = np.hstack([episode.joint_angles, episode.hands, episode.targets, episode.hands])
    other = np.hstack([np.full((5, 3), np.nan), hands, turned.targets, hands + 1])
    np.testing.assert_array_equal(frame[columns], np.vstack([known, other]).astype(np.float32))


def test_a_cell_is_known_by_its_settings_and_leaves_nothing_once_removed(store, episodes):
    assert cell_facts(store, KEY, {**SETTINGS, "arguments": (1, 2)}) == FACTS
    assert cell_facts(store, KEY, {**SETTINGS, "seed": 1}) is None
    assert cell_facts(store, KEY._replace(training_seed=None), SETTINGS) is None
    write(store, KEY, episodes, {"has_paths": False})
    assert read_paths(store).empty and len(read_episodes(store)) == 2
    write_cell(store, KEY, {})
    assert not list(store.glob("*/*.parquet"))


@pytest.mark.parametrize("kind", READ)
def test_damage_is_noticed_and_named(store, kind):
    path, other = store / kind / KEY.file_name, store / kind / OTHER.file_name
    other.write_bytes(path.read_bytes())
    with pytest.raises(UserError, match=f"{other.name} is damaged.* a copy of {KEY.stem}"):
        READ[kind](store)
    other.unlink()
    cut = path.read_bytes()[:-50]
    pd.DataFrame({"agent": ["ppo"]}).to_parquet(path)  # not made by the benchmark
    for content in (path.read_bytes(), cut, b""):
        path.write_bytes(content)
        with pytest.raises(UserError, match=f"{path.name} is damaged"):
            READ[kind](store)
        assert cell_facts(store, KEY, SETTINGS) is None
    path.unlink()
    assert cell_facts(store, KEY, SETTINGS) is None


def test_a_file_that_was_removed_is_named(store, episodes):
    write(store, OTHER, episodes, FACTS)
    (store / PATHS / KEY.file_name).unlink()
    with pytest.raises(UserError, match=f"{PATHS}/{KEY.file_name} is missing"):
        read_episodes(store)
    (store / PATHS / OTHER.file_name).unlink()
    assert len(read_episodes(store)) == 4  # without any paths, a store is whole
    manifest = MANIFEST.model_copy(update={"cpu_seconds": {KEY.stem: 1.0, "mmc--random": 1.0}})
    with pytest.raises(UserError, match=f"{EPISODES}/mmc--random.parquet is missing"):
        require_all_cells(store, manifest)


def test_a_cell_of_another_benchmark_and_a_folder_without_one_are_named(store, episodes, tmp_path):
    content = episodes_file(OTHER, episodes, {**SETTINGS, "seed": 1}, {})
    write_cell(store, OTHER, {EPISODES: content})
    with pytest.raises(UserError, match=f"{OTHER.file_name} must be of the same settings as"):
        read_episodes(store)
    for read in (read_episodes, read_manifest):
        with pytest.raises(UserError, match="folder must hold a benchmark's"):
            read(tmp_path / "empty")
    for read in (read_episodes, read_manifest, read_paths):
        with pytest.raises(UserError, match="folder must be a path, got"):
            read("a\0b")


def test_file_names_are_different_and_safe():
    names = ["a:b", "a-b", "A-b", "a--b", "a/b", "a.b", ".a", "../a", "", "é", "an (ideal)"]
    files = {CellKey(name, seed, "random").file_name for name in names for seed in (None, 0)}
    assert len({name.lower() for name in files}) == 2 * len(names)
    assert all("/" not in name and not name.startswith(".") for name in files)
    assert {name.count("--") for name in files} == {1, 2}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"schema_version": 1}, "schema_version must be 4, got 1"),
        ({"episodes": "many"}, "cannot be read: episodes must be a valid integer"),
        ({"agents": {"mmc": {}}}, "agents.mmc must be a valid array"),
        ({"environments": {"a": {"tolerance": "x"}}}, "a.tolerance must be a valid number.* 'x'"),
        (
            {"environments": {"a": {"segment_lengths": 1}}},
            "a.segment_lengths must be a valid array",
        ),
        ({"environments": {"a": {"kwargs": []}}}, "a.kwargs must be an object, got"),
        ({"episodes": 5}, "has been changed since the benchmark wrote it: remove it"),
    ],
)
def test_a_damaged_manifest_is_refused(tmp_path, changes, message):
    update_manifest(tmp_path, lambda before: MANIFEST)
    assert read_manifest(tmp_path) == MANIFEST
    content = json.dumps(MANIFEST.model_dump() | changes)
    for text, said in ((content, message), (content[:-1], "cannot be read: Invalid JSON")):
        (tmp_path / "manifest.json").write_text(text)
        with pytest.raises(UserError, match=said):
            read_manifest(tmp_path)


def test_a_store_may_lack_a_measure_that_came_later(store, episodes, monkeypatch):
    with monkeypatch.context() as earlier:
        others = {name: measure for name, measure in MEASURES.items() if name != "success"}
        earlier.setattr("mmc_gym.benchmark.store.MEASURES", others)
        old = KEY._replace(agent="old")
        write(store, old, episodes, {})
    assert cell_facts(store, old, SETTINGS) is None
    read = read_episodes(store).groupby("agent")["success"].count()
    assert read.to_dict() == {"old": 0, "ppo": 2}


@pytest.mark.parametrize("kind", READ)
def test_any_flipped_bit_is_damage(store, kind):
    path = store / kind / KEY.file_name
    content = bytearray(path.read_bytes())
    size, footer = len(content), int.from_bytes(content[-8:-4], "little") + 8
    places = [*range(8 * (size - footer), 8 * size)]  # offsets and numbers of rows are there
    places += np.random.default_rng(0).integers(8 * size, size=1000).tolist()
    for number, place in enumerate(places):
        content[place // 8] ^= 1 << place % 8
        with pytest.raises(ValueError, match="not as it was written"):
            parse_cell(bytes(content))
        if number % 400 == 0:
            path.write_bytes(content)
            with pytest.raises(UserError, match=f"{path.name} is damaged"):
                READ[kind](store)
            assert cell_facts(store, KEY, SETTINGS) is None
            assert kind == PATHS or not kept_cells(store)
        content[place // 8] ^= 1 << place % 8
    parse_cell(bytes(content))


def test_files_of_other_writers_and_versions_are_not_parsed(store, monkeypatch):
    path = store / EPISODES / KEY.file_name
    table = pq.read_table(path)  # by others, a file can be read as any
    monkeypatch.setattr(pq, "ParquetFile", None)
    metadata = {b"mmc_gym": b"{}", b"mmc_gym_check": b"0" * 64}  # of a version before
    pq.write_table(table.replace_schema_metadata(metadata), path)
    with pytest.raises(UserError, match=f"{path.name} is damaged.* or is of an earlier version"):
        read_episodes(store)


def test_a_text_of_zeros_is_no_place_for_a_digest(store, episodes):
    zeros = KEY._replace(agent="0" * 64)
    write(store, zeros, episodes, {"has_paths": True, "note": "0" * 64, "mmc_gym_sha256": "0" * 66})
    assert len(read_episodes(store)) == 4 and len(read_paths(store)) == 82
