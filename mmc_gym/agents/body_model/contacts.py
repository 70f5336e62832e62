"""Contacts: where the arm was stopped, and ways round it.

An obstacle is not seen, only felt: joints are asked to turn, but are pushed back.  Where the arm
rests or slides against something, one of its points does not move across its segment, though it
should.  For points along the segments, with the unit normal n of their segment, the wanted speed
w·n and the actual speed a·n follow from the turns asked of the joints and those seen.  Over the
last control steps,

    r = Σ |a·n| / Σ |w·n|

is next to nothing at the point of contact.  There a disc of `RADIUS` is remembered, on the side to
which the point was to move.  A load that gathers speed looks alike, but not for long.

Imagination then goes through movements before they are made: straight ones, in the joint angles, to
each of the imagined postures, and ones with another posture on the way.  Those in which a segment
comes into a remembered disc are left out, and the shortest of the others is taken.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mmc_gym.agents.base import some
from mmc_gym.agents.body_model.imagination import Arms, Imagination
from mmc_gym.agents.body_model.senses import Bools, Points
from mmc_gym.interface import ReachInterface
from mmc_gym.network.chain import Floats

POINTS = np.arange(1, 13) / 12
"""Places along a segment that may be in contact."""
LACKED = 0.02
"""Turn that a joint owes in a control step if something holds it back, radians."""
RECENT = 0.8
"""Share of the sums of speeds that a control step leaves."""
WANTED = 0.25
"""Way that a point in contact was to go, segment lengths."""
STOPPED = 0.06
"""r of a point in contact."""
LONG = 12
"""Control steps after which what does not move is no heavy load that gathers speed."""
RADIUS = 0.28
"""Radius of what stands in the way, half the segment's thickness included, segment lengths."""
MARGIN = 0.02
"""Distance from a disc that is kept, segment lengths."""
MOST = 6
"""So many contacts are remembered."""
NOWHERE = 1e6 + 0j
"""Place of a disc that is none."""
STAGES = np.arange(1, 9) / 8
"""Shares of a movement at which it is looked at."""
DETOURS = 96
"""Postures that are tried on the way."""
SIMILAR = 4.0
"""Postures that cost at most so much more than the best one are tried, radians."""
ARRIVED = 0.3
"""A detour is made when no joint is farther from it, radians."""


