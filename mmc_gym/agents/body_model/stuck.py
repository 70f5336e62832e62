"""Joint sensors that are stuck, as the hand says, or drift, as speeds say.

**Stuck.**  Hand, joints and commands tell one movement three times.  The hand should move by
Σ J_i m_i, where joints turn by m_i and the columns of the Jacobian are J_i, but moves by e more.  A
joint j that is felt to stand still may really turn by as much as explains e best, p_j, which is at
most what its command asks of it, c_j:

    p_j = m_j + J_jᵀe / |J_j|²      between 0 and c_j

Where that has lately left little of e, and less than for other joints that stand still, sensor j is
stuck, until it moves.  Its joint then turns by its command, and what the hand is seen to be off by,
x, corrects it:

    θ_j ← θ_j + c_j + J_jᵀx / Σ |J|²        sum over stuck sensors

If an angle with few counts stands still while its speed shows that the joint turns, c_j is that
turn.  If no servo is known, p_j has no bounds.  Then the joint turns by J_jᵀe / Σ |J|² instead of
c_j, and only a tenth of what is off is corrected.

Noisy joints are felt to turn by their speeds, see `senses`.  Then |e|² counts less by
(Σ |J_i| w_i)², where turns are uncertain by w_i, and by 4 σ² for a hand that is seen with noise of
variance σ² in each coordinate.  Of what is off, too, only a tenth is corrected.

The hand is in the plane or in space: vectors have 2 or 3 components.

**Drift.**  An angle should turn as speeds tell, but turns by r more.  A servo does not keep its
speed within a control step, so even if all is well |r| may be up to b: a tenth of the turn, half of
what its speed changes by, and 0.002.  In running sums with weights 1/b², the mean r̄ is a drift if
it is more than b̄, and than two standard errors, which noise is not.  Angles are then corrected by
what they drifted since.  What repeats tells nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple, TypeAlias

import numpy as np

from mmc_gym.agents.base import any_true
from mmc_gym.agents.body_model.forward_model import (
    BETTER,
    KEEP_LONG,
    RATE,
    SAME,
    SMALL,
    Bools,
    error_of_turn,
    turn_by_speeds,
)
from mmc_gym.geometry import Floats, wrap_angle
from mmc_gym.interface import Seen, Sensed

EXACT = 3e-5  # sum of square errors that is as good as none, segment lengths²
TURN_NOISE = 0.15  # standard deviation of a turn that speeds tell, per that of joint angles

HandModel: TypeAlias = Callable[[Floats], tuple[Floats, Floats]]
"""A function of postures (n, N) that returns hands (n, d) and their derivatives (n, N, d)."""


class Stuck(NamedTuple):
    """What is known of the sensors of n arms with N joints."""

    felt: Floats  # joint angles as last felt, (n, N)
    speeds: Floats  # and their speeds
    shown: Floats  # how far these show that joints turned; 0 where they are noisy, (n, N)
    hand: Floats  # as last seen, (n, d)
    turn: Floats  # how far joints were last felt to turn, (n, N)
    unclear: Floats  # and how uncertain that is, if there is noise, radians
    move: Floats  # and how far the hand was seen to move, (n, d)
    stands: Bools  # whether joints were last felt to stand still, (n, N)
    error: Floats  # recent square errors of the hand's movement if no sensor is stuck, (n, 1)
    error_if_stuck: Floats  # and if one is, (n, N)
    is_stuck: Bools  # (n, N)
    offset: Floats  # how far joints turned since their sensors got stuck, radians, (n, N)

    @classmethod
    def start(cls, sensed: Sensed) -> Stuck:
        """Return what is known before the first look at the hand."""
        felt = sensed.joint_angles
        zero, hand = np.zeros_like(felt), np.zeros_like(sensed.target)
        no, error = zero > 0, zero[:, :1]
        return cls(felt, zero, zero, hand, zero, zero, hand, no, error, zero, no, zero)

    def feel(self, seen: Seen, control_step: float = 0.0, noise: Floats | None = None) -> Stuck:
        """Return it after an observation.

        Speeds count if the `control_step` is given.  `noise` is the standard deviation of the joint
        angles, radians, (n, 1), if there may be any.
        """
        angles, speeds, hand = seen.joint_angles, seen.joint_speeds, seen.hand
        turn = wrap_angle(angles - self.felt)
        shown = turn_by_speeds(self.speeds, speeds, control_step)
        stands, unclear = np.abs(turn) < SAME, np.zeros_like(turn)
        if noise is not None and any_true(noise):
            # Noise is never the same twice: if an angle repeats, it has few counts instead.
            is_noisy = (noise > 0) & ~stands.any(axis=-1, keepdims=True)
            turn, shown = np.where(is_noisy, shown, turn), np.where(is_noisy, 0.0, shown)
            error = error_of_turn(self.speeds, speeds, control_step)
            unclear = is_noisy * np.hypot(error, TURN_NOISE * noise)
            stands = np.where(is_noisy, np.abs(turn) < 5 * TURN_NOISE * noise, stands)
        after = self._replace(felt=angles, speeds=speeds, shown=shown, hand=hand, turn=turn)
        return after._replace(unclear=unclear, move=hand - self.hand, stands=stands)

    def doubted(self, before: Stuck) -> Bools:
        """Return which arms may have a stuck sensor, (n,), if it was so `before` an observation.

        A joint stands still, or did so before, while the hand moves; or a sensor was stuck.
        """
        stands: Bools = self.stands | before.stands
        if not any_true(stands):  # as mostly while arms move; then no sensor was stuck, either
            return stands[:, 0]
        moves = np.any(np.abs(self.move) > SAME, axis=-1)
        doubted: Bools = (stands.any(axis=-1) & moves) | np.any(before.is_stuck, axis=-1)
        return doubted

    @property
    def contradicts(self) -> Bools:
        """Which arms have a stuck sensor, or last moved otherwise than felt, (n,)."""
        contradicts: Bools = self.error[:, 0] > EXACT
        return contradicts | np.any(self.is_stuck, axis=-1)

    def compare(
        self,
        model: HandModel,
        before: Floats,
        commanded: Floats | None,
        counts: Bools,
        noise: Floats | float = 0.0,
    ) -> Stuck:
        """Return it after the hand's movement is compared with that of the joints.

        Joints were at `before`, and should have turned as `commanded`, (n, N), if that is known;
        some arms count, (n,).  `noise` is the variance of the seen hand in each coordinate, (n,).
        Only needed for arms that are `doubted`.
        """
        noise = np.reshape(noise, (-1, 1))
        is_watched = np.any(self.stands, axis=-1, keepdims=True)
        _, columns = model(before + self.turn / 2)
        # What the hand's movement lacks if joints turned as they are felt to, and if one did not.
        lacks = self.move - (columns * self.turn[..., None]).sum(axis=-2)
        size = _squared(columns) + SMALL
        part = (columns * lacks[:, None]).sum(axis=-1) / size
        if commanded is not None:
            commanded = np.where(self.shown != 0, self.shown, commanded)
            low, high = np.minimum(commanded, 0), np.maximum(commanded, 0)
            part = np.clip(self.turn + part, low, high) - self.turn
        lacks_if_stuck = lacks[:, None] - columns * part[..., None]
        counts = counts[:, None]
        unclear = (np.sqrt(_squared(columns)) * self.unclear).sum(axis=-1, keepdims=True)
        expected = unclear**2 + 4 * noise  # of two coordinates, and two noisy hands
        error = (1 - RATE) * self.error + counts * (_squared(lacks)[:, None] - expected)
        error_if_stuck = (1 - RATE) * self.error_if_stuck + counts * _squared(lacks_if_stuck)
        is_better = error_if_stuck < BETTER * error - EXACT
        standing = np.where(self.stands, error_if_stuck, np.inf)
        is_better &= error_if_stuck <= standing.min(axis=-1, keepdims=True)
        is_stuck = self.stands & (is_better | self.is_stuck)
        offset = np.zeros_like(self.offset)
        if any_true(is_stuck):
            turn, is_sure = commanded, (self.unclear == 0) & (noise == 0)
            if turn is None:
                turn, is_sure = _pull(columns, is_stuck, lacks), np.zeros_like(is_stuck)
            offset = (self.offset + counts * turn) * is_stuck
            hand, columns = model(self.felt + offset)
            pull = _pull(columns, is_stuck, self.hand - hand)
            offset = offset + counts * np.where(is_sure, 1.0, RATE) * pull
        return self._replace(
            error=error * is_watched,
            error_if_stuck=error_if_stuck * is_watched,
            is_stuck=is_stuck,
            offset=offset,
        )

    def corrected(self, seen: Seen, before: Stuck, control_step: float) -> Seen:
        """Return what is seen, with angles and speeds of joints whose sensors are stuck.

        They turned by what `before`, a control step ago, was not yet known of them.
        """
        turn = self.offset - before.offset
        is_still = self.is_stuck & (self.shown == 0)
        speeds = np.where(is_still, turn / control_step, seen.joint_speeds)
        return replace(seen, joint_angles=seen.joint_angles + self.offset, joint_speeds=speeds)


class Drift(NamedTuple):
    """How far the joint sensors of n arms with N joints drifted, as speeds tell."""

    angles: Floats  # as last seen, (n, N)
    sums: Floats  # Σ w (1, r, r², b) with w = (0.002 / b)², (n, N, 4)
    offset: Floats  # of angles since they are known to drift, radians, (n, N)

    @classmethod
    def start(cls, sensed: Sensed) -> Drift:
        """Return what is known before a movement."""
        zero = np.zeros_like(sensed.joint_angles)
        return cls(sensed.joint_angles, np.zeros((*zero.shape, 4)), zero)

    def correct(
        self, before: Floats, seen: Seen, control_step: float, is_clear: Bools
    ) -> tuple[Drift, Seen]:
        """Return it after an observation, and what is seen without drift.

        Joints had the speeds `before`, (n, N), when last seen.  No drift is looked for where angles
        were not free of noise (`is_clear`, (n, 1)).
        """
        angles, speeds, x = seen.joint_angles, seen.joint_speeds, np.ones_like(self.sums)
        by_speeds = turn_by_speeds(before, speeds, control_step)
        bound = error_of_turn(before, speeds, control_step) + RATE * np.abs(by_speeds) + SMALL
        turn = wrap_angle(angles - self.angles)
        x[..., 1] = turn - by_speeds
        x[..., 2], x[..., 3] = x[..., 1] ** 2, bound
        is_new = (turn != 0) | (speeds != before)
        weight = is_new * (SMALL / bound) ** 2
        sums = KEEP_LONG * self.sums + weight[..., None] * x
        count = sums[..., 0] + SAME
        mean, square, bound = np.moveaxis(sums[..., 1:] / count[..., None], -1, 0)
        least = np.maximum(4 * (square - mean * mean) / count, bound * bound)
        drifts = (mean * mean > least) & (count > 1) & is_clear
        offset = self.offset
        if any_true(drifts) or any_true(offset):
            offset = np.where(drifts, offset + mean, (1 - RATE) * offset)
            seen = replace(seen, joint_angles=wrap_angle(angles - offset))
        return Drift(angles, sums, offset), seen


def _pull(columns: Floats, is_stuck: Bools, error: Floats) -> Floats:
    """Return turns of stuck joints, (n, N), that move the hand towards one off by `error`, (n, d).

    `columns` are the derivatives of the hand by the joint angles, (n, N, d).
    """
    columns = columns * is_stuck[..., None]
    size = _squared(columns).sum(axis=-1, keepdims=True) + SMALL
    turns: Floats = (columns * error[:, None]).sum(axis=-1) / size
    return turns


def _squared(vectors: Floats) -> Floats:
    """Return the squared lengths (...) of vectors (..., d)."""
    square: Floats = (vectors * vectors).sum(axis=-1)
    return square
