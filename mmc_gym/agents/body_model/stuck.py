"""Stuck sensors: joints that are felt to stand still, although the hand says that they turn.

Hand, joints and commands tell one movement three times.  The hand moves by Σ J_i m_i, where joints
turn by m_i and the columns of the Jacobian are J_i.  If joint j is felt to stand still, but turns
as its command should turn it, by p_j, it moves by J_j p_j more.  Where that has lately explained
the hand better, sensor j is stuck.  Its joint then turns by p_j, corrected by what the hand is seen
to be off by, x:

    θ_j ← θ_j + p_j + J_jᵀx / (Σ |J|² + 0.1) · 0.6        sums over stuck sensors

If no servo is known, p_j is what the hand says, of the one joint that explains it best:

    p_j = m_j + J_jᵀ(Δx − Σ J_i m_i) / |J_j|²

The hand is in the plane or in space: vectors have 2 or 3 components.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple, TypeAlias

import numpy as np

from mmc_gym.agents.base import any_true
from mmc_gym.agents.body_model.forward_model import RATE, SAME, Bools
from mmc_gym.geometry import Floats, wrap_angle
from mmc_gym.interface import Seen, Sensed

BETTER = 0.5  # ratio of these sums below which a sensor is stuck
EXACT = 1e-5  # sum of square errors that is as good as none, segment lengths²
STILL = 2.0  # observations in turn without a change after which a sensor may be stuck
FOLLOWS = 0.6  # rate at which the angle of such a joint follows the hand
DAMPING = 0.1  # of that, segment lengths²
NEGLIGIBLE = 1e-3  # square of a joint's distance from the hand that is as good as 0, likewise

HandModel: TypeAlias = Callable[[Floats], tuple[Floats, Floats]]
"""A function of postures (n, N) that returns hands (n, d) and their derivatives (n, N, d)."""


class Stuck(NamedTuple):
    """What is known of the sensors of n arms with N joints."""

    felt: Floats  # joint angles as last felt, (n, N)
    hand: Floats  # as last seen, (n, d)
    turn: Floats  # how far joints were last felt to turn, (n, N)
    move: Floats  # and how far the hand was seen to move, (n, d)
    still: Floats  # observations in turn without a change, (n, N)
    error: Floats  # recent square errors of the hand's movement if no sensor is stuck, (n, 1)
    error_if_stuck: Floats  # and if one is, (n, N)
    is_stuck: Bools  # (n, N)
    offset: Floats  # how far joints turned since their sensors got stuck, radians, (n, N)

    @classmethod
    def start(cls, sensed: Sensed) -> Stuck:
        """Return what is known before the first look at the hand."""
        felt = sensed.joint_angles
        zero, hand = np.zeros_like(felt), np.zeros_like(sensed.target)
        return cls(felt, hand, zero, hand, zero, zero[:, :1], zero, zero > 0, zero)

    def feel(self, seen: Seen) -> Stuck:
        """Return it after an observation."""
        hand, felt = seen.hand, seen.joint_angles
        turn = wrap_angle(felt - self.felt)
        still = (self.still + 1) * (np.abs(turn) < SAME)
        return self._replace(felt=felt, hand=hand, turn=turn, move=hand - self.hand, still=still)

    def doubted(self, before: Stuck) -> Bools:
        """Return which arms may have a stuck sensor, (n,), if it was so `before` an observation.

        A joint stands still, or did so before, while the hand moves; or a sensor was stuck.
        """
        stands: Bools = (self.still > 0) | (before.still > 0)
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

    def compare(self, model: HandModel, before: Floats, commanded: Floats, counts: Bools) -> Stuck:
        """Return it after the hand's movement is compared with that of the joints.

        Joints were at `before`, and should have turned as `commanded`, (n, N); some arms count,
        (n,).  Only needed for arms that are `doubted`.
        """
        is_watched = np.any(self.still > 0, axis=-1, keepdims=True)
        _, columns = model(before + self.turn / 2)
        # What the hand's movement lacks if joints turned as they are felt to, and if one did not.
        lacks = self.move - (columns * self.turn[..., None]).sum(axis=-2)
        lacks_if_stuck = lacks[:, None] - columns * (commanded - self.turn)[..., None]
        counts = counts[:, None]
        error = (1 - RATE) * self.error + counts * _squared(lacks)[:, None]
        error_if_stuck = (1 - RATE) * self.error_if_stuck + counts * _squared(lacks_if_stuck)
        is_better = error_if_stuck < BETTER * error - EXACT
        is_worse = error < BETTER * error_if_stuck - EXACT
        is_stuck = (self.still > STILL) & (is_better | (self.is_stuck & ~is_worse))
        offset = (self.offset + counts * commanded) * is_stuck
        if any_true(is_stuck):
            angles = self.felt + offset
            hand, columns = model(angles)
            pulls = columns * is_stuck[..., None]
            size = _squared(pulls).sum(axis=-1, keepdims=True) + DAMPING
            pull = (pulls * (self.hand - hand)[:, None]).sum(axis=-1)
            offset = offset + counts * FOLLOWS * pull / size
        return self._replace(
            error=error * is_watched,
            error_if_stuck=error_if_stuck * is_watched,
            is_stuck=is_stuck,
            offset=offset,
        )

    def shown_by_hand(self, model: HandModel, before: Floats) -> Floats:
        """Return how far joints turned, (n, N), by the hand's movement, if no servo is known.

        Of the joints that stand still, or whose sensor is stuck, the one that explains best what
        the movement lacks turned so; the others as they are felt to.
        """
        _, columns = model(before + self.turn / 2)
        lacks = self.move - (columns * self.turn[..., None]).sum(axis=-2)
        pull, size = (columns * lacks[:, None]).sum(axis=-1), _squared(columns) + NEGLIGIBLE
        is_known = np.any(self.is_stuck, axis=-1, keepdims=True)
        explained = pull * pull / size * np.where(is_known, self.is_stuck, self.still > 0)
        is_best = explained == explained.max(axis=-1, keepdims=True)
        return self.turn + is_best * pull / size

    def corrected(self, seen: Seen, commanded: Floats, control_step: float) -> Seen:
        """Return what is seen, with the angles and speeds of joints whose sensors are stuck."""
        speeds = np.where(self.is_stuck, commanded / control_step, seen.joint_speeds)
        return replace(seen, joint_angles=seen.joint_angles + self.offset, joint_speeds=speeds)


def _squared(vectors: Floats) -> Floats:
    """Return the squared lengths (...) of vectors (..., d)."""
    square: Floats = (vectors * vectors).sum(axis=-1)
    return square