class Contacts(NamedTuple):
    """What is remembered of obstacles.

    Attributes:
        discs: their centres, `NOWHERE` if there are fewer, (n, MOST).
        wanted: Σ |w·n| of the points, segment lengths, (n, N · points).
        actual: Σ |a·n| of the points, segment lengths, (n, N · points).
        lacking: control steps in a row in which joints did not turn as asked, (n,).
        met: contacts so far, (n,).
        is_new: whether there is a new one, (n,).
    """

    discs: Points
    wanted: Floats
    actual: Floats
    lacking: Floats
    met: Floats
    is_new: Bools

    @classmethod
    def start(cls, arms: int, joints: int) -> Contacts:
        """Return that there was no contact."""
        sums = np.zeros((arms, joints * len(POINTS)))
        none = np.zeros(arms)
        return cls(np.full((arms, MOST), NOWHERE), sums, sums, none, none, none > 0)

    def observed(
        self, joint_angles: Floats, turn: Floats, asked: Floats, lengths: Floats, counts: Bools
    ) -> Contacts:
        """Return the memory after another look.

        Args:
            joint_angles: radians, (n, N).
            turn: by how much the joints turned, radians, (n, N).
            asked: by how much they should have turned, radians, (n, N).
            lengths: of the segments, (n, N).
            counts: whether the joints are seen in time and without noise, (n,).
        """
        lacks = (np.abs(asked - turn).max(axis=-1) > LACKED) & counts
        if not some(lacks):
            if not (some(self.lacking) or some(self.is_new)):
                return self
            return self._replace(
                wanted=np.zeros_like(self.wanted),
                actual=np.zeros_like(self.actual),
                lacking=np.zeros(len(turn)),
                is_new=np.zeros(len(turn), bool),
            )
        arms, every = len(turn), np.arange(len(turn))
        units = np.exp(1j * np.cumsum(joint_angles, axis=-1))
        wanted = self._across(units, lengths, asked).reshape(arms, -1)
        actual = self._across(units, lengths, turn).reshape(arms, -1)
        side = np.sign(wanted)
        keep = RECENT * lacks[:, None]
        wanted = keep * self.wanted + np.abs(wanted)
        actual = keep * self.actual + np.abs(actual)
        ratio = np.where(wanted > WANTED, actual / np.maximum(wanted, 1e-9), np.inf)
        point = ratio.argmin(axis=-1)
        lacking = (self.lacking + 1) * lacks
        is_new = (lacking >= LONG) & (ratio[every, point] < STOPPED)
        if not some(is_new):
            return Contacts(self.discs, wanted, actual, lacking, self.met, is_new)
        places = self._places(units, lengths).reshape(arms, -1)[every, point]
        disc = places + RADIUS * 1j * units[every, point // len(POINTS)] * side[every, point]
        # Another contact with a disc that is known tells better where it is.
        distance = np.abs(self.discs - disc[:, None])
        known = distance.argmin(axis=-1)
        is_known = distance[every, known] < RADIUS
        slot = np.where(is_known, known, self.met % MOST).astype(int)
        disc = np.where(is_known, (disc + self.discs[every, slot]) / 2, disc)
        discs = self.discs.copy()
        discs[every[is_new], slot[is_new]] = disc[is_new]
        fresh = ~is_new[:, None]
        return Contacts(
            discs, wanted * fresh, actual * fresh, lacking * ~is_new, self.met + is_new, is_new
        )

    @staticmethod
    def _places(units: Points, lengths: Floats) -> Points:
        """Return the points along the segments, (n, N, points)."""
        segments = lengths * units
        begin = np.cumsum(segments, axis=-1) - segments
        places: Points = begin[:, :, None] + POINTS * segments[:, :, None]
        return places

    @staticmethod
    def _across(units: Points, lengths: Floats, turn: Floats) -> Floats:
        """Return by how much the points move across their segment, segment lengths."""
        rotation = np.cumsum(turn, axis=-1)
        along = 1j * lengths * units * rotation  # by how much each segment's end moves
        begin = np.cumsum(along, axis=-1) - along
        normal = 1j * units
        moved: Floats = (begin * normal.conj()).real[:, :, None]
        return moved + (lengths * rotation)[:, :, None] * POINTS


def clearance(joint_angles: Floats, lengths: Floats, discs: Points) -> Floats:
    """Return how near the segments of postures (..., N) come to discs (M,), (...)."""
    units = np.exp(1j * np.cumsum(joint_angles, axis=-1))
    segments = lengths * units
    begin = np.cumsum(segments, axis=-1) - segments
    to_disc = (discs - begin[..., None]) * units.conj()[..., None]
    beside = to_disc.real - np.clip(to_disc.real, 0, lengths[:, None])
    nearest: Floats = np.hypot(beside, to_disc.imag).min(axis=(-1, -2))
    return nearest


def is_free(
    told: ReachInterface, start: Floats, end: Floats, lengths: Floats, discs: Points
) -> Bools:
    """Return whether straight movements between postures (..., N) are free of discs, (...)."""
    stages = start[..., None, :] + STAGES[:, None] * told.turn(start, end)[..., None, :]
    # A movement that begins in contact has to lead away from it.
    begin = clearance(start, lengths, discs)[..., None]
    needed = np.minimum(RADIUS + MARGIN, begin + 2 * MARGIN * STAGES)
    free: Bools = np.all(clearance(stages, lengths, discs) > needed, axis=-1)
    return free


class Plan(NamedTuple):
    """Where an arm is to go.

    Attributes:
        goal: the imagined posture with the hand at the target, radians, (n, N).
        detour: a posture to go to before that, radians, (n, N).
        is_indirect: whether the arm is still on its way there, (n,).
    """

    goal: Floats
    detour: Floats
    is_indirect: Bools

    @property
    def next(self) -> Floats:
        """The posture to go to now, radians, (n, N)."""
        following: Floats = np.where(self.is_indirect[:, None], self.detour, self.goal)
        return following

    def arrived(self, told: ReachInterface, joint_angles: Floats) -> Plan:
        """Return the plan of arms in these postures, some of which may have made their detour."""
        if not some(self.is_indirect):
            return self
        left = np.abs(told.turn(joint_angles, self.detour)).max(axis=-1)
        return self._replace(is_indirect=self.is_indirect & (left > ARRIVED))


class Ways:
    """Imagines movements round the contacts that are remembered."""

    def __init__(self, imagination: Imagination) -> None:
        """Make it for the arm of an imagination."""
        self.imagination = imagination
        joints = len(imagination.interface.segment_lengths)
        random = np.random.default_rng(0)  # always the same detours
        self.detours = random.uniform(-np.pi, np.pi, (DETOURS, joints))

    def planned(self, plan: Plan, contacts: Contacts, arms: Arms, begins: Bools) -> Plan:
        """Return the plans, made anew for arms that begin a movement and remember a contact."""
        chosen = np.flatnonzero(begins & (contacts.met > 0))
        if not chosen.size:
            return plan
        plan = Plan(plan.goal.copy(), plan.detour.copy(), plan.is_indirect.copy())
        for arm in chosen:
            discs = contacts.discs[arm]
            way = self._way_round(arms.of(np.array([arm])), discs[discs != NOWHERE])
            plan.is_indirect[arm] = way is not None and len(way) == 2
            if way is not None:
                plan.detour[arm], plan.goal[arm] = way[0], way[-1]
        return plan

    def _way_round(self, arm: Arms, discs: Points) -> list[Floats] | None:
        """Return the postures to go to one after the other, (N,) each; None: no way is found."""
        told, (start, lengths) = self.imagination.interface, (arm.joint_angles[0], arm.lengths[0])
        postures, costs = (values[:, 0] for values in self.imagination.all(arm))
        good = costs < costs.min() + SIMILAR
        goals, costs = postures[good], costs[good]
        free = is_free(told, start, goals, lengths, discs)
        if some(free):
            return [goals[np.where(free, costs, np.inf).argmin()]]
        detours = self.detours[is_free(told, start, self.detours, lengths, discs)]
        free = is_free(told, detours[:, None], goals, lengths, discs)
        if not some(free):
            return None
        way = np.abs(told.turn(start, detours)).max(axis=-1)[:, None]
        way = way + np.abs(told.turn(detours[:, None], goals)).max(axis=-1)
        detour, goal = np.unravel_index(np.where(free, way, np.inf).argmin(), free.shape)
        return [detours[detour], goals[goal]]
