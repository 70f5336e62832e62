"""Training: deterministic, resumable to the bit after a kill, and really learning."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from copy import deepcopy
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import safetensors.numpy
import torch

from mmc_gym.agents.policy import PolicyAgent, load_policy
from mmc_gym.interface import ReachInterface
from mmc_gym.training.hyperparameters import read_hyperparameters
from mmc_gym.training.training import CHECKPOINT, Training, library_versions

LEGS = 4
SMALL = {"n_timesteps": 1600, "n_envs": 4}
OFF_POLICY = {"learning_starts": 64, "batch_size": 32, "buffer_size": 1200}  # it overflows
TINY: dict[str, dict[str, Any]] = {
    "ppo": {"n_steps": 100, "batch_size": 100, "n_epochs": 2, "policy_kwargs": {"net_arch": [8]}},
    "ppo-residual": {"n_steps": 50, "batch_size": 50, "policy_kwargs": {"net_arch": [8]}},
    "sac": {**OFF_POLICY, "gradient_steps": 1, "policy_kwargs": {"net_arch": [8]}},
    "tqc-her": {
        **OFF_POLICY,
        "learning_starts": 440,  # hindsight needs a finished episode
        "gradient_steps": 1,
        "policy_kwargs": {"net_arch": [8], "n_critics": 1},
    },
}

# What the killed process runs; it says after every checkpoint that it stands.
SCRIPT = """
import json, sys
from pathlib import Path
from mmc_gym.training.training import Training
name, hyperparameters, env_id, folder = sys.argv[1], json.loads(sys.argv[2]), *sys.argv[3:]
report = lambda progress: progress.evaluation and print(progress.steps, flush=True)
print("ready", flush=True)
Training(name, hyperparameters, env_id, 3, Path(folder), report, evaluations=4).run(resume=True)
"""


def tiny(name: str) -> tuple[str, dict[str, Any]]:
    env_id, hyperparameters = read_hyperparameters(name)
    return env_id, {**hyperparameters, **SMALL, **TINY[name]}


def training(name: str, folder: Path, seed: int = 3, **changes: Any) -> Training:
    env_id, hyperparameters = tiny(name)
    return Training(name, {**hyperparameters, **changes}, env_id, seed, folder, evaluations=LEGS)


def weights(folder: Path, name: str = "ppo", seed: int = 3) -> bytes:
    return (folder / f"{name}-{seed}.safetensors").read_bytes()


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("trained")
    training("ppo", folder).run()
    return folder


@pytest.mark.parametrize("name", TINY)
def test_a_training_leaves_its_hyperparameters_as_they_were(name, tmp_path):
    one = training(name, tmp_path)
    before = deepcopy(one.hyperparameters)
    assert one.run().hyperparameters == before == one.hyperparameters


def test_a_card_has_the_environments_arguments_as_a_mapping(tmp_path):
    card = training("ppo", tmp_path, env_kwargs="dict(control='joint_delta')", n_timesteps=1).run()
    assert card.hyperparameters["env_kwargs"] == {"control": "joint_delta"}


def test_hindsight_loses_no_episode_to_a_checkpoint(tmp_path):
    legs = training("tqc-her", tmp_path, n_timesteps=2000).steps_per_leg
    assert legs % (SMALL["n_envs"] * 100) == 0
    assert training("sac", tmp_path, n_timesteps=2000).steps_per_leg == 2000 / LEGS


@pytest.mark.parametrize("name", TINY)
def test_the_same_seed_gives_the_same_policy_and_another_seed_another(name, tmp_path):
    for folder, seed in (("one", 3), ("again", 3), ("other", 4)):
        training(name, tmp_path / folder, seed).run()
    assert weights(tmp_path / "one", name) == weights(tmp_path / "again", name)
    assert weights(tmp_path / "one", name) != weights(tmp_path / "other", name, 4)


@pytest.mark.slow
@pytest.mark.parametrize("name", TINY)
@pytest.mark.parametrize("checkpoints", [1, 3])
def test_a_killed_training_goes_on_to_the_policy_of_an_undisturbed_one(name, checkpoints, tmp_path):
    env_id, hyperparameters = tiny(name)
    killed, undisturbed = tmp_path / "killed", tmp_path / "undisturbed"
    command = [sys.executable, "-c", SCRIPT, name, json.dumps(hyperparameters), env_id, str(killed)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        for _ in range(checkpoints):
            steps = int(process.stdout.readline())  # a checkpoint stands
        time.sleep(0.02)  # and the next leg has begun
        os.kill(process.pid, signal.SIGKILL)
    assert process.returncode == -signal.SIGKILL
    assert steps < hyperparameters["n_timesteps"]
    assert not (killed / f"{name}-3.safetensors").exists()
    resumed = training(name, killed)
    reports: list[int] = []
    resumed.report = lambda progress: reports.append(progress.steps)
    card = resumed.run(resume=True)
    assert reports[0] > steps
    assert card.training_steps == hyperparameters["n_timesteps"]
    training(name, undisturbed).run()
    assert weights(killed, name) == weights(undisturbed, name)


@pytest.mark.slow
def test_a_training_killed_at_any_moment_and_again_and_again_comes_to_the_same_policy(
    trained, tmp_path
):
    env_id, hyperparameters = tiny("ppo")
    command = [
        sys.executable,
        "-c",
        SCRIPT,
        "ppo",
        json.dumps(hyperparameters),
        env_id,
        str(tmp_path),
    ]
    for delay in np.random.default_rng(0).uniform(0.0, 0.4, 5):
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            assert process.stdout.readline() == "ready\n"
            time.sleep(delay)
            os.kill(process.pid, signal.SIGKILL)
    training("ppo", tmp_path).run(resume=True)
    assert weights(tmp_path) == weights(trained)


def test_a_training_killed_while_it_writes_has_its_last_checkpoint(trained, tmp_path):
    shutil.copytree(trained, tmp_path / "copy")
    (tmp_path / "copy" / f".{CHECKPOINT}.half").write_bytes(b"half a checkpoint")
    training("ppo", tmp_path / "copy").run(resume=True)
    assert weights(tmp_path / "copy") == weights(trained)


def test_the_card_tells_the_whole_training(trained):
    env_id, hyperparameters = tiny("ppo")
    _, card = load_policy(trained / "ppo-3.json")
    assert (card.name, card.algorithm, card.env_id) == ("ppo", "ppo", env_id)
    assert card.hyperparameters == hyperparameters
    assert card.seed == 3
    assert [row["steps"] for row in card.learning_curve] == [400, 800, 1200, 1600]
    assert card.training_seconds > 0
    assert card.training_cpu_seconds > 0
    assert {"success", "final_distance", "episode_return"} <= set(card.scores)


def test_the_policy_that_is_kept_acts_as_the_model_that_was_trained(tmp_path):
    one = training("ppo", tmp_path)
    models: list[Any] = []
    one.save = lambda model: (models.append(model), Training.save(one, model))  # type: ignore[method-assign, assignment]
    one.run()
    network, card = load_policy(tmp_path / "ppo-3.json")
    envs = gym.make_vec(card.env_id, 5, control="joint_delta")
    observations, _ = envs.reset(seed=0)
    actions, _ = PolicyAgent(network, card, ReachInterface.of(envs)).predict(
        observations, deterministic=True
    )
    expected, _ = models[-1].predict(observations, deterministic=True)
    np.testing.assert_allclose(actions, expected, atol=1e-6)


def test_tensorboard_gets_the_evaluations(tmp_path):
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    one = training("ppo", tmp_path)
    one.tensorboard = tmp_path / "logs"
    card = one.run()
    (run,) = (tmp_path / "logs").iterdir()
    events = EventAccumulator(str(run)).Reload().Scalars("evaluation/final_distance")
    assert [event.step for event in events] == [400, 800, 1200, 1600]
    distances = [row["final_distance"] for row in card.learning_curve]
    np.testing.assert_allclose([event.value for event in events], distances, rtol=1e-5)


def test_tensorboard_gets_the_returns_of_episodes(tmp_path):
    """As they are, before `VecNormalize` scales them."""
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    one = training("ppo", tmp_path)
    one.tensorboard = tmp_path / "logs"
    one.run()
    (run,) = (tmp_path / "logs").iterdir()
    events = EventAccumulator(str(run)).Reload()
    assert {event.value for event in events.Scalars("rollout/ep_len_mean")} == {100.0}
    returns = [event.value for event in events.Scalars("rollout/ep_rew_mean")]
    assert all(-500 < value < -20 for value in returns)


def test_steps_are_rounded_up_to_whole_legs(tmp_path):
    assert training("ppo", tmp_path, n_timesteps=1601).total_steps == 2400


def test_a_checkpoint_is_not_overwritten_unasked(trained):
    before = (trained / CHECKPOINT).read_bytes()
    with pytest.raises(FileExistsError, match="resume"):
        training("ppo", trained).run()
    assert (trained / CHECKPOINT).read_bytes() == before


@pytest.mark.parametrize("suffix", ["safetensors", "json"])
def test_a_policy_is_not_overwritten_unasked(trained, tmp_path, suffix):
    shutil.copy(trained / f"ppo-3.{suffix}", tmp_path)
    with pytest.raises(FileExistsError, match=rf"ppo-3.{suffix} exists already"):
        training("ppo", tmp_path).run()
    assert len(list(tmp_path.iterdir())) == 1


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"gamma": 0.5, "n_epochs": 3},
            r"with gamma 0.8 \(here 0.5\), n_epochs 2 \(here 3\): resume",
        ),
        ({"n_timesteps": 800}, r"with n_timesteps 1600 \(here 800, see --steps\): "),
        ({}, r"with seed 3 \(here 4\): .* delete "),
    ],
)
def test_a_checkpoint_of_another_training_is_refused(trained, changes, message):
    with pytest.raises(ValueError, match=message):
        training("ppo", trained, 3 if changes else 4, **changes).run(resume=True)


def test_a_checkpoint_of_other_versions_is_refused(trained, monkeypatch):
    versions = {**library_versions(), "numpy": "0.1"}
    monkeypatch.setattr("mmc_gym.training.training.library_versions", lambda: versions)
    with pytest.raises(ValueError, match=r"with numpy [\d.]+ \(here 0.1\): "):
        training("ppo", trained).run(resume=True)


def test_a_file_is_no_folder_to_train_in(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ValueError, match="out must be a folder, got the file"):
        training("ppo", tmp_path / "file").run()


@pytest.mark.parametrize("device", ["foo", "cuda:99", "meta", ""])
def test_a_device_that_is_not_there_is_refused(tmp_path, device):
    env_id, hyperparameters = tiny("ppo")
    with pytest.raises(ValueError, match=f"device must be one that .*, got '{device}'"):
        Training("ppo", hyperparameters, env_id, 3, tmp_path, device=device)


def test_cuda_is_refused_where_there_is_none(tmp_path):
    env_id, hyperparameters = tiny("ppo")
    if not torch.cuda.is_available():
        with pytest.raises(ValueError, match=r"device must be one that .*, got 'cuda'"):
            Training("ppo", hyperparameters, env_id, 3, tmp_path, device="cuda")
        assert Training("ppo", hyperparameters, env_id, 3, tmp_path, device="auto").device == "cpu"


def test_an_environment_that_is_none_to_train_in_is_refused(tmp_path):
    _, hyperparameters = tiny("ppo")
    with pytest.raises(ValueError, match="env must be the id of an environment"):
        Training("ppo", hyperparameters, "MMCReach-v99", 3, tmp_path)
    with pytest.raises(ValueError, match="env must be a reaching environment"):
        Training("ppo", {**hyperparameters, "env_kwargs": {}}, "Pendulum-v1", 3, tmp_path).run()
    with pytest.raises(ValueError, match=r"that takes {'colour': 1}, got MMCReach-v0"):
        training("ppo", tmp_path, env_kwargs={"colour": 1}).run()


@pytest.mark.parametrize("arguments", [{}, {"base_agent": "mmc"}])
def test_the_card_tells_whose_actions_are_corrected(tmp_path, arguments):
    wrapper = [{"mmc_gym.training.vec_env.Residual": arguments}]
    card = training("ppo-residual", tmp_path, vec_env_wrapper=wrapper, n_timesteps=1).run()
    assert card.base_agent == "mmc"
    with pytest.raises(ValueError, match="base_agent must be one of"):
        wrapper = [{"mmc_gym.training.vec_env.Residual": {"base_agent": "ik"}}]
        training("ppo-residual", tmp_path / "other", vec_env_wrapper=wrapper).run()


@pytest.mark.parametrize("part", [0.1, 0.5, 0.999])
def test_a_damaged_checkpoint_is_refused(trained, tmp_path, part):
    content = (trained / CHECKPOINT).read_bytes()
    (tmp_path / CHECKPOINT).write_bytes(content[: int(part * len(content))])
    with pytest.raises(ValueError, match="does not hold a training"):
        training("ppo", tmp_path).run(resume=True)


def test_a_checkpoint_that_lacks_weights_is_refused(trained, tmp_path):
    with safetensors.safe_open(trained / CHECKPOINT, framework="np") as file:
        tensors = {name: file.get_tensor(name) for name in file.keys()}
        metadata = file.metadata()
    del tensors["module/policy/action_net.bias"]
    safetensors.numpy.save_file(tensors, tmp_path / CHECKPOINT, metadata)
    with pytest.raises(ValueError, match="does not hold a training of this kind"):
        training("ppo", tmp_path).run(resume=True)


@pytest.mark.slow
def test_a_short_training_with_the_shipped_hyperparameters_reaches(tmp_path):
    env_id, hyperparameters = read_hyperparameters("ppo")
    hyperparameters["n_timesteps"] = 250_000
    card = Training("ppo", hyperparameters, env_id, 0, tmp_path).run()
    assert card.scores["success"] > 0.6
