"""Every example and notebook shows what it says."""

import json
import re
import runpy
import shutil
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import pytest

from tests.processes import run_python

FOLDER = Path(__file__).parents[1] / "examples"
EXAMPLES = sorted(path.relative_to(FOLDER).as_posix() for path in FOLDER.rglob("*.py"))

# What each prints.
SHOWS = {
    "bring_your_own.py": r"success at the end: still 0\.0 %, turner 0\.0 %, mmc 100\.0 %",
    "panda_reach.py": r"(?m)^success at the end .* 1\.000 +1\.000",
    "reacher.py": r"success at the end: mmc-body 100\.0 %, ik-body 100\.0 %",
    "plain_torch.py": r"9[5-9]\.\d% of the targets after",
    "adaptation/plot_error_clamp.py": r"3\.75°: .* \d°.*7\.5°: .* 1\d°.*15°: .* [34]\d°",
    "adaptation/plot_generalisation.py": r"-22\.5: 2\d\.\d, 0\.0: 2\d\.\d, 22\.5: 2",
    "adaptation/plot_rotation_and_washout.py": r"asymptote +2\d\.\d+ +\d+\.",
    "arm/plot_a_movement.py": r"the hand is 0\.0\d+ segment lengths from its target",
    "arm/plot_contact_sheet.py": r"\d+ tasks, \d+ perturbations",
    "arm/plot_locked_joint.py": r"mmc: [12]\d% .*\nmmc-body: [6-9]\d%",
    "arm/plot_million_arms.py": r"1,000,000 networks.*4\d\.\d% of 2,000 arms",
    "arm/plot_own_task.py": r"mmc: 0\.2\d segment lengths behind.*ppo: 0\.0\d",
    "bodies/plot_longer_reacher.py": r"mmc-body: 0\.[0-4] mm .*ik-dls: 2\d\.\d mm",
    "bodies/plot_locked_panda.py": r"mmc-body: .* is 0\.00\d m .*loops: .* is 0\.0[5-9]",
    "bodies/plot_settling_in_space.py": r"[67] of 8 hands within 1 mm.*by up to [4-6]\.",
    "comparing/plot_benchmark_with_pandas.py": r"rotation-10 +0\.0+ +0\.0+ +(1\.0|0\.[89])",
    "comparing/plot_mmc_ik_rl.py": r"success +1\.00 +1\.00 +1\.00 +1\.00",
    "comparing/plot_own_agent.py": r"mine +0\.\d+ +0\.\d+ +1\.\d+ +\d",
    "comparing/plot_own_measure.py": r"half_way_time.*minimum-jerk +0\.[3-6]",
    "learning/plot_backpropagation.py": r" 0: 9\d % .*: [12]?\d %.*(0\.2: [89]\d %.*){2}",
    "learning/plot_curriculum.py": r"trained up to [6-9]0°; 0°: (9\d|100)%, 60°: [6-9]\d%",
    "learning/plot_her.py": r"[6-9]\d% of the targets after 14,400 steps",
    "learning/plot_learning_curves.py": r"'ppo': 10.*by the seed alone",
    "learning/plot_normalizer_in_the_loop.py": r"240 epochs: hands 0\.1.*work: hands 0\.0",
    "learning/plot_plain_sb3.py": r"9[5-9]\.\d% of the targets after",
    "learning/plot_residual.py": r"ppo-residual: 100% of the targets.*ppo: \d% of the targets",
    "network/plot_learned_normalizer.py": r"shipped: mean angle error 0\.000\d°, hand 0\.000",
    "network/plot_longer_arms.py": r"N = 2: 3 vectors, 1\d iter.*N = 10: 55 vectors, 2\d\d iter",
    "network/plot_one_iteration.py": r"L1: now \[0\.96 0\.3 \], .* say \[0\.96 0\.3 \] and \[-1",
    "network/plot_population_code.py": r"tuning width: 1\d\d° to 1\d\d°",
    "network/plot_redundancy.py": r"9\d% of 500 arms end at the target",
    "network/plot_three_tasks.py": r"forward: end effector R \[-1\. +1\.5\]",
    "network/plot_velocity_profiles.py": r"kinematic: fastest in iteration 1,.*time base: .* 2\d,",
}


@pytest.fixture
def nothing_is_left(forget_what_is_registered):
    """Remove what an example registers and draws, and what other tests have drawn."""
    plt.close("all")
    yield
    plt.close("all")


def has_labels(axes):
    """Return whether both axes have a label: their own, of a shared panel, or of the figure."""
    x = [panel.get_xlabel() for panel in axes.get_shared_x_axes().get_siblings(axes)]
    y = [panel.get_ylabel() for panel in axes.get_shared_y_axes().get_siblings(axes)]
    figure = axes.figure
    is_bar = axes.get_label() == "<colorbar>"
    return any((*x, figure.get_supxlabel(), is_bar)) and any((*y, figure.get_supylabel()))


@pytest.mark.slow
@pytest.mark.parametrize("example", EXAMPLES)
def test_an_example_shows_what_it_says(example, nothing_is_left, tmp_path, monkeypatch, capsys):
    if example == "panda_reach.py":
        pytest.importorskip("panda_gym")  # pybullet has wheels for few versions of Python
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [example])
    monkeypatch.setattr(plt, "show", lambda: None)
    runpy.run_path(str(FOLDER / example), run_name="__main__")
    assert re.search(SHOWS[example], capsys.readouterr().out, re.DOTALL)
    assert not list(tmp_path.iterdir())
    figures = [plt.figure(number) for number in plt.get_fignums()]
    assert bool(figures) == Path(example).name.startswith("plot_")
    assert all(has_labels(axes) for figure in figures for axes in figure.axes if axes.axison)


NOTEBOOK_FOLDER = FOLDER / "notebooks"
NOTEBOOKS = sorted(path.name for path in NOTEBOOK_FOLDER.glob("*.ipynb"))
# What each prints.
NOTEBOOK_SHOWS = {
    "an_adaptation_experiment.ipynb": "short-savings.trials.csv",
    "quickstart.ipynb": "success at the end: mmc 0.0 %, ppo",
    "reproduce_the_paper.ipynb": "kinematic/kinematic_distance.png",
    "the_network_explained.ipynb": "eigenvalues [0. 0. 0. 4. 4. 4.]",
    "train_and_compare.ipynb": "ppo-1.safetensors",
}


def outputs_of(path):
    """Return what the cells of a notebook have printed and drawn."""
    cells = json.loads(path.read_text())["cells"]
    return [output for cell in cells for output in cell.get("outputs", ())]


@pytest.mark.slow
@pytest.mark.parametrize("name", NOTEBOOKS)
def test_a_notebook_runs_and_shows_figures(name, tmp_path):
    pytest.importorskip("nbmake")
    assert outputs_of(NOTEBOOK_FOLDER / name) == []  # none are kept
    shutil.copy(NOTEBOOK_FOLDER / name, tmp_path)  # in a folder that takes what it writes
    options = ["--nbmake", "--overwrite", "--nbmake-timeout=300", "-p", "no:cacheprovider"]
    # A notebook draws into itself unless another backend is asked for.
    run_python("-m", "pytest", *options, name, folder=tmp_path, without={"MPLBACKEND"})
    outputs = outputs_of(tmp_path / name)
    assert any("image/png" in output.get("data", ()) for output in outputs)
    streams = [output for output in outputs if output["output_type"] == "stream"]
    assert NOTEBOOK_SHOWS[name] in "".join("".join(stream["text"]) for stream in streams)
    assert {stream["name"] for stream in streams} == {"stdout"}
