"""The commands, as a user types them."""

import subprocess
import sys
from pathlib import Path

import pytest

from mmc_gym.cli import main


def test_compare_writes_data_and_figure(tmp_path, capsys):
    main(["compare", "--agents", "mmc", "random", "--episodes", "3", "--out", str(tmp_path)])
    assert "mmc" in capsys.readouterr().out
    written = {path.name for path in tmp_path.iterdir()}
    assert {"episodes.csv", "summary.csv", "paths_and_profiles.png"} <= written


def test_train_and_resume(tmp_path, capsys):
    folder = str(tmp_path / "run")
    main(["train", "ppo", "--steps", "1", "--out", folder])
    first = (Path(folder) / "ppo-0.safetensors").read_bytes()
    assert "success" in capsys.readouterr().out
    with pytest.raises(SystemExit) as stop:
        main(["train", "ppo", "--steps", "1", "--out", folder])
    assert stop.value.code == 2
    assert "resume" in capsys.readouterr().err
    main(["train", "ppo", "--steps", "1", "--out", folder, "--resume"])
    assert (Path(folder) / "ppo-0.safetensors").read_bytes() == first


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["compare", "--agents", "mcc"], "mcc"),
        (["compare", "--episodes", "0"], "episodes"),
        (["train", "dqn"], "name must be one of ppo, "),
        (["train"], "or else give --all"),
        (["train", "ppo", "--all"], "or else give --all"),
        (["train", "ppo", "--env", "MMCReachGoal-v0"], "env must be one of MMCReach-v0"),
        (["train", "--all", "--cluster", "slurm"], "cluster must be 'ray'"),
        (["tune", "mmc", "--trials", "0"], "trials must be at least 1"),
        (["play", "--agent", "mcc"], "mcc"),
    ],
)
def test_mistakes_end_with_one_line_that_names_them(arguments, message, capsys):
    with pytest.raises(SystemExit) as stop:
        main(arguments)
    assert stop.value.code == 2
    error = capsys.readouterr().err
    assert message in error
    assert "Traceback" not in error


def test_help_does_not_import_torch():
    code = (
        "import sys; from mmc_gym.cli import main\n"
        "try: main(['--help'])\n"
        "except SystemExit: print('torch' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "compare" in done.stdout
    assert done.stdout.strip().endswith("False")
