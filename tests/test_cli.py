"""The commands, as a user types them."""

import os
import signal
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path
from unittest.mock import Mock

import pytest

from mmc_gym._grid import CellError
from mmc_gym.cli import COMMANDS, main

ROOT = Path(__file__).resolve().parents[1]
ENV_KWARGS = ["compare", "--agents", "mmc", "--env-kwargs"]


def stop(arguments, status, capsys):
    """Return the error lines of a command that ends with this status."""
    with pytest.raises(SystemExit) as stopped:
        main(arguments)
    assert stopped.value.code == status
    return capsys.readouterr().err.strip().splitlines()


def test_train_takes_your_own_file_and_resumes(tmp_path, capsys):
    path, folder = tmp_path / "ppo-mine.yml", tmp_path / "run"
    entry = "{n_timesteps: 1, policy: MlpPolicy, policy_kwargs: {net_arch: [8]}, n_steps: 64}"
    path.write_text(f"CartPole-v1: {{n_timesteps: 1}}\nMMCReach-v0: {entry}\n")
    command = ["train", str(path), "--env", "MMCReach-v0", "--out", str(folder)]
    main([*command, "--resume"])
    said = capsys.readouterr()
    assert "nothing to resume, as there is no" in said.err
    assert "ppo-mine-0.safetensors: success" in said.out
    first = (folder / "ppo-mine-0.safetensors").read_bytes()
    assert "resume" in stop(command, 2, capsys)[-1]
    main([*command, "--resume"])
    assert (folder / "ppo-mine-0.safetensors").read_bytes() == first
    assert "nothing to resume" not in capsys.readouterr().err


def test_a_cell_that_fails_is_one_line_unless_all_is_asked_for(monkeypatch, capsys):
    error = CellError(3, "cell", ValueError("the first line\nthe second"))
    monkeypatch.setattr("mmc_gym.benchmark.runner.benchmark", Mock(side_effect=error))
    line = stop(["benchmark"], 1, capsys)[-1]
    assert line.startswith("mmc-gym: cell 3, 'cell', failed: ValueError: the first line (")
    monkeypatch.setenv("MMC_GYM_TRACEBACK", "1")
    with pytest.raises(CellError):
        main(["benchmark"])


def test_an_interruption_is_one_line(monkeypatch, capsys):
    monkeypatch.setattr("mmc_gym.report.write_report", Mock(side_effect=KeyboardInterrupt()))
    assert stop(["report"], 130, capsys) == ["mmc-gym: interrupted"]
    monkeypatch.setattr("mmc_gym.report.write_report", Mock(side_effect=ValueError("a defect")))
    with pytest.raises(ValueError, match="a defect"):  # not the user's: it has its traceback
        main(["report"])


