"""Trained policies on disk: complete, checked, and free of code."""

import json
import shutil
from importlib.resources import files
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
import torch

from mmc_gym import make_agent
from mmc_gym.agents.reinforcement import load_policy, make_policy, save_policy
from mmc_gym.agents.training import read_hyperparameters

SHIPPED = Path(str(files("mmc_gym.agents") / "pretrained"))


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    for suffix in ("json", "safetensors"):
        shutil.copy(SHIPPED / f"ppo.{suffix}", tmp_path)
    return tmp_path / "ppo.json"


def edit(card: Path, **changes: object) -> None:
    card.write_text(json.dumps({**json.loads(card.read_text()), **changes}))


def test_saving_and_loading_gives_the_same_actions(tmp_path):
    _, card = load_policy(SHIPPED / "ppo.json")
    torch.manual_seed(0)
    policy = make_policy(card)
    save_policy(policy, card, tmp_path)
    loaded, _ = load_policy(tmp_path / "ppo.safetensors")
    observations = np.random.default_rng(0).uniform(-1, 1, (7, 13)).astype(np.float32)
    expected, _ = policy.predict(observations, deterministic=True)
    actual, _ = loaded.predict(observations, deterministic=True)
    np.testing.assert_array_equal(actual, expected)


def test_the_card_of_what_ships_is_complete():
    _, card = load_policy(SHIPPED / "ppo.json")
    assert card.algorithm == "ppo"
    assert card.training_steps == card.learning_curve[-1]["steps"]
    assert card.hyperparameters == read_hyperparameters("ppo", card.env_id)
    assert card.scores["success"] >= 0.9
    assert make_agent("ppo", gym.make("MMCReach-v0")).training_steps == card.training_steps


def test_a_missing_file_is_an_error(copy):
    copy.with_suffix(".safetensors").unlink()
    with pytest.raises(FileNotFoundError):
        load_policy(copy)


def test_damaged_weights_are_an_error(copy):
    weights = bytearray(copy.with_suffix(".safetensors").read_bytes())
    weights[-1] ^= 1
    copy.with_suffix(".safetensors").write_bytes(weights)
    with pytest.raises(ValueError, match="its weights are not those of its card"):
        load_policy(copy)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"activation": "os.system"}, "activation must be one of"),
        ({"hidden_units": [7]}, "size mismatch|Missing key"),
        ({"segment_count": 4}, "size mismatch"),
        ({"extra": 1}, "other entries"),
    ],
)
def test_a_card_that_does_not_fit_is_an_error(copy, changes, message):
    edit(copy, **changes)
    with pytest.raises(ValueError, match=message):
        load_policy(copy)


def test_a_card_that_is_no_json_is_an_error(copy):
    copy.write_text("{")
    with pytest.raises(ValueError, match="does not hold a policy"):
        load_policy(copy)


def test_the_policy_refuses_other_arms_and_other_actions():
    with pytest.raises(ValueError, match="env must have 3 segments for this policy, got 2"):
        make_agent("ppo", gym.make("MMCReach-v0", segment_lengths=(1.0, 1.0)))
    with pytest.raises(ValueError, match=r"control must be .* for this policy, got 'joint_torque'"):
        make_agent("ppo", gym.make("MMCReach-v0", control="joint_torque"))
