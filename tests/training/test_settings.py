"""rl_zoo3's forms of hyperparameters all mean what they mean there, or are refused by name."""

from copy import deepcopy
from typing import Any

import pytest
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.vec_env import VecNormalize

from mmc_gym.training.hyperparameters import (
    EntropyDecay,
    Settings,
    names,
    read_hyperparameters,
    schedule,
)
from mmc_gym.training.training import make_vec_env
from mmc_gym.training.vec_env import Residual

POLICIES = "mmc_gym.training.policies"
LEAST = {"n_timesteps": 1000, "policy": f"{POLICIES}.PPOPolicy"}
RESIDUAL = "mmc_gym.training.vec_env.Residual"
DECAY = "mmc_gym.training.hyperparameters.EntropyDecay"


def read(algorithm: str = "ppo", **changes: Any) -> Settings:
    return Settings.read(algorithm, {**LEAST, **changes})


@pytest.mark.parametrize("name", names())
def test_reading_leaves_hyperparameters_as_they_are(name):
    _, hyperparameters = read_hyperparameters(name)
    before = deepcopy(hyperparameters)
    Settings.read(name.partition("-")[0], hyperparameters)
    assert hyperparameters == before


def test_what_is_left_out_is_the_algorithms_default():
    settings = read()
    model = settings.make_model(make_vec_env("MMCReach-v0", 1, {}), seed=0)
    assert isinstance(model, PPO)
    assert (settings.env_count, model.n_steps, model.gamma) == (1, 2048, 0.99)
    assert settings.wrapper is None
    assert settings.normalize is None
    assert settings.make_callbacks() == []


def test_a_leg_is_of_whole_rollouts():
    assert read().steps_per_leg(100, 25) == 2048
    assert read(n_envs=4, n_steps=50, n_timesteps=1e5).steps_per_leg(100, 25) == 4000
    sac = {"policy": f"{POLICIES}.SACPolicy"}
    assert read("sac", **sac).steps_per_leg(100, 25) == 40
    assert read("sac", **sac, n_steps=5).steps_per_leg(100, 25) == 40  # of returns, not rollouts
    assert read("sac", **sac, train_freq=[30, "step"]).steps_per_leg(100, 25) == 60
    assert read("sac", **sac, train_freq=[1, "episode"]).steps_per_leg(100, 25) == 100


@pytest.mark.parametrize(
    ("key", "one", "other"),
    [
        ("policy_kwargs", {"net_arch": [64, 64]}, "dict(net_arch=[64, 64])"),
        ("policy_kwargs", {"net_arch": {"pi": [8]}}, "dict(net_arch=dict(pi=[8]))"),
        ("policy_kwargs", {"activation_fn": "tanh"}, "dict(activation_fn=nn.Tanh)"),
        ("normalize", {"norm_obs": False}, "{'norm_obs': False}"),
        ("normalize", {"norm_obs": False}, "dict(norm_obs=False)"),
        ("normalize", None, False),
        ("env_kwargs", {"control": "joint_delta"}, "dict(control='joint_delta')"),
        ("callback", [DECAY], DECAY),
        ("callback", [DECAY], {DECAY: {}}),
        ("callback", [DECAY], [{DECAY: None}]),
        ("vec_env_wrapper", RESIDUAL, [RESIDUAL]),
        ("vec_env_wrapper", [{RESIDUAL: {"base_agent": "mmc"}}], {RESIDUAL: {"base_agent": "mmc"}}),
        ("gamma", 0.1, "1e-1"),
        ("batch_size", 100, 1e2),
        ("n_timesteps", 1000, "1e3"),
    ],
)
def test_two_ways_to_write_the_same(key, one, other):
    assert read(**{key: one}) == read(**{key: other})


