"""Body: how long the segments are, and how the seen hand is turned, in closed form.

With the unit vectors u_i of the segments, as complex numbers, all that may be wrong with lengths ℓ
and with the sight of the hand x is one linear model,

    x = e^{iφ} Σ ℓ_i u_i + c,

of which every hypothesis leaves some free: none (the body is as told); the angle φ of a cursor
that is turned about the base; one length; all lengths; lengths and angle; and each of these with
the shift c, which moves the centre of the turn to c / (1 − e^{iφ}).  Running sums over the
observations,

    G = Σ Re(ū uᵀ),     h = Σ ū x,     s = Σ |x|²       (about their means, where c is free)

give each of them in closed form, and what it leaves unexplained:

    turned            φ = arg(ℓᵀ h)
    segment j         ℓ_j = (Re h_j − Σ_{k≠j} G_jk ℓ_k) / G_jj
    all lengths       ℓ = G⁻¹ Re h
    lengths, turned   2φ = arg(hᵀ G⁻¹ h), then ℓ = G⁻¹ Re(e^{−iφ} h)
    unexplained       S = s − 2 Re(e^{−iφ} ℓᵀ h) + ℓᵀ G ℓ

(φ of the fourth maximises Re(e^{−iφ} h)ᵀ G⁻¹ Re(e^{−iφ} h).)  The hypothesis with the least

    n log((S + ε) / (n + 1)) + k (4 + 2 log(n + 1))

is believed: n observations, k free parameters, ε the square error that is none.  This is the
Bayesian information criterion (Schwarz 1978) with a heavier penalty, for neighbouring observations
are nearly the same.  A cursor that is turned, or a segment of another length, is mostly found with
the first observation, before anything has moved.

What the believed hypothesis leaves unexplained, if it is no noise, is added as an offset.

Literature: G. Schwarz (1978), Estimating the dimension of a model, Ann. Statist. 6, 461–464.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mmc_gym.agents.base import every, some, where
from mmc_gym.agents.body_model.senses import Points
from mmc_gym.network.chain import Floats

FORGET = 0.005
"""Share of the sums that a control step forgets."""
EXACT = 2 * 0.006**2
"""ε: square error that is none, segment lengths²."""
PENALTY = 4.0
"""What a parameter costs, besides 2 log(n + 1)."""
RIDGE = 1e-3
"""Weight of the told lengths where all of them are free."""
SHORTEST, LONGEST = 0.3, 2.0
"""Lengths are within these factors of those told, or the hypothesis is dropped."""
FREQUENT = 12
"""Observations after which the hypotheses are compared in every fourth control step only."""
OFFSET_RATE = 0.1
"""Share by which the mean of what is unexplained follows."""


class Body(NamedTuple):
    """A body and how its hand is seen: x = turn · Σ ℓ u + shift.

    Attributes:
        lengths: ℓ, segment lengths, (n, N).
        turn: e^{iφ}, (n,).
        shift: c, segment lengths, (n,).
    """

    lengths: Floats
    turn: Points
    shift: Points

    def seen(self, units: Points) -> Points:
        """Return where the hand is seen if the segments point along these units (n, N), (n,)."""
        seen: Points = self.turn * (self.lengths * units).sum(axis=-1) + self.shift
        return seen

    def felt(self, seen: Points) -> Points:
        """Return where the hand is, or has to be, that is seen at these points, (n,)."""
        felt: Points = (seen - self.shift) * self.turn.conj()
        return felt


def _products(units: Points, hand: Points) -> Points:
    """Return what an observation adds to the sums: z̄ zᵀ with z = (u_1 … u_N, x, 1).

    Args:
        units: u, (n, N).
        hand: x, (n,); or another place instead.

    Returns:
        (n, N + 2, N + 2).  In their sum, the first N rows and columns have the real part G, the
        next column is h, and the next number on the diagonal s; the last row has Σ u, Σ x and n.
    """
    arms, count = units.shape
    each = np.empty((arms, count + 2), complex)
    each[:, :count], each[:, count], each[:, count + 1] = units, hand, 1.0
    products: Points = each.conj()[:, :, None] * each[:, None, :]
    return products


class BodyEvidence(NamedTuple):
    """Running sums, and the body that they make most likely.

    Attributes:
        age: observations so far, (n,).
        sums: of the observations, see `_products`, with the older ones slowly forgotten; in place
            of the hand x there is e = x − ℓᵀu for the told ℓ, (n, N + 2, N + 2).
        told: the body as told.
        body: what is believed.
        offset: mean of what it leaves unexplained, (n,).
        scatter: mean square about that, (n,).
    """

    age: Floats
    sums: Points
    told: Body
    body: Body
    offset: Points
    scatter: Floats

    @classmethod
    def start(cls, lengths: tuple[float, ...], arms: int) -> BodyEvidence:
        """Return that nothing speaks against what was told."""
        zero, origin = np.zeros(arms), np.zeros(arms, complex)
        sums = np.zeros((arms, len(lengths) + 2, len(lengths) + 2), complex)
        told = Body(np.tile(np.array(lengths), (arms, 1)), origin + 1, origin)
        return cls(zero, sums, told, told, origin, zero)

    def observed(self, joint_angles: Floats, hand: Points) -> BodyEvidence:
        """Return the evidence after the hand was seen there, (n,), with this posture (n, N)."""
        units = np.exp(1j * np.cumsum(joint_angles, axis=-1))
        error = hand - (self.told.lengths * units).sum(axis=-1)
        sums, age = (1 - FORGET) * self.sums + _products(units, error), self.age + 1
        body = self._judged(sums, age)
        if body is not self.told:
            error = hand - body.seen(units)
        rate = np.maximum(OFFSET_RATE, 1 / age)
        offset = self.offset + rate * (error - self.offset)
        scatter = self.scatter + rate * (np.abs(error - offset) ** 2 - self.scatter)
        return BodyEvidence(age, sums, self.told, body, offset, scatter)

    @property
    def best(self) -> Body:
        """The body to go by: as believed, with the offset as far as it is no noise."""
        square = np.abs(self.offset) ** 2
        share = square / (square + self.scatter + EXACT)
        return self.body._replace(shift=self.body.shift + share * self.offset)

    def _judged(self, sums: Points, age: Floats) -> Body:
        """Return the body that the sums make most likely."""
        # What is worth less than one parameter speaks for no other body.
        count, unexplained = sums[:, -1, -1].real, sums[:, -2, -2].real
        worth = count * np.log1p(unexplained / EXACT)
        is_told = worth < PENALTY + 2 * np.log1p(count)
        if every(is_told):
            return self.told
        looks = ~is_told & ((age < FREQUENT) | (age % 4 == 0))
        body = where(is_told, self.told, self.body) if some(is_told) else self.body
        if some(looks):
            best = _most_likely(sums[looks], self.told.lengths[0])
            body = Body(body.lengths.copy(), body.turn.copy(), body.shift.copy())
            body.lengths[looks], body.turn[looks], body.shift[looks] = best
        return body


def _unexplained(
    products: Floats, hand_products: Points, square: Floats, lengths: Floats
) -> Floats:
    """Return S of lengths (..., N) under hand products that are turned back already, (...)."""
    own = ((products @ lengths[..., None])[..., 0] * lengths).sum(axis=-1)
    left = square - 2 * (hand_products.real * lengths).sum(axis=-1) + own
    unexplained: Floats = np.maximum(left, 0.0)
    return unexplained


def _most_likely(sums: Points, told: Floats) -> Body:
    """Return the most likely body of every arm; the told lengths are (N,)."""
    arms, segments = len(sums), len(told)
    to_hand = np.eye(segments + 2)  # x = e + ℓᵀu
    to_hand[segments, :segments] = told
    sums = to_hand @ sums @ to_hand.T
    count, unit_sum, hand_sum = sums[:, -1, -1].real, sums[:, -1, :-2], sums[:, -1, -2]

    # The sums as they are, and below them those about the means, for bodies with a shift.
    about = sums - sums[:, :, -1:] * sums[:, -1:, :] / count[:, None, None]
    both = np.concatenate([sums, about])
    g, h, s = both[:, :-2, :-2].real, both[:, :-2, -2], both[:, -2, -2].real

    # As told, turned, one segment, all segments, all segments and turned.
    inverse, ridge = np.linalg.inv(g + RIDGE * np.eye(segments)), RIDGE * told
    free = np.array([0, 1, *[1] * segments, segments, segments + 1])
    lengths: Floats = np.tile(told, (2 * arms, len(free), 1))
    turn: Points = np.ones(lengths.shape[:2], complex)
    turn[:, 1] = np.exp(1j * np.angle(h @ told))
    longer = (h.real - g @ told) / (np.diagonal(g, axis1=1, axis2=2) + RIDGE)
    lengths[:, 2 : 2 + segments] += longer[:, :, None] * np.eye(segments)
    lengths[:, -2] = (inverse @ (h.real + ridge)[..., None])[..., 0]
    double = (h * (inverse @ h[..., None])[..., 0]).sum(axis=-1)
    half_turn: Points = np.exp(0.5j * np.angle(double))
    # It is one of two opposite turns: the one that leaves lengths positive.
    turn[:, -1] = half_turn * np.where((half_turn.conj()[:, None] * h).real @ told < 0, -1, 1)
    back = (turn[:, -1].conj()[:, None] * h).real
    lengths[:, -1] = (inverse @ (back + ridge)[..., None])[..., 0]

    left = _unexplained(g[:, None], turn.conj()[..., None] * h[:, None], s[:, None], lengths)
    many = np.concatenate([count, count])[:, None]
    parameters = np.repeat([free, free + 2], arms, axis=0)
    worth = many * np.log((left + EXACT) / (many + 1))
    worth += parameters * (PENALTY + 2 * np.log1p(many))
    ratio = lengths / told
    worth[~((ratio > SHORTEST) & (ratio < LONGEST)).all(axis=-1)] = np.inf

    best = np.concatenate([worth[:arms], worth[arms:]], axis=1).argmin(axis=1)
    is_shifted, kind = best >= len(free), best % len(free)
    row = np.arange(arms) + arms * is_shifted
    likely = Body(lengths[row, kind], turn[row, kind], np.zeros(arms, complex))
    shift = (hand_sum - likely.seen(unit_sum)) / count
    return likely._replace(shift=np.where(is_shifted, shift, 0.0))
