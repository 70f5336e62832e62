"""The commands, as a user types them."""

import os
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path
from unittest.mock import Mock

import pytest

from mmc_gym._grid import CellError
from mmc_gym.cli import _commands, main

ENV_KWARGS = ["compare", "--agents", "mmc", "--env-kwargs"]


def test_train_takes_your_own_file_and_resumes(tmp_path, capsys):
    path, folder = tmp_path / "ppo-mine.yml", tmp_path / "run"
    path.write_text(
        "CartPole-v1: {n_timesteps: 1, policy: MlpPolicy}\n"
        "MMCReach-v0: {n_timesteps: 1, policy: MlpPolicy, policy_kwargs: {net_arch: [8]}, "
        "n_steps: 64}\n"
    )
    command = ["train", str(path), "--env", "MMCReach-v0", "--out", str(folder)]
    main([*command, "--resume"])
    said = capsys.readouterr()
    nothing = f"nothing to resume, as there is no {folder / 'checkpoint.safetensors'}"
    assert nothing in said.err and "ppo-mine-0.safetensors: success" in said.out
    first = (folder / "ppo-mine-0.safetensors").read_bytes()
    with pytest.raises(SystemExit) as stop:
        main(command)
    assert stop.value.code == 2
    assert "resume" in capsys.readouterr().err
    main([*command, "--resume"])
    assert (folder / "ppo-mine-0.safetensors").read_bytes() == first
    assert "nothing to resume" not in capsys.readouterr().err


def test_a_cell_that_fails_is_one_line_unless_all_is_asked_for(monkeypatch, capsys):
    error = CellError(3, "cell", ValueError("the first line\nthe second"))
    monkeypatch.setattr("mmc_gym.benchmark.runner.benchmark", Mock(side_effect=error))
    with pytest.raises(SystemExit) as stop:
        main(["benchmark"])
    assert stop.value.code == 1
    (line,) = capsys.readouterr().err.strip().splitlines()[-1:]
    assert line.startswith("mmc-gym: cell 3, 'cell', failed: ValueError: the first line (")
    monkeypatch.setenv("MMC_GYM_TRACEBACK", "1")
    with pytest.raises(CellError):
        main(["benchmark"])


def test_an_interruption_is_one_line(monkeypatch, capsys):
    monkeypatch.setattr("mmc_gym.report.write_report", Mock(side_effect=KeyboardInterrupt()))
    with pytest.raises(SystemExit) as stop:
        main(["report"])
    assert stop.value.code == 130
    assert capsys.readouterr().err == "mmc-gym: interrupted\n"
    monkeypatch.setattr("mmc_gym.report.write_report", Mock(side_effect=ValueError("a defect")))
    with pytest.raises(ValueError, match="a defect"):  # not the user's: it has its traceback
        main(["report"])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["train", "dqn"], "name 'dqn' is not accepted. It may be a2c, "),
        (["train", "ppo", "--on", "pursuit"], "on must be perturbations; a task is named by --env"),
        (["train", "my/dqn.yml"], "mmc-gym: my/dqn.yml: No such file or directory"),
        (["list", "agents", "--import", "../.."], "import must be the name of a module"),
        (["compare", "--episodes", "9" * 20], f"episodes must be at most 1000000, got {'9' * 20}"),
        ([*ENV_KWARGS, "x=2020-99-99"], "month must be in 1..12"),
        *(
            ([*ENV_KWARGS, text], "env-kwargs must be NAME=VALUE with a value in YAML")
            for text in ("control", "=3", "a b=3", "control=[")
        ),
        ([*ENV_KWARGS, "x=1", "x=2"], "env-kwargs must be given once for x, got 'x=2'"),
        ("compar", "command 'compar' is not accepted; did you mean 'compare'?"),
        ("compare --agnts mmc", "option of compare '--agnts' is not accepted; did you mean '--ag"),
        ("compare mmc", "must be followed by options, got 'mmc'; did you mean --agents mmc?"),
        ("play --agents mmc ppo", "--agents must be exactly one here, got mmc ppo"),
        ("compare --agents mmc --focus ppo", "focus 'ppo' is not accepted. It may be mmc"),
    ],
)
def test_mistakes_end_with_one_line_that_says_what_was_meant(arguments, message, capsys):
    with pytest.raises(SystemExit) as stop:
        main(arguments.split() if isinstance(arguments, str) else arguments)
    assert stop.value.code == 2
    error = capsys.readouterr().err
    assert message in error and len(error.splitlines()) == 1


@pytest.mark.parametrize("command", _commands)
def test_the_help_of_a_command_fits_a_screen_and_names_no_empty_default(command, capsys):
    with pytest.raises(SystemExit):
        main([command, "--help"])
    text = capsys.readouterr().out
    assert "(default: )" not in text and "None" not in text and "STR" not in text
    assert len(text.splitlines()) <= 40


def test_a_failed_cell_of_the_benchmark_is_the_last_line_and_the_exit_status(
    tmp_path, capsys, monkeypatch
):
    (tmp_path / "dying24.py").write_text(
        "import os\nclass Dying:\n    def __init__(self, env): os._exit(9)\n"
        "    def predict(self, *_, **__): pass\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    agents = ["--agents", "mmc", "dying24:Dying", "--out", str(tmp_path / "store")]
    with pytest.raises(SystemExit) as stop:
        main(["benchmark", "--scenarios", "random", "--episodes", "2", "--jobs", "2", *agents])
    assert stop.value.code == 1
    last = capsys.readouterr().err.splitlines()[-1]
    assert last.startswith(
        "mmc-gym: a cell failed, and counts as no success: dying24:Dying in random: its process"
    )


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="has no full disk to write to")
@pytest.mark.parametrize("command", ["--version", "list tasks", "--help"])
def test_a_full_disk_under_the_output_is_one_line(command):
    script = f"{sys.executable} -m mmc_gym.cli {command} >/dev/full"
    buffered = {**os.environ, "PYTHONUNBUFFERED": ""}
    done = subprocess.run(
        script, shell=True, stderr=subprocess.PIPE, text=True, check=False, env=buffered
    )
    assert done.returncode == 2
    assert done.stderr == "mmc-gym: standard output: No space left on device\n"


def test_version_and_completion_are_printed_and_help_says_so(capsys):
    main(["--version"])
    assert capsys.readouterr().out == f"mmc-gym {version('mmc-gym')}\n"
    with pytest.raises(SystemExit):
        main(["--help"])
    assert "--version" in capsys.readouterr().out

    with pytest.raises(SystemExit):
        main(["--tyro-print-completion", "bash"])  # for a shell
    script = capsys.readouterr().out
    assert "record" in script and "--episodes" in script
