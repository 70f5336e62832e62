"""Models of learning, fitted to curves by least squares: your own data fit in as well.

One or two states learn from the same error and forget (Smith, Ghazizadeh & Shadmehr 2006, PLoS
Biol. 4, e179).  In trial n, with A_f < A_s and x_0 = 0,

    y_n = Σ x_n,    x_{n+1} = A x_n + B e_n,    e_n = p_n − y_n

The adaptation y is how much of the perturbation p the hand compensates, in its unit.  In an error
clamp e is what the clamp shows; it is 0 where nothing is seen.  If the errors that were seen are
given, they drive the states, noise included; else the model's own.

An exponential is y_n = asymptote + (start − asymptote) e^{−rate n}, and a Gaussian about the
trained direction y = offset + height e^{−(x − centre)²/2 width²}, x in degrees.

`fit` takes a table with a row for each trial, `fit_curve` arrays.  Of several models, that with the
least BIC, n ln(S/n) + k ln n, is best: n trials, sum of square errors S, k parameters.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from itertools import product
from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import leastsq
from scipy.special import expit, logit

from mmc_gym._errors import UserError, require, require_choice, shown
from mmc_gym.measures.episode import Floats

Model: TypeAlias = Literal[
    "nothing", "correction", "one-state", "two-state", "exponential", "gaussian"
]
ONE_STATE, TWO_STATES = ("A", "B"), ("A_f", "A_s", "B_f", "B_s")
PARAMETERS: dict[Model, tuple[str, ...]] = {
    "nothing": (),  # y = 0
    "correction": ("gain",),  # y = gain p, or the clamp's error: within the movement, nothing lasts
    "one-state": ONE_STATE,
    "two-state": TWO_STATES,
    "exponential": ("asymptote", "start", "rate"),
    "gaussian": ("offset", "height", "centre", "width"),
}
"""The parameters of each model.  A is retention and B rate of learning, both from 0 to 1 per trial;
the exponential's rate is per trial, the Gaussian's centre and width are in degrees."""

LEAST_EXPLAINED = 0.2  # of the variance of a curve, for it to have a rate
# Where fits begin: rates per trial, and in degrees widths and centres; A and B of states.
_RATES = np.geomspace(1e-3, 3.0, 60)
_WIDTHS, _CENTRES = (
    grid.reshape(-1, 1)
    for grid in np.meshgrid(np.geomspace(5.0, 180.0, 40), np.linspace(-45.0, 45.0, 19))
)
_STARTS = {
    1: (*product((0.5, 0.8, 0.95, 0.99, 0.999), (0.01, 0.03, 0.1, 0.3, 0.7)),),
    2: (*product((0.3, 0.6, 0.85), (0.95, 0.99, 0.999), (0.05, 0.2, 0.4), (0.01, 0.03, 0.1)),),
}
_EXACT = 1e-8  # share of the sum of squares of y that is no error
_NUDGE = 1e-6  # of logits, for derivatives
_FARTHEST = 14.0  # logit: shares from 1e-6 to 1 − 1e-6


class Fit(NamedTuple):
    """A model fitted to a curve."""

    model: Model
    parameters: dict[str, float]  #: by name, see `PARAMETERS`
    predicted: Floats  #: y of the model, (trials,)
    mean_square: float  #: error, square of the unit of y; NaN if there was too little to fit
    r_squared: float  #: share of the variance of y that the model explains
    bic: float  #: Bayesian information criterion; the least is best
    trials: int  #: that were known


class Curve(NamedTuple):
    """A curve of learning and what drove it, each (trials,), see `fit_curve`."""

    y: Floats
    perturbation: Floats
    clamp: Floats
    error: Floats | None = None
    x: Floats | None = None

    @property
    def shown(self) -> Floats:
        """The error that is seen without adaptation; 0 where nothing is seen."""
        return np.nan_to_num(np.where(np.isnan(self.clamp), self.perturbation, self.clamp))


def fit(
    table: pd.DataFrame,
    model: Model | Sequence[Model] = ("one-state", "two-state"),
    *,
    by: str | Sequence[str] | None = None,
    y: str = "adaptation",
    perturbation: str = "perturbation",
    clamp: str | None = None,
    error: str | None = None,
    x: str = "trial",
) -> pd.DataFrame:
    """Fit models to the curves in a table, and tell which is best.

    Args:
        table: a row for each trial, in any order.
        model: one or more of `PARAMETERS`.
        by: column or columns, each value of which has a fit of its own, such as "subject"; a trial
            stands once in it.  None: the mean of y over the rows with one x is fitted.
        y: column of the adaptation; this and the others are those of `fit_curve`.
        perturbation: column of p.
        clamp: column of the error that is shown in error clamps.
        error: column of the errors that were seen.
        x: column of the trial, or for a Gaussian of the direction less the trained one, degrees.

    Returns:
        A row for each curve and model, with the columns `by`, model, the parameters, mean_square,
        r_squared, bic, trials and best.

    Raises:
        UserError: if there is no such model, no such column of numbers, or a trial stands twice.
    """
    models = [model] if isinstance(model, str) else list(model)
    for name in models:
        require_choice("model", name, PARAMETERS)
    require(len(table) > 0, "rows of the table", 0, "at least one")
    is_moved = any("state" in name or name == "correction" for name in models)
    states = {"perturbation": perturbation, "clamp": clamp, "error": error} if is_moved else {}
    columns = {"y": y, "x": x, **{name: column for name, column in states.items() if column}}
    names = [by] if isinstance(by, str) else [*(by or ())]
    for column in [*columns.values(), *names]:
        if column not in table:
            raise UserError(f"the table must have a column {shown(column)}, got {[*table.columns]}")
    numbers = {name: _numbers(column, table[column]) for name, column in columns.items()}
    trials = pd.DataFrame(numbers)
    if not names:
        trials = trials.groupby("x", as_index=False, dropna=False).mean()
    keys = [table[name].to_numpy() for name in names]
    rows, doubts = [], []
    groups = trials.groupby(keys, sort=False, dropna=False) if keys else [((), trials)]
    for group, points in groups:
        labels = dict(zip(names, group, strict=True))
        if any(kind != "gaussian" for kind in models):
            points = points.sort_values("x")
            wrong = points["x"][points["x"].duplicated() | points["x"].isna()].tolist()
            where = ", ".join(f"{name} {label}" for name, label in labels.items()) or "the table"
            require(not wrong, x, wrong, f"a number that stands once in {where}; by= splits curves")
        curve = _curve({name: points[name] for name in columns})
        fits = [_fit(kind, curve) for kind in models]
        doubts += [_doubt(fitted, curve) for fitted in fits]
        least = min((fitted.bic for fitted in fits if fitted.bic < math.inf), default=math.nan)
        for fitted in fits:
            facts = fitted._asdict() | fitted.parameters | {"best": fitted.bic == least}
            rows.append(labels | facts)
    for doubt in dict.fromkeys(filter(None, doubts)):
        warnings.warn(doubt, stacklevel=2)
    parameters = dict.fromkeys(name for kind in models for name in PARAMETERS[kind])
    ends = ["mean_square", "r_squared", "bic", "trials", "best"]
    return pd.DataFrame(rows)[[*names, "model", *parameters, *ends]]


def fit_curve(
    y: ArrayLike,
    model: Model = "two-state",
    *,
    perturbation: ArrayLike = math.nan,
    clamp: ArrayLike = math.nan,
    error: ArrayLike | None = None,
    x: ArrayLike | None = None,
) -> Fit:
    """Fit a model to one curve; the parameters are NaN if there is too little to fit.

    Warn if y seems to have another sign or unit than the perturbation.

    Args:
        y: adaptation, (trials,); NaNs are left out.
        model: one of `PARAMETERS`.
        perturbation: p, (trials,) or a number; NaN where nothing is seen.
        clamp: the error that is shown in error clamps, NaN in other trials, likewise.
        error: the errors that were seen, if they shall drive the states, likewise.
        x: of a Gaussian, degrees, (trials,); None: 0, 1, …, as an exponential always has.

    >>> aligned, turned = [0.0] * 20, [30.0] * 80
    >>> curve = 24 * (1 - 0.9 ** np.arange(80))
    >>> fitted = fit_curve([*aligned, *curve], "one-state", perturbation=aligned + turned)
    >>> {name: round(value, 3) for name, value in fitted.parameters.items()}
    {'A': 0.98, 'B': 0.08}
    """
    require_choice("model", model, PARAMETERS)
    numbers = {"y": y, "perturbation": perturbation, "clamp": clamp, "error": error, "x": x}
    curve = _curve({name: values for name, values in numbers.items() if values is not None})
    fitted = _fit(model, curve)
    if doubt := _doubt(fitted, curve):
        warnings.warn(doubt, stacklevel=2)
    return fitted


def _curve(numbers: Mapping[str, Any]) -> Curve:
    """Return the curve of numbers by name, all in the shape of y."""
    arrays = {name: _numbers(name, values) for name, values in numbers.items()}
    shape = arrays["y"].shape
    require(len(shape) == 1 and shape != (0,), "y", shape, "a curve of shape (trials,)")
    for name, array in arrays.items():
        is_alike = array.shape in ((), shape)
        require(is_alike, name, array.shape, f"a number, or of shape {shape} as y")
    arrays = dict.fromkeys(("perturbation", "clamp"), np.array(math.nan)) | arrays
    return Curve(**{name: np.broadcast_to(array, shape) for name, array in arrays.items()})


def _numbers(name: str, values: Any) -> Floats:
    try:
        return np.asarray(values, dtype=np.float64)
    except (ValueError, TypeError) as error:  # text, or lists of uneven lengths
        raise UserError(f"{name} must be numbers: {error}") from None


def _doubt(fitted: Fit, curve: Curve) -> str:
    """Return what sign or unit y seems to have, if not that of p; else an empty text."""
    if "state" not in fitted.model or math.isnan(fitted.r_squared) or not curve.shown.any():
        return ""
    ratio = math.sqrt(np.nanmean(curve.y**2) / np.mean(curve.shown**2))
    for unit, other_unit, sign in (("radians", "degrees", 1), ("degrees", "radians", -1)):
        if 0.2 < ratio / math.radians(1) ** sign < 1.25:
            return f"y seems to be in {unit} and the perturbation in {other_unit}, by their sizes"
    opposite = curve._replace(y=-curve.y)
    if fitted.r_squared < LEAST_EXPLAINED < _fit(fitted.model, opposite).r_squared:
        return "y seems to have the other sign: what compensates the perturbation is positive"
    return ""


def _fit(model: Model, curve: Curve) -> Fit:
    """Fit a model to a curve without checks."""
    y, shown_errors = curve.y, curve.shown
    known = np.isfinite(y)
    if model in ("one-state", "two-state"):
        p, e = curve.perturbation, curve.clamp
        if curve.error is not None:
            e = np.nan_to_num(curve.error)
        states = fit_states(y[None], p, e, states=2 if model == "two-state" else 1)
        logits = np.clip(logit(states), -_FARTHEST, _FARTHEST)
        predicted = _simulate(logits, p, e)[0]
        values = states[0]
    elif model == "correction":
        scale = float((shown_errors[known] ** 2).sum())
        values = np.array([shown_errors[known] @ y[known] / scale if scale else math.nan])
        predicted = values * shown_errors
    elif model == "exponential":
        values = fit_exponential(y)[[0, 2, 1]]
        fall = np.exp(-values[2] * np.arange(len(y)))
        predicted = values[0] + (values[1] - values[0]) * fall
    elif model == "gaussian":
        places = np.arange(len(y)) if curve.x is None else curve.x
        values = fit_gaussian(y, places)
        offset, height, centre, width = values
        predicted = offset + height * _bell(places, centre, width)
    else:
        values, predicted = np.empty(0), np.zeros_like(y)
    count, square = int(known.sum()), float(((predicted - y)[known] ** 2).sum())
    mean_square = r_squared = bic = math.nan
    if count > len(values) and not math.isnan(square):
        spread = float(np.var(y[known])) * count
        # Of exact curves, few parameters win.
        least = _EXACT * float((y[known] ** 2).sum()) + 1e-300
        mean_square = square / count
        r_squared = 1 - square / spread if spread > 0 else math.nan
        bic = count * math.log((square + least) / count) + len(values) * math.log(count)
    parameters = dict(zip(PARAMETERS[model], values.tolist(), strict=True))
    return Fit(model, parameters, predicted, mean_square, r_squared, bic, count)


def choose_states(
    curves: Floats, perturbations: ArrayLike, clamps: ArrayLike
) -> NDArray[np.float64]:
    """Return `ONE_STATE` and `TWO_STATES` of each curve, (..., 6), NaN for the model not chosen.

    The first of the curves y (..., trials), such as a mean before its resamples, decides by BIC.
    None are if nothing was learned, or nothing lasts beyond the movement.  For p and clamps see
    `fit_curve`.
    """
    flat = curves.reshape(-1, curves.shape[-1])
    kinds: tuple[Model, ...] = ("nothing", "correction", "one-state", "two-state")
    p, e = (np.broadcast_to(values, flat.shape[1:]) for values in (perturbations, clamps))
    fits = [_fit(kind, Curve(flat[0], p, e)) for kind in kinds]
    known = [fitted for fitted in fits if not math.isnan(fitted.bic)]
    best = min(known, key=lambda fitted: fitted.bic).model if known else "nothing"
    parameters = np.full((len(flat), 6), math.nan)
    if best == "one-state":
        parameters[:, :2] = fit_states(flat, p, e, states=1)
    elif best == "two-state":
        parameters[:, 2:] = fit_states(flat, p, e, states=2)
    return parameters.reshape(*curves.shape[:-1], 6)


def fit_states(
    curves: Floats, perturbations: Floats, clamps: Floats, *, states: Literal[1, 2]
) -> NDArray[np.float64]:
    """Return A and B of the states of each curve y (k, trials), (k, 2) or `TWO_STATES` (k, 4).

    NaN where fewer than eight trials are known, or nothing moves.  For p and clamps, (trials,), see
    `fit_curve`.  All curves are fitted at once, by Levenberg and Marquardt: one at a time,
    `scipy.optimize` would take a hundred times as long.
    """
    weights = np.isfinite(curves)
    is_fitted = (weights.sum(axis=1) >= 8) & (np.abs(np.where(weights, curves, 0)).max(axis=1) > 0)
    parameters = np.full((len(curves), 2 * states), math.nan)
    if is_fitted.any():
        known, weights = np.where(weights, curves, 0.0)[is_fitted], weights[is_fitted]
        grid = logit(np.array(_STARTS[states]))
        shapes = _simulate(grid, perturbations, clamps)
        costs = (shapes**2) @ weights.T - 2 * shapes @ known.T  # less what no start changes
        start = grid[costs.argmin(axis=0)]
        parameters[is_fitted] = expit(_polish_all(start, known, weights, perturbations, clamps))
    if states == 2:  # the fast one first
        swapped = parameters[:, 0] > parameters[:, 1]
        parameters[swapped] = parameters[swapped][:, [1, 0, 3, 2]]
    return parameters


def _simulate(at: Floats, perturbations: Floats, clamps: Floats) -> Floats:
    """Return y (k, trials) of k learners whose A and B have these logits, (k, 2 · states)."""
    retentions, rates = expit(at.T).reshape(2, -1, len(at))
    state, y = np.zeros_like(rates), np.empty((len(perturbations), len(at)))
    for trial, (p, clamp) in enumerate(zip(perturbations.tolist(), clamps.tolist(), strict=True)):
        y[trial] = state.sum(axis=0)
        state = retentions * state
        if not math.isnan(clamp):
            state += rates * clamp
        elif not math.isnan(p):
            state += rates * (p - y[trial])
    return y.T


def _polish_all(at: Floats, curves: Floats, weights: Floats, *schedule: Floats) -> Floats:
    """Return the logits that fit each curve best near these, by Levenberg and Marquardt."""
    at, damping, count = at.copy(), np.full(len(at), 1e-2), at.shape[1]
    nudges = np.concatenate([np.zeros((1, count)), _NUDGE * np.eye(count)])
    open_ones = np.arange(len(at))
    for _ in range(60):
        now, y, seen = at[open_ones], curves[open_ones], weights[open_ones]
        values = _simulate((now[:, None] + nudges).reshape(-1, count), *schedule)
        values = values.reshape(len(now), count + 1, -1) * seen[:, None]
        residuals = values[:, 0] - y
        slopes = (values[:, 1:] - values[:, :1]) / _NUDGE
        normal = np.einsum("kit,kjt->kij", slopes, slopes)
        diagonal = np.einsum("kii->ki", normal) * damping[open_ones, None] + 1e-9
        downhill = np.einsum("kit,kt->ki", slopes, residuals)[..., None]
        step = np.linalg.solve(normal + diagonal[..., None] * np.eye(count), downhill)[..., 0]
        new = np.clip(now - np.clip(step, -2, 2), -_FARTHEST, _FARTHEST)
        before = (residuals**2).sum(axis=1)
        after = ((_simulate(new, *schedule) * seen - y) ** 2).sum(axis=1)
        is_better = after < before
        at[open_ones[is_better]] = new[is_better]
        damping[open_ones] *= np.where(is_better, 0.2, 5.0)
        is_done = np.abs(before - after) <= 1e-8 * before
        open_ones = open_ones[~(is_done | (damping[open_ones] > 1e6))]
        if not len(open_ones):
            break
    return at


@np.vectorize(signature="(n)->(p)")
def fit_exponential(curves: Floats) -> Floats:
    """Fit an exponential to each curve (..., trials); return asymptote, rate and start, (..., 3).

    Only finite values count.  NaN for fewer than four trials, and if the fit explains less than a
    fifth of the variance: what has no course has no rate.
    """
    trials = np.flatnonzero(np.isfinite(curves))
    known = curves[trials]
    if len(trials) < 4 or np.ptp(known) == 0.0:
        return np.full(3, math.nan)
    shapes = np.exp(-_RATES[:, None] * trials)
    means = shapes.mean(axis=-1, keepdims=True)
    best, height = _nearest_shape(shapes - means, known - known.mean())
    if np.var(height * shapes[best]) < LEAST_EXPLAINED * np.var(known):
        return np.full(3, math.nan)

    def rate_of(log_rate: float) -> float:
        return math.exp(min(log_rate, math.log(_RATES[-1])))  # faster is learned in one trial

    asymptote, fall, log_rate = _polish(
        lambda at: at[0] + at[1] * np.exp(-rate_of(at[2]) * trials) - known,
        (known.mean() - height * means[best, 0], height, math.log(_RATES[best])),
    )
    return np.array([asymptote, rate_of(log_rate), asymptote + fall])


@np.vectorize(signature="(n),(n)->(p)")
def fit_gaussian(curves: Floats, places: Floats) -> Floats:
    """Fit a Gaussian with an offset to each curve, (..., 4), see `PARAMETERS`.

    The curves y (..., probes) are at `places` x, degrees.  Only finite values count; NaN for fewer
    than five different x, and where y is the same at all.
    """
    present = np.isfinite(curves) & np.isfinite(places)
    known, x = curves[present], places[present]
    if len(np.unique(x)) < 5 or np.ptp(known) == 0.0:
        return np.full(4, math.nan)
    shapes = _bell(x, _CENTRES, _WIDTHS)
    means = shapes.mean(axis=-1, keepdims=True)
    best, height = _nearest_shape(shapes - means, known - known.mean())
    start = known.mean() - height * means[best, 0], height, *_CENTRES[best], *_WIDTHS[best]
    offset, height, centre, width = _polish(
        lambda at: at[0] + at[1] * _bell(x, at[2], at[3]) - known, start
    )
    return np.array([offset, height, centre, abs(width)])


def _bell(x: Any, centre: Any, width: Any) -> Any:
    return np.exp(-(((x - centre) / width) ** 2) / 2)


@np.vectorize(signature="(n),(n)->()")
def generalization_width(adaptation: Floats, offsets: Floats) -> float:
    """Return σ of y = a exp(−(x − c)²/2σ²) by least squares, degrees; NaN for under four x.

    y is the `adaptation` of probes in other directions, (..., probes), of which finite ones count;
    x, the `offsets`, the target's direction less the trained one, degrees, (probes,).  At most
    180°, which stands for flat: on a circle nothing is wider.

    Source: Day, Roemmich, Taylor & Bastian (2016), eNeuro 3(2).
    """
    present = np.isfinite(adaptation) & np.isfinite(offsets)
    adaptation, offsets = adaptation[present], offsets[present]
    if len(np.unique(offsets)) < 4 or not np.any(adaptation):
        return math.nan
    best, height = _nearest_shape(_bell(offsets, _CENTRES, _WIDTHS), adaptation)
    start = height, *_CENTRES[best], *_WIDTHS[best]
    parameters = _polish(lambda at: at[0] * _bell(offsets, at[1], at[2]) - adaptation, start)
    return min(abs(float(parameters[2])), float(_WIDTHS.max()))


def _nearest_shape(shapes: Floats, values: Floats) -> tuple[int, float]:
    """Return which of the shapes (k, n) is nearest to `values` (n,) if scaled, and the scale."""
    along, square = shapes @ values, (shapes**2).sum(axis=-1)
    best = int(np.argmax(along**2 / square))
    return best, float(along[best] / square[best])


def _polish(residuals: Callable[[Floats], Floats], start: Sequence[float]) -> Floats:
    """Return what Levenberg and Marquardt make of a start; `leastsq` costs least per call."""
    return np.asarray(leastsq(residuals, start, ftol=1e-6, xtol=1e-6, full_output=True)[0])
