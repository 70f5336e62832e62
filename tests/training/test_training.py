"""Training: deterministic, resumable to the bit, and really learning; many at once."""

import shutil
import sys
from copy import deepcopy
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch

from mmc_gym import UserError, make_agent, train
from mmc_gym.agents.policy import load_policy
from mmc_gym.agents.resolver import resolve
from mmc_gym.benchmark.suite import Arms, make_player, play_episodes
from mmc_gym.body import ArmParameters
from mmc_gym.envs.scenarios import parse_scenario
from mmc_gym.interface import CannotActError
from mmc_gym.measures import run_episodes
from mmc_gym.training import training as module
from mmc_gym.training.hyperparameters import Recipe, read_recipe
from mmc_gym.training.training import CHECKPOINT, Training
from mmc_gym.training.vec_env import Memory
from studies.learners.ppo_residual import HYPERPARAMETERS
from tests.conftest import by_night

LEGS = 4
RESIDUAL = "studies.learners.ppo_residual.Residual"
SMALL = {"n_timesteps": 1600, "n_envs": 4, "policy_kwargs": {"net_arch": [8]}}
DELAYS = {"engine": "analytic", "perturbations": ["delay-0..100"]}
OFF_POLICY = {"batch_size": 32, "buffer_size": 1200, "gradient_steps": 1}  # it overflows
TINY: dict[str, dict[str, Any]] = {
    "ppo": {"n_steps": 100, "batch_size": 100, "n_epochs": 2},
    "ppo-residual": {"n_steps": 50, "batch_size": 50, "env_kwargs": DELAYS},
    "sac": {**OFF_POLICY, "learning_starts": 64, "normalize": True, "memory": [1, 2]},
    "td3": {**OFF_POLICY, "learning_starts": 64, "normalize": "dict(norm_obs=True)"},
    "crossq": {
        **{**OFF_POLICY, "learning_starts": 64},
        "policy_kwargs": {"net_arch": [8], "renorm_warmup_steps": 100},
    },
    "a2c": {"n_steps": 25},
    "trpo": {"n_steps": 50, "batch_size": 50},
    "ppo_lstm": {
        **{"n_steps": 50, "batch_size": 50, "n_epochs": 2, "normalize": True},
        "policy_kwargs": {"net_arch": [8], "lstm_hidden_size": 8},
    },
    "tqc-her": {
        **{**OFF_POLICY, "learning_starts": 440},  # hindsight needs a finished episode
        "policy_kwargs": {"net_arch": [8], "n_critics": 1},
    },
}


def tiny(name, **changes):
    source = str(HYPERPARAMETERS) if name == "ppo-residual" else name
    return read_recipe(source).with_changes(**{**SMALL, **TINY[name], **changes})


def training(name, folder, seed=3, **changes):
    return Training(tiny(name, **changes), seed, folder, evaluations=LEGS)


def weights(folder, name="ppo", seed=3):
    return (folder / f"{name}-{seed}.safetensors").read_bytes()


@pytest.fixture(scope="module", autouse=True)
def few_episodes():
    """Evaluations take longer than such trainings."""
    with pytest.MonkeyPatch.context() as patch:
        for name in ("EVALUATION_EPISODES", "FINAL_EPISODES"):
            patch.setattr(module, name, 20)
        yield


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """The folder of a training with TensorBoard's logs."""
    folder = tmp_path_factory.mktemp("ppo")
    tiny_training = training("ppo", folder)
    tiny_training.tensorboard = folder / "logs"
    before = deepcopy(tiny_training.recipe.hyperparameters)
    card = tiny_training.run()
    assert card.hyperparameters == before == tiny_training.recipe.hyperparameters
    return folder


