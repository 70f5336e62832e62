"""Locks: joints that are asked for much, but are still.

For as long as a joint stays where it is, the turns that the servo model expects of it are summed
up.  Asked for enough, it is taken as locked, and the internal model has to do without it: its angle
is a clamp.  It is pushed on, though, so that a joint that was only held up (by a load, an obstacle,
or a joint beside it) is free again as soon as it turns.

Nothing counts before the arm is felt to move: senses that are late show an arm that does not move.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mmc_gym.agents.base import some
from mmc_gym.agents.body_model.senses import Bools, PostureTrack
from mmc_gym.network.chain import Floats

ASKED, ASKED_IF_TOLD = 0.4, 0.15
"""Turn that is asked of a joint before it is taken as locked, radians; and of one told to lock."""
SLOWLY = 0.25
"""That much of it is enough where movements are as slow as those of people."""
ASKED_PER_NOISE = 10.0
"""What the noise of the joint angles adds to that."""
WRONGLY = 4.0
"""So many times more is asked of a joint that was taken as locked, and then turned."""
STILL, STILL_PER_ASKED = 0.004, 0.12
"""A joint within this of where it was is still, radians, and with this share of what was asked."""
SLOW, SLOW_PER_NOISE = 0.25, 15.0
"""And it is slower than this, rad/s; and what noise adds to that, 1/s."""
FREED = 0.06
"""A locked joint that is farther than this from its place is free, radians."""
PLACED = 0.1
"""Share by which the place of a locked joint follows what is seen."""
PUSH = 0.6
"""How far a locked joint is sent ahead, to see whether it turns, radians."""
LATEST = 25
"""Observations after which an arm that is not felt to move is taken to be locked."""


class Locks(NamedTuple):
    """What is known of locked joints, (n, N).

    Attributes:
        place: where each joint is locked, or was still last, radians.
        asked: the turns that were asked of it there, radians.
        is_locked: whether it is taken as locked.
        has_changed: whether that has changed with the last observation.
        was_wrong: whether it was taken as locked, and then turned.
    """

    place: Floats
    asked: Floats
    is_locked: Bools
    has_changed: Bools
    was_wrong: Bools

    @classmethod
    def start(cls, joint_angles: Floats) -> Locks:
        """Return that all joints are free."""
        free = np.zeros(joint_angles.shape, bool)
        return cls(joint_angles, np.zeros_like(joint_angles), free, free, free)

    def observed(
        self,
        posture: PostureTrack,
        expected: Floats,
        is_felt: Bools,
        *,
        lockable: tuple[int, ...] = (),
        vigour: float = 1.0,
    ) -> Locks:
        """Return what is known after another look.

        Args:
            posture: as seen.
            expected: by how much the servo model has the joints turned, radians, (n, N).
            is_felt: whether the arm has been felt to move, (n,).
            lockable: the only joints that can lock, where that was told.
            vigour: see `Parts`; at less of it, joints do sooner what they are asked.
        """
        noise, seen = posture.deviation, posture.joint_angles
        tolerance = STILL + 3 * noise
        away = np.abs(seen - self.place)
        moves = away > tolerance + STILL_PER_ASKED * np.abs(self.asked)
        moves |= np.abs(posture.speeds) > SLOW + SLOW_PER_NOISE * noise
        counts = ~moves & (is_felt[:, None] | (posture.age > LATEST))
        was_locked, was_wrong = some(self.is_locked), self.was_wrong
        if was_locked:
            freed = self.is_locked & (away > 2 * tolerance + FREED)
            counts &= ~freed
            was_wrong = was_wrong | freed
        asked = np.where(counts, self.asked + expected, 0.0)
        least = (ASKED_IF_TOLD if lockable else ASKED) * (SLOWLY + (1 - SLOWLY) * vigour)
        enough = least + ASKED_PER_NOISE * noise
        if some(was_wrong):
            enough = enough * np.where(was_wrong, WRONGLY, 1.0)
        holds = counts & (np.abs(asked) > enough)
        if lockable:
            holds[:, [joint for joint in range(seen.shape[1]) if joint not in lockable]] = False
        if not was_locked:
            return Locks(np.where(moves | holds, seen, self.place), asked, holds, holds, was_wrong)
        is_locked = (self.is_locked & ~freed) | holds
        place = self.place + PLACED * (seen - self.place)
        place = np.where(
            self.is_locked & is_locked, place, np.where(moves | holds, seen, self.place)
        )
        return Locks(place, asked, is_locked, is_locked != self.is_locked, was_wrong)
