"""Files are data: no reader imports, calls or unpacks what a file names."""

import json
import sys
import zipfile
from contextlib import suppress
from itertools import pairwise

import numpy as np
import pyarrow.parquet as pq
import pytest
import yaml

import mmc_gym
from mmc_gym import UserError
from mmc_gym._cells import CONTENT, SEAL, cell_content, parse_cell
from mmc_gym._files import UNSEALED, YAML_MOST, read_yaml, seal
from mmc_gym.agents.policy import load_policy, shipped_file
from mmc_gym.agents.sb3 import SavedModel
from mmc_gym.benchmark import store
from mmc_gym.experiments.experiment import TRIALS_MOST, Block, Experiment, find_experiment
from mmc_gym.experiments.trials import read_experiments
from mmc_gym.network import LearnedNormalizer
from mmc_gym.network.normalizers import WEIGHTS
from mmc_gym.report import write_report
from mmc_gym.training.hyperparameters import read_recipe

NAMES = ["os:abort", "bait:make", "bait:Bait-v0", "bait", "MMCReach-v0"]


@pytest.fixture
def bait(tmp_path, monkeypatch):
    """A module in the working directory; imported, it leaves a mark."""
    monkeypatch.chdir(tmp_path)
    mark = tmp_path / "imported"
    (tmp_path / "bait.py").write_text(f"open({str(mark)!r}, 'w')\n")
    yield mark
    sys.modules.pop("bait", None)
    assert not mark.exists()


def a_store(tmp_path):
    """Return the only file of trials of an experiment in the store tmp_path."""
    experiment = Experiment("tiny", [Block("all", 4, ["rotation-30"])])
    mmc_gym.run_experiment(experiment, "ik-dls", subjects=1, jobs=1, out=tmp_path)
    [file] = (tmp_path / "trials").glob("*.parquet")
    return file


def with_settings(file, settings):
    """Let a file of trials have other settings, with checksums that fit."""
    table, _, facts = parse_cell(file.read_bytes())
    columns = dict(zip(table.column_names, table.columns))
    file.write_bytes(cell_content(columns, settings, facts))


@pytest.mark.parametrize("name", NAMES)
def test_names_in_an_experiment_are_perturbations_and_nothing_else(name, bait, tmp_path):
    file = tmp_path / "mine.yml"
    block, probe = {"name": "all", "trials": 4}, {"name": "catch", "every": 2}
    for entries in (
        {"blocks": [block], "noise": [name]},
        {"blocks": [block | {"perturbations": [name]}]},
        {"blocks": [block | {"probes": [probe | {"perturbations": [name]}]}]},
    ):
        file.write_text(yaml.safe_dump({"name": "mine", **entries}))
        with pytest.raises(UserError, match="is not accepted"):
            find_experiment(file)


@pytest.mark.parametrize("name", NAMES[:3])
def test_what_a_file_of_trials_names_is_looked_up(name, bait, tmp_path):
    file = a_store(tmp_path)
    settings = json.loads(json.dumps(parse_cell(file.read_bytes()).settings))
    settings["experiment"]["blocks"][0]["perturbations"] = [name]
    for wrong in ({}, settings):  # another kind of file, or not of the digest in its name
        with_settings(file, wrong)
        with pytest.raises(UserError, match=f"{file.name} is damaged") as error:
            write_report(tmp_path, tmp_path / "report.html")
    renamed = file.rename(file.with_name(str(error.value).rpartition("it is ")[2]))
    stems = (path.name.rsplit(".", 2)[0] for path in (file, renamed))
    plan, renamed_plan = (file.with_name(f"{stem}.json") for stem in stems)
    plan.rename(renamed_plan)
    with pytest.raises(UserError, match="is not accepted"):
        read_experiments(tmp_path)


@pytest.mark.parametrize("content", ["[" * 100_000, "3", "[]", '{"settings": 1}', '{"facts": []}'])
def test_metadata_that_are_no_settings_are_damage(content, tmp_path):
    file = a_store(tmp_path)
    table = parse_cell(file.read_bytes()).table
    metadata = {CONTENT: content, SEAL: UNSEALED}
    pq.write_table(table.replace_schema_metadata(metadata), file)
    file.write_bytes(seal(file.read_bytes()))
    with pytest.raises(UserError, match="is damaged, remove it: its metadata"):
        write_report(tmp_path, tmp_path / "report.html")
    cell = tmp_path / "episodes" / file.name  # and it is no cell of a benchmark
    cell.parent.mkdir()
    file.rename(cell)
    assert store.kept_cells(tmp_path) == {}


