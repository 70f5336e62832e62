"""What subjects show of learning: their movements, the course of learning, and its measures."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmc_gym.envs.perturbations import Channel, ErrorClamp, ForceField, NoFeedback
from mmc_gym.experiments.experiment import PlannedTrial, has
from mmc_gym.experiments.fits import (
    ONE_STATE,
    TWO_STATES,
    choose_states,
    fit_exponential,
    generalization_width,
)
from mmc_gym.experiments.learning import (
    correction_gain,
    correction_latency,
    initial_direction,
    lateral_deviation,
)
from mmc_gym.measures.catalogue import Quantity
from mmc_gym.measures.episode import Floats

AT_START, AT_END = 4, 10  # trials whose mean is the level at the start or end of a block
BEFORE_FEEDBACK = 0.1  # s after movement onset: what a hand shows by then, it knew before
LEAST = 0.01  # share of the perturbation, and deviation in segment lengths; less is nothing

OF_ADAPTATION = "of adaptation"
QUANTITIES = (
    Quantity(name="deviation", label="first deviation in the field", unit="lengths", decimals=3),
    Quantity(name="rate", label="rate of learning", unit="1/trial", decimals=3),
    Quantity(name="final_adaptation", label="asymptote", unit=OF_ADAPTATION),
    Quantity(name="after_effect", label="after-effect", unit=OF_ADAPTATION),
    Quantity(name="channel_force", label="force in channels", unit="of the ideal force"),
    Quantity(name="retention", label="retention", unit="fraction"),
    Quantity(name="savings", label="savings", unit="ratio of rates"),
    Quantity(name="width", label="width of generalisation", unit="°", decimals=1),
    Quantity(name="clamp_asymptote", label="asymptote in clamps", unit=OF_ADAPTATION),
    Quantity(name="latency", label="latency of corrections", unit="s", decimals=3),
    Quantity(name="gain", label="gain of corrections"),
    *(Quantity(name=name, label=f"{name} of one state", decimals=3) for name in ONE_STATE),
    *(Quantity(name=name, label=f"{name} of two states", decimals=3) for name in TWO_STATES),
)
"""The measures of `measure_learning`; `OF_ADAPTATION` stands for the unit of the adaptation."""


class Movements(NamedTuple):
    """The movements of an agent's subjects in an experiment; paths are in segment lengths."""

    schedule: tuple[PlannedTrial, ...]
    angles: Floats  #: directions of the targets, degrees, (subjects, trials)
    hands: NDArray[np.floating]  #: (subjects, trials, steps + 1, 2)
    cursors: NDArray[np.floating]  #: likewise; the hand's where there is none
    targets: NDArray[np.floating]  #: likewise
    control_step: float  #: s
    #: of the ideal force in channels, NaN in other trials, (subjects, trials)
    channel_shares: Floats | float = math.nan


class Corrections(NamedTuple):
    """Responses to jumps in flight, see `correction_gain` and `correction_latency`."""

    responses: Floats  #: segment lengths, (..., time)
    size: float  #: of the jump, segment lengths
    time: float  #: of the jump, s after the start
    control_step: float  #: s


@dataclass(frozen=True, kw_only=True, eq=False)
class Learning:
    """The course of learning over trials, by subject or averaged over subjects."""

    adaptation: Floats  #: y, less the mean of the baseline, (..., trials)
    errors: Floats  #: e, (..., trials)
    perturbations: Floats  #: p, 0 for none, (trials,)
    #: the error that is shown in error clamps, 0 in channels and without feedback, NaN in other
    #: trials, (trials,)
    clamps: Floats
    kinds: NDArray[np.str_]  #: see `PlannedTrial.kind`, (trials,)
    offsets: Floats  #: the target's direction less the trained one, degrees, (trials,)
    blocks: NDArray[np.int64]  #: number of the block, (trials,)
    rests: Floats  #: before the trial, seconds, (trials,)
    unit: str = "°"  #: of adaptation, errors and perturbations
    deviation: float = math.nan  #: first one in a force field, segment lengths
    corrections: Corrections | None = None  #: of jumps in flight

    @property
    def exposures(self) -> list[NDArray[np.int64]]:
        """Trials with the perturbation that comes first, in its direction, by runs of blocks."""
        first = self.perturbations[np.flatnonzero(self.perturbations)[:1]].sum()
        trained = (self.perturbations * first > 0) & (self.kinds == "plain")
        numbers = np.unique(self.blocks[trained])
        groups = np.split(numbers, np.flatnonzero(np.diff(numbers) > 1) + 1) if len(numbers) else []
        return [np.flatnonzero(trained & np.isin(self.blocks, group)) for group in groups]


