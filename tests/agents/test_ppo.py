"""The model that the YAML file describes, and the plain policy that is kept of it."""

from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from mmc_gym.agents.ppo import make_model, plain_weights, schedule
from mmc_gym.agents.reinforcement import load_policy, make_policy
from mmc_gym.agents.training import read_hyperparameters
from mmc_gym.agents.vec_env import GymnasiumVecEnv

SMALL = {
    **read_hyperparameters("ppo", "MMCReach-v0"),
    "n_envs": 2,
    "n_steps": 32,
    "batch_size": 32,
    "policy_kwargs": {"net_arch": [8, 8], "activation_fn": "tanh"},
}


def environment() -> GymnasiumVecEnv:
    return GymnasiumVecEnv(gym.make_vec("MMCReach-v0", 2, autoreset_mode="SameStep"))


@pytest.mark.parametrize("scales", [None, [1.0] * 11 + [6.0, 0.5]])
def test_the_plain_policy_acts_as_the_one_that_learned_with_scaled_inputs(scales):
    hyperparameters = {name: value for name, value in SMALL.items() if name != "input_scales"}
    if scales is not None:
        hyperparameters["input_scales"] = scales
    model = make_model(hyperparameters, environment(), seed=0)
    model.learn(64)
    folder = Path(str(files("mmc_gym.agents") / "pretrained"))
    card = replace(load_policy(folder / "ppo.json")[1], hidden_units=[8, 8])
    policy = make_policy(card)
    policy.load_state_dict(plain_weights(model))
    observations = np.random.default_rng(0).uniform(-1, 1, (9, 13)).astype(np.float32)
    expected, _ = model.predict(observations, deterministic=True)
    actual, _ = policy.predict(observations, deterministic=True)
    np.testing.assert_allclose(actual, expected, atol=1e-6)


def test_another_number_of_scales_is_an_error():
    with pytest.raises(ValueError, match=r"input_scales must be as many .* \(13,\) has, got 2"):
        make_model({**SMALL, "input_scales": [1.0, 2.0]}, environment(), seed=0)


def test_a_schedule_is_constant_or_falls_to_zero():
    assert [schedule("lin_1e-3")(remaining) for remaining in (1.0, 0.5, 0.0)] == [1e-3, 5e-4, 0.0]
    assert [schedule(0.2)(remaining) for remaining in (1.0, 0.5, 0.0)] == [0.2] * 3
