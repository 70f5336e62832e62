"""At which level do error clamps end?  Arithmetic beside `mmc-body` (tuned), by number of targets.

The hand's direction is that at the end of movements, in the last third of trials.

Errors above the largest one, e, count as e, and what a movement shows in one direction counts at
the angle θ from it by g(θ) = exp(−θ²/2σ²).  With n targets that alternate at random, x ← A x + B e
g(θ) ends where what is forgotten equals what is learned on average:

    x = B e / (1 − A) · Σ g(θ_k) / n
"""

from __future__ import annotations

import math

import numpy as np
import tyro
from rich.console import Console

from mmc_gym.experiments.experiment import Block, Experiment
from mmc_gym.experiments.trials import run_experiment
from studies.body_model.playing import body_model
from studies.people import TUNED
from studies.tables import table_of


def level(targets: tuple[float, ...]) -> float:
    """Return x for targets in these directions, degrees."""
    away = [(target + 180) % 360 - 180 for target in targets]
    near = np.mean([math.exp(-((angle / TUNED.width) ** 2) / 2) for angle in away])
    return float(TUNED.rate[0] * TUNED.largest_error / (1 - TUNED.retention[0]) * near)


def main(counts: tuple[int, ...] = (1, 2, 4, 8), trials: int = 200, subjects: int = 2) -> None:
    """Print both levels for each number of targets.

    Args:
        counts: numbers of targets.
        trials: in the clamp, of 15 degrees.
        subjects: of each.
    """
    rows = []
    for count in counts:
        targets = tuple(360 / count * number for number in range(count))
        blocks = Block("baseline", 8, targets=targets), Block("clamp", trials, "clamp-15", targets)
        agents = {"mmc-body (tuned)": body_model(TUNED)}
        result = run_experiment(Experiment("levels", blocks), agents, subjects, jobs=1)
        way = (result.hands[:, -1] - result.hands[:, 0]) @ (1, 1j)
        turned = np.angle(way * np.exp(-1j * np.radians(result.trials["target_angle"])), deg=True)
        hand_angle = -turned[result.trials["trial"] >= 8 + trials * 2 // 3].mean()
        rows.append({"targets": count, "arithmetic [°]": level(targets), "hand [°]": hand_angle})
    shown = [{name: f"{value:.3g}" for name, value in row.items()} for row in rows]
    Console().print(table_of(shown, "levels of error clamps"))


if __name__ == "__main__":
    tyro.cli(main)