def measure_learning(of: Learning) -> dict[str, Floats]:
    """Return the `QUANTITIES` by name, a number for each curve; NaN where there is nothing to see.

    - A and B: of one state, if it fits best by BIC; A_f to B_s: of two states, if they do.
    - rate: of the exponential fit to the first exposure; savings: that of the second over it, see
      Zarahn et al. (2008), J. Neurophysiol. 100, 2537.
    - final_adaptation: mean of the last 10 trials of the first exposure.
    - after_effect: of the first 4 without perturbation in the block that follows, see Shadmehr &
      Mussa-Ivaldi (1994), J. Neurosci. 14, 3208.
    - retention: of the 4 trials after the first rest that follows (of all, if its block has fewer),
      over the 10 before it.
    - clamp_asymptote: of the last 10 trials whose error is clamped and not 0, see Morehead et al.
      (2017), J. Cogn. Neurosci. 29, 1061.
    - channel_force: adaptation in the last 10 channels of the first exposure, or if it has none of
      what follows, see Smith et al. (2006), PLoS Biol. 4, e179.
    - others: see `mmc_gym.experiments.learning`.
    """
    exposed, clamped = _of_exposures(of), np.flatnonzero(of.kinds == "clamp")
    measures: dict[str, Any] = {"deviation": of.deviation, **exposed}
    if exposed or len(clamped):
        adaptation = np.where(np.isin(of.kinds, ("transfer", "jump")), math.nan, of.adaptation)
        states = choose_states(adaptation, of.perturbations, of.clamps)
        measures |= zip(ONE_STATE + TWO_STATES, np.moveaxis(states, -1, 0), strict=True)
    curves = tuple(range(of.errors.ndim - 1))
    is_shown = np.abs(of.errors[..., clamped]).max(axis=curves, initial=0) > 0.1
    measures["clamp_asymptote"] = _level(of, clamped[is_shown][-AT_END:])
    if of.corrections:
        responses, *jump = of.corrections
        measures["latency"] = np.apply_along_axis(correction_latency, -1, responses, *jump)
        measures["gain"] = correction_gain(responses, of.corrections.size)
    shape = of.adaptation.shape[:-1]
    return {
        quantity.name: np.broadcast_to(measures.get(quantity.name, math.nan), shape)
        for quantity in QUANTITIES
    }


def _of_exposures(of: Learning) -> dict[str, Any]:
    exposures, least = of.exposures, LEAST * np.abs(of.perturbations).max()
    if not exposures:
        return {}
    begin, end = exposures[0][[0, -1]]
    rates = [_rate(of.adaptation[..., exposure], least) for exposure in exposures[:2]]
    is_free = (of.perturbations == 0) & (of.kinds != "transfer")
    is_free &= of.blocks == of.blocks[end] + 1
    return {
        "rate": rates[0],
        "savings": rates[1] / rates[0] if len(rates) > 1 else math.nan,
        "final_adaptation": _level(of, exposures[0][-AT_END:]),
        "after_effect": _level(of, np.flatnonzero(is_free)[:AT_START]),
        "channel_force": _level(of, _channels(of, begin)[-AT_END:]),
        "retention": _retention(of, begin, least),
        "width": _width(of, begin, least),
    }


def _level(of: Learning, trials: NDArray[np.int64]) -> Any:
    """Return the mean adaptation over some trials, NaN over none."""
    return of.adaptation[..., trials].mean(axis=-1) if len(trials) else math.nan


