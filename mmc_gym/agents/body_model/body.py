"""Body: segment lengths and a turned cursor, in closed form, and joints that are locked.

**Lengths and cursor.**  With the unit vectors u_i of the segments, as complex numbers, the lengths
ℓ and the way in which the hand x is seen are one linear model,

    x = e^{iφ} Σ ℓ_i u_i + c

Hypotheses differ in what they leave free: nothing (the body is as given); the angle φ of a cursor
that is turned about the base; one length; all lengths; all lengths and the angle; and each of these
with the shift c, which moves the centre of the turn to c / (1 − e^{iφ}).  Running sums over the
observations,

    G = Σ Re(ū uᵀ),     h = Σ ū x,     s = Σ |x|²       (about their means, where c is free)

give the parameters of each hypothesis in closed form, and the square error that it leaves:

    turned            φ = arg(ℓᵀ h)
    segment j         ℓ_j = (Re h_j − Σ_{k≠j} G_jk ℓ_k) / G_jj
    all lengths       ℓ = G⁻¹ Re h
    lengths, turned   2φ = arg(hᵀ G⁻¹ h), then ℓ = G⁻¹ Re(e^{−iφ} h)
    square error      S = s − 2 Re(e^{−iφ} ℓᵀ h) + ℓᵀ G ℓ

(φ of the fourth maximises Re(e^{−iφ} h)ᵀ G⁻¹ Re(e^{−iφ} h).)  The best hypothesis has the least

    n log((S + ε) / (n + 1)) + k (4 + 2 log(n + 1))

for n observations, k free parameters and the square error ε that is negligible.  This is the
Bayesian information criterion (Schwarz 1978) with a heavier penalty, because neighbouring
observations are nearly the same.  A turned cursor, or one other length, is mostly identified from
the first observation.  The mean error that is left is added as an offset, unless it is noise.

**Locks.**  A joint is taken as locked, and held in the internal model, when the turns commanded
while it rests add up to enough.  It is still pushed, so that a joint that was only held up (by a
load, an obstacle, or a neighbouring joint) is free again as soon as it turns.  Nothing counts
before the arm is felt to move, because late senses show an arm at rest.

Literature: G. Schwarz (1978), Estimating the dimension of a model, Ann. Statist. 6, 461–464.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmc_gym.agents.base import every, some, where
from mmc_gym.agents.body_model.forward_model import Bools, Points, unit_vectors
from mmc_gym.agents.body_model.senses import LastStep
from mmc_gym.geometry import Floats

FORGET = 0.005  # share of the sums that is forgotten in a control step
EXACT = 2 * 0.006**2  # ε: negligible square error, segment lengths²
PENALTY = 4.0  # penalty of a parameter, besides 2 log(n + 1)
RIDGE = 1e-3  # weight of the given lengths where lengths are free
LEAST_RATIO, LARGEST_RATIO = 0.3, 2.0  # of accepted lengths and the given ones
FREQUENT = 12  # observations after which hypotheses are compared in every fourth control step only
OFFSET_RATE = 0.1  # rate at which the offset follows the errors

LOCKED_AFTER = 0.4  # commanded turn of a resting joint until it is taken as locked, radians
LOCKED_AFTER_IF_GIVEN = 0.15  # the same of a joint that is given as lockable
LOCKED_AFTER_PER_NOISE = 10.0  # what noise of the joint angles adds to that turn
HUMAN_SHARE = 0.25  # share of that turn which is enough at a vigour of 0
CAUTION = 4.0  # factor of that turn for a joint that was once wrongly taken as locked
REST_TURN = 0.004  # a joint that turns by less rests, radians
REST_SHARE = 0.12  # and so does one that turns by a smaller share of the commanded turn
REST_SPEED = 0.25  # a faster joint does not rest, rad/s
REST_SPEED_PER_NOISE = 15.0  # what noise of the joint angles adds to that, 1/s
FREED_AT = 0.06  # a locked joint that is farther from its place is free, radians
PLACE_RATE = 0.1  # rate at which the place of a locked joint follows what is seen
PUSH = 0.6  # how far ahead the target of a locked joint is, radians
FELT_BY = 25  # observations after which joints count as locked though no movement was felt


class Body(NamedTuple):
    """A body and how its hand is seen: x = turn · Σ ℓ u + shift."""

    lengths: Floats  # ℓ
    turn: Points  # e^{iφ}
    shift: Points  # c

    def seen(self, units: Points) -> Points:
        """Return where the hand is seen if these are the unit vectors of the segments, (n, N)."""
        return self.turn * (self.lengths * units).sum(axis=-1) + self.shift

    def felt(self, seen: Points) -> Points:
        """Return where the hand really is if it is seen here."""
        return (seen - self.shift) * self.turn.conj()


class BodyEvidence(NamedTuple):
    """Running sums over the observations, and the best hypothesis about the body.

    With e = x − ℓᵀu for the given lengths ℓ, the sums are Σ z̄ zᵀ of z = (u_1 … u_N, e, 1).  Their
    first N rows and columns have the real part G.  Old observations are slowly forgotten.
    """

    age: Floats  # number of observations, (n,)
    sums: Points  # Σ z̄ zᵀ, (n, N + 2, N + 2)
    given: Body  # the body as given
    body: Body  # the best hypothesis
    offset: Points  # mean error that it leaves
    scatter: Floats  # mean square of the errors about their mean, (n,)

    @classmethod
    def start(cls, lengths: tuple[float, ...], arms: int) -> BodyEvidence:
        """Return the evidence before any observation, for the given lengths."""
        zero, origin = np.zeros(arms), np.zeros(arms, complex)
        sums = np.zeros((arms, len(lengths) + 2, len(lengths) + 2), complex)
        given = Body(np.tile(np.array(lengths), (arms, 1)), turn=origin + 1, shift=origin)
        return cls(zero, sums, given=given, body=given, offset=origin, scatter=zero)

    def add(self, joint_angles: Floats, hand: Points) -> BodyEvidence:
        """Return the evidence after the hand was seen in a posture."""
        units, age = unit_vectors(joint_angles), self.age + 1
        error = hand - (self.given.lengths * units).sum(axis=-1)
        z = np.concatenate([units, error[:, None], np.ones((len(hand), 1))], axis=1)
        sums = (1 - FORGET) * self.sums + z.conj()[:, :, None] * z[:, None, :]
        body = self._identify(sums, age)
        if body is not self.given:
            error = hand - body.seen(units)
        rate = np.maximum(OFFSET_RATE, 1 / age)
        offset = self.offset + rate * (error - self.offset)
        scatter = self.scatter + rate * (np.abs(error - offset) ** 2 - self.scatter)
        return BodyEvidence(age, sums, self.given, body, offset, scatter)

    @property
    def best(self) -> Body:
        """The best hypothesis, with the part of the offset that is not noise."""
        square = np.abs(self.offset) ** 2
        share = square / (square + self.scatter + EXACT)
        return self.body._replace(shift=self.body.shift + share * self.offset)

    def _identify(self, sums: Points, age: Floats) -> Body:
        """Return the best hypothesis for each arm."""
        # If even the whole error is worth less than one parameter, the body is as given.
        count, square = sums[:, -1, -1].real, sums[:, -2, -2].real
        is_given = count * np.log1p(square / EXACT) < PENALTY + 2 * np.log1p(count)
        if every(is_given):
            return self.given
        body = where(is_given, self.given, self.body)
        is_due = ~is_given & ((age < FREQUENT) | (age % 4 == 0))
        if some(is_due):
            body = Body(body.lengths.copy(), body.turn.copy(), body.shift.copy())
            best = most_likely(sums[is_due], self.given.lengths[0])
            body.lengths[is_due], body.turn[is_due], body.shift[is_due] = best
        return body


def _product(matrices: Floats, vectors: NDArray[Any]) -> NDArray[Any]:
    """Return the products of matrices (..., N, N) and vectors (..., N), the same in any batch.

    The order in which a library for matrices sums may differ between batches.
    """
    product: NDArray[Any] = (matrices * vectors[..., None, :]).sum(axis=-1)
    return product


def hypotheses(g: Floats, h: Points, given: Floats) -> tuple[Floats, Points, NDArray[Any]]:
    """Return ℓ (H, n, N), e^{iφ} (H, n) and k (H,) of H hypotheses, the shift left out.

    They are the best for G (n, N, N) and h (n, N), with the given lengths, (N,).
    """
    segments = len(given)
    as_given: Floats = np.tile(given, (len(h), 1))
    unturned: Points = np.ones(len(h), complex)
    turn = np.exp(1j * np.angle((h * given).sum(axis=-1)))
    change = (h.real - (g * given).sum(axis=-1)) / (np.diagonal(g, axis1=1, axis2=2) + RIDGE)
    inverse = np.linalg.inv(g + RIDGE * np.eye(segments))
    double = (h * _product(inverse, h)).sum(axis=-1)
    half_turn: Points = np.exp(0.5j * np.angle(double))
    # Of two opposite turns, the one that leaves lengths positive.
    is_opposite = ((half_turn.conj()[:, None] * h).real * given).sum(axis=-1) < 0
    both_turn = half_turn * np.where(is_opposite, -1, 1)
    all_lengths = (
        _product(inverse, (one.conj()[:, None] * h).real + RIDGE * given)
        for one in (unturned, both_turn)
    )
    one_length = (as_given + change * j for j in np.eye(segments))
    lengths = np.stack([as_given, as_given, *one_length, *all_lengths])
    turns = np.stack([unturned, turn, *[unturned] * segments, unturned, both_turn])
    return lengths, turns, np.array([0, 1, *[1] * segments, segments, segments + 1])


def most_likely(sums: Points, given: Floats) -> Body:
    """Return the best hypothesis for each arm, from the sums of `BodyEvidence` and ℓ as given."""
    to_hand = np.eye(len(given) + 2)  # x = e + ℓᵀu
    to_hand[-2, :-2] = given
    sums = to_hand @ sums @ to_hand.T
    count, unit_sum, hand_sum = sums[:, -1, -1].real, sums[:, -1, :-2], sums[:, -1, -2]
    about_means = sums - sums[:, :, -1:] * sums[:, -1:, :] / count[:, None, None]

    bodies, criteria = [], []
    for is_shifted, moments in enumerate((sums, about_means)):
        g, h, s = moments[:, :-2, :-2].real, moments[:, :-2, -2], moments[:, -2, -2].real
        lengths, turn, parameters = hypotheses(g, h, given)
        body = Body(lengths, turn, np.zeros((), complex))
        shift = is_shifted * (hand_sum - body.seen(unit_sum)) / count
        bodies.append(body._replace(shift=shift))
        error = np.maximum(_square_errors(body, g, h, s), 0.0)
        criterion = count * np.log((error + EXACT) / (count + 1))
        penalty = PENALTY + 2 * np.log1p(count)
        criterion += (parameters + 2 * is_shifted)[:, None] * penalty
        ratio = lengths / given
        is_absurd = ~((ratio > LEAST_RATIO) & (ratio < LARGEST_RATIO)).all(axis=-1)
        criteria.append(np.where(is_absurd, np.inf, criterion))
    best, arms = np.concatenate(criteria).argmin(axis=0), np.arange(len(sums))
    return Body(*(np.concatenate(fields)[best, arms] for fields in zip(*bodies, strict=True)))


def _square_errors(body: Body, g: Floats, h: Points, s: Floats) -> Floats:
    """Return S of hypotheses, (H, n), see above."""
    back = (body.turn.conj()[..., None] * h).real
    own: Floats = (_product(g, body.lengths) * body.lengths).sum(axis=-1)
    return s - 2 * (back * body.lengths).sum(axis=-1) + own


class Locks(NamedTuple):
    """Which joints are taken as locked, (n, N)."""

    place: Floats  # where each joint is locked, or was last at rest
    commanded: Floats  # sum of the turns commanded there
    is_locked: Bools  # whether it is taken as locked
    has_changed: Bools  # whether that changed with the last observation
    was_wrong: Bools  # whether it was ever taken as locked, but turned

    @classmethod
    def start(cls, joint_angles: Floats) -> Locks:
        """Return free joints."""
        free = np.zeros(joint_angles.shape, bool)
        return cls(joint_angles, np.zeros_like(joint_angles), free, free, free)

    def identify(
        self, step: LastStep, lockable: tuple[int, ...] = (), vigour: float = 1.0
    ) -> Locks:
        """Return the locks after a control step.

        Args:
            step: of n arms.
            lockable: the joints that can lock, if they are given; empty: any joint can.
            vigour: see `Parts`.
        """
        seen, noise = step.after.joint_angles, step.after.deviation
        away, rest_turn = np.abs(seen - self.place), REST_TURN + 3 * noise
        moves = away > rest_turn + REST_SHARE * np.abs(self.commanded)
        moves |= np.abs(step.after.speeds) > REST_SPEED + REST_SPEED_PER_NOISE * noise
        is_freed = self.is_locked & (away > 2 * rest_turn + FREED_AT)
        was_wrong = self.was_wrong | is_freed

        is_arm_felt = step.is_felt[:, None] | (step.after.age > FELT_BY)
        rests = ~moves & ~is_freed & is_arm_felt
        commanded = np.where(rests, self.commanded + step.commanded, 0.0)
        locks = rests & (np.abs(commanded) > _locking_turn(noise, was_wrong, lockable, vigour))
        if lockable:
            locks[:, [joint for joint in range(seen.shape[1]) if joint not in lockable]] = False

        stays_locked = self.is_locked & ~is_freed
        is_locked = stays_locked | locks
        place = np.where(moves | locks, seen, self.place)
        place = np.where(stays_locked, self.place + PLACE_RATE * (seen - self.place), place)
        return Locks(place, commanded, is_locked, is_locked != self.is_locked, was_wrong)


def _locking_turn(
    noise: Floats, was_wrong: Bools, lockable: tuple[int, ...], vigour: float
) -> Floats:
    """Return the commanded turn from which a resting joint is taken as locked, (n, N), radians."""
    least = LOCKED_AFTER_IF_GIVEN if lockable else LOCKED_AFTER
    least *= HUMAN_SHARE + (1 - HUMAN_SHARE) * vigour
    return (least + LOCKED_AFTER_PER_NOISE * noise) * np.where(was_wrong, CAUTION, 1.0)
