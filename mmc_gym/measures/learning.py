"""Measures of learning over trials, from plain arrays: your own data fit in as well.

Paths are (..., time, 2) and curves (..., trials); leading axes are subjects or resamples.  Angles
are in degrees, as in the literature, positive to the left.  Adaptation y is how much of a
perturbation p the hand compensates, in its unit: 30° if the hand turns against a cursor turned by
30°; in a force field the share of the first deviation that has gone.  The error that is seen is

    e_n = p_n − y_n         in an error clamp the clamp's, NaN where nothing is seen
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import leastsq
from scipy.signal import lfilter
from scipy.special import expit, logit

from mmc_gym.measures.episode import Floats

LEAST_EXPLAINED = 0.2  # of the variance of a curve, for it to have a rate
# Where fits begin: rates per trial, retentions, and in degrees widths and centres.
_RATES, _RETENTIONS = np.geomspace(1e-3, 3.0, 60), 1 - np.geomspace(1.0, 1e-4, 40)
_WIDTHS, _CENTRES = np.geomspace(5.0, 180.0, 40), np.linspace(-45.0, 45.0, 19)


def initial_direction(paths: ArrayLike, targets: ArrayLike) -> Floats:
    """Return the direction of the hand at its peak speed less that of the target, degrees.

    Both are seen from the start of the movement; in (−180, 180], NaN for a hand that never moves.

    Args:
        paths: positions of the hand or cursor, (..., time, 2), in any unit of length.
        targets: positions of the target, (..., 2).

    Source:
        Krakauer, Pine, Ghilardi & Ghez (2000), J. Neurosci. 20, 8916–8924.
    """
    hand, aim = _at_peak_speed(paths, targets)
    return np.degrees(np.arctan2(_cross(aim, hand), (aim * hand).sum(axis=-1)))


def lateral_deviation(paths: ArrayLike, targets: ArrayLike) -> Floats:
    """Return how far the hand is to the left of the line from start to target at its peak speed.

    In the unit of `paths`; for arguments and NaN see `initial_direction`.
    """
    hand, aim = _at_peak_speed(paths, targets)
    return _cross(aim, hand) / np.linalg.norm(aim, axis=-1)


def _at_peak_speed(paths: ArrayLike, targets: ArrayLike) -> tuple[Floats, Floats]:
    """Return the hand at the end of its fastest step, and the target, both from the start."""
    hands = np.asarray(paths, dtype=np.float64)
    steps = np.linalg.norm(np.diff(hands, axis=-2), axis=-1)
    fastest = np.argmax(steps, axis=-1)[..., None, None] + 1
    hand = np.take_along_axis(hands, fastest, axis=-2)[..., 0, :] - hands[..., 0, :]
    moves = steps.max(axis=-1, keepdims=True) > 0
    return np.where(moves, hand, math.nan), np.asarray(targets) - hands[..., 0, :]


def _cross(one: Floats, other: Floats) -> Floats:
    return np.asarray(one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0])


def correction_gain(jumped: ArrayLike, plain: ArrayLike, wanted: ArrayLike) -> float:
    """Return which share of a jump in flight the hand has corrected when the movement ends.

    (mean end of `jumped` − mean end of `plain`) · w / |w|²: 1 for a full correction.

    Args:
        jumped: paths of the hand with a jump, (trials, time, 2).
        plain: paths to the same target without one, (trials, time, 2).
        wanted: w, the correction that would be full, (2,): the target's jump, or minus the
            cursor's.

    Source:
        Veyrat-Masson, Brière & Proteau (2010), J. Vision 10(14), 27.
    """
    full = np.asarray(wanted, dtype=np.float64)
    return float(_response(jumped, plain, full)[-1] / np.linalg.norm(full))


def correction_latency(
    jumped: ArrayLike, plain: ArrayLike, wanted: ArrayLike, jump: float, control_step: float
) -> float:
    """Return the seconds from a jump in flight until the mean path responds.

    The response is the mean acceleration with a jump less that without.  A line through the points
    where it first has 25 % and 75 % of its peak is extended to 0, so that a strong response does
    not count as an early one.  NaN if the path never differs by 1 % of the jump.

    Args:
        jumped: see `correction_gain`, as for `plain` and `wanted`.
        plain: without a jump.
        wanted: the full correction.
        jump: time of the jump, seconds after the first position.
        control_step: between two positions, seconds.

    Source:
        Why to extrapolate: Oostwoud Wijdenes, Brenner & Smeets (2014), Behav. Res. Methods 46.
    """
    path = _response(jumped, plain, np.asarray(wanted, dtype=np.float64))
    response = np.diff(path, 2)  # centred at the times control_step, 2 control_step, …
    response[: max(0, math.ceil(jump / control_step) - 1)] = 0.0
    highest = response.max(initial=0.0)
    if np.abs(path).max() < 0.01 * np.linalg.norm(wanted):
        return math.nan
    times = (np.arange(len(response)) + 1) * control_step
    rise = slice(0, int(np.argmax(response)) + 1)
    reached = np.maximum.accumulate(response[rise])
    quarter, three_quarters = np.interp([0.25 * highest, 0.75 * highest], reached, times[rise])
    return max(0.0, float(quarter - (three_quarters - quarter) / 2) - jump)


def _response(jumped: ArrayLike, plain: ArrayLike, wanted: Floats) -> Floats:
    mean, without = (np.asarray(one, dtype=np.float64).mean(axis=0) for one in (jumped, plain))
    return np.asarray((mean - without) @ wanted / np.linalg.norm(wanted))


class Exponential(NamedTuple):
    """y_n = asymptote + (start − asymptote) e^{−rate n} for the trials n = 0, 1, …."""

    start: Any
    asymptote: Any
    rate: Any


def fit_exponential(curves: ArrayLike) -> Exponential:
    """Fit an `Exponential` to each curve (..., trials) by least squares; NaNs are left out.

    All are NaN for fewer than four trials, and if the fit explains less than a fifth of the
    curve's variance: a curve without a course has no rate.
    """
    return Exponential(*np.moveaxis(_exponential(np.asarray(curves, np.float64)), -1, 0))


@np.vectorize(signature="(n)->(p)")
def _exponential(values: Floats) -> Any:
    trials = np.flatnonzero(~np.isnan(values))
    known = values[trials]
    if len(trials) < 4 or np.ptp(known) == 0.0:
        return np.full(3, math.nan)
    shapes = np.exp(-_RATES[:, None] * trials)
    means = shapes.mean(axis=-1)
    shapes_alone, alone = shapes - means[:, None], known - known.mean()
    best, height = _nearest_shape(shapes_alone, alone)
    if np.var(height * shapes_alone[best]) < LEAST_EXPLAINED * np.var(known):
        return np.full(3, math.nan)

    def rate_of(log_rate: float) -> float:
        return math.exp(min(log_rate, math.log(_RATES[-1])))  # faster is learned in one trial

    asymptote, height, log_rate = _polish(
        lambda at: at[0] + at[1] * np.exp(-rate_of(at[2]) * trials) - known,
        (known.mean() - height * means[best], height, math.log(_RATES[best])),
    )
    return np.array([asymptote + height, asymptote, rate_of(log_rate)])


def _nearest_shape(shapes: Floats, values: Floats) -> tuple[int, float]:
    """Return which of the shapes (k, n) is nearest to `values` (n,) if scaled, and the scale."""
    along, square = shapes @ values, (shapes**2).sum(axis=-1)
    best = int(np.argmax(along**2 / square))
    return best, float(along[best] / square[best])


def _polish(residuals: Callable[[Floats], Floats], start: Sequence[float]) -> Floats:
    """Return what Levenberg and Marquardt make of a start; `leastsq` costs least per call."""
    return np.asarray(leastsq(residuals, start, ftol=1e-6, xtol=1e-6, maxfev=300)[0])


class TwoStates(NamedTuple):
    """A fast and a slow process learn from the same error, and forget.

        y_n = f_n + s_n,    f_{n+1} = A_f f_n + B_f e_n,    s_{n+1} = A_s s_n + B_s e_n

    with A_f < A_s, from f_0 = s_0 = 0.

    Source:
        Smith, Ghazizadeh & Shadmehr (2006), PLoS Biol. 4, e179.
    """

    A_f: Any
    A_s: Any
    B_f: Any
    B_s: Any


def fit_two_states(adaptation: ArrayLike, errors: ArrayLike) -> TwoStates:
    """Fit `TwoStates` to each curve (..., trials) by least squares, all parameters from 0 to 1.

    The states follow from the errors that were seen, with their noise, so that clamps and trials
    without feedback need no model of their own.  A process that does not help has B = 0 and A NaN.

    Args:
        adaptation: y; trials with NaN are left out.
        errors: e; NaN where nothing is seen.
    """
    curves = np.asarray(adaptation, np.float64), np.nan_to_num(np.asarray(errors, np.float64))
    return TwoStates(*np.moveaxis(_two_states(*curves), -1, 0))


@np.vectorize(signature="(n),(n)->(p)")
def _two_states(values: Floats, errors: Floats) -> Any:
    present = ~np.isnan(values)
    known = values[present]
    if present.sum() < 8 or np.abs(known).max() <= 1e-3 * np.abs(errors).max():
        return np.full(4, math.nan)  # nothing seen, or nothing learned

    def state(retention: float) -> Floats:
        return np.asarray(lfilter([0.0, 1.0], [1.0, -retention], errors)[present])

    # All pairs of retentions: B_f and B_s by their normal equations.
    states = np.array([state(retention) for retention in _RETENTIONS])
    products, along = states @ states.T, states @ known
    squares = np.diag(products)
    determinants = np.outer(squares, squares) - products**2
    solvable = determinants > 1e-9 * np.outer(squares, squares)
    rates = np.outer(along, squares) - products * along  # of the row's state
    rates = np.divide(rates, determinants, out=np.full_like(rates, -1.0), where=solvable)
    explained = np.where((rates > 0) & (rates.T > 0), rates * along[:, None] + rates.T * along, 0)
    fast, slow = np.unravel_index(np.argmax(explained), explained.shape)
    if explained[fast, slow] <= 0.0:  # one process does as well
        best, rate = _nearest_shape(states, known)
        return np.array([math.nan, _RETENTIONS[best], 0.0, max(rate, 0.0)])
    start = *_RETENTIONS[[fast, slow]], rates[fast, slow], rates[slow, fast]

    def residuals(at: Floats) -> Floats:
        a, b, rate_a, rate_b = expit(at)
        return np.asarray(rate_a * state(a) + rate_b * state(b) - known)

    a, b, rate_a, rate_b = expit(_polish(residuals, logit(np.clip(start, 1e-4, 0.9999))))
    return np.array([a, b, rate_a, rate_b] if a < b else [b, a, rate_b, rate_a])


def simulate_learners(
    learner: TwoStates,
    perturbations: ArrayLike,
    clamps: ArrayLike = math.nan,
    *,
    subjects: int = 1,
    noise: float = 0.0,
    seed: int = 0,
) -> tuple[Floats, Floats]:
    """Simulate learners that are `TwoStates`: an analytical reference, and a test of the fits.

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