def heed_ctrl_c():
    """Let a child be interrupted, also where its parents ignore Ctrl-C (jobs in the background)."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@pytest.mark.skipif(os.name != "posix", reason="signals")
@pytest.mark.parametrize("module", ["gymnasium", "tyro", "pyarrow"])
@pytest.mark.parametrize("becomes", ["KeyboardInterrupt", "ImportError"])
def test_an_interruption_while_importing_is_one_line(module, becomes, tmp_path):
    # As Ctrl-C in the middle of an import, of which some libraries make another error.
    code = "import os, signal\n"
    code += "try: os.kill(os.getpid(), signal.SIGINT), signal.pause()\n"
    code += f"except KeyboardInterrupt: raise {becomes} from None\n"
    (tmp_path / f"{module}.py").write_text(code)
    paths = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), str(ROOT)])}
    command = [sys.executable, "-m", "mmc_gym.cli", "benchmark", "--out", str(tmp_path / "store")]
    run = {"start_new_session": True, "preexec_fn": heed_ctrl_c, "timeout": 120}
    done = subprocess.run(command, capture_output=True, text=True, env=paths, **run)
    assert (done.returncode, done.stderr) == (130, "mmc-gym: interrupted\n")


@pytest.mark.skipif(os.name != "posix", reason="signals")
def test_a_script_that_imports_the_package_has_its_own_interruptions():
    code = "import signal, mmc_gym, mmc_gym.cli\n"
    code += "assert signal.getsignal(signal.SIGINT) is signal.default_int_handler"
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT, preexec_fn=heed_ctrl_c)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("train dqn", "name 'dqn' is not accepted. It may be a2c, "),
        ("train ppo --on pursuit", "on must be perturbations; a task is named by --env"),
        ("train my/dqn.yml", "mmc-gym: my/dqn.yml: No such file or directory"),
        ("list agents --import ../..", "import must be the name of a module"),
        ("compare --episodes 9999999", "episodes must be at most 1000000, got 9999999"),
        ([*ENV_KWARGS, "x=2020-99-99"], "month must be in 1..12"),
        ([*ENV_KWARGS, "a b=3"], "env-kwargs must be NAME=VALUE with a value in YAML"),
        ([*ENV_KWARGS, "control=["], "env-kwargs must be NAME=VALUE with a value in YAML"),
        ([*ENV_KWARGS, "x=1", "x=2"], "env-kwargs must be given once for x, got 'x=2'"),
        ("compar", "command 'compar' is not accepted; did you mean 'compare'?"),
        ("compare --agnts mmc", "option of compare '--agnts' is not accepted; did you mean '--ag"),
        ("compare mmc", "must be followed by options, got 'mmc'; did you mean --agents mmc?"),
        ("play --agents mmc ppo", "--agents must be exactly one here, got mmc ppo"),
        ("compare --agents mmc --focus ppo", "focus 'ppo' is not accepted. It may be mmc"),
        ("compare --agents mmc --scenarios NoSuchEnv-v0", "NoSuchEnv-v0"),
        ("show rotatoin-30", "did you mean 'rotation-30'?"),
        ("record --out film.avi", "out must be a file that ends in .gif or .mp4, got 'film.avi'"),
        ("record --scenarios CartPole-v1", "env must be a reaching environment"),
        ("record --episodes 0", "episodes must be a whole number of at least 1, got 0"),
        ("report /nowhere", "folder must hold a benchmark's or an experiment's store, got"),
        ("benchmark --jobs 0", "jobs must be a whole number of at least 1, got 0"),
        ("benchmark --cluster dask", "cluster must be"),
        (f"benchmark --out {__file__}", "out must be a folder"),
        ("play --agents nobody", "'nobody' is not accepted"),
        ("play --scenarios Pendulum-v1", "env must be a reaching environment"),
    ],
)
def test_mistakes_end_with_one_line_that_says_what_was_meant(arguments, message, capsys):
    words = arguments.split() if isinstance(arguments, str) else arguments
    (line,) = stop(words, 2, capsys)
    assert message in line


@pytest.mark.parametrize("command", COMMANDS)
def test_the_help_of_a_command_fits_a_screen_and_names_no_empty_default(command, capsys):
    with pytest.raises(SystemExit):
        main([command, "--help"])
    text = capsys.readouterr().out
    assert "(default: )" not in text and "None" not in text and "STR" not in text
    assert len(text.splitlines()) <= 40


def test_a_failed_cell_of_the_benchmark_is_the_last_line_and_the_exit_status(
    tmp_path, capsys, monkeypatch
):
    (tmp_path / "failing24.py").write_text("def agent(env): 1 / 0\n")
    monkeypatch.syspath_prepend(tmp_path)
    agents = ["--agents", "mmc", "failing24:agent", "--out", str(tmp_path / "store")]
    command = ["benchmark", "--scenarios", "random", "--episodes", "2", "--jobs", "1", *agents]
    assert stop(command, 1, capsys)[-1].startswith(
        "mmc-gym: a cell failed, and counts as no success: failing24:agent in random: ZeroDiv"
    )


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="has no full disk to write to")
@pytest.mark.parametrize("command", ["--version", "list tasks", "--help"])
def test_a_full_disk_under_the_output_is_one_line(command):
    script = f"{sys.executable} -m mmc_gym.cli {command} >/dev/full"
    buffered = {**os.environ, "PYTHONUNBUFFERED": ""}
    done = subprocess.run(script, shell=True, capture_output=True, text=True, env=buffered)
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
