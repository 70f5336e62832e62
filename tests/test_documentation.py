"""The pictures in the documentation are those that the commands beside them draw.

They are compared by the mean colours of squares of 8 × 8 pixels, in which edges and single dots
have little weight.  Redrawn by the same code a square differs by 0 to 2 of 255; with another
version of pygame or SDL by up to 5; and by up to 20 where other rounding changes the movements of
learned policies.  Arms that are drawn a single control step later differ by 40 to 110 somewhere in
their panels.  `ALIKE` lies between.
"""

import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

ROOT = Path(__file__).parents[1]
ALIKE = 40
SQUARE = 8

# Picture, the command that draws it, its file, and the frames that are compared.
PICTURES = [
    # Starts, the joint locks, ends.
    ("film.gif", "docs/draw_film.py film.gif", "film.gif", (0, 3, 25, 51)),
    ("panda.gif", "docs/draw_panda.py panda.gif", "panda.gif", (0, 20, 65)),
    ("learning-curves.png", "-m mmc_gym.cli curves --out .", "learning_curves.png", (0,)),
    (
        "compare.png",
        "-m mmc_gym.cli compare --agents mmc-body mmc ik-dls ppo sac --out .",
        "paths_and_profiles.png",
        (0,),
    ),
]

# Another matplotlib may put labels elsewhere.
pinned = f"matplotlib=={version('matplotlib')}" in (ROOT / "constraints.txt").read_text()
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        not pinned or not (ROOT / "docs").is_dir(),
        reason="needs the matplotlib of constraints.txt, and the pictures, which no archive has",
    ),
]


def squares(path, frame):
    """Return the mean colours of a picture's squares."""
    with Image.open(path) as image:
        image.seek(frame)
        return np.asarray(image.convert("RGB").reduce(SQUARE), float)


@pytest.mark.parametrize(("name", "command", "file", "frames"), PICTURES)
def test_a_picture_shows_what_its_command_draws(name, command, file, frames, tmp_path):
    if name == "panda.gif":
        pytest.importorskip("panda_gym")
    first, *others = command.split()
    script = ROOT / first
    arguments = [script if script.exists() else first, *others]
    done = subprocess.run([sys.executable, *arguments], cwd=tmp_path, capture_output=True)
    assert done.returncode == 0, done.stderr.decode()
    drawn, shown = tmp_path / file, ROOT / "docs" / name
    assert drawn.suffix != ".gif" or drawn.stat().st_size < 500_000
    for frame in frames:
        now, before = squares(drawn, frame), squares(shown, frame)
        assert now.shape == before.shape
        differences = np.abs(now - before).mean(axis=-1)
        assert differences.max() < ALIKE, f"draw docs/{name} anew: python {command}"
