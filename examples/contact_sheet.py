"""One picture of every task and every perturbation, mid-movement, in one labelled sheet.

`python examples/contact_sheet.py docs/contact-sheet.png` makes the one in the documentation.
"""

import os
import sys
from math import ceil
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from mmc_gym.envs.scenarios import PERTURBATION_NAMES
from mmc_gym.envs.tasks import TASKS
from mmc_gym.listing import picture

COLUMNS = 6
STEPS = {"centre-out": 6, "force-field": 7, "pursuit": 60, "via-points": 30}
OTHERS = 11  # steps until the picture is taken
OPTIONS = {
    "random": {"joint_angles": [0.2, 0.4, 0.4], "target": (-1.5, 1.8)},
    "centre-out": {"trial": 3},
    "paper": {"trial": 130},
}

names = [*TASKS, *PERTURBATION_NAMES]
rows = ceil(len(names) / COLUMNS)
figure, axes = plt.subplots(rows, COLUMNS, figsize=(1.6 * COLUMNS, 1.8 * rows), dpi=125)
for axis in axes.flat:
    axis.axis("off")
for axis, name in zip(axes.flat, names):
    axis.imshow(picture(name, STEPS.get(name, OTHERS), OPTIONS.get(name))[28:-28, 28:-28])
    axis.set_title(name, fontsize=8)
figure.tight_layout(pad=0.3)
path = Path(sys.argv[1] if len(sys.argv) > 1 else "contact-sheet.png")
whole = path.with_name(f".{path.name}.new")
figure.savefig(whole, format="png")
os.replace(whole, path)  # never half a picture, even if two write at once
print(f"wrote {path}: {len(names)} pictures")
