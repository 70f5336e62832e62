"""Measures of users, registered in a module and in a script, in all that shows measures."""

import subprocess
import sys

import pandas as pd
import pytest

from mmc_gym.benchmark.compare import compare
from mmc_gym.benchmark.store import read_episodes, read_manifest
from mmc_gym.measures import measure
from mmc_gym.report import write_report

MODULE = """
from mmc_gym.measures import measure

@measure(label="steps to move", shown=True)
def steps_to_move(episode):
    return float((episode.speeds > 0).argmax())
"""

SCRIPT = """
import sys
from pathlib import Path
import my_measures
from mmc_gym.benchmark.runner import benchmark
from mmc_gym.measures import measure

@measure(label="half-way time", unit="s", best="low", shown=True, successes_only=True)
def half_way_time(episode):
    return int((episode.distances <= episode.distances[0] / 2).argmax()) * episode.control_step

if __name__ == "__main__":
    cluster = sys.argv[2] if len(sys.argv) > 2 else None
    benchmark(["mmc", "ik-dls"], Path(sys.argv[1]), ["random"], 3, jobs=2, cluster=cluster)
"""


@pytest.mark.usefixtures("forget_what_is_registered")
def test_a_comparison_has_a_column_and_a_row_for_it(tmp_path, capsys):
    @measure(label="kinetic energy", unit="J", best="low", shown=True)
    def energy(episode):
        return float((episode.speeds**2).sum())

    print(compare(["random"], episodes=2, out=tmp_path))
    assert pd.read_csv(tmp_path / "episodes.csv")["energy"].gt(0).all()
    assert set(pd.read_csv(tmp_path / "summary.csv").query("measure == 'energy'")["unit"]) == {"J"}
    assert "kinetic energy" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize("cluster", [None, "ray"])
def test_workers_take_the_measures_of_modules_and_scripts(tmp_path, monkeypatch, cluster):
    if cluster == "ray":
        pytest.importorskip("ray")
    monkeypatch.setenv("RAY_ADDRESS", "local")
    monkeypatch.setenv("RAY_TMPDIR", "/tmp")  # short enough for the names of sockets
    monkeypatch.setenv("GRPC_ENABLE_FORK_SUPPORT", "0")
    (tmp_path / "my_measures.py").write_text(MODULE)
    (tmp_path / "script.py").write_text(SCRIPT)
    store = tmp_path / "store"
    command = [sys.executable, str(tmp_path / "script.py"), str(store), *filter(None, [cluster])]
    subprocess.run(command, check=True, timeout=300)
    episodes = read_episodes(store)
    assert episodes["steps_to_move"].notna().all() and episodes["half_way_time"].gt(0).all()
    assert read_manifest(store).measures["half_way_time"]["unit"] == "s"
    # A report needs the store alone, not the code of the measures.
    page = write_report(store, store / "report.html", resamples=50).read_text()
    assert "half-way time" in page and "steps to move" in page
    if cluster is None:
        changed = MODULE.replace("float((episode.speeds > 0).argmax())", "-1.0")
        (tmp_path / "my_measures.py").write_text(changed)
        subprocess.run(command, check=True, timeout=300)
        assert read_episodes(store)["steps_to_move"].eq(-1).all()  # it is taken anew
