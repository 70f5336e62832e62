"""Tuning: the same trials in parts as at once, and what is in use among them."""

import itertools
import json
import signal
import subprocess
import sys
from functools import partial

import gymnasium as gym
import optuna
import pytest
from optuna.storages.journal import JournalFileBackend

from mmc_gym import make_agent
from mmc_gym.measures.rollout import evaluate
from mmc_gym.training import tuning as tuning_targets
from mmc_gym.training.hyperparameters import read_hyperparameters
from mmc_gym.training.tuning import TUNING_SEED, tune

STEPS = 200


def complete(folder, name="mmc"):
    """Parameters and values of the trials that are complete."""
    journal = JournalFileBackend(str(folder / f"{name}.journal"))
    study = optuna.load_study(study_name=name, storage=optuna.storages.JournalStorage(journal))
    found = study.get_trials(states=(optuna.trial.TrialState.COMPLETE,))
    return [(trial.params, trial.value) for trial in found]


def test_a_tuning_in_parts_is_the_tuning_at_once(tmp_path):
    whole = tune("mmc", 13, STEPS, tmp_path / "whole")
    seen: list[int] = []
    for trials in (2, 5, 12, 13):
        parts = tune(
            "mmc", trials, STEPS, tmp_path / "parts", lambda number, _: seen.append(number)
        )
    assert parts == whole
    assert seen == list(range(13))
    trials = complete(tmp_path / "whole")
    assert complete(tmp_path / "parts") == trials
    parameters = [parameters for parameters, _ in trials]
    assert not any(one == other for one, other in itertools.combinations(parameters, 2))
    assert json.loads((tmp_path / "parts" / "mmc.json").read_text()) == whole


KILLED = """
import itertools, os, signal, sys
from pathlib import Path
from mmc_gym.evaluation import tuning_targets
from mmc_gym.training.tuning import tune

calls, evaluate = itertools.count(), tuning_targets.evaluate

def evaluate_or_die(*arguments):
    if next(calls) == int(sys.argv[2]):
        os.kill(os.getpid(), signal.SIGKILL)
    return evaluate(*arguments)

tuning_targets.evaluate = evaluate_or_die
tune("mmc", 13, 200, Path(sys.argv[1]))
"""


@pytest.mark.slow
@pytest.mark.parametrize("trial", [0, 1, 11])
def test_a_tuning_that_was_killed_in_a_trial_is_the_tuning_at_once(trial, tmp_path):
    killed = tmp_path / "killed"
    process = subprocess.run([sys.executable, "-c", KILLED, str(killed), str(trial)])
    assert process.returncode == -signal.SIGKILL
    assert len(complete(killed)) == trial
    assert tune("mmc", 13, STEPS, killed) == tune("mmc", 13, STEPS, tmp_path / "whole")
    assert complete(killed) == complete(tmp_path / "whole")


def test_the_first_trial_has_the_constants_in_use(tmp_path):
    result = tune("mmc", 1, 20_000, tmp_path)
    assert result["best"] == result["in_use"]
    assert result["in_use"] == {
        "damping": 4.0,
        "velocity_damping": 5.0,
        "velocity_decay": 0.92,
        "iterations_per_step": 3,
    }
    assert result["best_value"] == result["value_of_those_in_use"]
    assert 0.5 < result["best_value"] < 0.9  # arriving takes half a second of two


def test_constants_that_came_into_use_later_have_a_trial_too(tmp_path, monkeypatch):
    before = tune("mmc", 2, STEPS, tmp_path)
    monkeypatch.setitem(tuning_targets._NETWORK_IN_USE, "iterations_per_step", 5)
    after = tune("mmc", 2, STEPS, tmp_path)
    assert (before["in_use"]["iterations_per_step"], after["in_use"]["iterations_per_step"]) == (
        3,
        5,
    )
    assert after["value_of_those_in_use"] == complete(tmp_path)[-1][1]
    assert after["trials"] == 3


