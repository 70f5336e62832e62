"""Measures of an experiment over trials, each registered with label and unit.

They take the `Learning` of an experiment, of each subject or averaged over subjects, and return NaN
where the experiment does not show what they measure.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from mmc_gym.measures.catalogue import Quantity
from mmc_gym.measures.episode import Floats
from mmc_gym.measures.learning import (
    Exponential,
    TwoStates,
    fit_exponential,
    fit_two_states,
    generalization_width,
)

AT_START, AT_END = 4, 10  # trials whose mean is the level at the start or end of a block


@dataclass(frozen=True, kw_only=True, eq=False)
class Learning:
    """What the trials of an experiment show of learning, by subject or averaged over subjects."""

    adaptation: Floats  #: y, less the mean of the baseline, (..., trials)
    errors: Floats  #: e, (..., trials)
    perturbations: Floats  #: p, 0 for none, (trials,)
    kinds: NDArray[np.str_]  #: "", "clamp", or the name of a probe, (trials,)
    offsets: Floats  #: the target's direction less the trained one, degrees, (trials,)
    blocks: NDArray[np.int64]  #: number of the block, (trials,)
    rests: Floats  #: before the trial, seconds, (trials,)
    unit: str = "°"  #: of adaptation, errors and perturbations
    deviation: float = math.nan  #: first one in a force field, segment lengths

    @cached_property
    def exposures(self) -> list[NDArray[np.int64]]:
        """Trials with the perturbation that comes first, in its direction.

        Blocks with it that follow each other are one exposure.
        """
        first = self.perturbations[np.flatnonzero(self.perturbations)[:1]].sum()
        trained = (self.perturbations * first > 0) & (self.kinds == "")
        numbers = np.unique(self.blocks[trained])
        groups = np.split(numbers, np.flatnonzero(np.diff(numbers) > 1) + 1) if len(numbers) else []
        return [np.flatnonzero(trained & np.isin(self.blocks, group)) for group in groups]

    @cached_property
    def exponentials(self) -> list[Exponential]:
        """The fit to each of the `exposures`."""
        return [fit_exponential(self.adaptation[..., trials]) for trials in self.exposures]

    @cached_property
    def two_states(self) -> TwoStates:
        """The fit to all trials; NaN if nothing was to be learned."""
        has_lesson = bool(self.exposures) or bool((self.kinds == "clamp").any())
        found = fit_two_states(self.adaptation, self.errors)
        return found if has_lesson else TwoStates(*[self.none] * 4)

    def level(self, trials: NDArray[np.int64]) -> Floats:
        """Return the mean adaptation in some trials, NaN without any."""
        return np.asarray(self.adaptation[..., trials].mean(axis=-1)) if len(trials) else self.none

    @property
    def noticeable(self) -> float:
        """The least adaptation that ratios and widths are taken of: 1 % of the perturbation."""
        return 0.01 * float(np.abs(self.perturbations).max())

    @property
    def none(self) -> Floats:
        """NaN for each curve."""
        return np.full(self.adaptation.shape[:-1], math.nan)


OfLearning: TypeAlias = Callable[[Learning], Floats]


@dataclass(frozen=True, kw_only=True)
class LearningMeasure(Quantity):
    """A measure `of` learning, a number for each curve; `ADAPTATION` stands for its unit."""

    of: OfLearning = field(compare=False)


ADAPTATION = "of adaptation"
LEARNING_MEASURES: dict[str, LearningMeasure] = {}
"""All measures of learning by name, in the order of tables."""


def learning_measure(
    *, label: str, unit: str = "", decimals: int = 2
) -> Callable[[OfLearning], OfLearning]:
    """Register a function `Learning -> (...)`; it returns NaN where an experiment has no value."""

    def decorate(function: OfLearning) -> OfLearning:
        name = function.__name__
        LEARNING_MEASURES[name] = LearningMeasure(
            name=name, label=label, unit=unit, decimals=decimals, of=function
        )
        return function

    return decorate


@learning_measure(label="rate of learning", unit="1/trial", decimals=3)
def rate(learning: Learning) -> Floats:
    """Return the rate of the `fit_exponential` to the first exposure."""
    return learning.exponentials[0].rate if learning.exposures else learning.none


@learning_measure(label="adaptation at the end", unit=ADAPTATION)
def final_adaptation(learning: Learning) -> Floats:
    """Return the mean adaptation in the last `AT_END` trials of the first exposure.

    Unlike the asymptote of a fit it lies within the data, where learning is slow as well.
    """
    return learning.level(learning.exposures[0][-AT_END:]) if learning.exposures else learning.none


@learning_measure(label="after-effect", unit=ADAPTATION)
def after_effect(learning: Learning) -> Floats:
    """Return the mean adaptation in the first `AT_START` trials of the block without perturbation.

    The block is the one after the first exposure.

    Source:
        Shadmehr & Mussa-Ivaldi (1994), J. Neurosci. 14, 3208–3224.
    """
    if not learning.exposures:
        return learning.none
    is_next = learning.blocks == learning.blocks[learning.exposures[0][-1]] + 1
    is_free = (learning.perturbations == 0) & (learning.kinds != "transfer")
    return learning.level(np.flatnonzero(is_next & is_free)[:AT_START])


@learning_measure(label="retained over the rest", unit="fraction")
def retention(learning: Learning) -> Floats:
    """Return the adaptation in `AT_START` trials after the first rest, over `AT_END` before it.

    Only rests after the perturbation has begun count.
    """
    begin = learning.exposures[0][0] if learning.exposures else len(learning.rests)
    rested = np.flatnonzero(learning.rests[begin + 1 :] > 0)[:1] + begin + 1
    after, before = (np.add.outer(rested, np.arange(*ends)).ravel() for ends in _AROUND)
    learned = learning.level(before[before >= begin])
    return learning.level(after) / np.where(learned > learning.noticeable, learned, math.nan)


_AROUND = (0, AT_START), (-AT_END, 0)


@learning_measure(label="savings", unit="ratio of rates")
def savings(learning: Learning) -> Floats:
    """Return the rate of the second exposure over that of the first; above 1 there are savings.

    Source:
        Zarahn, Weston, Liang, Mazzoni & Krakauer (2008), J. Neurophysiol. 100, 2537–2548.
    """
    fits = learning.exponentials
    return fits[1].rate / fits[0].rate if len(fits) > 1 else learning.none


@learning_measure(label="width of generalisation", unit="°", decimals=1)
def width(learning: Learning) -> Floats:
    """Return the `generalization_width` of the probes in other directions."""
    begin = learning.exposures[0][0] if learning.exposures else len(learning.kinds)
    probes = np.flatnonzero(learning.kinds[begin:] == "transfer") + begin
    if not len(probes):
        return learning.none
    adaptation = learning.adaptation[..., probes]
    is_seen = adaptation.max(axis=-1) > learning.noticeable
    found = generalization_width(adaptation, learning.offsets[probes])
    return np.where(is_seen, found, math.nan)


@learning_measure(label="asymptote under the clamp", unit=ADAPTATION)
def clamp_asymptote(learning: Learning) -> Floats:
    """Return the mean adaptation in the last `AT_END` trials whose error is clamped, not at 0.

    Source:
        Morehead, Taylor, Parvin & Ivry (2017), J. Cogn. Neurosci. 29, 1061–1074.
    """
    shown = np.abs(learning.errors.reshape(-1, len(learning.kinds))).max(axis=0) > 0.1
    return learning.level(np.flatnonzero((learning.kinds == "clamp") & shown)[-AT_END:])


def _parameter(name: str) -> OfLearning:
    def parameter(learning: Learning) -> Floats:
        return np.asarray(getattr(learning.two_states, name))

    parameter.__name__ = name
    return parameter


for _name in TwoStates._fields:
    learning_measure(label=f"{_name} of two states", decimals=3)(_parameter(_name))
