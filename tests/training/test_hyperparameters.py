"""The YAML files describe models that stable-baselines3 can make."""

import re
from importlib.resources import files
from typing import Any

import gymnasium as gym
import pytest
import yaml
from stable_baselines3 import PPO

from mmc_gym.training.hyperparameters import (
    ALGORITHMS,
    EntropyDecay,
    Settings,
    algorithm_of,
    names,
    policy_name,
    read_hyperparameters,
)
from mmc_gym.training.training import make_vec_env


def make(name: str, **changes: Any) -> Any:
    env_id, hyperparameters = read_hyperparameters(name)
    h = {**hyperparameters, **changes}
    env = make_vec_env(env_id, h["n_envs"], h.get("env_kwargs", {}))
    return Settings.read(algorithm_of(name), h).make_model(env, seed=0)


@pytest.mark.parametrize("name", names())
def test_every_file_describes_a_model(name):
    model = make(name)
    assert type(model) is ALGORITHMS[algorithm_of(name)]
    assert model.n_envs == read_hyperparameters(name)[1]["n_envs"]


@pytest.mark.parametrize("name", names())
def test_every_file_says_what_it_is(name):
    text = (files("mmc_gym.training") / "hyperparams" / f"{name}.yml").read_text()
    assert re.match(r"# \w+.*", text)
    for env_id in yaml.safe_load(text):
        assert env_id in gym.registry


def test_unknown_names_and_environments_are_errors():
    with pytest.raises(ValueError, match=r"name must be one of ppo, .*, got 'dqn'"):
        read_hyperparameters("dqn")
    with pytest.raises(ValueError, match="env must be one of MMCReach-v0 for ppo, got 'Pen"):
        read_hyperparameters("ppo", "Pendulum-v1")


def test_a_file_of_ones_own_is_read_by_its_path(tmp_path):
    path = tmp_path / "ppo-mine.yml"
    path.write_text("A-v0: {gamma: 0.5}\nB-v0: {gamma: 0.6}\n")
    assert read_hyperparameters(str(path)) == ("A-v0", {"gamma": 0.5})
    assert read_hyperparameters(str(path), "B-v0") == ("B-v0", {"gamma": 0.6})
    assert policy_name(str(path)) == "ppo-mine"
    assert policy_name("tqc-her") == "tqc-her"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("A: {", "must be YAML"),
        ("", "must map environments to hyperparameters, got None"),
        ("- A", "must map environments to hyperparameters"),
        ("A: 1", "must have hyperparameters for A, got 1"),
    ],
)
def test_a_file_that_holds_something_else_is_an_error(tmp_path, text, message):
    path = tmp_path / "ppo.yaml"
    path.write_text(text)
    with pytest.raises(ValueError, match=message):
        read_hyperparameters(str(path))
    with pytest.raises(FileNotFoundError):
        read_hyperparameters("there/is/no/ppo.yml")


def test_the_entropy_bonus_falls_to_zero():
    env = make_vec_env("MMCReach-v0", 2, {})
    model = PPO("MlpPolicy", env, n_steps=8, batch_size=16, ent_coef=0.5, device="cpu")
    seen = []

    class Watch(EntropyDecay):
        def _on_rollout_start(self) -> None:
            super()._on_rollout_start()
            seen.append(self.model.ent_coef)  # type: ignore[attr-defined]

    model.learn(64, callback=Watch())
    assert seen == pytest.approx([0.5, 0.375, 0.25, 0.125])
