"""Stuck sensors: joints that are felt to stand still, although the hand says that they turn.

Hand, joints and commands tell one movement three times.  The hand moves by Σ J_i m_i, where joints
turn by m_i and the columns of the Jacobian are J_i.  If joint j is felt to stand still, but turns
as its command should turn it, by p_j, it moves by J_j p_j more.  Where that has lately explained
the hand better, sensor j is stuck.  Its joint then turns by p_j, corrected by what the hand is seen
to be off by, x:

    θ_j ← θ_j + p_j + Re(J̄_j x) / (Σ |J|² + 0.1) · 0.6        sums over stuck sensors
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from mmc_gym.agents.base import any_true
from mmc_gym.agents.body_model.body import Body
from mmc_gym.agents.body_model.forward_model import Bools, Points, as_points, squared, unit_vectors
from mmc_gym.geometry import Floats, wrap_angle
from mmc_gym.interface import Seen

STANDS = 1e-5  # a sensor that turns by less stands still, radians
RECENT = 0.9  # share of the sums of square errors that is left after a control step
BETTER = 0.5  # ratio of these sums below which a sensor is stuck
EXACT = 1e-5  # sum of square errors that is as good as none, segment lengths²
STILL = 2.0  # observations in turn without a change after which a sensor may be stuck
FOLLOWS = 0.6  # rate at which the angle of such a joint follows the hand
DAMPING = 0.1  # of that, segment lengths²


class Stuck(NamedTuple):
    """What is known of the sensors of n arms with N joints."""

    felt: Floats  # joint angles as last felt, (n, N)
    hand: Points  # as last seen, (n,)
    turn: Floats  # how far joints were last felt to turn, (n, N)
    move: Points  # and how far the hand was seen to move, (n,)
    still: Floats  # observations in turn without a change, (n, N)
    error: Floats  # recent square errors of the hand's movement if no sensor is stuck, (n, 1)
    error_if_stuck: Floats  # and if one is, (n, N)
    is_stuck: Bools  # (n, N)
    offset: Floats  # how far joints turned since their sensors got stuck, radians, (n, N)

    @classmethod
    def start(cls, joint_angles: Floats) -> Stuck:
        """Return what is known before the first look at the hand."""
        zero, hand = np.zeros_like(joint_angles), np.zeros(len(joint_angles), complex)
        return cls(joint_angles, hand, zero, hand, zero, zero[:, :1], zero, zero > 0, zero)

    def feel(self, seen: Seen) -> Stuck:
        """Return it after an observation."""
        hand, felt = as_points(seen.hand), seen.joint_angles
        turn = wrap_angle(felt - self.felt)
        still = (self.still + 1) * (np.abs(turn) < STANDS)
        return self._replace(felt=felt, hand=hand, turn=turn, move=hand - self.hand, still=still)

    def compare(self, body: Body, before: Floats, commanded: Floats, counts: Bools) -> Stuck:
        """Return it after the hand's movement is compared with that of the joints.

        Joints were at `before`, and should have turned as `commanded`, (n, N); some arms count,
        (n,).  Only needed where a joint stands still, or did so before; no sensor of other arms is
        stuck.
        """
        is_watched = np.any(self.still > 0, axis=-1, keepdims=True)
        columns = body.jacobian(before + self.turn / 2)
        # What the hand's movement lacks if joints turned as they are felt to, and if one did not.
        lacks = self.move[:, None] - (columns * self.turn).sum(axis=-1, keepdims=True)
        lacks_if_stuck = lacks - columns * (commanded - self.turn)
        counts = counts[:, None]
        error = RECENT * self.error + counts * squared(lacks)
        error_if_stuck = RECENT * self.error_if_stuck + counts * squared(lacks_if_stuck)
        is_better = error_if_stuck < BETTER * error - EXACT
        is_worse = error < BETTER * error_if_stuck - EXACT
        is_stuck = (self.still > STILL) & (is_better | (self.is_stuck & ~is_worse))
        offset = (self.offset + counts * commanded) * is_stuck
        if any_true(is_stuck):
            angles = self.felt + offset
            off = self.hand - body.seen(unit_vectors(angles))
            pulls = body.jacobian(angles) * is_stuck
            size = squared(pulls).sum(axis=-1, keepdims=True) + DAMPING
            offset = offset + counts * FOLLOWS * (pulls.conj() * off[:, None]).real / size
        return self._replace(
            error=error * is_watched,
            error_if_stuck=error_if_stuck * is_watched,
            is_stuck=is_stuck,
            offset=offset,
        )

    def corrected(self, seen: Seen, commanded: Floats, control_step: float) -> Seen:
        """Return what is seen, with the angles and speeds of joints whose sensors are stuck."""
        speeds = np.where(self.is_stuck, commanded / control_step, seen.joint_speeds)
        return replace(seen, joint_angles=seen.joint_angles + self.offset, joint_speeds=speeds)
