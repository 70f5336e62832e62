"""The commands, as a user types them."""

import subprocess
import sys
from importlib.metadata import version

import pytest

from mmc_gym._grid import CellError
from mmc_gym.cli import main


def test_compare_writes_data_and_figure(tmp_path, capsys):
    main(["compare", "--agents", "mmc", "random", "--episodes", "3", "--out", str(tmp_path)])
    assert "mmc" in capsys.readouterr().out
    written = {path.name for path in tmp_path.iterdir()}
    assert {"episodes.csv", "summary.csv", "paths_and_profiles.png"} <= written


def test_train_takes_your_own_file_and_resumes(tmp_path, capsys):
    path, folder = tmp_path / "ppo-mine.yml", tmp_path / "run"
    path.write_text(
        "CartPole-v1: {n_timesteps: 1, policy: MlpPolicy}\n"
        "MMCReach-v0: {n_timesteps: 1, policy: MlpPolicy, policy_kwargs: {net_arch: [8]}, "
        "n_steps: 64}\n"
    )
    command = ["train", str(path), "--env", "MMCReach-v0", "--out", str(folder)]
    main(command)
    assert "ppo-mine-0.safetensors: success" in capsys.readouterr().out
    first = (folder / "ppo-mine-0.safetensors").read_bytes()
    with pytest.raises(SystemExit) as stop:
        main(command)
    assert stop.value.code == 2
    assert "resume" in capsys.readouterr().err
    main([*command, "--resume"])
    assert (folder / "ppo-mine-0.safetensors").read_bytes() == first


def test_a_cell_that_fails_is_one_line_unless_all_is_asked_for(monkeypatch, capsys):
    def fail(*arguments, **options):
        raise CellError(3, "cell", "ValueError: the first line\nthe second")

    monkeypatch.setattr("mmc_gym.training.training.train_all", fail)
    with pytest.raises(SystemExit) as stop:
        main(["train", "--all"])
    assert stop.value.code == 1
    (line,) = capsys.readouterr().err.strip().splitlines()[-1:]
    assert line.startswith("mmc-gym: cell 3, 'cell', failed: ValueError: the first line (")
    monkeypatch.setenv("MMC_GYM_TRACEBACK", "1")
    with pytest.raises(CellError):
        main(["train", "--all"])


def test_an_error_that_is_not_the_users_keeps_its_traceback(monkeypatch):
    def fail(*arguments, **options):
        raise ValueError("a defect")

    monkeypatch.setattr("mmc_gym.report.write_report", fail)
    with pytest.raises(ValueError, match="a defect"):
        main(["report"])


def test_an_interruption_is_one_line(monkeypatch, capsys):
    def interrupt(*arguments, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr("mmc_gym.report.write_report", interrupt)
    with pytest.raises(SystemExit) as stop:
        main(["report"])
    assert stop.value.code == 130
    assert capsys.readouterr().err == "mmc-gym: interrupted\n"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["compare", "--agents", "mcc"], "mcc"),
        (["compare", "--episodes", "0"], "episodes"),
        (["train", "dqn"], "name 'dqn' is not accepted. It may be ppo, "),
        (["train"], "or else give --all"),
        (["train", "ppo", "--all"], "or else give --all"),
        (["train", "ppo", "--env", "MMCReachGoal-v0"], "env for ppo 'MMCReachGoal-v0' is not"),
        (["train", "--all", "--cluster", "slurm"], "cluster must be 'ray'"),
        (["train", "my/dqn.yml"], "No such file or directory: 'my/dqn.yml'"),
        (["train", "ppo", "--steps", "0"], "n_timesteps must be at least 1, got 0"),
        (["train", "ppo", "--device", "foo"], "device must be one that PyTorch can use here"),
        (["train", "ppo", "--out", __file__], "out must be a folder, got the file"),
        (["train", "ppo", "--cluster", "ray"], "--cluster is for --all only, got ray"),
        (["train", "--all", "--jobs", "-3"], "jobs must be a whole number of at least 1, got -3"),
        (["train", "--all", "--seed", "3"], "--seed is for a single training only, got 3"),
    ],
)
def test_mistakes_end_with_one_line_that_names_them(arguments, message, capsys):
    with pytest.raises(SystemExit) as stop:
        main(arguments)
    assert stop.value.code == 2
    error = capsys.readouterr().err
    assert message in error
    assert "Traceback" not in error


def test_the_version_is_printed_and_help_says_so(capsys):
    main(["--version"])
    assert capsys.readouterr().out == f"mmc-gym {version('mmc-gym')}\n"
    with pytest.raises(SystemExit):
        main(["--help"])
    assert "--version" in capsys.readouterr().out


def test_a_shell_completes_commands_and_options(capsys):
    with pytest.raises(SystemExit) as stop:
        main(["--tyro-print-completion", "bash"])
    script = capsys.readouterr().out
    assert not stop.value.code and "record" in script and "--episodes" in script


def test_help_does_not_import_torch():
    code = (
        "import sys; from mmc_gym.cli import main\n"
        "try: main(['--help'])\n"
        "except SystemExit: print('torch' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "compare" in done.stdout
    assert done.stdout.strip().endswith("False")
