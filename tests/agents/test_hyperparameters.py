"""The YAML files describe models that stable-baselines3 can make."""

import re
from importlib.resources import files
from typing import Any

import gymnasium as gym
import pytest
import yaml
from stable_baselines3 import PPO

from mmc_gym.agents.hyperparameters import (
    ALGORITHMS,
    EntropyDecay,
    algorithm_of,
    make_callbacks,
    make_model,
    names,
    read_hyperparameters,
    schedule,
)
from mmc_gym.agents.training import make_vec_env


def make(name: str, **changes: Any) -> Any:
    env_id, hyperparameters = read_hyperparameters(name)
    h = {**hyperparameters, **changes}
    env = make_vec_env(env_id, h["n_envs"], h.get("env_kwargs", {}))
    return make_model(algorithm_of(name), h, env, seed=0)


@pytest.mark.parametrize("name", names())
def test_every_file_describes_a_model(name):
    model = make(name)
    assert type(model) is ALGORITHMS[algorithm_of(name)]
    assert model.n_envs == read_hyperparameters(name)[1]["n_envs"]


@pytest.mark.parametrize("name", names())
def test_every_file_says_what_it_is(name):
    text = (files("mmc_gym.agents") / "hyperparams" / f"{name}.yml").read_text()
    assert re.match(r"# \w+.*", text)
    for env_id in yaml.safe_load(text):
        assert env_id in gym.registry


def test_unknown_names_and_environments_are_errors():
    with pytest.raises(ValueError, match=r"name must be one of ppo, .*, got 'dqn'"):
        read_hyperparameters("dqn")
    with pytest.raises(ValueError, match="env must be one of MMCReach-v0 for ppo, got 'Pen"):
        read_hyperparameters("ppo", "Pendulum-v1")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"policy": "os.system"}, "policy must be one of"),
        ({"callback": ["os.system"]}, "callback must be one of"),
        ({"vec_env_wrapper": "os.system"}, "vec_env_wrapper must be one of"),
        ({"replay_buffer_class": "Pickle"}, "replay_buffer_class must be one of"),
    ],
)
def test_only_what_is_known_here_can_be_named(changes, message):
    with pytest.raises(ValueError, match=message):
        make("ppo", **changes)
        make_callbacks(changes)


def test_a_schedule_is_constant_or_falls_to_zero():
    assert [schedule("lin_1e-3")(remaining) for remaining in (1.0, 0.5, 0.0)] == [1e-3, 5e-4, 0.0]
    assert [schedule(0.2)(remaining) for remaining in (1.0, 0.5, 0.0)] == [0.2] * 3


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
