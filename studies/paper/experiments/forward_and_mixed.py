"""Give the network forward and mixed tasks, which the paper claims but does not show.

A task is a set of clamped vectors, and the network completes the others (paper, abstract and
Sect. "The Mean of Multiple Computations Model").  Arms start in one random posture, and vectors of
another random posture are clamped, so that every task has a solution:

    forward   all segments L; the result is the end effector R = L_1 + L_2 + L_3
    mixed     the first segment L_1 and R;  the last segment L_3 and R, a hand's place and
              orientation;  the diagonal D_1 = L_1 + L_2, an elbow's place, and R
    inverse   R alone, for comparison

With every L clamped the rest of the network, D_1, D_2 and R, is linear.  Its eigenvalues are 1 −
λ/d with λ = 2 ± √2 and 2, so the error shrinks by the factor (d − 2 + √2)/d in each iteration.  It
does so with every normalizer, because a clamped segment is not normalized.  The error is the
distance between R and the hand ΣL (0 once the network has settled) plus, where D_1 is clamped, the
distance between D_1 and L_1 + L_2.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import product
from math import sqrt
from typing import Any, TypeAlias

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mmc_gym.geometry import Floats
from mmc_gym.network.chain import Pair, chain_vectors, vector_pairs
from mmc_gym.network.model import Clamps, MMCNetwork, MMCState
from mmc_gym.network.normalizers import EuclideanNormalizer, LearnedNormalizer, Normalizer
from studies.drawing import COLOURS
from studies.paper.experiment import Captioned, ExperimentSettings, Result, ResultRow, tracked
from studies.paper.figures import add_legend, look, make_panels, styled
from studies.paper.protocol import ACCURATE, EUCLIDEAN

ARMS = 1000
ITERATIONS = 500

_Errors: TypeAlias = Mapping[tuple[str, str, str], Floats]
"""Errors by network, normalizer and task, (iterations, arms)."""

_R: Pair = (0, 3)
TASKS: Mapping[str, tuple[Pair, ...]] = {
    "forward: L_1, L_2, L_3": ((0, 1), (1, 2), (2, 3)),
    "mixed: L_1, R": ((0, 1), _R),
    "mixed: L_3, R": ((2, 3), _R),
    "mixed: D_1, R": ((0, 2), _R),
    "inverse: R": (_R,),
}
"""The node pairs of the clamped vectors, by task."""

NETWORKS: Mapping[str, MMCNetwork] = {
    "kinematic": MMCNetwork(),
    "kinematic, delayed": MMCNetwork(schedule="delayed"),
    "dynamic": MMCNetwork(dynamics="paper"),
}
"""d = 10: equations as printed, the schedule of the published figures, velocities (decay 0.92)."""

_SHOWN = (10, 40, 100, 500)


def factor(damping: float) -> float:
    """Return the factor of the error of a forward task in an iteration: (d − 2 + √2)/d.

    >>> round(factor(10), 4)
    0.9414
    """
    return (damping - 2 + sqrt(2)) / damping


def random_tasks(
    network: MMCNetwork, arms: int, seed: int
) -> tuple[MMCState, dict[Pair, NDArray[np.float64]]]:
    """Return arms in random postures, and by node pair the vectors of other random postures."""
    angles = np.random.default_rng(seed).uniform(-np.pi, np.pi, (2, arms, 3))
    goal = network.state_from_joint_angles(angles[1]).segments
    vectors = np.asarray(chain_vectors(goal), dtype=np.float64)
    return network.state_from_joint_angles(angles[0]), {
        pair: vectors[:, row] for row, pair in enumerate(vector_pairs(3))
    }


def errors(network: MMCNetwork, state: MMCState, clamps: Clamps, iterations: int) -> Floats:
    """Return the error after every iteration, segment lengths, (iterations, arms)."""
    diagonal = vector_pairs(3).index((0, 2))
    error = np.empty((iterations, *state.batch_shape))
    for iteration in range(iterations):
        state = network.step(state, clamps)
        vectors, segments = state.vectors, state.segments
        error[iteration] = np.linalg.norm(vectors[..., -1, :] - state.end_effector, axis=-1)
        if diagonal in clamps.rows:
            elbow = segments[..., :2, :].sum(axis=-2)
            error[iteration] += np.linalg.norm(vectors[..., diagonal, :] - elbow, axis=-1)
    return error


def run(settings: ExperimentSettings) -> Result:
    """Run every task in every network with every normalizer."""
    arms = ARMS // 10 if settings.quick else ARMS
    normalizers: dict[str, Normalizer] = {
        EUCLIDEAN: EuclideanNormalizer(),
        ACCURATE: LearnedNormalizer.shipped("accurate"),
        "paper's recipe [16, 16]": LearnedNormalizer.shipped("paper"),
    }
    task_errors: dict[tuple[str, str, str], Floats] = {}
    for name, normalizer, task in tracked(list(product(NETWORKS, normalizers, TASKS)), "tasks"):
        network = replace(NETWORKS[name], normalizer=normalizers[normalizer])
        state, vectors = random_tasks(network, arms, settings.seed)
        clamps = network.clamp({pair: vectors[pair] for pair in TASKS[task]})
        task_errors[name, normalizer, task] = errors(network, state, clamps, ITERATIONS)
    courses = {key: error.mean(axis=1) for key, error in task_errors.items()}
    panels = {
        name: {task: courses["kinematic", name, task] for task in TASKS} for name in normalizers
    }
    return Result(
        rows=[*_forward_rows(task_errors), *_mixed_rows(task_errors)],
        figures={
            "forward_and_mixed": Captioned(
                draw_errors(panels, factor(NETWORKS["kinematic"].damping)),
                f"Mean error over {arms} random postures of the kinematic network, d = 10, by the "
                "vectors that are clamped, for three normalizers; grey: the slope of a forward "
                "task by theory.",
            )
        },
        data={
            "forward_and_mixed": pd.DataFrame(
                {"iteration": np.arange(1, ITERATIONS + 1)}
                | {" | ".join(key): course for key, course in courses.items()}
            )
        },
    )


@styled
def draw_errors(panels: Mapping[str, Mapping[str, Floats]], slope: float) -> Figure:
    """Draw errors, (iterations,), by panel and name, and the line of a constant factor."""
    figure, row = make_panels(len(panels), 2.7 * len(panels) + 0.6, 3.4, sharey=True)
    iterations = np.arange(1, ITERATIONS + 1)
    for axes, (title, courses) in zip(row, panels.items(), strict=True):
        for number, (name, error) in enumerate(courses.items()):
            style = look(number) | {"color": (*COLOURS, "black")[number], "label": name}
            marks: Any = {"marker": "osD^v"[number], "markevery": (10 * number, len(error) // 6)}
            axes.plot(iterations, error, markersize=3, **style, **marks)
        label = f"{slope:.4f}ᵏ"
        axes.plot(iterations, slope**iterations, color="0.6", linewidth=0.8, label=label)
        axes.set(title=title, xlabel="iteration k", yscale="log", ylim=(1e-4, 5))
    row[0].set_ylabel("error [segment lengths]")
    add_legend(figure, row[0])
    return figure


def _forward_rows(task_errors: _Errors) -> list[ResultRow]:
    task = next(iter(TASKS))
    rows = []
    for name, network in NETWORKS.items():
        course = task_errors[name, EUCLIDEAN, task]
        same = max(
            float(np.abs(others - course).max())
            for (mover, _, which), others in task_errors.items()
            if mover == name and which == task
        )
        measured = (course[99].mean() / course[49].mean()) ** (1 / 50)
        rows += [
            ResultRow(
                f"{task}, {name} network: factor of the error in an iteration",
                paper="(a forward task is claimed, none is shown)",
                ours=f"{measured:.5f}",
                note=f"theory: (d − 2 + √2)/d = {factor(network.damping):.5f}; iterations 50 "
                f"to 100; largest difference between normalizers {same:.0e}",
            ),
            ResultRow(
                f"{task}, {name} network: error after {', '.join(map(str, _SHOWN[:3]))} iterations",
                ours=", ".join(f"{course[k - 1].mean():.5f}" for k in _SHOWN[:3]),
                unit="segment lengths",
            ),
        ]
    return rows


def _mixed_rows(task_errors: _Errors) -> list[ResultRow]:
    return [
        ResultRow(
            f"{task}, {network} network, {normalizer}: mean error after "
            f"{', '.join(map(str, _SHOWN))} iterations; below 0.05 at the end",
            paper="(mixed tasks are claimed, none is shown)" if task.startswith("mixed") else None,
            ours=", ".join(f"{course[k - 1].mean():.4f}" for k in _SHOWN)
            + f"; {100 * (course[-1] < 0.05).mean():.1f} %",
            unit="segment lengths",
        )
        for (network, normalizer, task), course in task_errors.items()
        if not task.startswith("forward") and network != "kinematic, delayed"  # as kinematic
    ]
