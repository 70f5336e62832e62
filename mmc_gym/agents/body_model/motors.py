"""Motors: what commands really do to joints, where that is not what the given servo does.

By the model of `commanded_turn` a command should turn a joint by u in a control step.  It turns by

    v′ = a v + g u + b

where v is its turn in the step before: a is what lasts of that, g the strength of the motor and its
sign, b a push.  Weak, strong and reversed motors, other servos, pushes and dead zones are all in
these three numbers.  They follow from the control steps by recursive least squares that forget,

    x = (v, u, 1),   v̂ = a v + g u + b,   w = 1 / (1 + (v̂ − v)² / V²)
    S = Σ λ^k w x xᵀ,   r = Σ λ^k w x (v′ − a₀ v − g₀ u)
    (a, g, b) = (a₀, g₀, 0) + (S + Λ)⁻¹ r

where a₀ and g₀ are of the given servo.  Torque is limited, and no linear motor shows that: joints
with a load lag behind, and what is learned from that is wrong near the goal.  So steps in which a
turn should change much have a small weight w, and what is learned acts only where it predicts
clearly better than the given servo, with its torque limited or not.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mmc_gym.agents.base import any_true
from mmc_gym.agents.body_model.forward_model import (
    CLEARLY,
    FAST_RATE,
    KEEP,
    WEAK,
    Bools,
    bounded,
)
from mmc_gym.geometry import Floats

GIVEN = np.array([0.19, 0.77, 0.0])  # a₀, g₀ and b of the given servo
RIDGE = np.diag([0.5, 0.01, 1.0])  # Λ, in full turns squared
CHANGE = 0.2  # V: change of a turn from which on torque may be at its limit, full turns
AS_GOOD = 2e-4  # square error that is as good as none, full turns squared
OTHER = 2e-3  # square error of a motor that clearly is not the given servo, full turns squared
LEAST_CHANGE = 0.1  # change of a turn that a given servo always can, full turns


class Motors(NamedTuple):
    """What is known of the motors of n arms with N joints, in turns at full speed."""

    squares: Floats  # S, (n, N, 3, 3)
    products: Floats  # r, (n, N, 3)
    fit: Floats  # a, g and b, (n, N, 3)
    running: Floats  # mean squares: errors as given, and as learned; changes of the turn, (n, N, 3)
    is_learned: Bools  # whether what is learned is used, (n, N)

    @classmethod
    def start(cls, arms: int, joints: int) -> Motors:
        """Return what is known before a movement."""
        sums = np.zeros((arms, joints, 3))
        squares = np.zeros((*sums.shape, 3))
        return cls(squares, sums, sums + GIVEN, sums, sums[..., 0] > 0)

    def observe(
        self, before: Floats, commanded: Floats, turn: Floats, strength: Floats, counts: Bools
    ) -> Motors:
        """Return the motors after a control step, all in full turns, (n, N); some count, (n, 1).

        Joints turned `before`, and now by `turn`.  `strength` is by how much a given servo changes
        a turn at most, as far as is known.
        """
        x, sizes = np.ones((*turn.shape, 3)), np.empty_like(self.running)
        x[..., 0], x[..., 1] = before, commanded
        given, learned = (x * GIVEN).sum(axis=-1), (x * self.fit).sum(axis=-1)
        most: Floats = np.maximum(strength, LEAST_CHANGE)
        limited = before + bounded(given - before, most)
        error = turn - given
        sizes[..., 0] = np.minimum(np.abs(error), np.abs(turn - limited))
        sizes[..., 1], sizes[..., 2] = turn - learned, turn - before
        weight = (counts / (1 + ((learned - before) / CHANGE) ** 2))[..., None]
        running = self.running + FAST_RATE * weight * (sizes * sizes - self.running)
        keep, weighted = np.where(counts, KEEP, 1.0)[..., None], weight * x
        squares = keep[..., None] * self.squares + weighted[..., None] * x[..., None, :]
        products = keep * self.products + weighted * error[..., None]
        fit = GIVEN + np.linalg.solve(squares + RIDGE, products[..., None])[..., 0]
        ratio = np.where(self.is_learned, 1 / CLEARLY, CLEARLY)
        is_better = running[..., 1] + AS_GOOD < ratio * running[..., 0]
        is_learned = is_better & (np.abs(fit[..., 1]) > WEAK)
        return Motors(squares, products, fit, running, is_learned)

    @property
    def differ(self) -> Bools:
        """Which motors are not as given, or bear a load, (n, N)."""
        differ: Bools = self.running[..., 0] > AS_GOOD
        return differ

    @property
    def error(self) -> Floats:
        """Mean square error of the motor that is least as given, full turns squared, (n,)."""
        error: Floats = self.running[..., 0].max(axis=-1)
        return error

    @property
    def clearly_differ(self) -> Bools:
        """Which arms have a motor that is clearly not as given, (n,)."""
        differ: Bools = self.error > OTHER
        return differ

    @property
    def shown_change(self) -> Floats:
        """Root mean square of how turns lately changed in a control step, full turns, (n, N)."""
        change: Floats = np.sqrt(self.running[..., 2])
        return change

    def expected(self, before: Floats, commanded: Floats, unit: float) -> Floats:
        """Return how far joints turn by a command, radians, where that is learned; else as given.

        `unit` is a full turn, radians.
        """
        if not any_true(self.is_learned):
            return commanded
        lasting, gain, push = np.moveaxis(self.fit, -1, 0)
        turn = lasting * before + gain * commanded + push * unit
        return np.where(self.is_learned, turn, commanded)

    def inverse(self, turn: Floats, before: Floats, unit: float) -> Floats:
        """Return the command for a turn by what is learned, radians."""
        lasting, gain, push = np.moveaxis(self.fit, -1, 0)
        gain = np.copysign(np.maximum(np.abs(gain), WEAK), gain)
        return (turn - lasting * before - push * unit) / gain
