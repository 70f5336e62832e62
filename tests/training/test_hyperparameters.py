"""The YAML files describe models that stable-baselines3 can make; mistakes in them are named."""

import re
from copy import deepcopy
from importlib.resources import files
from operator import methodcaller

import numpy as np
import pytest
import yaml
from stable_baselines3.common.vec_env import unwrap_vec_wrapper

from mmc_gym import UserError
from mmc_gym.training.hyperparameters import Recipe, names, read_recipe
from mmc_gym.training.training import make_vec_env
from studies.learners.ppo_residual import Residual

RESIDUAL = "studies.learners.ppo_residual.Residual"
HER = "HerReplayBuffer"
OF_PPO = "hyperparameters of ppo-mine must .*"


def recipe_of(algorithm="ppo", **changes):
    least = {"n_timesteps": 1000, "policy": "MlpPolicy"}
    return Recipe(f"{algorithm}-mine", "MMCReach-v0", {**least, **changes})


def make(recipe):
    settings = recipe.settings
    envs = make_vec_env(recipe.env_id, settings["n_envs"], settings["env_kwargs"])
    return recipe.make_model(envs, 0)


@pytest.mark.parametrize("name", names())
def test_every_file_describes_a_model(name):
    recipe = read_recipe(name)
    file = files("mmc_gym.training") / "hyperparams" / f"{name}.yml"
    entry = yaml.safe_load(file.read_text())[recipe.env_id]
    assert entry == recipe.hyperparameters  # none of the keys that rl_zoo3 does not know
    assert not {"perturbations", "memory"} & entry.keys()
    before = deepcopy(recipe.hyperparameters)
    model = make(recipe)
    assert isinstance(model, recipe.algorithm_class)
    assert model.n_envs == before["n_envs"]
    assert recipe.hyperparameters == before
    for key in ("gamma", "batch_size", "tau", "gae_lambda", "buffer_size", "n_epochs"):
        assert getattr(model, key, None) == before.get(key, getattr(model, key, None))
    layers = re.findall(r"(?<=out_features=)\d+", str(model.policy))
    assert ("128" in layers) == ("policy_kwargs" in before)


@pytest.mark.parametrize(
    ("read", "message"),
    [
        (lambda: read_recipe("dqn"), "name 'dqn'"),
        (lambda: read_recipe("ppo", "Pendulum-v1"), "env for ppo 'Pendulum-v1'"),
        (lambda: Recipe("dqn", "MMCReach-v0", {}).settings, "begin with one of ppo, .*'dqn'"),
        (lambda: Recipe("ppo", "MMCReach-v0", {}).settings, "policy must .*; n_timesteps must"),
    ],
)
def test_unknown_names_and_environments_are_errors(read, message):
    with pytest.raises(UserError, match=message):
        read()


def test_your_own_file_is_read_by_its_path(tmp_path):
    path = tmp_path / "ppo-mine.yml"
    path.write_text("A-v0: {gamma: 0.5}\nB-v0: {gamma: 0.6}\n")
    assert read_recipe(str(path)) == Recipe("ppo-mine", "A-v0", {"gamma": 0.5})
    assert read_recipe(str(path), "B-v0").hyperparameters == {"gamma": 0.6}
    assert read_recipe(str(path), steps=9).hyperparameters == {"gamma": 0.5, "n_timesteps": 9}
    assert read_recipe("tqc-her").name == "tqc-her"
    arguments = read_recipe("ppo", env_kwargs={"control": "joint_velocity"}).settings["env_kwargs"]
    assert arguments == {"engine": "analytic", "control": "joint_velocity"}


def test_a_recipe_without_a_group_draws_the_others_with_their_weights():
    drawn = {
        "one_of": ["locked-1..3", None, "rotation-0..30", "locks-1..3"],
        "weights": [1, 2, 3, 4],
    }
    arguments = {"engine": "analytic", "perturbations": ["longer-0..20", drawn]}
    recipe = recipe_of(env_kwargs=arguments)
    without = {group: recipe.without(group) for group in ("locks", "geometry", "cursor")}
    drawn = {key: each.settings["env_kwargs"]["perturbations"] for key, each in without.items()}
    rest = {"one_of": [None, "rotation-0..30"], "weights": [2.0, 3.0]}
    assert drawn["locks"] == ["longer-0..20", rest]
    assert drawn["geometry"] == [arguments["perturbations"][1]]
    assert drawn["cursor"][1]["one_of"] == ["locked-1..3", None, "locks-1..3"]
    assert [each.name for each in without.values()] == [f"ppo-mine-without-{key}" for key in drawn]
    assert recipe.settings["env_kwargs"] == arguments
    for refused, group in (
        (recipe, "motors"),
        (recipe.without("locks").without("cursor"), "geometry"),
    ):
        with pytest.raises(UserError, match="without must be the group of some, but not all"):
            refused.without(group)
    with pytest.raises(UserError, match=r"without 'motor' .* cursor, geometry, loads"):
        recipe.without("motor")


