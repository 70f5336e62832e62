"""The paper's networks are trained once, kept, and the same for the same seed."""

import tokenize
import zlib
from dataclasses import replace

import numpy as np
import pytest

from mmc_gym.network import fitting as training
from studies.paper import networks as normalizers
from studies.paper.experiment import Settings
from studies.paper.networks import trained_architectures

pytestmark = pytest.mark.slow

FEW = ((2,), (3, 2))


@pytest.fixture(autouse=True)
def short_recipe(monkeypatch):
    monkeypatch.setattr(normalizers, "QUICK_RECIPE", replace(training.PAPER, samples=400, epochs=6))


@pytest.fixture
def calls(monkeypatch):
    """The architectures that were trained rather than read."""
    trained = []

    def train(hidden_units, *arguments, **options):
        trained.append(hidden_units)
        return training.train_normalizers(hidden_units, *arguments, **options)

    monkeypatch.setattr(normalizers, "train_normalizers", train)
    return trained


def train_few(folder=None, **settings):
    return trained_architectures(Settings(quick=True, folder=folder, **settings), FEW)


def assert_same(one, other):
    assert one.keys() == other.keys()
    for a, b in zip(one.values(), other.values(), strict=True):
        np.testing.assert_array_equal(a.training_mse, b.training_mse)
        np.testing.assert_array_equal(a.validation_mse, b.validation_mse)
        for m, n in zip(a.normalizers, b.normalizers, strict=True):
            np.testing.assert_array_equal(m.weights[0], n.weights[0])
            np.testing.assert_array_equal(m.biases[-1], n.biases[-1])


def test_trained_networks_are_measured():
    few = train_few()
    assert list(few) == ["[2]", "[3, 2]"]
    for units, architecture in zip(FEW, few.values(), strict=True):
        assert architecture.training_mse.shape == architecture.validation_mse.shape == (2, 6)
        for normalizer, grid_mse in zip(
            architecture.normalizers, architecture.grid_mse, strict=True
        ):
            assert normalizer.hidden_units == units
            mse = normalizers.mean_squared_error(normalizer, directions=180)
            assert grid_mse == pytest.approx(mse)


def test_a_seed_gives_the_same_networks_and_another_seed_others():
    one, again, other = train_few(), train_few(), train_few(seed=1)
    assert_same(one, again)
    assert not np.allclose(one["[2]"].training_mse, other["[2]"].training_mse)


def test_interrupted_work_goes_on_where_it_was(tmp_path, calls, monkeypatch):
    def interrupt(done, total):
        if done > 6:  # in the second architecture
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train_few(tmp_path, on_progress=interrupt)
    assert calls == [(3, 2), (2,)]  # the larger first
    calls.clear()

    reports = []
    resumed = train_few(tmp_path, on_progress=lambda *report: reports.append(report))
    assert calls == [(2,)]
    assert reports == [(done, 12) for done in range(6, 13)]
    assert_same(resumed, train_few())

    calls.clear()
    assert_same(train_few(tmp_path), resumed)
    assert calls == []


def test_what_is_kept_is_for_its_seed_and_recipe_only(tmp_path, calls, monkeypatch):
    train_few(tmp_path)
    calls.clear()
    train_few(tmp_path, seed=1)
    assert len(calls) == 2
    recipe = replace(normalizers.QUICK_RECIPE, epochs=2)
    monkeypatch.setattr(normalizers, "QUICK_RECIPE", recipe)
    assert train_few(tmp_path)["[2]"].training_mse.shape == (2, 2)


def cut(path):
    path.write_bytes(path.read_bytes()[:100])


def scramble(path):
    """Damage what is compressed, and leave the archive's directory whole."""
    content = bytearray(path.read_bytes())
    content[70:110] = b"\xff" * 40
    path.write_bytes(content)


def rewrite(**changes):
    """Replace arrays by others, or drop those that are None."""

    def damage(path):
        with np.load(path) as arrays:
            changed = {**arrays, **changes}
        np.savez(path, **{name: array for name, array in changed.items() if array is not None})

    return damage


DAMAGE = {
    "cut short": cut,
    "empty": lambda path: path.write_bytes(b""),
    "scrambled": scramble,
    "without weights": rewrite(weights_0=None),
    "too few runs": rewrite(weights_0=np.zeros((1, 2, 2))),
    "no numbers": rewrite(biases_1=np.array(["a", "b"])),
}


@pytest.mark.parametrize("damage", DAMAGE.values(), ids=DAMAGE)
def test_a_damaged_file_is_named_and_made_anew(damage, tmp_path, calls):
    whole, notes = train_few(tmp_path), []
    (damaged,) = (tmp_path / "networks").glob("2-*.npz")
    damage(damaged)
    calls.clear()
    assert_same(train_few(tmp_path, on_note=notes.append), whole)
    assert calls == [(2,)]
    (note,) = notes
    assert note.startswith(f"{damaged} is damaged and is made anew")
    calls.clear()
    train_few(tmp_path)
    assert calls == []


@pytest.mark.parametrize("error", [zlib.error, tokenize.TokenError, RuntimeError, KeyError])
def test_whatever_a_damaged_file_raises_it_is_made_anew(error, tmp_path, calls, monkeypatch):
    def load(file):
        raise error("damaged")

    train_few(tmp_path)
    calls.clear()
    monkeypatch.setattr(np, "load", load)
    with pytest.warns(UserWarning, match="is damaged and is made anew"):
        train_few(tmp_path)
    assert len(calls) == 2


@pytest.mark.parametrize("version", ["0.0.1", None])
def test_another_version_trains_anew(version, tmp_path, calls):
    train_few(tmp_path, version=version or "0.1")
    if not version:
        for path in (tmp_path / "networks").iterdir():
            rewrite(version=None)(path)  # as before versions were kept
    calls.clear()
    notes = []
    train_few(tmp_path, on_note=notes.append)
    assert len(calls) == len(notes) == 2
    assert f"was made by version {version or 'unknown'}" in notes[0]


def test_processes_give_what_one_process_gives(tmp_path, monkeypatch):
    monkeypatch.setattr(normalizers, "_FEW_EPOCHS", 0)
    # Spawned processes know nothing of the recipe's replacement but what they are sent.
    reports = []
    parallel = train_few(tmp_path, jobs=2, on_progress=lambda *report: reports.append(report))
    assert_same(parallel, train_few())
    assert_same(parallel, train_few(tmp_path))
    assert reports[0] == (0, 12)
    assert reports[-1] == (12, 12)