@pytest.mark.parametrize("name", ["mmc", "mmc-feedback"])
def test_constants_in_use_are_those_of_the_agent_of_that_name(name):
    target = tuning_targets.find_target(name)
    constants = target.space(optuna.trial.FixedTrial(target.in_use))
    made = getattr(tuning_targets, {"mmc": "_make_network"}.get(name, "_make_feedback"))
    arguments = {"perturbations": ["rotation-30"]}
    expected = evaluate(
        lambda interface: make_agent(name, gym.make("MMCReach-v0")), "MMCReach-v0", arguments, 20, 5
    )
    scores = evaluate(partial(made, constants), "MMCReach-v0", arguments, 20, 5)
    assert scores == expected


def test_feedback_is_tuned_where_it_matters(tmp_path):
    result = tune("mmc-feedback", 1, 2_000, tmp_path)
    assert result["episodes"] == 20
    assert result["in_use"] == {
        "damping": 3.75,
        "velocity_damping": 5.0,
        "velocity_decay": 0.92,
        "iterations_per_step": 3,
        "posture_weight": 0.25,
        "hand_rate": 0.3,
    }
    target = tuning_targets.find_target("mmc-feedback")
    without = {**result["in_use"], "damping": 4.0, "posture_weight": 0.0, "hand_rate": 0.0}
    assert target.judge(without, 2_000) < result["value_of_those_in_use"] - 0.1


def test_no_trial_of_other_steps_comes_into_a_tuning(tmp_path):
    tune("mmc", 1, STEPS, tmp_path)
    before = (tmp_path / "mmc.json").read_bytes(), complete(tmp_path)
    with pytest.raises(
        ValueError, match=r"steps must be those of the trials in .*, 200, .* got 50"
    ):
        tune("mmc", 2, 50, tmp_path)
    assert ((tmp_path / "mmc.json").read_bytes(), complete(tmp_path)) == before


@pytest.mark.parametrize(("name", "episodes"), [("mmc", 1), ("mmc-feedback", 10)])
def test_the_number_of_episodes_is_that_of_those_played(name, episodes, tmp_path, monkeypatch):
    played: list[int] = []
    evaluate = tuning_targets.evaluate

    def count(make, env_id, arguments, episodes, seed):
        played.append(episodes)
        return evaluate(make, env_id, arguments, episodes, seed)

    monkeypatch.setattr(tuning_targets, "evaluate", count)
    result = tune(name, 1, 50, tmp_path)
    assert result["episodes"] == sum(played) == episodes


@pytest.mark.parametrize("name", ["ppo", "ppo-position", "sac", "tqc-her"])
def test_what_is_printed_is_what_was_trained(name, tmp_path, monkeypatch):
    trained = []

    def judge(name, constants, steps):
        trained.append(constants)
        return len(trained) / 10

    monkeypatch.setattr(tuning_targets, "_judge_training", judge)
    result = tune(name, 12, 1_000, tmp_path)
    assert result["best"] == trained[-1]
    assert result["in_use"] == trained[0]
    assert all(one["learning_rate"].startswith("lin_") for one in trained)
    _, hyperparameters = read_hyperparameters(name)
    for constant, value in result["in_use"].items():
        expected = hyperparameters[constant]
        if constant == "learning_rate":
            value, expected = (float(v.removeprefix("lin_")) for v in (value, expected))
        assert value == expected


@pytest.mark.slow
@pytest.mark.parametrize(("name", "steps"), [("ppo", 8_192), ("tqc-her", 3_264)])
def test_a_training_is_tuned(name, steps, tmp_path):
    result = tune(name, 1, steps, tmp_path)
    assert 0.0 <= result["best_value"] <= 1.0
    assert set(result["best"]) >= {"learning_rate", "gamma", "batch_size", "ent_coef"}
    assert TUNING_SEED > 1_000_000


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("mmc", 0, 100), "trials must be at least 1, got 0"),
        (("mmc", 1, 0), "steps must be at least 1, got 0"),
        (("ik-dls", 1, 100), "name must begin with one of ppo, sac, tqc, got 'ik-dls'"),
        (("ppo-best", 1, 100), "name must be one of .*, got 'ppo-best'"),
    ],
)
def test_bad_input_is_an_error(arguments, message, tmp_path):
    with pytest.raises(ValueError, match=message):
        tune(*arguments, tmp_path / "out")
    assert not (tmp_path / "out").exists()