def write(path, perturbations):
    least = {"n_timesteps": 1000, "policy": "MlpPolicy", "env_kwargs": {"engine": "analytic"}}
    entry = {**least, "perturbations": perturbations} if perturbations else least
    path.write_text(yaml.safe_dump({"MMCReach-v0": entry}))
    return str(path)


def drawn_by(source):
    return read_recipe(str(source)).settings["env_kwargs"].get("perturbations")


def test_a_recipe_takes_the_perturbations_of_another(tmp_path):
    (tmp_path / "more").mkdir()
    write(tmp_path / "ppo-a.yml", ["longer-0..20", "locks-2"])
    of_file = write(tmp_path / "more" / "sac-b.yml", "../ppo-a.yml")
    of_that = write(tmp_path / "ppo-c.yml", "more/sac-b.yml")
    assert drawn_by(of_file) == drawn_by(of_that) == ["longer-0..20", "locks-2"]
    of_shipped = write(tmp_path / "ppo-d.yml", "ppo-drawn")
    assert drawn_by(of_shipped) == drawn_by("ppo-drawn")
    assert read_recipe(of_shipped).settings["env_kwargs"]["engine"] == "analytic"
    without = read_recipe(of_that).without("locks")
    assert without.hyperparameters["env_kwargs"]["perturbations"] == ["longer-0..20"]
    replaced = read_recipe(of_that, env_kwargs={"perturbations": ["delay-100"]})
    assert replaced.settings["env_kwargs"]["perturbations"] == ["delay-100"]
    assert drawn_by(write(tmp_path / "ppo-e.yml", "rotation-30")) == "rotation-30"  # no recipe
    for name in ("ppo-kinds", "ppo_lstm-kinds", "tqc-kinds", "crossq-kinds"):
        assert drawn_by(f"studies/learners/{name}.yml") == drawn_by("ppo-drawn")
    stacked, teacher = (
        drawn_by(f"studies/learners/ppo-{name}.yml") for name in ("stacked", "teacher")
    )
    for name in ("ppo_lstm-drawn", "sac-stacked"):
        assert drawn_by(f"studies/learners/{name}.yml") == stacked
    for plain, with_locks in ((stacked, teacher), (drawn_by("ppo-drawn"), drawn_by("ppo-context"))):
        assert plain[0]["one_of"] == with_locks[0]["one_of"]  # which draws locks more often


def test_perturbations_of_a_recipe_that_has_none_are_errors(tmp_path):
    circle = "must stand in one of these files, got a circle: ppo-a, ppo-b, ppo-a"
    write(tmp_path / "ppo-b.yml", "ppo-a.yml")
    for value, message in {
        "ppo-drwn": "perturbations of ppo-a 'ppo-drwn' is not accepted; did you mean 'ppo-drawn'",
        "ppo": "perturbations of ppo-a must be those of a recipe that has some, got 'ppo'",
        "ppo-b.yml": f"perturbations {circle}",
        "ppo-a.yml": "got a circle: ppo-a, ppo-a",
    }.items():
        with pytest.raises(UserError, match=message):
            read_recipe(write(tmp_path / "ppo-a.yml", value))
    with pytest.raises(FileNotFoundError, match=r"none\.yml"):
        read_recipe(write(tmp_path / "ppo-a.yml", "none.yml"))


def test_a_file_that_holds_something_else_is_an_error(tmp_path):
    path = tmp_path / "ppo.yaml"
    for content, message in {
        b"A: {": "must be YAML",
        b"A: {gamma: 0.5, gamma: 0.6}": "must be YAML: the key 'gamma' occurs twice",
        b"\xff\xff": "must be YAML",
        b"": "must map environments to entries",
        b"{}": "must map environments to entries",
        b"A: 1": "A must be a valid dictionary, got 1",
    }.items():
        path.write_bytes(content)
        with pytest.raises(UserError, match=message):
            read_recipe(str(path))
    with pytest.raises(FileNotFoundError):
        read_recipe("there/is/no/ppo.yml")


@pytest.mark.parametrize(
    ("recipe", "steps"),
    [
        (recipe_of(), 2048),
        (recipe_of(n_envs=4, n_steps=50, n_timesteps=1e5), 4000),
        (recipe_of("sac", n_steps=5), 40),  # of returns, not rollouts
        (recipe_of("sac", train_freq=[30, "step"]), 60),
        (recipe_of("sac", train_freq=[1, "episode"]), 100),
        # It learns from whole episodes.
        (recipe_of("sac", replay_buffer_class=HER, env_kwargs={"max_episode_steps": 30}), 60),
    ],
)
def test_a_leg_is_of_whole_rollouts(recipe, steps):
    assert recipe.steps_per_leg(25) == steps