def _channels(of: Learning, begin: int) -> NDArray[np.int64]:
    """Return the trials in channels, of the first exposure if it has some, else all that follow."""
    after = np.flatnonzero(of.kinds[begin:] == "channel") + begin
    inside = after[np.isin(of.blocks[after], of.blocks[of.exposures[0]])]
    return inside if len(inside) else after


def _rate(curves: Floats, least: float) -> Floats:
    fits = fit_exponential(curves)
    # A hand that turns with the perturbation, not against it, has learned nothing.
    return np.where(fits[..., 0] > least, fits[..., 1], math.nan)


def _retention(of: Learning, begin: int, least: float) -> Any:
    """Return the share of what was learned that is left after the first rest from `begin` on."""
    rests = np.flatnonzero(of.rests[begin + 1 :]) + begin + 1
    if not len(rests):
        return math.nan
    rest = rests[0]
    learned = _level(of, np.arange(max(begin, rest - AT_END), rest))
    left = _level(of, np.flatnonzero(of.blocks[rest:] == of.blocks[rest])[:AT_START] + rest)
    return left / np.where(learned > least, learned, math.nan)


def _width(of: Learning, begin: int, least: float) -> Any:
    """Return the width of generalisation to the targets of probes from `begin` on."""
    probes = np.flatnonzero(of.kinds[begin:] == "transfer") + begin
    if not len(probes):
        return math.nan
    learned = of.adaptation[..., probes]
    widths = generalization_width(learned, of.offsets[probes])
    return np.where(np.fmax.reduce(learned, axis=-1) > least, widths, math.nan)


def learning_of(of: Movements) -> Learning:
    """Return what the subjects of an agent show of learning, (subjects, trials).

    Under a cursor the adaptation is the direction of the hand `BEFORE_FEEDBACK`, because later a
    movement corrects itself, from the instructed aim, if there is one: what remains is implicit.
    In a force field it is the lateral deviation at peak speed, in units of its mean in the first
    trial, without what differs between targets, because the field pushes less in some directions.
    In a channel it is the share of the ideal force.  The mean of each subject's baseline at each
    target is subtracted.  Channels and hidden cursors show no error.  Probes in other directions
    are sorted by direction within their block, since each subject has another order.
    """
    schedule, angles = of.schedule, of.angles
    blocks = np.array([trial.block for trial in schedule])
    kinds = np.array([trial.kind for trial in schedule])
    strengths = np.array([trial.strength for trial in schedule])
    clamped, in_channel, hidden, in_field = (
        np.array([has(trial.condition.perturbations, kind) for trial in schedule])
        for kind in (ErrorClamp, Channel, NoFeedback, ForceField)
    )
    is_field = in_field.any()
    errorless = in_channel | (hidden & (not is_field))  # a field is felt
    first = np.flatnonzero(strengths)[:1]  # empty without a perturbation
    sign = np.sign(strengths[first].sum())

    aims = np.radians(angles + np.array([trial.aim for trial in schedule]))
    towards = np.stack([np.cos(aims), np.sin(aims)], axis=-1)
    steps = round(BEFORE_FEEDBACK / of.control_step)
    measured = lateral_deviation if is_field else partial(initial_direction, steps=steps)
    hand, seen = (measured(paths, of.hands[:, :, 0] + towards) for paths in (of.hands, of.cursors))
    before, free = np.arange(len(schedule)) < first.sum(), np.where(in_channel, math.nan, hand)
    baseline = _baseline(free, angles, before)
    hand, seen = hand - baseline, seen - np.where(clamped, 0.0, baseline)
    perturbations = np.where(clamped | in_channel, 0.0, strengths) * sign
    adaptation, errors, deviation = -hand * sign, seen * sign, math.nan
    if is_field:
        perturbations /= np.abs(strengths).max()
        groups = blocks + len(schedule) * np.unique(kinds, return_inverse=True)[1]
        hand = _without_directions(hand, angles, groups)
        deviation = float(np.nanmean(hand[:, first]) / perturbations[first].sum())
        is_known = abs(deviation) > LEAST and perturbations[first].sum() > 0.5
        errors = hand / (deviation if is_known else math.nan)
        adaptation = perturbations - errors
    if in_channel.any():
        shares = np.broadcast_to(of.channel_shares if is_field else math.nan, angles.shape)
        shares = shares - _baseline(shares, angles, before)
        parts = [trial.condition.perturbations for trial in schedule]
        curls = [sum(c.number or 0.0 for c in changes if has([c], Channel)) for changes in parts]
        adaptation = np.where(in_channel, shares * (np.sign(curls) * sign), adaptation)
    errors, perturbations = (np.where(errorless, 0.0, values) for values in (errors, perturbations))
    order = np.tile(np.arange(len(schedule)), (len(angles), 1))
    for block in np.unique(blocks):
        probes = np.flatnonzero((blocks == block) & (kinds == "transfer"))
        order[:, probes] = probes[np.argsort(angles[:, probes], axis=1, kind="stable")]
    adaptation, errors, ordered = (
        np.take_along_axis(values, order, axis=1) for values in (adaptation, errors, angles)
    )
    return Learning(
        adaptation=adaptation,
        errors=errors,
        perturbations=perturbations,
        clamps=np.where(clamped, strengths * sign, np.where(errorless, 0.0, math.nan)),
        kinds=kinds,
        offsets=(ordered[0] - angles[0, first].sum() + 180) % 360 - 180,
        blocks=blocks,
        rests=np.array([trial.rest for trial in schedule]),
        unit="fraction" if is_field else "°",
        deviation=abs(deviation),
        corrections=_corrections(of, kinds),
    )


