"""Do the fits recover the parameters of simulated learners, and do their intervals cover them?

Groups of simulated learners have one or two states and motor noise.  They are alike, or each
parameter differs by 30 % between them (of A, what is forgotten, 1 − A).  Each group is analysed as
the subjects of an experiment are: a fit to the mean curve, and an interval over subjects.  It
estimates the parameters of that curve; where learners differ, they are not the mean parameters.

    learner     parameter of the mean learner
    curve       that of the mean curve of 3,000 such learners without noise
    mean, sd    of the estimates
    coverage    share of the 95 % intervals that contain the parameter of the curve
    of learner  share of them that contain that of the mean learner
    chosen      share of the groups in which the least BIC is that of the true number of states
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from itertools import product
from typing import Any, NamedTuple

import numpy as np
import tyro
from numpy.typing import ArrayLike
from rich.console import Console

from mmc_gym.benchmark.statistics import expanded_tails, percentile_interval, resampled_means
from mmc_gym.experiments.fits import (
    TWO_STATES,
    fit_curve,
    fit_exponential,
    fit_states,
    generalization_width,
)
from mmc_gym.measures.episode import Floats
from studies.tables import table_of


class TwoStates(NamedTuple):
    """Parameters of a learner, see `mmc_gym.experiments.fits`."""

    A_f: float
    A_s: float
    B_f: float
    B_s: float


ONE_STATE = TwoStates(A_f=0.0, A_s=0.97, B_f=0.0, B_s=0.1)
LEARNER = TwoStates(A_f=0.6, A_s=0.99, B_f=0.2, B_s=0.02)
NOISE = 3.0  # °, of each movement
PERTURBATION = 30.0  # °
RESAMPLES = 200  # of the subjects, for each interval
MANY = 3000  # learners without noise, whose mean curve is that of the population
RATE, ASYMPTOTE, WIDTH = 0.05, 25.0, 38.0
OFFSETS = np.array([0.0, 22.5, 45.0, 90.0, 180.0, -90.0, -45.0, -22.5])


def simulate_learners(
    learner: TwoStates,
    perturbations: ArrayLike,
    clamps: ArrayLike = math.nan,
    *,
    subjects: int = 1,
    noise: float = 0.0,
    spread: float = 0.0,
    seed: int = 0,
) -> tuple[Floats, Floats]:
    """Simulate learners that are `TwoStates`: a reference for agents, and a test of the fits.

    Args:
        learner: its parameters.
        perturbations: p, (trials,); NaN where nothing is seen.
        clamps: errors shown whatever the hand does, (trials,); NaN where it is not clamped.
        subjects: number of learners.
        noise: standard deviation of each movement, which the learner sees in its error.
        spread: standard deviation of B and 1 − A between learners, as a share of them.
        seed: of the noise and of the learners.

    Returns:
        Adaptation y with noise, and the errors e (NaN where nothing is seen), (subjects, trials).
    """
    schedule, random = np.asarray(perturbations, dtype=np.float64), np.random.default_rng(seed)
    adaptation = random.normal(0.0, noise, (subjects, len(schedule)))
    errors = np.empty_like(adaptation)
    factors = np.clip(random.normal(1.0, spread, (4, subjects)), 0.05, 1.95)
    a_f, a_s = (1 - (1 - a) * factor for a, factor in zip(learner[:2], factors[:2], strict=True))
    b_f, b_s = (b * factor for b, factor in zip(learner[2:], factors[2:], strict=True))
    fast, slow = np.zeros((2, subjects))
    for trial, clamp in enumerate(np.broadcast_to(clamps, schedule.shape)):
        adaptation[:, trial] += fast + slow
        free = schedule[trial] - adaptation[:, trial]
        errors[:, trial] = free if math.isnan(clamp) else clamp
        seen = np.nan_to_num(errors[:, trial])
        fast = a_f * fast + b_f * seen
        slow = a_s * slow + b_s * seen
    return adaptation, errors


def recovery(
    fit: Callable[[Floats], Any],
    simulate: Callable[[int], Floats],
    learner: Mapping[str, float],
    curve: Floats,
    groups: int,
) -> dict[str, dict[str, float]]:
    """Return the columns of the table for each parameter that `fit` returns, in its order."""
    estimates, bounds = [], []
    of_curve = np.ravel(fit(curve[np.newaxis]))
    for group in range(groups):
        curves = simulate(group)
        fits = np.reshape(fit(resampled_means(curves, RESAMPLES)), (-1, len(learner)))
        tails = expanded_tails(len(curves))
        estimates.append(fits[0])
        bounds.append([percentile_interval(resampled, tails) for resampled in fits[1:].T])
    low, high = np.moveaxis(np.array(bounds), -1, 0)
    of_learner = np.array(list(learner.values()))
    columns = {
        "learner": of_learner,
        "curve": of_curve,
        "mean": np.nanmean(estimates, axis=0),
        "sd": np.nanstd(estimates, axis=0),
        "coverage": np.mean((low <= of_curve) & (of_curve <= high), axis=0),
        "of learner": np.mean((low <= of_learner) & (of_learner <= high), axis=0),
    }
    return {
        name: {key: float(column[index]) for key, column in columns.items()}
        for index, name in enumerate(learner)
    }


LEARNING = np.r_[np.zeros(60), np.full(160, PERTURBATION)]
NEVER = np.full(300, math.nan)
SCHEDULES = {
    "washout": (np.r_[LEARNING, np.zeros(80)], NEVER),
    "counter, clamp": (
        np.r_[LEARNING, np.full(20, -PERTURBATION), np.zeros(60)],
        np.r_[NEVER[:240], np.zeros(60)],
    ),
}
"""p and clamped errors: washed out, or as in Smith et al. (2006), by p and clamps."""


def state_rows(schedule: str, states: int, spread: float, groups: int, subjects: int) -> Any:
    """Return the rows of the table for learners with one or two states in a schedule."""
    perturbations, clamps = SCHEDULES[schedule]
    learner = LEARNER if states == 2 else ONE_STATE
    names = TWO_STATES if states == 2 else TWO_STATES[1::2]

    def simulate(group: int) -> Floats:
        settings: Any = {"subjects": subjects, "noise": NOISE, "spread": spread, "seed": group}
        return simulate_learners(learner, perturbations, clamps, **settings)[0]

    def fit(curves: Floats) -> Floats:
        return fit_states(curves, perturbations, clamps, states=states)

    parameters = {name: getattr(learner, name) for name in names}
    population = simulate_learners(learner, perturbations, clamps, subjects=MANY, spread=spread)[0]
    recovered = recovery(fit, simulate, parameters, population.mean(axis=0), groups)
    seen: Any = {"perturbation": perturbations, "clamp": clamps}
    correct = 0
    for group in range(groups):
        mean = simulate(group).mean(axis=0)
        bics = [fit_curve(mean, kind, **seen).bic for kind in ("one-state", "two-state")]
        correct += (bics[1] < bics[0]) == (states == 2)
    case = f"{states} state{'s' * (states > 1)}, {schedule}, {'differ' if spread else 'alike'}"
    share = f"{correct / groups:.0%}"
    return [(case, name, columns, share) for name, columns in recovered.items()]


def main(groups: int = 100, subjects: int = 12) -> None:
    """Simulate groups of learners and print how well the fits recover their parameters.

    Args:
        groups: number of groups.
        subjects: learners in a group.
    """
    rows = []
    for schedule, states, spread in product(SCHEDULES, (1, 2), (0.0, 0.3)):
        rows += state_rows(schedule, states, spread, groups, subjects)
    trials = np.arange(160)
    course = ASYMPTOTE * (1 - np.exp(-RATE * trials))
    around = 20.0 * np.exp(-(OFFSETS**2) / (2 * WIDTH**2))
    plain: list[tuple[str, Any, Floats, dict[str, float]]] = [
        (
            "exponential",
            lambda curves: fit_exponential(curves)[:, :2],
            course,
            {"asymptote": ASYMPTOTE, "rate": RATE},
        ),
        (
            "width of a Gaussian",
            lambda curves: generalization_width(curves, OFFSETS),
            around,
            {"σ [°]": WIDTH},
        ),
    ]
    for case, fit, curve, parameters in plain:

        def noisy(group: int, curve: Floats = curve) -> Floats:
            shape = (subjects, len(curve))
            return np.asarray(curve + np.random.default_rng(group).normal(0.0, NOISE, shape))

        recovered = recovery(fit, noisy, parameters, curve, groups)
        rows += [(case, name, columns, "–") for name, columns in recovered.items()]
    printed = [
        {"case": case, "parameter": name}
        | {key: f"{columns[key]:.4f}" for key in ("learner", "curve", "mean", "sd")}
        | {key: f"{columns[key]:.0%}" for key in ("coverage", "of learner")}
        | {"chosen": share}
        for case, name, columns, share in rows
    ]
    title = f"{groups} groups of {subjects} simulated learners"
    Console(width=120).print(table_of(printed, title))


if __name__ == "__main__":
    tyro.cli(main)
