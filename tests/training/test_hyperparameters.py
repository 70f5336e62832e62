"""The YAML files describe models that stable-baselines3 can make; mistakes in them are named."""

import inspect
import re
from copy import deepcopy
from importlib.resources import files
from typing import Any

import gymnasium as gym
import pytest
import yaml
from stable_baselines3.common.vec_env import VecNormalize, unwrap_vec_wrapper

from mmc_gym._errors import UserError
from mmc_gym.training.hyperparameters import (
    SETTINGS,
    Rate,
    Recipe,
    Settings,
    names,
    read_recipe,
)
from mmc_gym.training.training import make_vec_env
from mmc_gym.training.vec_env import Residual

POLICIES = "mmc_gym.training.policies"
RESIDUAL = "mmc_gym.training.vec_env.Residual"
HER = "HerReplayBuffer"
SAC: dict[str, Any] = {"algorithm": "sac"}


def read(algorithm: str = "ppo", **changes: Any) -> Any:
    least = {"n_timesteps": 1000, "policy": "MlpPolicy"}
    return Recipe(f"{algorithm}-mine", "MMCReach-v0", {**least, **changes}).settings


@pytest.mark.parametrize("name", names())
def test_every_file_says_what_it_is_and_describes_a_model(name):
    recipe = read_recipe(name)
    before = deepcopy(recipe.hyperparameters)
    settings = recipe.settings
    env = make_vec_env(recipe.env_id, settings.n_envs, settings.env_kwargs)
    model = settings.make_model(env, seed=0)
    assert isinstance(model, SETTINGS[recipe.algorithm].algorithm)
    assert model.n_envs == before["n_envs"]
    assert recipe.hyperparameters == before
    for key in ("gamma", "batch_size", "tau", "gae_lambda", "buffer_size", "train_freq"):
        if key in before:
            found = getattr(model, key)
            assert (found.frequency if key == "train_freq" else found) == before[key]
    text = (files("mmc_gym.training") / "hyperparams" / f"{name}.yml").read_text()
    assert re.match(r"# \w+.*", text)
    assert set(yaml.safe_load(text)) <= set(gym.registry)


def test_unknown_names_and_environments_are_errors():
    with pytest.raises(UserError, match="name 'dqn' is not accepted"):
        read_recipe("dqn")
    with pytest.raises(UserError, match="env for ppo 'Pendulum-v1' is not accepted"):
        read_recipe("ppo", "Pendulum-v1")
    with pytest.raises(UserError, match="name must begin with one of ppo, sac, tqc, got 'dqn'"):
        _ = Recipe("dqn", "MMCReach-v0", {}).settings


def test_your_own_file_is_read_by_its_path(tmp_path):
    path = tmp_path / "ppo-mine.yml"
    path.write_text("A-v0: {gamma: 0.5}\nB-v0: {gamma: 0.6}\n")
    assert read_recipe(str(path)) == Recipe("ppo-mine", "A-v0", {"gamma": 0.5})
    assert read_recipe(str(path), "B-v0").hyperparameters == {"gamma": 0.6}
    assert read_recipe(str(path), steps=9).hyperparameters == {"gamma": 0.5, "n_timesteps": 9}
    assert read_recipe("tqc-her").name == "tqc-her"
    given = read_recipe("ppo", env_kwargs={"control": "joint_velocity"}).settings.env_kwargs
    assert given == {"engine": "analytic", "control": "joint_velocity"}


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"A: {", "must be YAML"),
        (b"\xff\xff", "must be YAML"),
        (b"", "must map environments to hyperparameters, got None"),
        (b"- A", "must map environments to hyperparameters"),
        (b"A: 1", "must have hyperparameters for A, got 1"),
    ],
)
def test_a_file_that_holds_something_else_is_an_error(tmp_path, content, message):
    path = tmp_path / "ppo.yaml"
    path.write_bytes(content)
    with pytest.raises(UserError, match=message):
        read_recipe(str(path))
    with pytest.raises(FileNotFoundError):
        read_recipe("there/is/no/ppo.yml")


@pytest.mark.parametrize("algorithm", SETTINGS)
def test_defaults_are_those_of_the_algorithm(algorithm):
    parameters = inspect.signature(SETTINGS[algorithm].algorithm).parameters
    settings = read(algorithm)
    checked = 0
    for key, parameter in parameters.items():
        if key in type(settings).model_fields and key != "policy":
            found = getattr(settings, key)
            found = found[0] if key == "train_freq" else found
            assert (found.start if isinstance(found, Rate) else found) == parameter.default, key
            checked += 1
    assert checked > 15


