"""Who takes part: what names stand for, and which are refused."""

from __future__ import annotations

import shutil

import gymnasium as gym
import numpy as np
import pytest

import mmc_gym
from mmc_gym._errors import UserError
from mmc_gym.agents.policy import PRETRAINED
from mmc_gym.benchmark import entries
from mmc_gym.benchmark.entries import (
    default_agents,
    find_entries,
    training_steps,
)


def read(*names):
    return [(one.label, one.training_seed, one.source) for one in find_entries(names)]


def test_a_policy_of_ones_own_takes_part_by_its_path(tmp_path):
    name = next(iter(sorted(PRETRAINED.glob("ppo-[0-9].json")))).stem
    folder = tmp_path / "lr=0.001"
    folder.mkdir()
    for suffix in (".json", ".safetensors"):
        shutil.copy(PRETRAINED / f"{name}{suffix}", folder / f"mine{suffix}")
    path, seed = f"{folder}/mine.json", int(name[-1])
    assert read(path, f"x={path}", f"x@2={path}") == [
        ("mine", seed, path),
        ("x", seed, path),
        ("x", 2, path),
    ]
    own, shipped = find_entries([path, name])
    assert own.fingerprint == shipped.fingerprint
    for missing in (f"{folder}/other.json", f"x={folder}/other.json"):
        with pytest.raises(FileNotFoundError, match="other"):
            find_entries([missing])


def test_names_of_trained_agents_stand_for_their_training_seeds(monkeypatch):
    monkeypatch.setattr(entries, "shipped_seeds", lambda name: [0, 2])
    kind = next(name for name, entry in mmc_gym.agents.AGENTS.items() if entry.training_seeds)
    assert read(kind, f"other={kind}", "x@5=os:getcwd", "mmc", f"y={kind}-1") == [
        (kind, 0, f"{kind}-0"),
        (kind, 2, f"{kind}-2"),
        ("other", 0, f"{kind}-0"),
        ("other", 2, f"{kind}-2"),
        ("x", 5, "os:getcwd"),
        ("mmc", None, "mmc"),
        ("y", 1, f"{kind}-1"),
    ]
    monkeypatch.setattr(entries, "shipped_seeds", lambda name: [])
    with pytest.raises(UserError, match="has not been trained"):
        find_entries([kind])
    assert kind not in default_agents()
    assert "mmc" in default_agents()


def test_objects_and_factories_take_part_under_their_own_names(oracle, frozen):
    def thaw(env):
        return frozen

    env = gym.make("MMCReach-v0")
    made = {
        one.label: one.agent
        for one in find_entries([oracle, thaw, "random", "x=mmc"], every_training=False)
    }
    assert list(made) == ["Oracle", "thaw", "random", "x"]
    assert (made["Oracle"].factory(env), made["thaw"].factory(env)) == (oracle, frozen)


def test_training_steps_are_ours_or_those_of_stable_baselines3_or_unknown(oracle):
    class Ours:
        training_steps = 3

    class Theirs:
        num_timesteps = np.int64(4)

    assert [training_steps(agent) for agent in (Ours(), Theirs(), oracle)] == [3, 4, None]


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["nobody"], "agent 'nobody' is not accepted"),
        ([], "agents must be one or more"),
        (["mmc", "mmc"], "agents must have different names, got mmc repeatedly"),
        (["=mmc"], "agents must have names"),
        (["x@y=os:getcwd"], "agents must be named as LABEL or LABEL@SEED"),
        (["x@99999999999=os:getcwd"], "training seeds must be at most 4294967295, got 'x@9"),
        (["x@1=ppo"], "must name one training, such as ppo-0"),
        (["no_such_module:make"], "cannot be imported"),
    ],
)
def test_wrong_names_are_refused(names, message):
    with pytest.raises(UserError, match=message):
        find_entries(names)
