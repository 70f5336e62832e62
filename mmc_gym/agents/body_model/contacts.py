"""Contacts: where the arm was stopped.

An obstacle is not seen, only felt: joints are asked to turn, but are pushed back.  Where the arm
rests or slides against something, one of its points does not move across its segment, though it
should.  For points along the segments, with the unit normal n of their segment, the wanted speed
w·n and the actual speed a·n follow from the turns asked of the joints and those seen.  Over the
last control steps,

    r = Σ |a·n| / Σ |w·n|

is next to nothing at the point of contact.  A load that gathers speed looks alike, but there a
point never loses its speed at a blow: one that does rests after a few control steps of small r,
and one that had no speed to lose only after many.  Where all joints rest although they are asked
to turn, all is in contact, and the point that was to go farthest counts.

There a disc of `RADIUS` is remembered, on the side to which the point was to move.  Ways round the
discs are in `ways`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mmc_gym.agents.base import some, where
from mmc_gym.agents.body_model.senses import Bools, Points
from mmc_gym.network.chain import Floats

POINTS = np.arange(1, 13) / 12
"""Places along a segment that may be in contact."""
LACKED = 0.02
"""Turn that a joint owes in a control step if something holds it back, radians."""
RECENT = 0.6
"""Share of the sums of speeds that a control step leaves."""
WANTED = 0.12
"""Way that a point in contact was to go, segment lengths."""
STOPPED = 0.06
"""r of a point in contact."""
BLOW, FADES = 0.02, 0.9
"""A point struck something that lost so much of its way in a control step, segment lengths; and
the share of that which a control step leaves."""
SHORT, LONG = 3, 16
"""Control steps that a point in contact rests if it struck something, and if not."""
STILL = 0.002
"""Joints that turn by less in a control step rest, radians."""
OWED = 0.015
"""Turn in a control step that is owed where all joints rest in contact, radians."""
LASTING = 10
"""Control steps that they rest."""
RADIUS = 0.28
"""Radius of what stands in the way, half the segment's thickness included, segment lengths."""
MOST = 6
"""So many contacts are remembered."""
NOWHERE = 1e6 + 0j
"""Place of a disc that is none."""


class Contacts(NamedTuple):
    """What is remembered of obstacles.

    Attributes:
        discs: their centres, `NOWHERE` if there are fewer, (n, MOST).
        wanted: Σ |w·n| of the points, segment lengths, (n, N · points).
        actual: Σ |a·n| of the points, segment lengths, (n, N · points).
        blows: the way that the points lost in a control step, segment lengths, (n, N · points).
        rests: control steps in which r of the points was small, (n, N · points).
        still: control steps in which all joints rested, (n,).
        met: contacts so far, (n,).
        is_new: whether there is a new one, (n,).
    """

    discs: Points
    wanted: Floats
    actual: Floats
    blows: Floats
    rests: Floats
    still: Floats
    met: Floats
    is_new: Bools

    @classmethod
    def start(cls, arms: int, joints: int) -> Contacts:
        """Return that there was no contact."""
        sums, none = np.zeros((arms, joints * len(POINTS))), np.zeros(arms)
        nothing = np.full((arms, MOST), NOWHERE)
        return cls(nothing, sums, sums, sums, sums, none, none, none > 0)

    def observed(
        self,
        joint_angles: Floats,
        turn: Floats,
        *,
        before: Floats,
        asked: Floats,
        lengths: Floats,
        counts: Bools,
    ) -> Contacts:
        """Return the memory after another look.

        Args:
            joint_angles: radians, (n, N).
            turn: by how much the joints turned, radians, (n, N).
            before: by how much they turned in the control step before, radians, (n, N).
            asked: by how much they should have turned, radians, (n, N).
            lengths: of the segments, (n, N).
            counts: whether the joints are seen in time and without noise, (n,).
        """
        owed = np.abs(asked - turn).max(axis=-1)
        lacks = (owed > LACKED) & counts
        is_still = (owed > OWED) & (np.abs(turn).max(axis=-1) < STILL) & counts
        if not some(lacks | is_still):
            if not (some(self.wanted) or some(self.is_new)):
                return self
            return self.start(*turn.shape)._replace(discs=self.discs, met=self.met)
        units = np.exp(1j * np.cumsum(joint_angles, axis=-1))
        wanted = self._across(units, lengths, asked)
        actual = self._across(units, lengths, turn)
        earlier = self._across(units, lengths, before)
        side, goes_on = np.sign(wanted), lacks[:, None]
        blows = np.maximum(FADES * self.blows * goes_on, (earlier - actual) * side)
        lever = np.abs(wanted)
        wanted = RECENT * self.wanted * goes_on + lever
        actual = RECENT * self.actual * goes_on + np.abs(actual)
        is_at_rest = (wanted > WANTED) & (actual < STOPPED * wanted) & goes_on
        rests = np.where(is_at_rest, self.rests + 1, 0.0)
        still = np.where(is_still, self.still + 1, 0.0)

        touches = rests >= np.where(blows > BLOW, SHORT, LONG)
        is_felt = touches.any(axis=-1)
        is_new = is_felt | (still >= LASTING)
        after = Contacts(self.discs, wanted, actual, blows, rests, still, self.met, is_new)
        if not some(is_new):
            return after
        every = np.arange(len(turn))
        ratio = np.where(touches, actual / np.maximum(wanted, 1e-9), np.inf)
        point = np.where(is_felt, ratio.argmin(axis=-1), lever.argmax(axis=-1))
        places = self._places(units, lengths)[every, point]
        normal = 1j * units[every, point // len(POINTS)] * side[every, point]
        fresh = self.start(*turn.shape)._replace(
            discs=self._remembered(places + RADIUS * normal, is_new),
            met=self.met + is_new,
            is_new=is_new,
        )
        return where(is_new, fresh, after)

    def _remembered(self, disc: Points, is_new: Bools) -> Points:
        """Return the discs with new ones (n,) among them, (n, MOST)."""
        # Another contact with a disc that is known tells better where it is.
        every, distance = np.arange(len(disc)), np.abs(self.discs - disc[:, None])
        known = distance.argmin(axis=-1)
        is_known = distance[every, known] < RADIUS
        slot = np.where(is_known, known, self.met % MOST).astype(int)
        disc = np.where(is_known, (disc + self.discs[every, slot]) / 2, disc)
        discs = self.discs.copy()
        discs[every[is_new], slot[is_new]] = disc[is_new]
        return discs

    @staticmethod
    def _places(units: Points, lengths: Floats) -> Points:
        """Return the points along the segments, (n, N · points)."""
        segments = lengths * units
        begin = np.cumsum(segments, axis=-1) - segments
        places: Points = begin[:, :, None] + POINTS * segments[:, :, None]
        return places.reshape(len(units), -1)

    @staticmethod
    def _across(units: Points, lengths: Floats, turn: Floats) -> Floats:
        """Return by how much the points move across their segment, (n, N · points)."""
        rotation = np.cumsum(turn, axis=-1)
        along = 1j * lengths * units * rotation  # by how much each segment's end moves
        begin = np.cumsum(along, axis=-1) - along
        normal = 1j * units
        moved: Floats = (begin * normal.conj()).real[:, :, None]
        moved = moved + (lengths * rotation)[:, :, None] * POINTS
        return moved.reshape(len(units), -1)