@pytest.mark.parametrize("name", by_night(TINY, ["ppo", "tqc-her", "td3", "a2c", "ppo_lstm"]))
def test_an_interrupted_training_resumes_to_the_policy_of_an_undisturbed_one(name, tmp_path):
    def interrupt(progress):
        if progress.steps > 400:  # a leg after a checkpoint has begun
            raise KeyboardInterrupt

    undisturbed, interrupted, resumed = (
        training(name, tmp_path / folder, n_timesteps=800) for folder in ("whole", "cut", "cut")
    )
    undisturbed.run()
    interrupted.report = interrupt
    with pytest.raises(KeyboardInterrupt):
        interrupted.run()
    assert not any(file.exists() for file in interrupted.policy_files)
    steps = []
    resumed.report = lambda progress: steps.append(progress.steps)
    resumed.run(resume=True)
    assert 400 < steps[0] <= steps[-1] == 800
    assert weights(tmp_path / "cut", name) == weights(tmp_path / "whole", name)
    training(name, tmp_path / "other", seed=4, n_timesteps=400).run()
    assert weights(tmp_path / "cut", name) != weights(tmp_path / "other", name, seed=4)


def test_a_training_killed_while_it_writes_has_its_last_checkpoint(trained, tmp_path, monkeypatch):
    copy = tmp_path / "copy"
    shutil.copytree(trained, copy)
    (copy / f".{CHECKPOINT}.half").write_bytes(b"half a checkpoint")
    heads = []
    read_head = module.read_head
    monkeypatch.setattr(module, "read_head", lambda path: heads.append(path) or read_head(path))
    training("ppo", copy).run(resume=True)
    assert weights(copy) == weights(trained)
    assert heads == [copy / CHECKPOINT]  # read once


def test_the_card_describes_the_whole_training(trained, tmp_path):
    recipe = tiny("ppo")
    _, card = load_policy(trained / "ppo-3.json")
    assert (card.name, card.algorithm, card.env_id) == ("ppo", "ppo", recipe.env_id)
    assert (card.hyperparameters, card.seed) == (recipe.hyperparameters, 3)
    residual = training("ppo-residual", tmp_path, n_timesteps=1).run()
    assert (card.base_agent, residual.base_agent) == ("", "mmc")
    assert (card.engine, card.body, card.control) == ("analytic", ArmParameters(), "joint_delta")
    assert [row["steps"] for row in card.learning_curve] == [400, 800, 1200, 1600]
    assert min(card.training_seconds, card.training_cpu_seconds) > 0
    assert {"success", "final_distance", "episode_return"} <= set(card.scores)


@pytest.mark.parametrize("name", ["ppo", "td3", "a2c", "ppo_lstm", "crossq"])
def test_the_policy_that_is_kept_acts_as_the_model_that_was_trained(name, tmp_path):
    tiny_training, models = training(name, tmp_path, n_timesteps=1), []
    tiny_training.save = lambda model: (models.append(model), Training.save(tiny_training, model))
    tiny_training.run()
    model, envs = models[-1], gym.make_vec("MMCReach-v0", 5)
    normalizer = model.get_vec_normalize_env()
    assert (normalizer is not None) == (name not in ("ppo", "crossq"))
    observations, _ = envs.reset(seed=0)
    agent = make_agent(str(tmp_path / f"{name}-3.json"), envs)
    state = theirs = None
    for start in ([True] * 5, [False] * 5, [False, True, False, False, False]):
        actions, state = agent.predict(observations, state, start, deterministic=True)
        seen = normalizer.normalize_obs(observations) if normalizer else observations
        expected, theirs = model.predict(seen, theirs, np.array(start), deterministic=True)
        np.testing.assert_allclose(actions, expected, atol=1e-5)
        observations = envs.step(actions)[0]


def test_tensorboard_gets_evaluations_and_the_returns_of_episodes(trained):
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    (run,) = (trained / "logs").iterdir()
    events = EventAccumulator(str(run)).Reload()
    distances = events.Scalars("evaluation/final_distance")
    assert [event.step for event in distances] == [400, 800, 1200, 1600]
    _, card = load_policy(trained / "ppo-3.json")
    expected = [row["final_distance"] for row in card.learning_curve]
    np.testing.assert_allclose([event.value for event in distances], expected, rtol=1e-5)
    assert {event.value for event in events.Scalars("rollout/ep_len_mean")} == {100.0}
    returns = [event.value for event in events.Scalars("rollout/ep_rew_mean")]
    assert all(-500 < value < -20 for value in returns)