def test_what_is_left_out_is_the_algorithms_default():
    settings = read()
    model = settings.make_model(make_vec_env("MMCReach-v0", 1, {}), seed=0)
    assert (settings.n_envs, model.n_steps, model.gamma) == (1, 2048, 0.99)
    assert (settings.vec_env_wrapper, settings.normalize) == ([], None)


@pytest.mark.parametrize(
    ("settings", "steps"),
    [
        (read(), 2048),
        (read(n_envs=4, n_steps=50, n_timesteps=1e5), 4000),
        (read("sac"), 40),
        (read("sac", n_steps=5), 40),  # of returns, not rollouts
        (read("sac", train_freq=[30, "step"]), 60),
        (read("sac", train_freq=[1, "episode"]), 100),
        (read("sac", replay_buffer_class=HER), 100),  # learns from whole episodes
        (read("sac", replay_buffer_class=HER, env_kwargs={"max_episode_steps": 30}), 60),
    ],
)
def test_a_leg_is_of_whole_rollouts(settings: Settings, steps: int):
    assert settings.steps_per_leg(100, 25) == steps


@pytest.mark.parametrize(
    ("key", "one", "other"),
    [
        ("policy_kwargs", {"net_arch": [64, 64]}, "dict(net_arch=[64, 64])"),
        ("policy_kwargs", {"net_arch": {"pi": [8]}}, "dict(net_arch=dict(pi=[8]),)"),
        ("policy_kwargs", {"activation_fn": "tanh"}, "dict(activation_fn=nn.Tanh)"),
        ("normalize", {"norm_obs": False}, "{'norm_obs': False}"),
        ("normalize", {"norm_obs": False}, "dict(norm_obs=False)"),
        ("normalize", None, False),
        ("vec_env_wrapper", RESIDUAL, [RESIDUAL]),
        ("gamma", 0.1, "1e-1"),
        ("batch_size", 100, 1e2),
        ("n_timesteps", 1000, "1e3"),
    ],
)
def test_two_ways_to_write_the_same(key, one, other):
    one, other = (getattr(read(**{key: value}), key) for value in (one, other))
    assert repr(one) == repr(other)  # two partials are never equal


