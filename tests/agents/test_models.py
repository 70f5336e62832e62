"""Models of stable-baselines3 as agents: as they were trained, or with a word about it."""

import importlib
import pickle
import shutil
import warnings
import zipfile
from copy import deepcopy

import cloudpickle
import gymnasium as gym
import numpy as np
import pandas as pd
import pytest
from gymnasium import wrappers
from sb3_contrib import ARS, TQC, TRPO, CrossQ, RecurrentPPO
from stable_baselines3 import A2C, DDPG, PPO, SAC, TD3, HerReplayBuffer
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import VecFrameStack, VecNormalize

from mmc_gym import MismatchWarning, UserError, make_agent
from mmc_gym.agents import resolve, resolve_all
from mmc_gym.benchmark.compare import compare
from mmc_gym.benchmark.runner import benchmark
from mmc_gym.benchmark.store import kept_cells
from mmc_gym.benchmark.suite import make_player
from mmc_gym.envs.scenarios import parse_scenario
from mmc_gym.experiments.experiment import Block, Experiment
from mmc_gym.experiments.trials import run_experiment
from mmc_gym.interface import CannotActError, ControlError
from mmc_gym.training.vec_env import GymnasiumVecEnv, Memory, MemoryObservation

CONTROL = "joint_velocity"
TWICE = np.float32([-2.0, 2.0])
TWO_TRIALS = Experiment(name="two", blocks=(Block("baseline", 2),))
TINY = {"n_steps": 8, "batch_size": 8, "n_epochs": 1, "policy_kwargs": {"net_arch": [4]}}


def vec_env(**env_kwargs):
    return make_vec_env("MMCReach-v0", 1, env_kwargs={"control": CONTROL, **env_kwargs})


def trained(seed=0, wrap=lambda env: env, **env_kwargs):
    env = wrap(vec_env(**env_kwargs))
    return PPO("MlpPolicy", env, seed=seed, device="cpu", **TINY).learn(8)


def load(source, env, **options):
    return make_agent(source, env, allow_pickle=True, **options)


def assert_acts_as(model, agent, env):
    """The agent normalizes observations where, and only where, the model was trained on such."""
    observation, _ = env.reset(seed=3)
    normalizer = model.get_vec_normalize_env()
    for batch in (observation, np.stack([observation, observation])):
        plain, _ = model.predict(batch, deterministic=True)
        expected = plain
        if normalizer and normalizer.norm_obs:
            expected, _ = model.predict(normalizer.normalize_obs(batch), deterministic=True)
            assert not np.array_equal(plain, expected)
        np.testing.assert_array_equal(agent.predict(batch, deterministic=True)[0], expected)


@pytest.fixture(scope="module")
def model():
    return trained(seed=5, wrap=VecNormalize)


@pytest.fixture
def folder(tmp_path, model):
    """A model and the statistics of its `VecNormalize`, as stable-baselines3's pages save them."""
    model.save(tmp_path / "model")
    model.get_env().save(str(tmp_path / "vec_normalize.pkl"))
    return tmp_path


@pytest.fixture
def env():
    return gym.make("MMCReach-v0", control=CONTROL)


def test_a_model_that_is_trained_further_acts_with_its_present_statistics(env):
    """Old statistics with new weights are another policy."""
    model = trained(wrap=VecNormalize)
    agent = make_agent(model, env)
    model.learn(40, reset_num_timesteps=False)
    assert_acts_as(model, agent, env)
    assert resolve(model).fingerprint == resolve(agent).fingerprint