@pytest.mark.parametrize(
    ("entry", "why"),
    [
        ("bait:Bait-v0: {n_timesteps: 10}", "may run any code"),
        ("MMCReach-v0: {n_timesteps: 10, policy: 'bait:Policy'}", "policy must be MlpPolicy"),
    ],
)
def test_a_hyperparameter_file_imports_no_environment(entry, why, bait, tmp_path):
    (tmp_path / "ppo-mine.yml").write_text(entry)
    with pytest.raises(UserError, match=why):
        _ = read_recipe(str(tmp_path / "ppo-mine.yml")).settings


def test_a_card_of_a_policy_imports_nothing(bait, tmp_path):
    card = shipped_file("ppo", 0)
    for file in (card, card.with_suffix(".safetensors")):
        (tmp_path / file.name).write_bytes(file.read_bytes())
    entries = json.loads(card.read_text()) | {"env_id": "bait:Bait-v0", "base_agent": "bait:make"}
    (tmp_path / card.name).write_text(json.dumps(entries))
    with pytest.raises(UserError, match="its card"):
        load_policy(tmp_path / card.name)


# Each list has ten times the one before it.
TENFOLD = ", ".join(f"&{b} [{', '.join([f'*{a}'] * 10)}]" for a, b in pairwise("abcdefghi"))
TENFOLD = f"[&a [1], {TENFOLD}]"


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("on: 2", "key on must be a text"),
        ("? [a, b]\n: 2", "must be a text"),
        ("a: &a [1]\nb: *a\na: 1", "'a' occurs twice"),
        ("&a [*a]", "nested too deeply"),
        (TENFOLD, f"at most {YAML_MOST:,} values"),
    ],
)
def test_yaml_is_plain_data_of_a_bounded_size(text, why):
    with pytest.raises(ValueError, match=why):
        read_yaml(text)


def test_files_have_bounds(tmp_path):
    (tmp_path / "mine.yml").write_text("a" * (YAML_MOST + 1))
    with pytest.raises(UserError, match=f"at most {YAML_MOST:,} characters"):
        find_experiment(tmp_path / "mine.yml")
    with pytest.raises(UserError, match=f"of {TRIALS_MOST:,} trials at most"):
        Experiment("long", [Block("all", TRIALS_MOST // 2 + 1)] * 2)
    with pytest.raises(UserError, match=r"targets .*3600"):
        Block("all", 5, targets=np.arange(3601) / 20)
    with zipfile.ZipFile(tmp_path / "mine.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("data", b" " * (300 * 2**20))
    with pytest.raises(UserError, match="data has more than"):
        _ = SavedModel(tmp_path / "mine.zip").facts


def flips(content, file):
    """Write the content into a file three hundred times, each with another bit flipped."""
    for place in np.random.default_rng(0).integers(0, 8 * len(content), 300).tolist():
        changed = bytearray(content)
        changed[place // 8] ^= 1 << place % 8
        file.write_bytes(changed)
        yield file


def test_a_zip_with_flipped_bits_is_refused_in_one_line(tmp_path):
    entries = {"policy_class": {}, "action_space": {}, "x": "y" * 99}
    with zipfile.ZipFile(tmp_path / "mine.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("data", json.dumps(entries))
    for file in flips((tmp_path / "mine.zip").read_bytes(), tmp_path / "flipped.zip"):
        with suppress(UserError):  # a flip may hit what is never read, such as a date
            _ = SavedModel(file).facts


def test_a_normalizer_with_any_flipped_bit_is_refused(tmp_path):
    whole = (WEIGHTS / "accurate-16x16.safetensors").read_bytes()
    for file in flips(whole, tmp_path / "flipped"):
        with pytest.raises(UserError, match="does not hold a normalizer"):
            LearnedNormalizer.load(file)
