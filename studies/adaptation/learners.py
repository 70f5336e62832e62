"""Learners that are known: the analytical two-state model, simulated."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from mmc_gym.measures.episode import Floats


class TwoStates(NamedTuple):
    """Parameters of a learner, see `mmc_gym.experiments.learning.fit_two_states`."""

    A_f: float
    A_s: float
    B_f: float
    B_s: float


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