def test_all_that_an_entry_names_is_made():
    settings = read(
        n_envs=2,
        vec_env_wrapper=[{RESIDUAL: {"base_agent": "mmc"}}],
        normalize={"norm_obs": False},
        policy_kwargs="dict(activation_fn=nn.Tanh, net_arch=[8, 9])",
    )
    env = make_vec_env("MMCReach-v0", 2, {"control": "joint_delta"})
    model = settings.make_model(env, seed=0)
    made = model.get_env()
    assert isinstance(made, VecNormalize)
    assert made.gamma == 0.99
    residual = unwrap_vec_wrapper(made, Residual)
    assert residual is not None
    assert residual.base_agent == "mmc"
    layers = re.findall(r"(?<=out_features=)\d+|Tanh", str(model.policy.mlp_extractor.policy_net))
    assert layers == ["8", "Tanh", "9", "Tanh"]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"frame_stack": 4, "env_wrapper": "a"},
            "hyperparameter 'frame_stack' is not accepted",
        ),
        ({"seed": 3}, "hyperparameter 'seed' is not accepted"),
        ({"learning_rat": 1e-3}, "'learning_rat' is not accepted; did you mean 'learning_rate'"),
        ({"policy": "os.system"}, "policy must be one of .*MlpPolicy.*, got 'os.system'"),
        ({"policy": "CnnPolicy"}, "policy must be one of .*, got 'CnnPolicy'"),
        ({"policy": f"{POLICIES}.TQCGoalPolicy"}, "policy must be one of .*PPOTargetPolicy.*, got"),
        ({"callback": ["os.system"]}, "hyperparameter 'callback' is not accepted"),
        ({"vec_env_wrapper": "os.system"}, "vec_env_wrapper must be one of"),
        ({"vec_env_wrapper": [RESIDUAL, "os.system"]}, "vec_env_wrapper must be one of"),
        ({"vec_env_wrapper": [{RESIDUAL: {"base": 1}}]}, "must have arguments that .*Residual"),
        ({"policy_kwargs": "dict(net_arch=os.system('ls'))"}, "policy_kwargs must be a mapping of"),
        ({"policy_kwargs": "__import__('os')"}, "policy_kwargs must be a mapping of literals"),
        ({"policy_kwargs": [64]}, r"policy_kwargs must be a valid dictionary .*, got \[64\]"),
        ({"policy_kwargs": "dict(activation_fn=nn.ELU)"}, "must be 'relu' or 'tanh', got 'elu'"),
        ({"policy_kwargs": {"net_arch": [-5]}}, r"policy_kwargs.net_arch .* 1: .*, got \[-5\]"),
        ({"policy_kwargs": {"net_arch": {"pi": [8.5]}}}, "policy_kwargs.net_arch must be sizes"),
        ({"policy_kwargs": {"log_std_init": "wide"}}, "log_std_init must be a number, got 'wide'"),
        ({"normalize": True}, "normalize must have norm_obs: false, .*got True"),
        ({"normalize": {"norm_obs": False, "mean": 1}}, "normalize.mean is not known"),
        ({"env_kwargs": {"max_episode_steps": None}}, "env_kwargs must have .* max_episode_steps"),
        ({"env_kwargs": {"max_episode_steps": -1}}, "env_kwargs must have a whole number of at le"),
        ({"env_kwargs": "dict(control='joint_delta')"}, "env_kwargs must be a valid dictionary"),
        ({"n_timesteps": 0}, "n_timesteps must be at least 1, got 0"),
        ({"n_timesteps": -5}, "n_timesteps must be at least 1, got -5"),
        ({"n_envs": 0}, "n_envs must be at least 1"),
        ({"n_envs": True}, "n_envs must be a number, got True"),
        ({"n_steps": 1.5}, "n_steps must be .* integer, .*, got 1.5"),
        ({"gamma": "high"}, "gamma must be a number, got 'high'"),
        ({"gamma": 5}, "gamma must be at most 1, got 5"),
        ({"gamma": float("nan")}, "gamma must be a number, got nan"),
        ({"n_timesteps": 10**400}, "n_timesteps must be a number, got 1000"),
        ({"clip_range": -1}, "clip_range must be a number greater than 0, or lin_NUMBER, got -1"),
        ({"learning_rate": "lin_fast"}, "learning_rate must be a number .*, got 'lin_fast'"),
        ({"learning_rate": "cosine"}, "learning_rate must be a number greater than 0, .*'cosine'"),
        ({"use_sde": 1}, "use_sde must be a valid boolean, got 1"),
        ({**SAC, "replay_buffer_class": "Pickle"}, f"replay_buffer_class must be one of {HER}"),
        ({**SAC, "replay_buffer_kwargs": {"goal_selection_strategy": ""}}, "must be 'future', 'fi"),
        ({**SAC, "train_freq": [1, "week"]}, "train_freq must be N"),
        ({**SAC, "train_freq": 0}, "train_freq must be N"),
        ({**SAC, "ent_coef": "auto_x"}, "ent_coef must be .*, or auto_NUMBER, got 'auto_x'"),
        ({**SAC, "target_entropy": "low"}, "target_entropy must be a number, got 'low'"),
    ],
)
def test_a_mistake_is_named_with_the_value_and_what_is_accepted(changes, message):
    with pytest.raises(UserError, match=message):
        read(**changes)


def test_what_must_be_there_is_named():
    with pytest.raises(UserError, match="n_timesteps must be given; policy must be given"):
        _ = Recipe("ppo", "MMCReach-v0", {}).settings


def test_what_only_the_algorithm_can_refuse_is_named():
    with pytest.raises(UserError, match=r"PPO does not take .*net_architecture"):
        read(policy_kwargs={"net_architecture": [8]}).make_model(
            make_vec_env("MMCReach-v0", 1, {}), seed=0
        )


def test_a_rate_is_constant_or_falls_to_zero():
    linear, constant = read(learning_rate="lin_1e-3", clip_range=0.2), Rate(0.2)
    parts = (1.0, 0.5, 0.0)
    assert [linear.learning_rate(part) for part in parts] == [1e-3, 5e-4, 0.0]
    assert linear.clip_range == constant
    assert [constant(part) for part in parts] == [0.2] * 3
