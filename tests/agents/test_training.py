"""Training: deterministic, resumable to the bit after a kill, and really learning."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from mmc_gym.agents.reinforcement import load_policy
from mmc_gym.agents.training import CHECKPOINT, Training, read_hyperparameters

ENV_ID = "MMCReach-v0"
TINY = {
    **read_hyperparameters("ppo", ENV_ID),
    "n_timesteps": 1024,
    "n_envs": 2,
    "n_steps": 64,
    "batch_size": 64,
    "n_epochs": 2,
    "rollouts_per_leg": 2,
}
TINY["policy_kwargs"] = {**TINY["policy_kwargs"], "net_arch": [8]}

# What the killed process runs; it says after every checkpoint that it stands.
SCRIPT = """
import json, sys
from pathlib import Path
from mmc_gym.agents.training import Training
hyperparameters, folder = json.loads(sys.argv[1]), Path(sys.argv[2])
report = lambda progress: progress.evaluation and print(progress.steps, flush=True)
Training(hyperparameters, "MMCReach-v0", 3, folder, report).run()
"""


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("trained")
    Training(TINY, ENV_ID, 3, folder).run()
    return folder


def weights(folder: Path) -> bytes:
    return (folder / "ppo.safetensors").read_bytes()


def test_the_same_seed_gives_the_same_policy_and_another_seed_another(trained, tmp_path):
    Training(TINY, ENV_ID, 3, tmp_path / "again").run()
    Training(TINY, ENV_ID, 4, tmp_path / "other").run()
    assert weights(tmp_path / "again") == weights(trained)
    assert weights(tmp_path / "other") != weights(trained)


def test_a_killed_training_goes_on_to_the_policy_of_an_undisturbed_one(trained, tmp_path):
    command = [sys.executable, "-c", SCRIPT, json.dumps(TINY), str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        steps = int(process.stdout.readline())  # the first checkpoint stands
        time.sleep(0.05)  # and the next leg has begun
        os.kill(process.pid, signal.SIGKILL)
    assert process.returncode == -signal.SIGKILL
    assert steps < TINY["n_timesteps"]
    assert not (tmp_path / "ppo.safetensors").exists()
    reports: list[int] = []
    card = Training(TINY, ENV_ID, 3, tmp_path, lambda progress: reports.append(progress.steps)).run(
        resume=True
    )
    assert reports[0] > steps
    assert card.training_steps == TINY["n_timesteps"]
    assert weights(tmp_path) == weights(trained)


def test_the_card_tells_the_whole_training(trained):
    _, card = load_policy(trained / "ppo.json")
    assert card.hyperparameters == TINY
    assert card.seed == 3
    assert [row["steps"] for row in card.learning_curve] == [256, 512, 768, 1024]
    assert card.training_seconds > 0
    assert set(card.scores) == {"success", "final_distance"}


def test_steps_are_rounded_up_to_whole_legs(tmp_path):
    assert Training({**TINY, "n_timesteps": 1025}, ENV_ID, 0, tmp_path).total_steps == 1280


def test_a_checkpoint_is_not_overwritten_unasked(trained):
    before = (trained / CHECKPOINT).read_bytes()
    with pytest.raises(FileExistsError, match="resume"):
        Training(TINY, ENV_ID, 3, trained).run()
    assert (trained / CHECKPOINT).read_bytes() == before


@pytest.mark.parametrize(("change", "name"), [({"gamma": 0.5}, "hyperparameters"), ({}, "seed")])
def test_a_checkpoint_of_another_training_is_refused(trained, change, name):
    with pytest.raises(ValueError, match=f"must have the same {name}"):
        Training({**TINY, **change}, ENV_ID, 3 if change else 4, trained).run(resume=True)


def test_a_damaged_checkpoint_is_refused(trained, tmp_path):
    content = (trained / CHECKPOINT).read_bytes()
    (tmp_path / CHECKPOINT).write_bytes(content[: len(content) // 2])
    with pytest.raises(ValueError, match="does not hold a training"):
        Training(TINY, ENV_ID, 3, tmp_path).run(resume=True)


def test_unknown_algorithms_and_environments_are_errors():
    with pytest.raises(ValueError, match="algorithm must be 'ppo', got 'dqn'"):
        read_hyperparameters("dqn", ENV_ID)
    with pytest.raises(ValueError, match="env must be one of MMCReach-v0 for ppo, got 'Pen"):
        read_hyperparameters("ppo", "Pendulum-v1")


@pytest.mark.slow
def test_a_short_training_with_the_shipped_hyperparameters_learns(tmp_path):
    hyperparameters = {**read_hyperparameters("ppo", ENV_ID), "n_timesteps": 280_000}
    hyperparameters["rollouts_per_leg"] = 10
    curve = Training(hyperparameters, ENV_ID, 0, tmp_path).run().learning_curve
    assert curve[-1]["final_distance"] < 0.5 * curve[0]["final_distance"]