def generalization_width(adaptation: ArrayLike, offsets: ArrayLike) -> Floats:
    """Return σ of a Gaussian over the directions of targets, degrees.

    Least squares of y = a exp(−(x − c)²/2σ²); NaN for fewer than four directions.

    Args:
        adaptation: y of probes, (..., probes).
        offsets: x, the target's direction less the trained one, degrees, (probes,).

    Source:
        Day, Roemmich, Taylor & Bastian (2016), eNeuro 3(2).
    """
    return np.asarray(_width(np.asarray(adaptation, np.float64), np.asarray(offsets, np.float64)))


@np.vectorize(signature="(n),(n)->()")
def _width(values: Floats, offsets: Floats) -> Any:
    present = ~np.isnan(values)
    known, x = values[present], offsets[present]
    if len(np.unique(x)) < 4 or not np.any(known):
        return math.nan
    widths, centres = (grid.reshape(-1, 1) for grid in np.meshgrid(_WIDTHS, _CENTRES))
    best, height = _nearest_shape(np.exp(-(((x - centres) / widths) ** 2) / 2), known)
    found = _polish(
        lambda at: at[0] * np.exp(-(((x - at[1]) / (abs(at[2]) + 1.0)) ** 2) / 2) - known,
        (height, *centres[best], *(widths[best] - 1.0)),
    )
    return abs(found[2]) + 1.0
