"""Do the fits recover the parameters of simulated learners, and do their intervals cover them?

Groups of simulated learners are `TwoStates` with motor noise.  Each group is analysed as the
subjects of an experiment are: a fit to the mean curve, and an interval over subjects.

    bias        mean estimate less the true value
    sd          standard deviation of the estimates
    coverage    share of the 95 % intervals that contain the true value
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
import tyro
from numpy.typing import ArrayLike
from rich.console import Console

from mmc_gym.benchmark.statistics import percentile_interval, resampled_means
from mmc_gym.experiments.learning import (
    TWO_STATES,
    fit_exponential,
    fit_two_states,
    generalization_width,
)
from mmc_gym.measures.episode import Floats
from studies.tables import table_of


class TwoStates(NamedTuple):
    """Parameters of a learner, see `mmc_gym.experiments.learning.fit_two_states`."""

    A_f: float
    A_s: float
    B_f: float
    B_s: float


LEARNER = TwoStates(A_f=0.6, A_s=0.99, B_f=0.2, B_s=0.02)
NOISE = 3.0  # °, of each movement
PERTURBATION = 30.0  # °
RATE, ASYMPTOTE, WIDTH = 0.05, 25.0, 38.0
OFFSETS = np.array([0.0, 22.5, 45.0, 90.0, 180.0, -90.0, -45.0, -22.5])

Curves = tuple[Any, ...]


def simulate_learners(
    learner: TwoStates,
    perturbations: ArrayLike,
    clamps: ArrayLike = math.nan,
    *,
    subjects: int = 1,
    noise: float = 0.0,
    seed: int = 0,
) -> tuple[Floats, Floats]:
    """Simulate learners that are `TwoStates`: a reference for agents, and a test of the fits.

    Args:
        learner: its parameters.
        perturbations: p, (trials,); NaN where nothing is seen.
        clamps: errors shown whatever the hand does, (trials,); NaN where it is not clamped.
        subjects: number of learners.
        noise: standard deviation of each movement, which the learner sees in its error.
        seed: of the noise.

    Returns:
        Adaptation y with noise, and the errors e (NaN where nothing is seen), (subjects, trials).
    """
    schedule = np.asarray(perturbations, dtype=np.float64)
    adaptation = np.random.default_rng(seed).normal(0.0, noise, (subjects, len(schedule)))
    errors = np.empty_like(adaptation)
    fast, slow = np.zeros((2, subjects))
    for trial, clamp in enumerate(np.broadcast_to(clamps, schedule.shape)):
        adaptation[:, trial] += fast + slow
        free = schedule[trial] - adaptation[:, trial]
        errors[:, trial] = free if math.isnan(clamp) else clamp
        seen = np.nan_to_num(errors[:, trial])
        fast = learner.A_f * fast + learner.B_f * seen
        slow = learner.A_s * slow + learner.B_s * seen
    return adaptation, errors


def recovery(
    fit: Callable[..., Any],
    simulate: Callable[[int], Curves],
    true: Mapping[str, float],
    groups: int,
    resamples: int,
) -> dict[str, dict[str, float]]:
    """Return mean, bias, sd and coverage for each parameter that `fit` returns, in its order."""
    estimates, covered = [], []
    wanted = np.array(list(true.values()))
    for group in range(groups):
        found = fit(*(resampled_means(curves, resamples) for curves in simulate(group)))
        values = np.reshape(found, (resamples + 1, len(true))).T
        low, high = np.transpose([percentile_interval(one[1:]) for one in values])
        estimates.append(values[:, 0])
        covered.append((low <= wanted) & (wanted <= high))
    columns = zip(true, wanted, np.transpose(estimates), np.mean(covered, axis=0), strict=True)
    return {
        name: {
            "true": value,
            "mean": float(np.nanmean(one)),
            "bias": float(np.nanmean(one)) - value,
            "sd": float(np.nanstd(one)),
            "coverage": float(coverage),
        }
        for name, value, one, coverage in columns
    }


def two_state_groups(
    counter: bool, subjects: int, unseen: float = 0.0
) -> Callable[[int], tuple[Any, Any]]:
    """Return a function that simulates a group, in one of two schedules.

    Args:
        counter: whether the perturbation is followed by its opposite and by trials clamped to an
            error of 0, as in Smith et al. (2006), or by washout.
        subjects: in a group.
        unseen: noise of the measurement, which the learner does not see, degrees.
    """
    learning = np.r_[np.zeros(60), np.full(160, PERTURBATION)]
    after = np.r_[np.full(20, -PERTURBATION), np.zeros(60)] if counter else np.zeros(80)
    schedule, clamps = np.r_[learning, after], np.full(300, np.nan)
    clamps[240:] = 0.0 if counter else np.nan

    def simulate(group: int) -> tuple[Any, Any]:
        adaptation, errors = simulate_learners(
            LEARNER, schedule, clamps, subjects=subjects, noise=NOISE, seed=group
        )
        extra = np.random.default_rng((group, 1)).normal(0.0, unseen, adaptation.shape)
        return adaptation + extra, np.where(np.isnan(clamps), errors - extra, errors)

    return simulate


def main(groups: int = 200, subjects: int = 20, resamples: int = 200) -> None:
    """Simulate groups of learners and print how well the fits recover their parameters.

    Args:
        groups: number of groups.
        subjects: learners in a group.
        resamples: of the subjects, for each interval.
    """
    console = Console(width=120)
    true_states = dict(zip(TWO_STATES, LEARNER))
    trials = np.arange(160)
    course = ASYMPTOTE * (1 - np.exp(-RATE * trials))
    around = 20.0 * np.exp(-(OFFSETS**2) / (2 * WIDTH**2))

    def noisy(curve: Any) -> Callable[[int], tuple[Any]]:
        shape = (subjects, len(curve))
        return lambda group: (curve + np.random.default_rng(group).normal(0.0, NOISE, shape),)

    def width(curves: Any) -> Any:
        return generalization_width(curves, OFFSETS)

    schedules = {
        "rotation and washout": two_state_groups(False, subjects),
        "rotation, its opposite, clamp": two_state_groups(True, subjects),
        "the same, 3° of noise unseen by the learner": two_state_groups(True, subjects, unseen=3.0),
    }
    cases: dict[str, tuple[Any, Any, Mapping[str, float]]] = {
        **{case: (fit_two_states, learn, true_states) for case, learn in schedules.items()},
        "exponential": (fit_exponential, noisy(course), {"asymptote": ASYMPTOTE, "rate": RATE}),
        "width of a Gaussian": (width, noisy(around), {"σ [°]": WIDTH}),
    }
    rows = []
    for case, (fit, simulate, true) in cases.items():
        for name, found in recovery(fit, simulate, true, groups, resamples).items():
            values = {key: f"{value:.4f}" for key, value in found.items() if key != "coverage"}
            rows.append({"case": case, "parameter": name, **values})
            rows[-1]["coverage"] = f"{found['coverage']:.1%}"
    console.print(table_of(rows, f"{groups} groups of {subjects} simulated learners"))


if __name__ == "__main__":
    tyro.cli(main)
