"""Tuning: the same trials in parts as at once, and what is in use among them."""

import itertools
import json
from functools import partial

import gymnasium as gym
import optuna
import pytest
from optuna.storages.journal import JournalFileBackend

from mmc_gym import UserError, make_agent
from mmc_gym.measures.rollout import evaluate
from studies.learners import tuning
from studies.learners.tuning import find_target, tune

STEPS = 200
IN_USE = {"damping": 4.0, "velocity_damping": 5.0, "velocity_decay": 0.92, "iterations_per_step": 3}


def complete(folder):
    """Parameters and values of the complete trials of the network, of STEPS each."""
    journal = JournalFileBackend(str(folder / "mmc.journal"))
    storage = optuna.storages.JournalStorage(journal)
    name = json.dumps({"steps": STEPS, "in use": IN_USE})
    study = optuna.load_study(study_name=name, storage=storage)
    complete_trials = study.get_trials(states=(optuna.trial.TrialState.COMPLETE,))
    return [(trial.params, trial.value) for trial in complete_trials]


@pytest.mark.slow
def test_tuning_in_parts_and_interrupted_gives_the_same_as_at_once(tmp_path, monkeypatch):
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    tune("mmc", 12, STEPS, whole)  # the 11th and later trials are not random
    seen, calls = [], itertools.count()

    def interrupt(*arguments):
        if next(calls) in (0, 11):
            raise KeyboardInterrupt
        return evaluate(*arguments)

    with monkeypatch.context() as patch:
        patch.setattr(tuning, "evaluate", interrupt)
        for expected in (0, 10):
            with pytest.raises(KeyboardInterrupt):
                tune("mmc", 12, STEPS, parts, lambda number, _: seen.append(number))
            assert len(complete(parts)) == expected
    for trials in (11, 12):
        result = tune("mmc", trials, STEPS, parts, lambda number, _: seen.append(number))
    assert result == json.loads((parts / "mmc.json").read_text())
    assert (parts / "mmc.json").read_bytes() == (whole / "mmc.json").read_bytes()
    assert seen == list(range(12))
    trials = complete(whole)
    assert complete(parts) == trials
    parameters = [parameters for parameters, _ in trials]
    assert not any(first == second for first, second in itertools.combinations(parameters, 2))


def test_the_first_trial_has_the_constants_in_use_which_are_those_of_the_agent(tmp_path):
    result = tune("mmc", 1, 20_000, tmp_path)
    assert result["best"] == result["in_use"] == IN_USE
    assert 0.5 < result["best_value"] < 0.9  # arriving takes half a second of two
    target = find_target("mmc")
    constants = target.space(optuna.trial.FixedTrial(target.in_use))
    where = ("MMCReach-v0", {"perturbations": ["rotation-30"]}, 20, 5)
    expected = evaluate(lambda interface: make_agent("mmc", gym.make("MMCReach-v0")), *where)
    assert evaluate(partial(tuning.make_network_agent, constants), *where) == expected


@pytest.mark.parametrize(
    ("name", "keys", "in_use"),
    [
        ("ppo", "ent_coef: 0.5, batch_size: 77", {"ent_coef": 0.5, "batch_size": 77}),
        ("ppo", "learning_rate: lin_1.2345e-5", {"learning_rate": "lin_1.2345e-05"}),
        ("sac", "", {"learning_rate": 3e-4, "target_entropy": "auto", "ent_coef": "auto"}),
        ("tqc", "ent_coef: 0.2, tau: 0.5", {"ent_coef": 0.2, "tau": 0.5, "batch_size": 256}),
    ],
)
def test_your_own_file_is_tuned_around_what_it_has(name, keys, in_use, tmp_path, monkeypatch):
    """Each trial is judged better than the one before, untrained."""
    tried = []

    def judge(recipe, constants, steps):
        _ = recipe.with_changes(**constants, n_timesteps=steps).settings  # can be trained with
        tried.append(constants)
        return len(tried)

    monkeypatch.setattr(tuning, "judge_training", judge)
    path = tmp_path / f"{name}-x.yml"
    path.write_text(f"MMCReach-v0: {{n_timesteps: 9, policy: MlpPolicy, {keys}}}\n")
    result = tune(str(path), 2, 1_000, tmp_path / "out")
    assert result["name"] == f"{name}-x"
    assert in_use.items() <= result["in_use"].items()
    assert (result["in_use"], result["best"]) == (tried[0], tried[-1])
    assert (tmp_path / "out" / f"{name}-x.json").exists()


@pytest.mark.slow
def test_a_training_is_tuned(tmp_path):
    result = tune("tqc-her", 1, 3_264, tmp_path)
    assert 0.0 <= result["best_value"] <= 1.0
    assert set(result["best"]) >= {"learning_rate", "gamma", "batch_size", "ent_coef"}


def test_the_command_prints_trials_and_bad_input_or_a_damaged_journal_is_an_error(tmp_path, capsys):
    with pytest.raises(UserError, match="trials and steps must be at least 1, got 1 and 0"):
        tune("mmc", 1, 0, tmp_path)
    tuning.main("mmc", 1, STEPS, tmp_path)
    first, last = capsys.readouterr().out.splitlines()
    assert first.startswith("trial   0  time at target ")
    assert "'iterations_per_step': 3" in last and last.endswith("with the constants in use")
    journal = tmp_path / "mmc.journal"
    written = journal.read_bytes()
    for old, new in ((b"op_code", b"op_cove"), (b":", b"\xff"), (b"{", b"")):
        journal.write_bytes(written.replace(old, new, 1))
        with pytest.raises(UserError, match=r"mmc\.journal is no journal of Optuna, or is damaged"):
            tune("mmc", 2, STEPS, tmp_path)
