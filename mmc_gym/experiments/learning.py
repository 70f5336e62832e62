"""Measures of learning over trials, from plain arrays: your own data fit in as well.

Paths are (..., time, 2) and curves (..., trials); leading axes are subjects or resamples.  Angles
are in degrees, as in the literature, positive to the left.  Adaptation y is how much of a
perturbation p the hand compensates, in its unit: 30° if the hand turns against a cursor turned by
30°.  The error that is seen is e = p − y, in an error clamp the clamp's.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import leastsq
from scipy.special import expit, logit

from mmc_gym.measures.episode import Floats

LEAST_EXPLAINED = 0.2  # of the variance of a curve, for it to have a rate
TWO_STATES = ("A_f", "A_s", "B_f", "B_s")
# Where fits begin: rates per trial, retentions, and in degrees widths and centres.
_RATES, _RETENTIONS = np.geomspace(1e-3, 3.0, 60), 1 - np.geomspace(1.0, 1e-4, 40)
_WIDTHS, _CENTRES = np.meshgrid(np.geomspace(5.0, 180.0, 40), np.linspace(-45.0, 45.0, 19))


def initial_direction(paths: ArrayLike, targets: ArrayLike) -> Floats:
    """Return the direction of the hand at its peak speed less that of the target, degrees.

    Both are seen from the start of the movement; in (−180, 180], NaN for a hand that never moves
    and for a target at the start.
    Paths of hand or cursor are (..., time, 2), in any unit of length, and targets (..., 2).

    Source: Krakauer, Pine, Ghilardi & Ghez (2000), J. Neurosci. 20, 8916–8924.
    """
    hand, aim = _at_peak_speed(paths, targets)
    turns = np.degrees(np.arctan2(_cross(aim, hand), (aim * hand).sum(axis=-1)))
    return np.asarray(np.where(aim.any(axis=-1), turns, math.nan))


def lateral_deviation(paths: ArrayLike, targets: ArrayLike) -> Floats:
    """Return how far the hand is to the left of the line from start to target at its peak speed.

    In the unit of `paths`; for arguments and NaN see `initial_direction`.
    """
    hand, aim = _at_peak_speed(paths, targets)
    ways = np.linalg.norm(aim, axis=-1)
    return np.asarray(_cross(aim, hand) / np.where(ways > 0, ways, math.nan))


def _at_peak_speed(paths: ArrayLike, targets: ArrayLike) -> tuple[Floats, Floats]:
    """Return the hand at the end of its fastest step, and the target, both from the start."""
    hands = np.asarray(paths, dtype=np.float64)
    if hands.shape[-2] < 2:  # it never moves
        hands = np.full((*hands.shape[:-2], 2, 2), math.nan)
    steps = np.linalg.norm(np.diff(hands, axis=-2), axis=-1)
    fastest = np.argmax(steps, axis=-1)[..., None, None] + 1
    hand = np.take_along_axis(hands, fastest, axis=-2)[..., 0, :] - hands[..., 0, :]
    moves = steps.max(axis=-1, keepdims=True) > 0
    return np.where(moves, hand, math.nan), np.asarray(targets) - hands[..., 0, :]


def _cross(one: Floats, other: Floats) -> Floats:
    return np.asarray(one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0])


def correction_gain(response: ArrayLike, jump: float) -> Floats:
    """Return which share of a jump in flight the hand has corrected at the end.

    The response is the mean path with the jump less that without, along the full correction,
    (..., time), and `jump` the size of the jump of target or cursor, in the same unit.  NaN for a
    jump of 0.

    Source: Veyrat-Masson, Brière & Proteau (2010), J. Vision 10(14), 27.
    """
    ends = np.asarray(response, dtype=np.float64)[..., -1:].sum(axis=-1)
    return np.asarray(ends / (jump if jump and np.size(response) else math.nan))


def correction_latency(
    response: ArrayLike, jump: float, jump_time: float, control_step: float
) -> float:
    """Return the seconds from a jump in flight until the mean path responds.

    A line through the points where the response's acceleration first has 25 % and 75 % of its peak
    is extended to 0, so that a strong response does not count as an early one.  NaN if the response
    never is 1 % of the jump in its direction, is not known throughout, or ends before the jump.

    The response, (time,), and the jump are those of `correction_gain`; it jumps at `jump_time`,
    seconds after the first position.

    Why to extrapolate: Oostwoud Wijdenes, Brenner & Smeets (2014), Behav. Res. Methods 46.
    """
    path = np.asarray(response, dtype=np.float64)
    is_response = len(path) > 2 and path.max() >= 0.01 * jump > 0  # False with NaN, as the next one
    if not (is_response and jump_time < len(path) * control_step):
        return math.nan
    accelerations = np.diff(path, 2)  # centred at the times control_step, 2 control_step, …
    accelerations[: max(0, math.ceil(jump_time / control_step) - 1)] = 0.0
    rise = np.maximum.accumulate(accelerations[: np.argmax(accelerations) + 1])
    if not rise[-1] > 0:
        return math.nan
    times = (np.arange(len(rise)) + 1) * control_step
    quarter, three_quarters = np.interp([0.25 * rise[-1], 0.75 * rise[-1]], rise, times)
    return max(0.0, float(quarter - (three_quarters - quarter) / 2) - jump_time)


@np.vectorize(signature="(n)->(p)")
def fit_exponential(curves: Floats) -> Floats:
    """Fit y_n = asymptote + (start − asymptote) e^{−rate n} to each curve, n = 0, 1, ….

    The curves y are (..., trials); only finite values count.  Return asymptote and rate, (..., 2).
     NaN for fewer than four trials, and if the fit explains less than a fifth of the
    variance: what has no course has no rate.
    """
    trials = np.flatnonzero(np.isfinite(curves))
    known = curves[trials]
    if len(trials) < 4 or np.ptp(known) == 0.0:
        return np.full(2, math.nan)
    shapes = np.exp(-_RATES[:, None] * trials)
    means = shapes.mean(axis=-1, keepdims=True)
    best, height = _nearest_shape(shapes - means, known - known.mean())
    if np.var(height * shapes[best]) < LEAST_EXPLAINED * np.var(known):
        return np.full(2, math.nan)

    def rate_of(log_rate: float) -> float:
        return math.exp(min(log_rate, math.log(_RATES[-1])))  # faster is learned in one trial

    asymptote, _, log_rate = _polish(
        lambda at: at[0] + at[1] * np.exp(-rate_of(at[2]) * trials) - known,
        (known.mean() - height * means[best, 0], height, math.log(_RATES[best])),
    )
    return np.array([asymptote, rate_of(log_rate)])


def _nearest_shape(shapes: Floats, values: Floats) -> tuple[int, float]:
    """Return which of the shapes (k, n) is nearest to `values` (n,) if scaled, and the scale."""
    along, square = shapes @ values, (shapes**2).sum(axis=-1)
    best = int(np.argmax(along**2 / square))
    return best, float(along[best] / square[best])


def _polish(residuals: Callable[[Floats], Floats], start: Sequence[float]) -> Floats:
    """Return what Levenberg and Marquardt make of a start; `leastsq` costs least per call."""
    return np.asarray(leastsq(residuals, start, ftol=1e-6, xtol=1e-6, full_output=True)[0])


@np.vectorize(signature="(n),(n)->(p)")
def fit_two_states(adaptation: Floats, errors: Floats) -> Floats:
    """Fit a fast and a slow process that learn from the same error, and forget, to each curve.

        y_n = f_n + s_n,    f_{n+1} = A_f f_n + B_f e_n,    s_{n+1} = A_s s_n + B_s e_n

    with A_f < A_s, all from 0 to 1, and f_0 = s_0 = 0, by least squares.  The states follow from
    the errors that were seen, noise included, so that clamps need no model of their own.

    The adaptation y and the errors e are (..., trials).  NaNs in y are left out; e is NaN where
    nothing is seen.  Return `TWO_STATES`, (..., 4).  A process that does not help has B = 0 and A
    NaN; all are NaN where nothing was learned, or no error was seen.

    Source: Smith, Ghazizadeh & Shadmehr (2006), PLoS Biol. 4, e179.
    """
    present, seen = ~np.isnan(adaptation), np.nan_to_num(errors)
    known = adaptation[present]
    if len(known) < 8 or not seen.any() or np.abs(known).max() <= 1e-3 * np.abs(seen).max():
        return np.full(4, math.nan)
    from scipy.signal import lfilter  # takes long to import

    def state(retention: float) -> Floats:
        return np.asarray(lfilter([0.0, 1.0], [1.0, -retention], seen)[present])

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
        one_state = np.array([math.nan, _RETENTIONS[best], 0.0, rate])
        return one_state if rate > 0 else np.full(4, math.nan)

    def residuals(at: Floats) -> Floats:
        a, b, rate_a, rate_b = expit(at)
        return np.asarray(rate_a * state(a) + rate_b * state(b) - known)

    start = *_RETENTIONS[[fast, slow]], rates[fast, slow], rates[slow, fast]
    a, b, rate_a, rate_b = expit(_polish(residuals, logit(np.clip(start, 1e-4, 0.9999))))
    return np.array([a, b, rate_a, rate_b] if a < b else [b, a, rate_b, rate_a])


@np.vectorize(signature="(n),(n)->()")
def generalization_width(adaptation: Floats, offsets: Floats) -> float:
    """Return σ of y = a exp(−(x − c)²/2σ²) by least squares, degrees; NaN for under four x.

    At most 180°, which stands for flat: on a circle nothing is wider.  Only finite y count.

    y is the `adaptation` of probes in other directions, (..., probes), and x, the `offsets`, the
    target's direction less the trained one, degrees, (probes,).

    Source: Day, Roemmich, Taylor & Bastian (2016), eNeuro 3(2).
    """
    present = np.isfinite(adaptation) & np.isfinite(offsets)
    adaptation, offsets = adaptation[present], offsets[present]
    if len(np.unique(offsets)) < 4 or not np.any(adaptation):
        return math.nan
    widths, centres = _WIDTHS.reshape(-1, 1), _CENTRES.reshape(-1, 1)
    best, height = _nearest_shape(np.exp(-(((offsets - centres) / widths) ** 2) / 2), adaptation)
    found = _polish(
        lambda at: at[0] * np.exp(-(((offsets - at[1]) / at[2]) ** 2) / 2) - adaptation,
        (height, *centres[best], *widths[best]),
    )
    return min(abs(float(found[2])), float(_WIDTHS.max()))
