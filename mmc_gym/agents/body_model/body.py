"""Body: identify segment lengths and a turned or mirrored cursor in closed form; locked joints.

**Lengths and cursor.**  With the unit vectors u_i of the segments, as complex numbers, the lengths
ℓ and the way in which the hand x is seen are one linear model,

    x = e^{iφ} Σ ℓ_i u_i + c

Hypotheses differ in what they leave free: nothing (the body is as given); the angle φ of a cursor
that is turned about the base; one length; one factor of all lengths, or this and the angle; all
lengths; all lengths and the angle; and each of these with the shift c, which moves the centre of
the turn to c / (1 − e^{iφ}).  All are tried for the mirror image of x, too.  Agents that learn from
movement to movement try neither mirror images nor one factor.  Running sums over the observations,

    G = Σ Re(ū uᵀ),     h = Σ ū x,     s = Σ |x|²       (about their means, where c is free)

give the parameters of each hypothesis, and its remaining square error, in closed form:

    turned            φ = arg(ℓᵀ h)
    segment j         ℓ_j = (Re h_j − Σ_{k≠j} G_jk ℓ_k) / G_jj
    scaled            ℓ ← ℓ Re(e^{−iφ} ℓᵀ h) / ℓᵀ G ℓ        φ = 0, or as if only turned
    all lengths       ℓ = G⁻¹ Re h
    lengths, turned   2φ = arg(hᵀ G⁻¹ h), then ℓ = G⁻¹ Re(e^{−iφ} h)
    square error      S = s − 2 Re(e^{−iφ} ℓᵀ h) + ℓᵀ G ℓ

(The fourth φ maximises Re(e^{−iφ} h)ᵀ G⁻¹ Re(e^{−iφ} h).)  The best hypothesis minimises

    n log((S + ε) / (n + 1)) + k (4 + 2 log(n + 1))

for n observations, k free parameters and a negligible square error ε.  This is the Bayesian
information criterion (Schwarz 1978) with a heavier penalty, because neighbouring observations are
nearly the same.  A turned cursor, or one changed length, is mostly identified from the first
observation.  If joints are noisy, filtered angles err alike for some time, which would look like
other lengths.  So the square error of the hand that they explain is part of ε, for each observation
after the first dozen.  The remaining mean error is added as an offset, unless it is noise.

**Changes.**  Sums that remember a second cannot follow a change within a movement.  So a rival also
predicts the hand: the best hypothesis times a complex factor m (a turn and a gain) that fits the
last five hands, with log m on a line in time.  Once the rival's errors are clearly smaller, the
body is taken to change until they are larger: the rival is used, extrapolated to when a command
acts, and the sums are of the last five observations.  These cannot tell lengths, so the rival keeps
the hypothesis it began with.  Noise is no change, because under noise a line through five hands
predicts worse than the sums.  Where two hands in turn are far from where the best hypothesis
expects them, all begins anew with these.

**Locks.**  A joint is taken as locked, and held in the internal model, when the turns commanded
while it rests add up to enough.  It is still pushed, so that a joint that was only held up (by a
load, an obstacle, or a neighbouring joint) is free again as soon as it turns.  Nothing counts
before the arm is felt to move, because late senses show an arm at rest.

Literature: Schwarz (1978), Ann. Statist. 6, 461–464.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmc_gym.agents.base import all_true, any_true, of_arms, where
from mmc_gym.agents.body_model.forward_model import (
    CLEARLY,
    EXACT,
    NOISE_OF_SPEEDS,
    RATE,
    REST_TURN,
    SIGMAS,
    WEAK,
    Bools,
    Points,
    as_vectors,
    squared,
    to_hand,
    unit_vectors,
)
from mmc_gym.agents.body_model.senses import LONGEST_DELAY, LastStep
from mmc_gym.geometry import Floats

FORGET = 0.005  # share of the sums that is forgotten in a control step
PENALTY = 4.0  # penalty of a parameter, besides 2 log(n + 1)
RIDGE = 1e-3  # weight of the given lengths where lengths are free
# Observations after which hypotheses are compared in every fourth control step only, and mirrored
# cursors in every 16th.
FREQUENT = 12

SURPRISE_RATE = 0.3  # rate at which the mean square errors of predictions follow new errors
LOST = 0.3  # square error from which on all that is known is wrong, segment lengths²
# Weights of five values that give the slope and the end of the least-squares line through them.
SLOPE, LEVEL = np.array([-0.2, -0.1, 0.0, 0.1, 0.2]), np.array([-0.2, 0.0, 0.2, 0.4, 0.6])

LOCKED_AFTER = 0.4  # commanded turn of a resting joint until it is taken as locked, radians
LOCKED_AFTER_PER_NOISE = 10.0  # what noise of the joint angles adds to that turn
HUMAN_SHARE = 0.25  # share of that turn that is enough at a vigour of 0
FREED_AT = 0.06  # a locked joint that is farther from its place is free, radians
REST_SPEED = 0.25  # a faster joint does not rest, rad/s
FELT_BY = LONGEST_DELAY + 1  # observations after which joints may be locked, though none moved


class Body(NamedTuple):
    """A body and how its hand is seen: x = turn · Σ ℓ u + shift, or the mirror image of it."""

    lengths: Floats  # ℓ
    turn: Points  # e^{iφ}; while the body changes, times a gain
    shift: Points  # c
    is_mirrored: Bools  # about the first axis

    def seen(self, units: Points) -> Points:
        """Return where the hand is seen (n,) for unit vectors of the segments (n, N)."""
        place = self.turn * (self.lengths * units).sum(axis=-1) + self.shift
        return _mirrored(place, self.is_mirrored)

    def hand_model(self, joint_angles: Floats) -> tuple[Floats, Floats]:
        """Return the seen hand and its derivatives by joint angles as vectors: a `HandModel`."""
        levers = self.turn[:, None] * to_hand(joint_angles, self.lengths)
        hand = _mirrored(levers[:, 0] + self.shift, self.is_mirrored)
        columns = _mirrored(1j * levers, self.is_mirrored[:, None])
        return as_vectors(hand), as_vectors(columns)

    def felt(self, seen: Points) -> Points:
        """Return where the hand really is (n,) if it is seen at `seen` (n,)."""
        return (_mirrored(seen, self.is_mirrored) - self.shift) / self.turn


def _mirrored(points: Points, is_mirrored: Bools) -> Points:
    return np.where(is_mirrored, points.conj(), points) if any_true(is_mirrored) else points


class Change(NamedTuple):
    """Whether the body changes: a trend then predicts the hand better than the best hypothesis."""

    looks: Points  # the last five z, see `BodyEvidence`, (n, 5, N + 2)
    error: Floats  # mean square error of the best hypothesis, (n,)
    error_of_trend: Floats  # mean square error of the trend, (n,)
    is_on: Bools  # whether the body is taken to change, (n,)
    base: Body  # the best hypothesis before that

    def body(self, given_body: Body, steps: Floats | float) -> Body:
        """Return the body, extrapolated to `steps` control steps after the last look.

        `base`, multiplied by factors m (each a turn and a gain), explains the last hands; log m
        lies on a line in time.  Near the centre of the turn m is not known, and the rest becomes a
        shift.
        """
        base = self.base
        units = self.looks[..., :-2]
        hands = _hands(self.looks, given_body.lengths[:, None])
        seen = _mirrored(hands, base.is_mirrored[:, None]) - base.shift[:, None]
        felt = base.turn[:, None] * (base.lengths[:, None] * units).sum(axis=-1)
        factors = (seen * felt.conj() + EXACT) / (squared(felt) + EXACT)
        logs = np.log(factors / factors[:, -1:])
        slope = (SLOPE * logs).sum(axis=-1)
        turn = factors[:, -1] * np.exp((LEVEL * logs).sum(axis=-1) + slope * steps)
        rest = (LEVEL * (seen - factors * felt)).sum(axis=-1)
        return base._replace(turn=base.turn * turn, shift=base.shift + rest)

    def observe(
        self,
        evidence: BodyEvidence,
        looks: Points,
        hand: Points,
        is_given: Bools,
        blur: Floats | float,
    ) -> Change:
        """Return the `Change` after one more of the `looks`; `evidence` is from before it.

        The trend is judged only where the best hypothesis errs by more than its usual error and
        `blur` explain, or always errs in the same direction, or where the body changes.
        """
        zero = np.zeros(len(hand))
        if all_true(is_given):
            return Change(looks, zero, zero, zero > 0, evidence.best)
        units = looks[:, -1, :-2]
        error = squared(hand - evidence.best.seen(units))
        mean = self.error + SURPRISE_RATE * (error - self.error)
        mean[is_given | (evidence.age == 0)] = 0.0
        usual = evidence.scatter + (EXACT + 3 * blur)
        fails = (mean > 3 * usual) | (3 * squared(evidence.offset) > usual) | self.is_on
        fails &= ~is_given
        if not any_true(fails):
            return Change(looks, mean, mean, fails, evidence.best)
        failing = np.flatnonzero(fails)
        error_of_trend, is_on = mean.copy(), zero > 0
        base = where(self.is_on, self.base, evidence.best)
        before = of_arms(self._replace(base=base), failing)
        given_body = of_arms(evidence.given_body, failing)
        trend = before.body(given_body, 1.0)
        error = squared(hand[failing] - trend.seen(units[failing]))
        error = before.error_of_trend + SURPRISE_RATE * (error - before.error_of_trend)
        limit = np.where(before.is_on, 1.0, CLEARLY)
        error_of_trend[failing] = error
        is_on[failing] = error + EXACT < limit * (mean[failing] + EXACT)
        return Change(looks, mean, error_of_trend, is_on, base)


class BodyEvidence(NamedTuple):
    """Running sums over the observations, and the best hypothesis about the body.

    With e = x − ℓᵀu for the given lengths ℓ, the sums are Σ w zᵀ of z = (u_1 … u_N, e, 1) and
    w = (x, z̄).  Rows 1 to N have the real part G, and row 0 is for mirrored cursors.  Old
    observations are slowly forgotten, and at once where the body changes.
    """

    age: Floats  # number of observations that count, (n,)
    sums: Points  # Σ w zᵀ, (n, N + 3, N + 2)
    given_body: Body  # the body as given
    body: Body  # the best hypothesis
    offset: Points  # mean error of the best hypothesis, (n,)
    scatter: Floats  # mean square of the errors about their mean, (n,)
    best: Body  # the best hypothesis, with the part of the offset that is not noise
    change: Change

    @classmethod
    def start(cls, lengths: tuple[float, ...], arms: int) -> BodyEvidence:
        """Return the evidence before any observation, for the given lengths."""
        zero, origin, joints = np.zeros(arms), np.zeros(arms, complex), len(lengths)
        looks, sums = (np.zeros((arms, rows, joints + 2), complex) for rows in (5, joints + 3))
        given_body = Body(np.tile(np.array(lengths), (arms, 1)), origin + 1, origin, zero > 0)
        change = Change(looks, zero, zero, zero > 0, given_body)
        return cls(zero, sums, given_body, given_body, origin, zero, best=given_body, change=change)

    def add(
        self,
        joint_angles: Floats,
        hand: Points,
        follows: bool = True,
        mirrors: bool = True,
        blur: Floats | float = 0.0,
    ) -> BodyEvidence:
        """Return the evidence after the hand (n,) was seen in a posture (n, N).

        `follows`: whether changes are followed.  `mirrors`: whether cursors that mirror or magnify
        are tried, and noise makes errors negligible.  `blur`: mean square error of the hand that is
        due to errors of the posture.
        """
        units, age, is_anew = unit_vectors(joint_angles), self.age + 1, self.change.is_on
        error = hand - (self.given_body.lengths * units).sum(axis=-1)
        z = np.ones(self.sums[:, 0].shape, complex)
        z[:, :-2], z[:, -2] = units, error
        looks = np.concatenate([self.change.looks[:, 1:], z[:, None]], axis=1)
        sums = (1 - FORGET) * self.sums + _products(z, hand)
        if any_true(is_anew):
            age = np.where(is_anew, np.minimum(age, len(SLOPE)), age)
        if follows and any_true(is_lost := self._is_lost(hand, units)):
            age, is_anew = np.where(is_lost, 2.0, age), is_anew | is_lost
        if any_true(is_anew):
            sums[is_anew] = self._recent_sums(looks[is_anew], age[is_anew])
        is_given = _is_given(sums)
        change = self.change
        if follows:
            change = change.observe(self, looks, hand, is_given, blur)
        negligible = EXACT + mirrors * np.maximum(age - FREQUENT, 0.0) * blur
        body = self._identify(sums, mirrors, is_given, age, negligible)
        if body is not self.given_body:
            error = hand - body.seen(units)
        rate = np.maximum(RATE, 1 / age)
        offset = self.offset + rate * (error - self.offset)
        scatter = self.scatter + rate * (squared(error - offset) - self.scatter)
        square = squared(offset)
        part = offset * square / (square + scatter + EXACT)
        best = body._replace(shift=body.shift + _mirrored(part, body.is_mirrored))
        return BodyEvidence(age, sums, self.given_body, body, offset, scatter, best, change)

    def _recent_sums(self, looks: Points, count: Floats) -> Points:
        """Return the sums over the last `count`, (m,), of looks, (m, 5, N + 2)."""
        is_recent = np.arange(looks.shape[1], 0, -1) <= count[:, None]
        looks = looks * is_recent[..., None]
        return _products(looks, _hands(looks, self.given_body.lengths[0])).sum(axis=1)

    def _is_lost(self, hand: Points, units: Points) -> Bools:
        """Return which arms look so unlike the best hypothesis that all begins anew, (n,).

        They looked so in the last observation, too, and the body does not change steadily.
        """
        is_lost: Bools = (self.change.error > SURPRISE_RATE * LOST) & ~self.change.is_on
        if any_true(is_lost):
            is_lost = is_lost & (squared(hand - self.best.seen(units)) > LOST)
        return is_lost

    @property
    def explains_hand(self) -> Bools:
        """Whether the hand is seen where a steady body expects it, but for noise, (n,)."""
        explains: Bools = squared(self.offset) <= self.scatter + EXACT
        return explains & ~self.change.is_on

    def after(self, steps: Floats) -> Body:
        """Return the body predicted for `steps` (n,) control steps after the last observation."""
        if not any_true(self.change.is_on):
            return self.best
        changing = np.flatnonzero(self.change.is_on)
        change = of_arms(self.change, changing)
        given_body = of_arms(self.given_body, changing)
        body = where(self.change.is_on, self.change.base, self.best)
        turn, shift = body.turn.copy(), body.shift.copy()
        after = change.body(given_body, steps[changing])
        turn[changing], shift[changing] = after.turn, after.shift
        return body._replace(turn=turn, shift=shift)

    def _identify(
        self, sums: Points, mirrors: bool, is_given: Bools, age: Floats, negligible: Floats
    ) -> Body:
        if all_true(is_given):
            return self.given_body
        is_due = ~is_given & ((age < FREQUENT) | (age % 4 == 0) | self.change.is_on)
        if not any_true(is_due | is_given):
            return self.body
        body = where(is_given, self.given_body, self.body)
        if any_true(is_due):
            may_be = mirrors & ((age < FREQUENT) | (age % 16 == 0) | self.change.is_on)
            may_be |= self.body.is_mirrored
            due = sums[is_due], may_be[is_due], negligible[is_due]
            best = most_likely(*due, self.given_body.lengths[0], mirrors)
            for field, best_field in zip(body, best, strict=True):
                field[is_due] = best_field
        return body


def _is_given(sums: Points) -> Bools:
    """Return whether the body is as given: no gain in fit could outweigh one more parameter."""
    count, square = sums[:, -1, -1].real, sums[:, -2, -2].real
    is_given: Bools = count * np.log1p(square / EXACT) < _penalty(sums)
    return is_given


def _hands(looks: Points, given_lengths: Floats) -> Points:
    """Return the hands x = e + ℓᵀu, (..., 5), of looks, (..., 5, N + 2)."""
    return looks[..., -2] + (given_lengths * looks[..., :-2]).sum(axis=-1)


def _products(z: Points, hands: Points) -> Points:
    """Return w zᵀ, (..., N + 3, N + 2), of z, (..., N + 2), and hands, (...)."""
    w = np.concatenate([hands[..., None], z.conj()], axis=-1)
    return w[..., :, None] * z[..., None, :]


def _product(matrices: Floats, vectors: NDArray[Any]) -> NDArray[Any]:
    """Return matrix-vector products (..., N), rounded alike in every batch, unlike those of `@`."""
    product: NDArray[Any] = (matrices * vectors[..., None, :]).sum(axis=-1)
    return product


def hypotheses(
    g: Floats, h: Points, given_lengths: Floats, magnifies: bool
) -> tuple[Floats, Points, NDArray[Any]]:
    """Return ℓ (H, …, N), e^{iφ} (H, …) and k (H,) of H hypotheses from G (…, N, N), h (…, N).

    Without `magnifies` none has one factor of all lengths.
    """
    segments = len(given_lengths)
    as_given: Floats = np.broadcast_to(given_lengths, h.shape)
    unturned: Points = np.ones(h.shape[:-1], complex)
    pull = (h * given_lengths).sum(axis=-1)
    turn = np.exp(1j * np.angle(pull))
    diagonal = np.diagonal(g, axis1=-2, axis2=-1) + RIDGE
    change = (h.real - (g * given_lengths).sum(axis=-1)) / diagonal
    inverse = np.linalg.inv(g + RIDGE * np.eye(segments))
    double = (h * _product(inverse, h)).sum(axis=-1)
    half_turn: Points = np.exp(0.5j * np.angle(double))
    # Of two opposite turns, the one that leaves lengths positive.
    is_opposite = ((half_turn.conj()[..., None] * h).real * given_lengths).sum(axis=-1) < 0
    both_turn = half_turn * np.where(is_opposite, -1, 1)
    all_lengths, all_turned = (
        _product(inverse, (phase.conj()[..., None] * h).real + RIDGE * given_lengths)
        for phase in (unturned, both_turn)
    )
    kinds = [
        (as_given, unturned, 0),
        (as_given, turn, 1),
        *((as_given + change * j, unturned, 1) for j in np.eye(segments)),
        (all_lengths, unturned, segments),
        (all_turned, both_turn, segments + 1),
    ]
    if magnifies:
        size = (_product(g, as_given) * given_lengths).sum(axis=-1) + RIDGE
        scales = ((part + RIDGE) / size for part in (pull.real, np.abs(pull)))
        scaled, scaled_turned = (as_given * scale[..., None] for scale in scales)
        kinds += [(scaled, unturned, 1), (scaled_turned, turn, 2)]
    lengths, turns, parameters = zip(*kinds, strict=True)
    return np.stack(lengths), np.stack(turns), np.array(parameters)


def most_likely(
    sums: Points, mirrors: Bools, negligible: Floats, given_lengths: Floats, magnifies: bool
) -> Body:
    """Return the best hypothesis for each arm; mirrored only where `mirrors`, (n,).

    `negligible` is ε, (n,).  Cursors that magnify are only tried if `magnifies`.
    """
    to_hand = np.eye(len(given_lengths) + 2)  # x = e + ℓᵀu
    to_hand[-2, :-2] = given_lengths
    mirrored, sums = sums[:, 0, :-2], to_hand @ sums[:, 1:] @ to_hand.T
    least, body = _fit(sums, negligible, given_lengths, magnifies)
    tried = np.flatnonzero(mirrors)
    if len(tried):
        sums = sums[tried]  # of the mirror image of x, too
        sums[:, :-2, -2] = mirrored[tried].conj()
        sums[:, [-1, -2], [-2, -1]] = sums[:, [-2, -1], [-1, -2]]
        least = least[tried] - _penalty(sums)
        mirrored_least, mirrored_body = _fit(sums, negligible[tried], given_lengths, magnifies)
        is_better = mirrored_least < least
        mirrored_body = mirrored_body._replace(is_mirrored=is_better)
        for field, mirrored_field in zip(body, mirrored_body, strict=True):
            field[tried[is_better]] = mirrored_field[is_better]
    return body


def _fit(
    sums: Points, negligible: Floats, given_lengths: Floats, magnifies: bool
) -> tuple[Floats, Body]:
    """Return the least criterion for each arm, and the body behind it.

    Rows and columns of `sums` are for u_1 … u_N, x and 1; symbols are those of the module.
    """
    count = sums[:, -1, -1].real
    about_means = sums - sums[:, :, -1:] * sums[:, -1:, :] / count[:, None, None]

    # Axes: hypotheses; without and with a shift; arms; segments.
    moments, is_shifted = np.stack([sums, about_means]), np.arange(2)[:, None]
    g, h, s = moments[..., :-2, :-2].real, moments[..., :-2, -2], moments[..., -2, -2].real
    lengths, turn, parameters = hypotheses(g, h, given_lengths, magnifies)
    shift = sums[:, -1, -2] - turn * (lengths * sums[:, -1, :-2]).sum(axis=-1)
    shift = is_shifted * shift / count

    back = (turn.conj()[..., None] * h).real  # Re(e^{−iφ} h)
    quadratic = (_product(g, lengths) * lengths).sum(axis=-1)  # ℓᵀ G ℓ
    error = np.maximum(s - 2 * (back * lengths).sum(axis=-1) + quadratic, 0.0)
    parameters = parameters[:, None, None] + 2 * is_shifted
    criterion = count * np.log((error + negligible) / (count + 1))
    criterion += parameters * _penalty(sums)
    is_absurd = (lengths <= 0).any(axis=-1)
    criterion = np.where(is_absurd, np.inf, criterion).reshape(-1, len(sums))

    arms = np.arange(len(sums))
    best = criterion.argmin(axis=0), arms
    least, turn, shift = (
        values.reshape(criterion.shape)[best] for values in (criterion, turn, shift)
    )
    lengths = lengths.reshape(*criterion.shape, -1)[best]
    return least, Body(lengths, turn, shift, is_mirrored=arms < 0)


def _penalty(sums: Points) -> Floats:
    """Return the penalty of a free parameter, for each arm."""
    return PENALTY + 2 * np.log1p(sums[:, -1, -1].real)


class Locks(NamedTuple):
    """Which joints are taken as locked, (n, N)."""

    place: Floats  # where each joint is locked, or was last at rest
    commanded: Floats  # sum of the turns commanded while the joint rests there, radians
    is_locked: Bools  # whether the joint is taken as locked
    has_changed: Bools  # whether `is_locked` changed with the last observation

    @classmethod
    def start(cls, joint_angles: Floats) -> Locks:
        """Return locks with all joints free, at joint angles (n, N)."""
        free = np.zeros(joint_angles.shape, bool)
        return cls(joint_angles, np.zeros_like(joint_angles), free, free)

    def identify(self, step: LastStep, vigour: float = 1.0) -> Locks:
        """Return the locks after a control step."""
        seen, noise = step.after.joint_angles, step.after.deviation
        away, rest_turn = np.abs(seen - self.place), REST_TURN + SIGMAS * noise
        moves = away > rest_turn + WEAK * np.abs(self.commanded)
        moves |= np.abs(step.after.speeds) > REST_SPEED + NOISE_OF_SPEEDS * noise
        is_freed = self.is_locked
        after: Floats | float = 0.0
        if any_true(self.is_locked):
            is_freed = self.is_locked & (away > 2 * rest_turn + FREED_AT)
            if vigour == 1:  # its sign is the direction in which a locked joint is pushed, if fast
                after = np.where(self.is_locked & ~is_freed, self.commanded, 0.0)
        rests = (step.is_felt[:, None] | (step.after.age > FELT_BY)) & ~(moves | is_freed)
        commanded = np.where(rests, self.commanded + step.commanded, after)
        least = LOCKED_AFTER * (HUMAN_SHARE + (1 - HUMAN_SHARE) * vigour)
        may_lock = np.abs(commanded) > least
        if not any_true(self.is_locked | may_lock):  # as mostly; then `may_lock` is False for all
            place = np.where(moves, seen, self.place)
            return self._replace(place=place, commanded=commanded, has_changed=may_lock)

        locks = rests & (np.abs(commanded) > least + LOCKED_AFTER_PER_NOISE * noise)
        stays_locked = self.is_locked & ~is_freed
        is_locked = stays_locked | locks
        place = np.where(moves | locks, seen, self.place)
        place = np.where(stays_locked, self.place + RATE * (seen - self.place), place)
        return Locks(place, commanded, is_locked, is_locked != self.is_locked)
