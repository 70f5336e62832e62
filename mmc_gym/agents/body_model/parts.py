"""The switches of a body agent's parts, and how it moves and learns."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from mmc_gym._errors import require, require_between, require_number, require_numbers, spelt


@spelt
@dataclass(frozen=True)
class Parts:
    """Which parts an agent has, and how it moves and learns."""

    #: whether noise is filtered, lost numbers are completed, and moving targets are predicted
    filters: bool = True
    bridges_delay: bool = True  #: whether the delay of the senses is estimated and bridged
    #: whether lengths and a turned cursor are identified; else the given ones are used
    identifies_body: bool = True
    #: whether changes of lengths and cursor within a movement are followed, see `body_model.body`
    follows_changes: bool = True
    #: whether it is learned what commands really do to joints, and which sensors are stuck
    finds_motors: bool = True
    finds_locks: bool = True  #: whether locked joints are identified
    imagines: bool = True  #: whether several models settle; else one, from the present posture
    drives: bool = True  #: whether the servos are inverted; else they get the imagined posture
    avoids: bool = True  #: whether contacts are remembered, and routes round them planned
    vigour: float = 1.0  #: 1 as fast as servos allow, 0 as people: slower, with a bell-shaped speed
    #: share of a movement's error that is learned, see `body_model.memory`; one number for each
    #: state, such as a fast and a slow one, together at most 1.  At 1 all is learned within the
    #: movement.
    rate: tuple[float, ...] = (1.0,)
    #: share of each state that is left at the next movement; with a rate of 1 and 0 here there is
    #: no memory
    retention: tuple[float, ...] = (0.0,)
    #: how subjects differ: standard deviation of the rate, as a share of it, and of the retention
    rate_spread: float = 0.0
    retention_spread: float = 0.0
    #: of the directions for which it is learned, about that of the target when the movement begins:
    #: standard deviation of a Gaussian, degrees
    width: float = math.inf
    largest_error: float = math.inf  #: larger errors count as this angle, degrees
    #: of the direction that a movement is planned in: standard deviation, degrees (van Beers 2009)
    planning_noise: float = 0.0
    #: of commands, as a share of each: it grows with the command (Harris & Wolpert 1998)
    motor_noise: float = 0.0
    noise_spread: float = 0.0  #: how subjects differ in both: standard deviation, as a share
    noise_seed: int = 0  #: of their draws; that of a subject is drawn

    def __post_init__(self) -> None:
        accepted = "a number between 0 and 1"
        require_number("vigour", self.vigour, accepted, lambda number: 0 <= number <= 1)
        for name in ("rate_spread", "retention_spread", "motor_noise", "noise_spread"):
            require_between(0, 1, **{name: getattr(self, name)})
        require_between(0, 180, planning_noise=self.planning_noise)
        for name in ("width", "largest_error"):
            require_number(name, getattr(self, name), "positive", lambda number: number > 0)
        accepted = "numbers between 0 and 1, of each state, such as (0.2,)"
        for name in ("rate", "retention"):
            numbers = require_numbers(name, getattr(self, name), accepted, _are_shares)
            object.__setattr__(self, name, numbers)
        count, total = len(self.rate), sum(self.rate)
        accepted = f"{count} numbers, as many as rate has"
        require(len(self.retention) == count, "retention", self.retention, accepted)
        require(total <= 1, "rate", self.rate, "at most 1 together")

    @cached_property
    def learns(self) -> bool:
        """Whether anything lasts from movement to movement: what is learned, or draws of noise."""
        return any(self.retention) or sum(self.rate) < 1 or self.is_noisy

    @property
    def is_noisy(self) -> bool:
        """Whether plans or commands are noisy."""
        return self.planning_noise > 0 or self.motor_noise > 0

    def drawn(self, random: np.random.Generator) -> Parts:
        """Return the parts of a subject, whose rate, retention and noise are drawn about these."""
        normal = random.standard_normal((2, len(self.rate)))
        rate = np.clip(self.rate * (1 + self.rate_spread * normal[0]), 0, 1)
        retention = np.clip(self.retention + self.retention_spread * normal[1], 0, 1)
        rate /= max(1.0, rate.sum())
        subject_settings: dict[str, Any] = {
            "rate": tuple(rate.tolist()),
            "retention": tuple(retention.tolist()),
        }
        if self.is_noisy:
            factor = max(0.0, 1 + self.noise_spread * random.standard_normal())
            subject_settings["planning_noise"] = min(180.0, factor * self.planning_noise)
            subject_settings["motor_noise"] = min(1.0, factor * self.motor_noise)
            subject_settings["noise_seed"] = int(random.integers(2**32))
        return replace(self, **subject_settings)


def _are_shares(numbers: tuple[float, ...]) -> bool:
    return len(numbers) > 0 and all(0 <= number <= 1 for number in numbers)


NOISE = ("planning_noise", "motor_noise", "noise_spread")
LEARNED = ("rate", "retention", "rate_spread", "retention_spread", "width", "largest_error", *NOISE)
"""The fields that say how it learns from movement to movement, and how noisy it is."""

ALL_PARTS = Parts()
"""The parts of an agent by default."""