def _baseline(values: Floats, angles: Floats, before: NDArray[np.bool_]) -> Floats:
    """Return each subject's mean before the perturbation at the same target, 0 without one."""
    same = (angles[:, :, None] == angles[:, None, before]) & ~np.isnan(values[:, None, before])
    known = np.where(same, values[:, None, before], 0.0).sum(axis=-1)
    return known / np.maximum(same.sum(axis=-1), 1)


def _without_directions(values: Floats, angles: Floats, groups: NDArray[np.int64]) -> Floats:
    """Subtract how the mean at each target differs from the mean of its group of trials."""
    centred = values.copy()
    for group in np.unique(groups):
        level = np.nanmean(values[:, groups == group])
        for angle in np.unique(angles[:, groups == group]):
            here = (angles == angle) & (groups == group)
            centred[here] -= np.nanmean(values[here]) - level
    return centred


def _corrections(of: Movements, kinds: NDArray[np.str_]) -> Corrections | None:
    """Return each subject's mean response to jumps, None if no trial shows one.

    A jump changes where the hand must go: the target's, or that of the cursor against the hand.
    """
    jumps = np.flatnonzero(kinds == "jump")
    if not len(jumps):
        return None
    goals = (of.targets - (of.cursors - of.hands))[:, jumps].astype(np.float64)
    go_step = max(round(trial.condition.go_cue / of.control_step) for trial in of.schedule)
    moved = goals - goals[:, :, [go_step + 1]]
    sizes = np.linalg.norm(moved[:, :, -1], axis=-1)
    if not sizes.any():
        return None
    same = (of.angles[:, jumps, None] == of.angles[:, None]) & (kinds == "plain")
    plain = np.einsum("sjk,sktd->sjtd", same / same.sum(axis=-1, keepdims=True), of.hands)
    first = tuple(np.argwhere(sizes > 0)[0])
    step = np.argmax(np.linalg.norm(moved[first], axis=-1) > sizes[first] / 2)
    sizes[sizes == 0] = math.nan
    ways = moved[:, :, -1] / sizes[..., None]
    along = np.einsum("sjtd,sjd->sjt", of.hands[:, jumps] - plain, ways)
    counts = (~np.isnan(along)).sum(axis=1)
    return Corrections(
        responses=np.nansum(along, axis=1) / np.where(counts, counts, math.nan),
        size=float(np.nanmean(sizes)),
        time=float(step) * of.control_step,
        control_step=of.control_step,
    )