def test_what_a_list_of_mappings_names_is_made():
    settings = read(
        n_envs=2, vec_env_wrapper=[{RESIDUAL: {"base_agent": "mmc"}}], normalize={"norm_obs": False}
    )
    env = make_vec_env("MMCReach-v0", 2, {"control": "joint_delta"})
    made = settings.make_model(env, seed=0).get_env()
    assert isinstance(made, VecNormalize)
    assert made.gamma == 0.99
    assert isinstance(made.venv, Residual)
    assert made.venv.base_agent == "mmc"
    assert [type(each) for each in read(callback=DECAY).make_callbacks()] == [EntropyDecay]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"frame_stack": 4, "env_wrapper": "a.B"},
            "must be among .*, got frame_stack, env_wrapper",
        ),
        ({"seed": 3}, "got seed"),
        ({"policy": "os.system"}, "policy must be one of .*PPOPolicy.*, got 'os.system'"),
        ({"policy": "MlpPolicy"}, "policy must be one of .*, got 'MlpPolicy'"),
        ({"policy": f"{POLICIES}.SACPolicy"}, "policy must be one of .*PPOPolicy.*, got"),
        ({"callback": ["os.system"]}, "callback must be one of"),
        ({"callback": [3]}, "callback must be a name, or a mapping of one name"),
        ({"callback": {DECAY: {"start": 1}}}, "callback .*EntropyDecay does not take"),
        ({"vec_env_wrapper": "os.system"}, "vec_env_wrapper must be one of"),
        ({"vec_env_wrapper": [RESIDUAL, RESIDUAL]}, "vec_env_wrapper must be one at most"),
        ({"vec_env_wrapper": {RESIDUAL: {"base": 1}}}, "Residual does not take"),
        ({"policy_kwargs": "dict(net_arch=os.system('ls'))"}, "policy_kwargs must be a mapping of"),
        ({"policy_kwargs": "__import__('os')"}, "policy_kwargs must be a mapping of literals"),
        ({"policy_kwargs": [64]}, r"policy_kwargs must be a mapping, got \[64\]"),
        (
            {"policy_kwargs": "dict(activation_fn=nn.ELU)"},
            "activation_fn must be one of relu, tanh",
        ),
        ({"normalize": True}, "normalize must have norm_obs: false, .*got True"),
        ({"normalize": {"norm_obs": False, "mean": 1}}, "normalize must have keys among .*, got m"),
        ({"n_timesteps": 0}, "n_timesteps must be at least 1, got 0"),
        ({"n_timesteps": -5}, "n_timesteps must be at least 1, got -5"),
        ({"n_envs": 0}, "n_envs must be at least 1"),
        ({"n_steps": 1.5}, "n_steps must be a whole number, got 1.5"),
        ({"gamma": "high"}, "gamma must be a number, got 'high'"),
        ({"learning_rate": "lin_fast"}, "learning_rate must be a number"),
        ({"learning_rate": "cosine"}, "learning_rate must be a number, got 'cosine'"),
        ({"use_sde": 1}, "use_sde must be true or false, got 1"),
    ],
)
def test_a_mistake_is_named(changes, message):
    with pytest.raises(ValueError, match=message):
        read(**changes)


def test_only_known_replay_buffers_and_frequencies():
    sac = {"policy": f"{POLICIES}.SACPolicy"}
    with pytest.raises(ValueError, match="replay_buffer_class must be one of HerReplayBuffer"):
        read("sac", **sac, replay_buffer_class="Pickle")
    with pytest.raises(ValueError, match="train_freq must be N"):
        read("sac", **sac, train_freq=[1, "week"])
    with pytest.raises(
        ValueError, match="ent_coef must be a number, or auto_NUMBER, got 'auto_some'"
    ):
        read("sac", **sac, ent_coef="auto_some")
    assert read("sac", **sac, ent_coef="auto_0.1", train_freq=[1, "step"]).algorithm is SAC


@pytest.mark.parametrize("key", ["n_timesteps", "policy"])
def test_what_must_be_there_is_named(key):
    with pytest.raises(ValueError, match=f"hyperparameters must have {key}"):
        Settings.read("ppo", {name: value for name, value in LEAST.items() if name != key})


def test_what_only_the_algorithm_can_refuse_is_named():
    with pytest.raises(ValueError, match=r"PPO does not take .*net_architecture"):
        read(policy_kwargs={"net_architecture": [8]}).make_model(
            make_vec_env("MMCReach-v0", 1, {}), seed=0
        )


def test_a_schedule_is_constant_or_falls_to_zero():
    assert [schedule("lin_1e-3")(remaining) for remaining in (1.0, 0.5, 0.0)] == [1e-3, 5e-4, 0.0]
    assert [schedule(0.2)(remaining) for remaining in (1.0, 0.5, 0.0)] == [0.2] * 3
