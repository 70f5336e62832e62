"""The pictures in the documentation are those that the commands beside them draw.

They are compared as averages over squares of 8 × 8 pixels, in which edges and single dots weigh
little.  Redrawn by the same code a square differs by 0 to 2 of 255, with another version of pygame
or SDL by up to 5, and by up to 20 where learned policies, which dance about the target, round
otherwise.  Arms that are drawn a single control step later differ by 40 to 110 somewhere in their
panels.  `ALIKE` lies between.
"""

import inspect
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from PIL import Image

from mmc_gym._plotting import PlottedMovement, paths_and_profiles, save_figure
from mmc_gym.agents import make_agent, resolve
from mmc_gym.benchmark.reference import REFERENCE, minimum_jerk_episodes
from mmc_gym.cli import compare, main
from mmc_gym.measures import episode_seeds, run_episodes

ROOT = Path(__file__).parents[1]
ALIKE = 40
SQUARE = 8

# Another matplotlib may put labels elsewhere.
pinned = f"matplotlib=={version('matplotlib')}" in (ROOT / "constraints.txt").read_text()
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        not pinned or not (ROOT / "docs").is_dir(),
        reason="needs the matplotlib of constraints.txt, and the pictures, which no archive has",
    ),
]


def differences(drawn: Path, name: str, frame: int = 0) -> np.ndarray:
    """How far the squares of a picture are from those in the documentation."""
    shown = []
    for path in (drawn, ROOT / "docs" / name):
        with Image.open(path) as image:
            image.seek(frame)
            shown.append(np.asarray(image.convert("RGB").reduce(SQUARE), float))
    assert shown[0].shape == shown[1].shape, f"docs/{name} has another size than it is drawn with"
    return np.abs(shown[0] - shown[1]).mean(axis=-1)


def test_the_contact_sheet_shows_every_scenario_as_it_is(tmp_path):
    drawn = tmp_path / "sheet.png"
    example = ROOT / "examples" / "arm" / "plot_contact_sheet.py"
    subprocess.run([sys.executable, example, drawn], check=True, capture_output=True)
    found = differences(drawn, "contact-sheet.png").max()
    assert found < ALIKE, f"draw it anew: python {example} docs/contact-sheet.png"


def test_the_film_shows_what_the_agents_do(tmp_path):
    drawn = tmp_path / "film.gif"
    script = ROOT / "docs" / "draw_film.py"
    subprocess.run([sys.executable, script, drawn], check=True, capture_output=True)
    assert drawn.stat().st_size < 500_000
    for number in (0, 3, 25, 51):  # starts, the joint locks, ends
        found = differences(drawn, "film.gif", number).max()
        assert found < ALIKE, "draw it anew: python docs/draw_film.py"


def test_the_learning_curves_are_those_of_what_ships(tmp_path):
    main(["curves", "--out", str(tmp_path)])
    found = differences(tmp_path / "learning_curves.png", "learning-curves.png").max()
    assert found < ALIKE, "copy learning_curves.png of `mmc-gym curves` to docs/learning-curves.png"


def test_the_comparison_shows_what_the_agents_do(tmp_path):
    agents = inspect.signature(compare).parameters["agents"].default
    seeds, episodes = episode_seeds(0, 200), {}
    for name in agents:
        agent = resolve(name)
        control = agent.control
        # Many at once draw other actions, or round otherwise.
        if name == "random" or agent.policy is not None:
            env = gym.make("MMCReach-v0", control=control)
        else:
            env = gym.make_vec("MMCReach-v0", 200, control=control, autoreset_mode="Disabled")
        episodes[name] = run_episodes(make_agent(name, env), env, seeds, records_effort=False)
    episodes[REFERENCE] = minimum_jerk_episodes(episodes["mmc"])
    movements = {
        name: [PlottedMovement(one.hands, one.target, one.speeds) for one in found]
        for name, found in episodes.items()
    }
    save_figure(paths_and_profiles(movements, 3.0, 0.05, 0.02), tmp_path / "drawn")
    found = differences(tmp_path / "drawn.png", "compare.png").max()
    assert found < ALIKE, "copy paths_and_profiles.png of `mmc-gym compare` to docs/compare.png"