@pytest.mark.parametrize(
    ("key", "short", "long"),
    [
        ("policy_kwargs", {"net_arch": [64, 64]}, "dict(net_arch=[64, 64])"),
        ("policy_kwargs", {"net_arch": {"pi": [8]}}, "dict(net_arch=dict(pi=[8]),)"),
        ("policy_kwargs", {"activation_fn": "tanh"}, "dict(activation_fn=nn.Tanh)"),
        ("vec_env_wrapper", RESIDUAL, [RESIDUAL]),
        ("normalize", True, {}),
        ("normalize", {"norm_obs": True}, "{'norm_obs': True}"),
        ("normalize", {"norm_reward": False}, "dict(norm_reward=False)"),
        ("normalize", False, None),
        ("gamma", 0.1, "1e-1"),
        ("batch_size", 100, 1e2),
        ("n_timesteps", 1000, "1e3"),
    ],
)
def test_two_ways_to_write_the_same(key, short, long):
    short, long = (recipe_of(**{key: value}).settings[key] for value in (short, long))
    assert repr(short) == repr(long)  # two partials are never equal


def test_all_that_an_entry_names_is_made():
    network = "dict(activation_fn=nn.Tanh, net_arch=[8, 9])"
    changes = {"policy_kwargs": network, "learning_rate": "lin_1e-3", "clip_range": 0.2}
    changes["vec_env_wrapper"] = [{RESIDUAL: {"base_agent": "mmc"}}]
    model = make(recipe_of(n_envs=2, **changes))
    assert unwrap_vec_wrapper(model.get_env(), Residual).base_agent == "mmc"
    layers = re.findall(r"(?<=out_features=)\d+|Tanh", str(model.policy.mlp_extractor.policy_net))
    assert layers == ["8", "Tanh", "9", "Tanh"]
    np.testing.assert_allclose([model.lr_schedule(part) for part in (1, 0.5, 0)], [1e-3, 5e-4, 0])
    assert model.clip_range(1.0) == model.clip_range(0.0) == 0.2


@pytest.mark.parametrize(
    ("algorithm", "key", "value", "message"),
    [
        ("ppo", "learning_rat", 1e-3, "'learning_rate'"),
        ("ppo", "policy", "mmc_gym.training.policies.TQCGoalPolicy", "policy must be MlpPolicy"),
        ("ppo", "rollout_buffer_class", "os.system", "got 'os.system'"),
        ("ppo", "vec_env_wrapper", [RESIDUAL, "os.system"], "got 'os.system'"),
        ("ppo", "vec_env_wrapper", {RESIDUAL: 3}, "got 3"),
        ("ppo", "policy_kwargs", "dict(net_arch=os.system('ls'))", "policy_kwargs must be"),
        ("ppo", "policy_kwargs", "ls()", "policy_kwargs must be a mapping"),
        ("ppo", "policy_kwargs", {"activation_fn": "nn.ELU"}, "relu or tanh as activation_fn"),
        ("ppo", "env_kwargs", "control", "env_kwargs must be a valid dictionary"),
        ("ppo", "n_timesteps", 0, "n_timesteps must be at least 1"),
        # A leg that would never end.
        ("ppo", "env_kwargs", {"max_episode_steps": None}, "max_episode_steps must be"),
        ("ppo", "n_steps", 0, "n_steps must be at least 1"),
        ("ppo", "normalize", "os.system('ls')", "normalize must be a mapping"),
        ("ppo", "noise_type", "white", "noise_type must be 'normal' or"),
        ("sac", "replay_buffer_class", "Pickle", "got 'Pickle'"),
        ("sac", "train_freq", 0, "train_freq.* must be .*, got 0"),
        # What only the constructor can refuse is said in its words.
        ("ppo", "policy_kwargs", {"net_architecture": [8]}, f"{OF_PPO}net_architecture'"),
        ("ppo", "batch_size", 1, f"{OF_PPO}AssertionError: `batch_size`"),
        ("ppo", "vec_env_wrapper", [{RESIDUAL: {"base": 1}}], f"{OF_PPO}unexpected .* 'base'"),
        ("sac", "ent_coef", "auto_x", "hyperparameters of sac-mine must .*ValueError: .*'x'"),
    ],
)
def test_a_mistake_is_named_with_the_value_and_what_is_accepted(algorithm, key, value, message):
    mistaken = recipe_of(algorithm, **{key: value})
    act = make if message.startswith("hyperparameters of") else methodcaller("steps_per_leg", 25)
    with pytest.raises(UserError, match=message):
        act(mistaken)