def test_an_own_part_of_a_model_belongs_to_it_with_its_module(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    code = "from stable_baselines3.common.torch_layers import FlattenExtractor\n"
    code += "class Own(FlattenExtractor): pass\n"
    (tmp_path / "own_extractor.py").write_text(code)
    extractor = importlib.import_module("own_extractor").Own
    policy = {"net_arch": [4], "features_extractor_class": extractor}
    model = PPO("MlpPolicy", "MMCReach-v0", device="cpu", **{**TINY, "policy_kwargs": policy})
    model.save(tmp_path / "saved")

    def fingerprints():
        saved = resolve(tmp_path / "saved.zip", allow_pickle=True)
        return [resolve(model).fingerprint, saved.fingerprint]

    before = fingerprints()
    assert fingerprints() == before
    (tmp_path / "own_extractor.py").write_text(f"{code}# changed")
    assert all(now != then for now, then in zip(fingerprints(), before))


@pytest.mark.parametrize("source", ["model", "model.zip", "folder"])
def test_a_model_acts_on_observations_normalized_as_in_training(model, folder, env, source):
    source = {"model": model, "model.zip": folder / "model.zip", "folder": folder}[source]
    agent = load(source, env)
    assert_acts_as(model, agent, env)
    assert agent.training_steps == resolve(source, allow_pickle=True).training_steps == 8


@pytest.mark.parametrize("form", ["file", "object", "by label"])
def test_a_model_that_was_loaded_is_given_its_statistics_or_refused(model, folder, env, form):
    file = folder / "vec_normalize.pkl"
    forms = {"file": file, "object": model.get_env(), "by label": {"PPO": str(file)}}
    alone = folder / "alone" / "model.zip"
    alone.parent.mkdir()
    shutil.copy(folder / "model.zip", alone)
    for source in (PPO.load(folder / "model", device="cpu"), alone):
        with pytest.raises(UserError, match=r"must have the statistics .* say --statistics FILE"):
            load(source, env)
        if form != "by label" or source is not alone:
            assert_acts_as(model, load(source, env, statistics=forms[form]), env)
            (agent,) = resolve_all([source], statistics=forms[form], allow_pickle=True)
            assert agent.fingerprint == resolve(model).fingerprint
            assert agent.training_seed == (5 if source is alone else None)


def test_a_model_with_statistics_of_a_file_is_sent_to_other_processes(model, folder, env):
    loaded, file = PPO.load(folder / "model", device="cpu"), folder / "vec_normalize.pkl"
    (agent,) = resolve_all([loaded], statistics=file, allow_pickle=True)
    sent = pickle.loads(cloudpickle.dumps(agent))
    assert_acts_as(model, sent.factory(env), env)


def test_a_model_that_was_loaded_into_its_normalization_needs_no_more(model, folder, env):
    plain = vec_env()
    with pytest.raises(UserError, match="must have the statistics of the VecNormalize"):
        load(PPO.load(folder / "model", env=plain, device="cpu"), env)
    normalized = VecNormalize.load(str(folder / "vec_normalize.pkl"), plain)
    assert_acts_as(model, load(PPO.load(folder / "model", normalized, device="cpu"), env), env)


OFF_POLICY = {"policy_kwargs": {"net_arch": [4]}, "buffer_size": 50, "learning_starts": 10}


@pytest.mark.parametrize("normalizes_rewards", [False, True])
@pytest.mark.parametrize(("kind", "steps"), [(PPO, 8), (SAC, 0), (SAC, 12)])
def test_a_model_that_observed_what_there_is_needs_no_statistics(
    kind, steps, normalizes_rewards, tmp_path, env
):
    envs = VecNormalize(vec_env(), norm_obs=False) if normalizes_rewards else vec_env()
    model = kind("MlpPolicy", envs, device="cpu", **(TINY if kind is PPO else deepcopy(OFF_POLICY)))
    model = model.learn(steps) if steps else model
    model.save(tmp_path / "model")
    assert_acts_as(model, load(tmp_path / "model.zip", env), env)
    if normalizes_rewards or kind is PPO:
        assert_acts_as(model, load(kind.load(tmp_path / "model", device="cpu"), env), env)


def test_a_file_of_pickles_is_loaded_only_if_the_user_says_so(folder, monkeypatch):
    monkeypatch.setattr("pickle.loads", None)
    monkeypatch.setattr("cloudpickle.loads", None)
    for source in (f"{folder}/model.zip", str(folder)):
        with pytest.raises(UserError, match=r"holds pickles.*--allow-pickle.*allow_pickle=True"):
            compare([source], episodes=1)


def test_a_model_acts_in_the_control_mode_of_its_training_alone(model):
    other = gym.make("MMCReach-v0", control="joint_torque")
    with pytest.raises(ControlError, match=f"control must be '{CONTROL}' .* got 'joint_torq"):
        make_agent(model, other)
    comparison = compare({"object": model, "mmc": "mmc"}, episodes=1)
    assert comparison.controls == {"object": CONTROL, "mmc": "joint_delta"}


def test_a_model_of_unknown_control_mode_acts_by_the_default_with_a_warning(folder, tmp_path):
    bare = f"{folder}/model.zip"
    default = "does not declare the control mode .* acts by joint_delta, the environment's default"

    def control_of(source, **arguments):
        comparison = compare({"mine": source}, episodes=1, allow_pickle=True, **arguments)
        return comparison.controls["mine"]

    trained().save(tmp_path / "plain")
    for source in (bare, lambda env: PPO.load(tmp_path / "plain", device="cpu")):
        with pytest.warns(MismatchWarning, match=f"mine {default}"):
            assert control_of(source) == "joint_delta"
        assert control_of(source, env_kwargs={"control": CONTROL}) == CONTROL
    with pytest.warns(MismatchWarning, match=default):
        benchmark([bare], tmp_path / "store", ["random"], 1, jobs=1, allow_pickle=True)
    (cell,) = kept_cells(tmp_path / "store").values()
    assert cell.facts["control"] == "joint_delta"


@pytest.mark.parametrize("steps", ["", "_1000_steps"])
def test_of_several_files_of_statistics_a_model_takes_its_own(folder, steps):
    model = (folder / "model.zip").rename(folder / f"mine{steps}.zip")
    statistics = folder / f"mine_vecnormalize{steps}.pkl"
    for copy in (statistics, folder / "other_vecnormalize_2000_steps.pkl"):
        shutil.copy(folder / "vec_normalize.pkl", copy)
    assert resolve(model).model.statistics == statistics
    statistics.unlink()
    with pytest.raises(UserError, match="must have one file of VecNormalize in its folder"):
        _ = resolve(model).model.statistics


def test_the_folder_of_rl_zoo3_has_its_statistics_inside(folder, model, env):
    """Beside its settings, in a folder named after the environment."""
    inside = folder / "MMCReach-v0"
    inside.mkdir()
    (folder / "vec_normalize.pkl").rename(inside / "vecnormalize.pkl")
    with pytest.raises(UserError, match="must have the statistics"):  # of anybody
        load(folder, env)
    (inside / "config.yml").write_text("normalize: true")
    assert_acts_as(model, load(folder, env), env)


@pytest.mark.parametrize("name", ["model", "lr_0.001"])
def test_a_model_is_found_by_the_name_it_was_saved_by(name, tmp_path, monkeypatch):
    """stable-baselines3 adds .zip to a name without a dot."""
    monkeypatch.chdir(tmp_path)
    trained().save(name)
    assert resolve(name).training_steps == 8
    assert resolve(f"./{name}").label == name


def test_other_observations_or_actions_than_in_training_are_refused_and_another_arm_is_not(env):
    behind = trained()
    behind.get_env().envs[0] = wrappers.RescaleAction(behind.get_env().envs[0], *TWICE)
    goals = SAC(
        "MultiInputPolicy", gym.make("MMCReachGoal-v0"), device="cpu", **deepcopy(OFF_POLICY)
    )
    for model, message in (
        (behind, "env must be wrapped in RescaleAction, as in the tr"),
        (goals, "let it play in MMCReachGoal-v0"),
        (trained(wrap=lambda env: VecFrameStack(env, 2)), r"must be of shape .* say --wrapper"),
        (trained(segment_lengths=(1, 1)), r"must be of shape .* say --wrapper"),
    ):
        with pytest.raises(CannotActError, match=message):
            make_agent(model, env)
    assert make_agent(behind, wrappers.RescaleAction(env, *TWICE))
    with pytest.warns(MismatchWarning, match="segment_lengths .*2.0.* in training"):
        make_agent(trained(segment_lengths=(1, 1, 2)), env)


def stacked(env):
    return wrappers.FlattenObservation(wrappers.FrameStackObservation(env, 2, padding_type="zero"))


def test_a_model_behind_wrappers_acts_behind_yours(tmp_path, monkeypatch):
    wrapped = {
        "gymnasium": make_vec_env("MMCReach-v0", 1, wrapper_class=stacked),
        "sb3": VecFrameStack(make_vec_env("MMCReach-v0", 1), 2),
    }
    models = {label: PPO("MlpPolicy", venv, **TINY) for label, venv in wrapped.items()}
    comparison = compare({**models, "mmc": "mmc"}, episodes=2, wrapper=stacked)
    # Each acts as stable-baselines3 itself lets it.
    seed = int(comparison.episodes["seed"].iloc[0])
    for label, model in models.items():
        env = model.get_env()
        env.seed(seed)
        observation = env.reset()
        for _ in range(99):
            observation, _, _, infos = env.step(model.predict(observation, deterministic=True)[0])
        expected = infos[0]["end_effector"]
        np.testing.assert_allclose(comparison.recorded[label][0].hands[99], expected, atol=1e-4)
    # In an experiment, as wrapped by hand; the wrapper belongs to the settings.
    learned = run_experiment(TWO_TRIALS, {"sb3": models["sb3"]}, subjects=1, wrapper=stacked)
    trial = learned.trials.iloc[0]
    env = stacked(TWO_TRIALS.scenario().make())
    observation, _ = env.reset(seed=1, options={"trial": int(trial["target_angle"] // 45)})
    for _ in range(3):
        observation, *_, info = env.step(models["sb3"].predict(observation, deterministic=True)[0])
    np.testing.assert_allclose(learned.hands[0][3], info["end_effector"], atol=1e-4)
    # By files, and in a benchmark, which notices another wrapper.
    for label, model in models.items():
        model.save(tmp_path / label)
    monkeypatch.chdir(tmp_path)
    named = {"wrapper": [f"sb3={__name__}:stacked"], "allow_pickle": True}
    control = {"env_kwargs": {"control": "joint_delta"}}
    for reused in (0, 2):
        run = benchmark(["sb3.zip", "mmc"], "store", ["random"], 2, jobs=1, **named, **control)
        assert (run.not_played, run.reused) == ([], reused)
    episodes = pd.read_parquet(tmp_path / "store" / "episodes")
    hands = episodes[episodes["agent"] == "sb3"].sort_values("instance")["final_distance"]
    expected = comparison.episodes[comparison.episodes["agent"] == "sb3"]["final_distance"]
    np.testing.assert_allclose(hands, expected)
    resolved = resolve_all(["sb3.zip"], wrapper=stacked, allow_pickle=True)[0].fingerprint
    assert resolved not in (None, resolve("sb3.zip").fingerprint)


def remembering(env):
    return MemoryObservation(env, [1, 2])


def test_a_model_with_a_memory_is_compared_in_the_same_memory(tmp_path):
    arms = gym.make_vec("MMCReach-v0", 2, autoreset_mode="SameStep")
    model = PPO("MlpPolicy", VecNormalize(Memory(GymnasiumVecEnv(arms), [1, 2])), **TINY).learn(16)
    model.save(tmp_path / "file")
    arguments = {"episodes": 1, "wrapper": {"file": remembering}, "allow_pickle": True}
    arguments["env_kwargs"] = {"control": "joint_delta"}
    arguments["statistics"] = {"file": model.get_env()}
    comparison = compare({"object": model, "file": tmp_path / "file"}, **arguments)
    hands = [comparison.recorded[label][0].hands for label in ("object", "file")]
    np.testing.assert_array_equal(*hands)
    # As stable-baselines3 lets it act in its own environment.
    env, seen = remembering(gym.make("MMCReach-v0")), []
    memory = Memory(make_vec_env("MMCReach-v0", 1), [1, 2])
    memory.seed(3)
    assert gym.make(env.spec).observation_space == memory.observation_space
    pair = env.reset(seed=3)[0], memory.reset()[0]
    for _ in range(102):
        seen.append(pair)
        action = env.action_space.sample()
        observation, _, _, is_over, _ = env.step(action)
        pair = env.reset()[0] if is_over else observation, memory.step(action[None])[0][0]
    np.testing.assert_array_equal(*map(np.stack, zip(*seen)))


def test_a_model_that_observed_the_context_is_shown_it(tmp_path):
    drawn = {"perturbations": ["rotation--60..60"], "observe_context": True}
    model = PPO("MlpPolicy", make_vec_env("MMCReach-v0", 1, env_kwargs=drawn), **TINY)
    model.save(tmp_path / "file")
    shown = {"observe_context": "rotation--60..60"}
    comparison = compare({"object": model, "mmc": "mmc"}, "rotation-30", episodes=1)
    with pytest.raises(CannotActError, match="trained with the context say --env-kwargs obs"):
        compare([tmp_path / "file"], "rotation-30", episodes=1, allow_pickle=True)
    arguments = {"env_kwargs": {**shown, "control": "joint_delta"}, "allow_pickle": True}
    other = compare({"file": tmp_path / "file"}, "rotation-30", episodes=1, **arguments)
    expected = comparison.recorded["object"][0].hands
    np.testing.assert_array_equal(other.recorded["file"][0].hands, expected)


def test_statistics_and_wrappers_that_are_none_or_of_no_model_are_refused(model, folder):
    statistics, both = model.get_env(), [model, "mmc"]
    for agents, arguments, message in (
        (["mmc"], {"statistics": statistics}, "must be for a model of stable-baselines3"),
        (both, {"statistics": {"mmc": statistics}}, "of mmc must be for a model of stable-base"),
        ([model], {"statistics": 3}, "statistics must be a VecNormalize, or the path of its"),
        ([model], {"statistics": folder / "vec_normalize.pkl"}, "vec_normalize.pkl' holds pickles"),
        (["mmc"], {"wrapper": "builtins:repr"}, "must be for a model of stable-baselines3 among"),
        (both, {"wrapper": "mmc_gym.training.vec_env:Memory"}, "single env.*raised TypeError"),
        (both, {"wrapper": "builtins:repr"}, "must be a function that returns an environment"),
        (both, {"wrapper": "no_module:stack"}, "wrapper 'no_module:stack' cannot be imported"),
        (both, {"wrapper": "other=builtins:repr"}, "of wrapper 'other' .* may be PPO or mmc"),
    ):
        with pytest.raises(UserError, match=message):
            compare(agents, episodes=1, **arguments)


def test_a_folder_with_a_best_model_is_that_model(folder):
    shutil.copy(folder / "model.zip", folder / "best_model.zip")
    assert resolve(str(folder)).model.path.name == "best_model.zip"


def test_a_model_takes_no_statistics_that_are_not_its_own(tmp_path, model):
    trained().save(tmp_path / "plain")
    model.get_env().save(str(tmp_path / "vecnormalize.pkl"))
    assert resolve(tmp_path / "plain.zip").model.statistics is None


def test_a_file_that_lacks_its_statistics_is_refused_or_warned_of(tmp_path, env):
    """Those of off-policy algorithms do not say whether they need them."""

    def save(envs):
        SAC("MlpPolicy", envs, device="cpu", **deepcopy(OFF_POLICY)).learn(12).save(
            tmp_path / "mine"
        )

    save(VecNormalize(vec_env()))
    with pytest.raises(UserError, match="must have the statistics of the VecNormalize"):
        load(tmp_path / "mine.zip", env)
    unsure = "does not say whether it was trained behind a VecN"
    with pytest.warns(MismatchWarning, match=unsure):
        load(SAC.load(tmp_path / "mine", env=vec_env(), device="cpu"), env)
    unbounded = lambda env: wrappers.TransformObservation(env, lambda seen: seen, space)  # noqa: E731
    space = gym.spaces.Box(-np.inf, np.inf, (15,))
    save(make_vec_env("MMCReach-v0", 1, wrapper_class=unbounded))
    with pytest.warns(MismatchWarning, match=unsure):
        load(tmp_path / "mine.zip", env)


def test_a_warning_of_a_model_shows_the_line_of_the_user(folder):
    with pytest.warns(MismatchWarning, match="does not declare the control mode") as caught:
        compare([folder / "model.zip"], episodes=1, allow_pickle=True)
    assert [warning.filename for warning in caught] == [__file__]


EACH = {"PPO": PPO, "A2C": A2C, "SAC": SAC, "TD3": TD3, "DDPG": DDPG, "TQC": TQC, "TRPO": TRPO}
EACH |= {"ARS": ARS, "CrossQ": CrossQ, "RecurrentPPO": RecurrentPPO, "HER": SAC}
OPTIONS = {
    "PPO": TINY,
    "A2C": {},
    "TRPO": {"n_steps": 64, "batch_size": 64},
    "ARS": {"n_delta": 1},
    "RecurrentPPO": {"n_steps": 64, "batch_size": 64},
    "HER": {"buffer_size": 200, "learning_starts": 100, "replay_buffer_class": HerReplayBuffer},
}


@pytest.mark.slow
@pytest.mark.parametrize("is_normalized", [False, True])
@pytest.mark.parametrize("name", EACH)
def test_every_algorithm_plays_the_same_as_object_file_and_folder(name, is_normalized, tmp_path):
    env_id = "MMCReachGoal-v0" if name == "HER" else "MMCReach-v0"
    policy = {"HER": "MultiInputPolicy", "RecurrentPPO": "MlpLstmPolicy"}.get(name, "MlpPolicy")
    envs = make_vec_env(env_id, 1)
    envs = VecNormalize(envs) if is_normalized else envs
    options = {**deepcopy(OPTIONS.get(name, OFF_POLICY)), "seed": 1, "device": "cpu"}
    model = EACH[name](policy, envs, **options).learn(150)
    inside = tmp_path / "of_zoo" / env_id
    inside.mkdir(parents=True)
    for path in (tmp_path / "alone", tmp_path / "of_zoo" / env_id):
        model.save(f"{path}.zip")
    (inside / "config.yml").write_text("")
    statistics = {}
    if is_normalized:
        envs.save(str(inside / "vecnormalize.pkl"))
        statistics = {name: inside / "vecnormalize.pkl" for name in ("loaded", "file")}
    fresh = make_vec_env(env_id, 1) if name == "HER" else None
    models = {
        "object": model,
        "loaded": EACH[name].load(tmp_path / "alone", env=fresh, device="cpu"),
        "file": tmp_path / "alone",
        "folder": tmp_path / "of_zoo",
    }
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MismatchWarning)  # of control modes
        comparison = compare(models, env_id, episodes=2, allow_pickle=True, statistics=statistics)
    expected = comparison.recorded["object"]
    for label in models:
        for episode, other in zip(expected, comparison.recorded[label], strict=True):
            np.testing.assert_array_equal(episode.hands, other.hands)


def test_what_is_no_model_is_an_error_of_the_user(tmp_path):
    (tmp_path / "text.zip").write_text("none")
    with zipfile.ZipFile(tmp_path / "other.zip", "w") as archive:
        archive.writestr("data", "{}")
    for name in ("text.zip", "other.zip"):
        with pytest.raises(UserError, match="must be a file that stable-baselines3's save wrote"):
            resolve(tmp_path / name)
    with pytest.raises(FileNotFoundError, match=r"gone\.zip"):
        resolve(tmp_path / "gone.zip")
    with pytest.raises(UserError, match=r"with best_model.zip, or .* got other.zip, text.zip"):
        resolve(tmp_path)


def test_several_trainings_are_one_agent_with_intervals_over_both(tmp_path):
    models = [trained(seed) for seed in (4, 2)]
    for seed, model in enumerate(models):
        model.save(tmp_path / f"mine-{seed}")
    pattern = f"{tmp_path}/mine-*"
    both = resolve_all([pattern], allow_pickle=True)
    assert [(agent.label, agent.training_seed) for agent in both] == [("mine", 4), ("mine", 2)]
    arguments = {"episodes": 3, "env_kwargs": {"control": CONTROL}}
    listed = compare({"mine": models}, **arguments)
    comparison = compare([pattern], allow_pickle=True, **arguments)
    assert comparison.trainings["mine"] == 2 and "mine (2)" in comparison.note
    mine = comparison.summary.query("agent == 'mine' and measure == 'final_distance'").iloc[0]
    assert mine["count"] == 6 and mine["low"] < mine["estimate"] < mine["high"]
    assert comparison.to_frame()["final_distance"].equals(listed.to_frame()["final_distance"])


def test_a_control_mode_that_is_asked_for_is_that_of_agents_that_act_by_several():
    for name, asked, control in (
        ("mmc", "joint_velocity", "joint_velocity"),
        ("ppo", "joint_torque", "joint_delta"),  # it acts by one only
    ):
        env, _ = make_player(resolve(name), parse_scenario("random", control=asked))
        assert env.unwrapped.control == control
    with pytest.raises(CannotActError, match="control must be 'joint_position'"):
        make_player(resolve("mmc"), parse_scenario("random", control="joint_torque"))
