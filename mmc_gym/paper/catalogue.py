"""The catalogue: every experiment that `mmc-gym reproduce` knows, in the order it runs them."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from mmc_gym.paper.experiment import Experiment
from mmc_gym.paper.experiments import (
    accurate,
    bell_shaped,
    dynamic,
    example,
    forward_and_mixed,
    kinematic,
    normalization,
    population,
)

_EXPERIMENTS: tuple[Experiment, ...] = (
    normalization.EXPERIMENT,
    population.EXPERIMENT,
    accurate.EXPERIMENT,
    kinematic.EXPERIMENT,
    dynamic.EXPERIMENT,
    example.EXPERIMENT,
    bell_shaped.EXPERIMENT,
    forward_and_mixed.EXPERIMENT,
)

EXPERIMENTS: Mapping[str, Experiment] = MappingProxyType({e.name: e for e in _EXPERIMENTS})
"""Experiments by name."""
