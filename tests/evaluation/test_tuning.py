"""Tuning: the same trials at every run, resumable, and what is in use comes first."""

import json

import pytest

from mmc_gym.evaluation.tuning import TUNING_SEED, tune


def test_tuning_the_network_is_repeatable_and_goes_on(tmp_path):
    whole = tune("mmc", 4, 2_000, tmp_path / "whole")
    again = tune("mmc", 4, 2_000, tmp_path / "again")
    assert whole == again
    first = tune("mmc", 2, 2_000, tmp_path / "parts")
    seen: list[int] = []
    on = tune("mmc", 4, 2_000, tmp_path / "parts", lambda number, value: seen.append(number))
    assert (first["trials"], on["trials"]) == (2, 4)
    assert seen == [2, 3]
    assert json.loads((tmp_path / "parts" / "mmc.json").read_text()) == on


def test_the_first_trial_has_the_constants_in_use(tmp_path):
    result = tune("mmc", 1, 20_000, tmp_path)
    assert result["best"] == {
        "damping": 4.0,
        "velocity_damping": 5.0,
        "velocity_decay": 0.92,
        "iterations_per_step": 3,
    }
    assert result["best_value"] == result["value_of_those_in_use"]
    assert 0.5 < result["best_value"] < 0.9  # arriving takes half a second of two


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
