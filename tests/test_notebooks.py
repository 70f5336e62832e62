"""The notebooks run as they stand, keep no outputs, and have a link that opens them."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[1] / "examples" / "notebooks"
NOTEBOOKS = sorted(path.name for path in FOLDER.glob("*.ipynb"))
SHOWS = {
    "an_adaptation_experiment.ipynb": "short-savings.trials.csv",
    "quickstart.ipynb": "success at the end: mmc 0.0 %, ppo",
    "reproduce_the_paper.ipynb": "kinematic/kinematic_distance.png",
    "the_network_explained.ipynb": "eigenvalues [0. 0. 0. 4. 4. 4.]",
    "train_and_compare.ipynb": "ppo-1.safetensors",
}


def cells_of(path, kind="code"):
    return [one for one in json.loads(path.read_text())["cells"] if one["cell_type"] == kind]


@pytest.mark.slow
@pytest.mark.parametrize("name", NOTEBOOKS)
def test_a_notebook_runs_and_shows_figures(name, tmp_path):
    pytest.importorskip("nbmake")
    shutil.copy(FOLDER / name, tmp_path)  # in a folder that takes what it writes
    options = ["--nbmake", "--overwrite", "--nbmake-timeout=300", "-p", "no:cacheprovider"]
    # A notebook draws into itself unless another backend is asked for.
    environment = {key: value for key, value in os.environ.items() if key != "MPLBACKEND"}
    command = [sys.executable, "-m", "pytest", *options, name]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout
    outputs = [one for cell in cells_of(tmp_path / name) for one in cell["outputs"]]
    assert any("image/png" in one.get("data", ()) for one in outputs)
    texts = {kind: "" for kind in ("stdout", "stderr")}
    for one in outputs:
        if one["output_type"] == "stream":
            texts[one["name"]] += "".join(one["text"])
    assert SHOWS[name] in texts["stdout"]
    assert not texts["stderr"]


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_a_notebook_keeps_no_outputs_and_its_badge_opens_it(name):
    for cell in cells_of(FOLDER / name):
        assert cell["outputs"] == [] and cell["execution_count"] is None
    first = "".join(cells_of(FOLDER / name, "markdown")[0]["source"])
    assert first.startswith("# ")
    assert f"/blob/main/examples/notebooks/{name})" in first
