"""A grid of trainings gives what each training alone would have given."""

import re
import shutil
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from mmc_gym.agents.policy import load_policy
from mmc_gym.training.hyperparameters import read_recipe
from mmc_gym.training.training import PolicyName, Training, shipped_policies, train_all

POLICIES = [PolicyName("ppo", 0), PolicyName("ppo", 1)]
STEPS = 4_096  # one rollout


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.glob("*.safetensors")}


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("trained")
    train_all(POLICIES, folder, steps=STEPS, jobs=1)
    return folder


def test_two_processes_train_what_one_does(trained, tmp_path):
    seen: list[Any] = []
    cards = train_all(POLICIES, tmp_path, steps=STEPS, jobs=2, on_policy=seen.append)
    assert contents(tmp_path) == contents(trained)
    assert [(card.name, card.seed) for card in cards] == POLICIES
    assert sorted(card.seed for card in seen) == [0, 1]
    assert not list(tmp_path.glob("checkpoints/*"))  # of no more use


@pytest.mark.slow
def test_ray_trains_what_one_process_does(trained, tmp_path, monkeypatch):
    monkeypatch.setenv("RAY_ADDRESS", "local")  # else it joins another test's cluster, which ends
    train_all(POLICIES, tmp_path, steps=STEPS, cluster="ray")
    assert contents(tmp_path) == contents(trained)


def test_what_is_there_is_not_trained_again(trained, monkeypatch):
    def fail(cell: Any) -> None:
        raise AssertionError(f"{cell} is trained again")

    monkeypatch.setattr("mmc_gym.training.training.train_cell", fail)
    cards = train_all(POLICIES, trained, steps=STEPS, jobs=1)
    assert cards == [load_policy(trained / f"ppo-{seed}.json")[1] for seed in (0, 1)]


def test_a_damaged_policy_is_trained_again(trained, tmp_path):
    for file in trained.glob("ppo-0.*"):
        shutil.copy(file, tmp_path)
    (tmp_path / "ppo-0.safetensors").write_bytes(b"damaged")
    train_all(POLICIES[:1], tmp_path, steps=STEPS, jobs=1)
    assert contents(tmp_path)["ppo-0.safetensors"] == contents(trained)["ppo-0.safetensors"]


def test_a_checkpoint_of_another_training_is_discarded(trained, tmp_path):
    checkpoints = tmp_path / "checkpoints" / "ppo-0"
    Training(read_recipe("ppo", steps=1), 0, checkpoints).run()
    notes: list[str] = []
    train_all(POLICIES[:1], tmp_path, steps=STEPS, jobs=1, on_note=notes.append)
    (note,) = notes
    assert re.match(r"ppo-0 begins anew: .* with n_timesteps 1 \(here 4096", note)
    assert contents(tmp_path)["ppo-0.safetensors"] == contents(trained)["ppo-0.safetensors"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"steps": 0}, "n_timesteps must be at least 1, got 0"),
        ({"device": "foo"}, "device must be one that PyTorch can use"),
        ({"jobs": 0}, "jobs must be a whole number of at least 1"),
    ],
)
def test_mistakes_are_named_before_anything_is_trained(tmp_path, options, message):
    with pytest.raises(ValueError, match=message):
        train_all(POLICIES, tmp_path, **options)
    assert not list(tmp_path.iterdir())


def test_the_seeds_that_ship_are_those_asked_for():
    policies = shipped_policies()
    assert len(set(policies)) == len(policies)
    counts = Counter(policy.name for policy in policies)
    assert (counts["ppo"], counts["sac"], counts["tqc-her"]) == (10, 5, 5)
    assert "ppo-memory" not in counts  # a study trains it