@pytest.mark.parametrize("file", [CHECKPOINT, "ppo-3.safetensors", "ppo-3.json"])
def test_nothing_is_overwritten_unasked(trained, tmp_path, file):
    shutil.copy(trained / file, tmp_path)
    hint = "resume it, or choose another" if file == CHECKPOINT else "choose another folder, or del"
    for resume in (False, file != CHECKPOINT):  # a policy alone cannot be resumed
        with pytest.raises(FileExistsError, match=rf"{file} exists already: {hint}"):
            training("ppo", tmp_path).run(resume)
    assert [path.read_bytes() for path in tmp_path.iterdir()] == [(trained / file).read_bytes()]


def test_a_checkpoint_of_another_training_is_refused(trained, monkeypatch):
    versions = {**module.library_versions(), "numpy": "0.1"}
    monkeypatch.setattr(module, "library_versions", lambda: versions)
    differing = ("seed 3", 4), ("n_epochs 2", 3), ("gamma 0.9", 0.5), (r"numpy [\d.]+", 0.1)
    named = ", ".join(rf"{before} \(here {now}\)" for before, now in differing)
    with pytest.raises(UserError, match=f"{named}: .* delete "):
        training("ppo", trained, seed=4, gamma=0.5, n_epochs=3).run(resume=True)


def test_a_damaged_checkpoint_is_refused(trained, tmp_path):
    content = (trained / CHECKPOINT).read_bytes()
    (tmp_path / CHECKPOINT).write_bytes(content[: len(content) // 2])
    with pytest.raises(UserError, match="does not hold a training"):
        training("ppo", tmp_path).run(resume=True)
    for bit in range(0, 8 * len(content), 20011):
        changed = bytearray(content)
        changed[bit // 8] ^= 1 << bit % 8
        (tmp_path / CHECKPOINT).write_bytes(changed)
        with pytest.raises(UserError, match=f"{CHECKPOINT} does not hold a training"):
            module.read_head(tmp_path / CHECKPOINT)


def test_a_training_has_whole_legs_and_finds_the_best_device(tmp_path):
    recipe = tiny("ppo", n_timesteps=1601)
    tiny_training = Training(recipe, 3, tmp_path, evaluations=LEGS, device="auto")
    best = "cuda" if torch.cuda.is_available() else "cpu"
    assert (tiny_training.total_steps, tiny_training.device) == (2400, best)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"device": "cuda:99"}, "device must be one that .*'cuda:99'"),
        ({"device": "meta"}, "device must be one that .*'meta'"),
        ({"seed": -1}, "seed must be from 0 to .*, got -1"),
        ({"tensorboard": Path("logs")}, r"mmc-gym\[training\]"),
        ({"env_kwargs": {"max_episode_steps": None}}, "max_episode_steps"),  # hung when evaluated
        ({"use_sde": True}, "a policy that acts: tensors must be"),
        ({"normalize": {"norm": True}}, "unexpected .*'norm'"),
        ({"vec_env_wrapper": {RESIDUAL: {"base_agent": "ik"}}}, "base_agent must be one of"),
        ({"memory": [0]}, r"memory.0 must be at least 1, got 0"),
        ({"env_id": "MMCReach-v99"}, "env must be the id of an environment"),
        ({"env_id": "Pendulum-v1"}, "env must be a reaching environment"),
        ({"env_kwargs": {"colour": 1}}, "unexpected .*'colour'"),
    ],
)
def test_mistakes_are_named_before_training(tmp_path, monkeypatch, changes, message):
    monkeypatch.setitem(sys.modules, "tensorboard", None)
    settings = {"seed": 3, "device": "cpu", "tensorboard": None, "env_id": "MMCReach-v0"}
    arguments = {name: changes.get(name, value) for name, value in settings.items()}
    others = {name: value for name, value in changes.items() if name not in settings}
    recipe = Recipe("ppo", arguments.pop("env_id"), tiny("ppo", **others).hyperparameters)
    with pytest.raises(UserError, match=message):
        Training(recipe, folder=tmp_path / "out", **arguments).run()
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_short_training_with_the_shipped_hyperparameters_reaches(tmp_path):
    card = Training(read_recipe("ppo", steps=250_000), 0, tmp_path).run()
    assert card.scores["success"] > 0.6


def test_from_python_it_returns_the_agent_and_writes_only_what_is_asked_for(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    agent = train("ppo", seed=3, steps=1)
    assert not list(tmp_path.iterdir())
    env = gym.make("MMCReach-v0")
    observation, _ = env.reset(seed=0)
    action, _ = agent.predict(observation, deterministic=True)
    saved = agent.save("mine")
    assert saved == Path("mine/ppo-3.json")
    written = train("ppo", seed=3, steps=1, out="kept")
    assert {path.name for path in Path("kept").iterdir()} >= {"ppo-3.json", CHECKPOINT}
    for same in (make_agent(str(saved), env), written):
        np.testing.assert_array_equal(action, same.predict(observation, deterministic=True)[0])


def test_a_policy_that_observes_the_context_does_so_in_every_scenario(tmp_path):
    file = tmp_path / "ppo-given.yml"
    (tmp_path / "ppo-other.yml").write_text(
        "MMCReach-v0: {perturbations: [rotation--60..60, {one_of: [locks-1..3, null]}]}\n"
    )
    file.write_text(
        "MMCReach-v0:\n  perturbations: ppo-other.yml\n"
        "  env_kwargs: {observe_context: true}\n  policy: MlpPolicy\n"
        "  n_timesteps: 400\n  n_envs: 4\n  n_steps: 100\n  batch_size: 100\n  memory: [1, 2]\n"
    )
    card = train(file, out=tmp_path).card
    scale = ["rotation--60..60", {"one_of": ["locks-1..3", None], "weights": [1.0, 1.0]}]
    assert card.context == card.hyperparameters["env_kwargs"]["perturbations"][:1] + scale[1:]
    agent = resolve(str(tmp_path))
    remembers = "remembers its last 3 steps; and what was drawn for the episode"
    assert agent.knowledge.senses.endswith(remembers)
    scenario = parse_scenario("rotation-90+locks-2-known")
    env, player = make_player(agent, scenario)
    assert env.reset()[0][-3:].tolist() == [1.5, 1.0, 0.0]
    together = play_episodes(Arms(scenario), env, player, [5, 6])
    for single, of_vector in zip(run_episodes(player, env, [5, 6]), together, strict=True):
        np.testing.assert_array_equal(single.hands, of_vector.hands)
    with pytest.raises(CannotActError, match=r"with observe_context=\['rotation--60..60', "):
        make_agent(str(tmp_path), gym.make("MMCReach-v0"))
    mmc = make_agent("mmc", env)  # ignores it
    plain, _ = scenario.make().reset(seed=1)
    action = make_agent("mmc", scenario.make()).predict(plain)[0]
    np.testing.assert_array_equal(mmc.predict(env.reset(seed=1)[0])[0], action)


@pytest.mark.parametrize(("name", "what"), [("out", "a path"), ("env_kwargs", "a map")])
def test_wrong_types_of_arguments_are_named(name, what):
    with pytest.raises(UserError, match=f"{name} must be {what}.*, got 3"):
        train("ppo", steps=1, **{name: 3})


def test_a_policy_remembers_in_play_what_it_saw_in_training(tmp_path):
    card = training("ppo", tmp_path, memory=[1, 2, 3], n_timesteps=400).run()
    assert card.blocks == (1, 2, 3)
    network, _ = load_policy(tmp_path / "ppo-3.json")
    seen = Memory(module.make_vec_env("MMCReach-v0", 2, {}), card.blocks)
    envs = gym.make_vec("MMCReach-v0", 2, autoreset_mode="SameStep")
    agent = make_agent(str(tmp_path), gym.make("MMCReach-v0"))
    seen.seed(1)
    shown, (observation, _) = seen.reset(), envs.reset(seed=1)
    state, starts = None, np.ones(2, dtype=bool)
    for step in range(120):
        action, state = agent.predict(observation, state, starts, deterministic=True)
        np.testing.assert_array_equal(action, network.act(shown), str(step))
        last = shown
        shown, _, starts, infos = seen.step(action)
        observation = envs.step(action)[0]
        if starts.any():
            assert infos[0]["terminal_observation"].shape == last[0].shape
    with pytest.raises(UserError, match="observation_space must be Box observations"):
        Memory(module.make_vec_env("MMCReachGoal-v0", 2, {}), [1])
