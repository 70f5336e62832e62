"""Ways round the contacts that are remembered.

Imagination goes through movements before they are made.  Postures beside the straight ways to the
target, and some anywhere, are a map of where the arm can be.  Legs between them that lead a segment
into a remembered disc are left out, and the shortest way from the present posture to one with the
hand at the target is taken (a probabilistic roadmap: Kavraki, Švestka, Latombe and Overmars 1996).
More than is known may stand in the way, so a leg costs more the farther the arm moves in the plane.
At last the postures on the way are drawn towards the straight line, as far as that is free.

Literature: L. E. Kavraki, P. Švestka, J.-C. Latombe, M. H. Overmars (1996), Probabilistic roadmaps
for path planning in high-dimensional configuration spaces, IEEE Trans. Robotics Automation 12,
566–580.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmc_gym.agents.base import some
from mmc_gym.agents.body_model.contacts import NOWHERE, RADIUS, Contacts
from mmc_gym.agents.body_model.imagination import Arms, Imagination
from mmc_gym.agents.body_model.senses import Bools, Points
from mmc_gym.interface import ReachInterface
from mmc_gym.network.chain import Floats

MARGIN = 0.02
"""Distance from a disc that is kept, segment lengths."""
COMFORT, DISCOMFORT = 0.15, 6.0
"""Distance from a disc up to which a leg costs more, segment lengths; and how much, radians."""
STAGES = np.arange(1, 17) / 16
"""Shares of a leg at which it is looked at."""
EVERYWHERE, NEARBY = 64, 96
"""Postures of the map: anywhere, and beside the straight ways to the target."""
BESIDE = 1.5
"""How far beside, radians."""
NEIGHBOURS = 8
"""From each posture of the map legs lead to so many others."""
GOALS = 24
"""So many postures with the hand at the target are tried."""
LEG = 0.3
"""What a leg costs beside its length, radians."""
HAZARD = 0.1
"""What it costs that ends of segments move: more may stand in the way, radians per length."""
LEGS = 5
"""A way has at most so many."""
ARRIVED = 0.3
"""A leg is over when no joint is farther from its end, radians."""
SHORTCUTS = np.array([1.0, 0.75, 0.5, 0.25, 0.0])
"""Shares by which a posture on the way is moved towards the straight line past it."""
TIGHTENED = 2
"""So many times they are."""


class Plan(NamedTuple):
    """Where an arm is to go.

    Attributes:
        goal: the imagined posture with the hand at the target, radians, (n, N).
        vias: postures to go through before that, the last one first, radians, (n, LEGS - 1, N).
        ahead: how many of them are still to be reached, (n,).
        begin: the posture in which the leg began; not beyond ±π of where it ends, (n, N).
    """

    goal: Floats
    vias: Floats
    ahead: NDArray[np.intp]
    begin: Floats

    @classmethod
    def start(cls, joint_angles: Floats) -> Plan:
        """Return the plan to stay."""
        vias = np.repeat(joint_angles[:, None], LEGS - 1, axis=1)
        return cls(joint_angles, vias, np.zeros(len(joint_angles), np.intp), joint_angles)

    @property
    def is_indirect(self) -> Bools:
        """Whether the arm is still to go through another posture, (n,)."""
        return self.ahead > 0

    @property
    def next(self) -> Floats:
        """The posture to go to now, radians, (n, N)."""
        if not some(self.ahead):
            return self.goal
        via = self.vias[np.arange(len(self.ahead)), np.maximum(self.ahead - 1, 0)]
        following: Floats = np.where(self.is_indirect[:, None], via, self.goal)
        return following

    def arrived(self, told: ReachInterface, joint_angles: Floats) -> Plan:
        """Return the plan of arms in these postures, some of which may have made a leg."""
        if not some(self.ahead):
            return self
        end = self.next
        left = np.abs(told.turn(joint_angles, end)).max(axis=-1)
        is_there = self.is_indirect & (left < ARRIVED)
        begin = self.begin + told.turn(self.begin, end)
        return self._replace(
            ahead=self.ahead - is_there,
            begin=np.where(is_there[:, None], begin, self.begin),
        )


def clearance(joint_angles: Floats, lengths: Floats, discs: Points) -> Floats:
    """Return how near the segments of postures (..., N) come to discs (M,), (...)."""
    units = np.exp(1j * np.cumsum(joint_angles, axis=-1))
    segments = lengths * units
    begin = np.cumsum(segments, axis=-1) - segments
    to_disc = (discs - begin[..., None]) * units.conj()[..., None]
    beside = to_disc.real - np.clip(to_disc.real, 0, lengths[:, None])
    nearest: Floats = np.hypot(beside, to_disc.imag).min(axis=(-1, -2))
    return nearest


def room(
    told: ReachInterface, start: Floats, end: Floats, lengths: Floats, discs: Points
) -> tuple[Floats, Floats]:
    """Return how much room there is on straight movements between postures (..., N).

    A movement that begins in contact has to lead away from it.

    Returns:
        By how much more than they must they keep from discs, above 0 where they are free, (...),
        and how far the ends of the segments move together, (...), in segment lengths.
    """
    stages = start[..., None, :] + STAGES[:, None] * told.turn(start, end)[..., None, :]
    begin = clearance(start, lengths, discs)[..., None]
    needed = np.minimum(RADIUS + MARGIN, begin + 2 * MARGIN * STAGES)
    spare: Floats = (clearance(stages, lengths, discs) - needed).min(axis=-1)
    ends = np.cumsum(lengths * np.exp(1j * np.cumsum(stages, axis=-1)), axis=-1)
    swept: Floats = np.abs(np.diff(ends, axis=-2)).sum(axis=(-1, -2))
    return spare, swept


class Ways:
    """Imagines movements round the contacts that are remembered."""

    def __init__(self, imagination: Imagination) -> None:
        """Make it for the arm of an imagination."""
        self.imagination = imagination
        told = imagination.interface
        joints = len(told.segment_lengths)
        random = np.random.default_rng(0)  # always the same map
        self.everywhere = told.within_limits(random.uniform(-np.pi, np.pi, (EVERYWHERE, joints)))
        self.along = random.uniform(0, 1, (NEARBY, 1))
        self.beside = random.uniform(-BESIDE, BESIDE, (NEARBY, joints))

    def planned(self, plan: Plan, contacts: Contacts, arms: Arms, begins: Bools) -> Plan:
        """Return the plans, made anew for arms that begin a movement and remember a contact."""
        chosen = np.flatnonzero(begins & (contacts.met > 0))
        plan = plan._replace(
            begin=np.where(begins[:, None], arms.joint_angles, plan.begin),
            ahead=np.where(begins, 0, plan.ahead),
        )
        if not chosen.size:
            return plan
        plan = plan._replace(goal=plan.goal.copy(), vias=plan.vias.copy(), ahead=plan.ahead.copy())
        for arm in chosen:
            discs = contacts.discs[arm]
            way = self._way_round(arms.of(np.array([arm])), discs[discs != NOWHERE])
            if way is not None:
                plan.goal[arm] = way[-1]
                plan.ahead[arm] = len(way) - 1
                plan.vias[arm, : len(way) - 1] = way[-2::-1]
        return plan

    def _way_round(self, arm: Arms, discs: Points) -> Floats | None:
        """Return the postures to go to one after the other, (legs, N); None: no way is found."""
        told, (start, lengths) = self.imagination.interface, (arm.joint_angles[0], arm.lengths[0])
        goals, costs = (values[:, 0] for values in self.imagination.all(arm))
        goals = goals[np.argsort(costs)[:GOALS]]
        goals = goals[clearance(goals, lengths, discs) > RADIUS]
        if not len(goals):
            return None
        towards = told.turn(start, goals)[np.arange(NEARBY) % len(goals)]
        nearby = told.within_limits(start + self.along * towards + self.beside)
        via = np.concatenate([nearby, self.everywhere])
        if arm.held is not None:
            via = np.where(arm.held[0], start, via)
        via = via[clearance(via, lengths, discs) > RADIUS]
        nodes, first_via = np.concatenate([start[None], goals, via]), 1 + len(goals)
        legs = self._legs(nodes, first_via)
        length = self._length(nodes[legs[:, 0]], nodes[legs[:, 1]], lengths, discs)
        cost = np.full((len(nodes), len(nodes)), np.inf)
        cost[legs[:, 0], legs[:, 1]] = cost[legs[:, 1], legs[:, 0]] = length
        chosen = self._shortest(cost, np.arange(1, first_via))
        if chosen is None:
            return None
        way = nodes[chosen]
        for _ in range(TIGHTENED):
            self._tighten(way, lengths, discs)
        return way[1:]

    def _legs(self, nodes: Floats, first_via: int) -> NDArray[np.intp]:
        """Return the legs of a map, pairs of nodes, (legs, 2).

        They lead from the first node, where the arm is, to all others; from each of those to its
        neighbours; and to the goals, the nodes before `first_via`, from more of them.
        """
        told = self.imagination.interface
        far = np.abs(told.turn(nodes[1:, None], nodes[1:])).max(axis=-1)
        near = np.argsort(far, axis=-1)[:, 1 : NEIGHBOURS + 1] + 1
        goals, others = np.arange(1, first_via), np.arange(1, len(nodes))
        to_goal = far[: len(goals), len(goals) :].argsort(axis=-1)[:, : 3 * NEIGHBOURS] + first_via
        legs = [
            np.stack(np.broadcast_arrays(ends[:, None], begins), axis=-1).reshape(-1, 2)
            for ends, begins in ((others, near), (goals, to_goal))
        ]
        between = np.unique(np.sort(np.concatenate(legs), axis=-1), axis=0)
        from_start = np.stack([np.zeros_like(others), others], axis=-1)
        return np.concatenate([from_start, between])

    def _length(self, start: Floats, end: Floats, lengths: Floats, discs: Points) -> Floats:
        """Return what legs cost, radians, infinite for those that are not free, (...)."""
        told = self.imagination.interface
        spare, swept = room(told, start, end, lengths, discs)
        length = np.abs(told.turn(start, end)).max(axis=-1) + LEG + HAZARD * swept
        length = length + DISCOMFORT * np.maximum(COMFORT - spare, 0.0)
        result: Floats = np.where(spare > 0, length, np.inf)
        return result

    def _tighten(self, way: Floats, lengths: Floats, discs: Points) -> None:
        """Move the postures on a way (legs + 1, N) to where it is shorter."""
        told = self.imagination.interface
        for k in range(1, len(way) - 1):
            before, via, after = way[k - 1 : k + 2]
            here, past = told.turn(before, via), told.turn(before, after)
            share = np.clip((here @ past) / np.maximum(past @ past, 1e-9), 0, 1)
            tried = via + SHORTCUTS[:, None] * (share * past - here)
            length = self._length(before, tried, lengths, discs)
            length = length + self._length(tried, after, lengths, discs)
            if np.isfinite(length.min()):
                way[k] = tried[length.argmin()]

    @staticmethod
    def _shortest(cost: Floats, end: NDArray[np.intp]) -> NDArray[np.intp] | None:
        """Return the nodes of the cheapest way from the first one to one of `end`."""
        best, every = cost[0].copy(), np.arange(len(cost))
        came = np.zeros(len(cost), int)
        for _ in range(LEGS - 1):
            through = best[:, None] + cost
            by = through.argmin(axis=0)
            is_better = through[by, every] < best
            came = np.where(is_better, by, came)
            best = np.where(is_better, through[by, every], best)
        way = [end[best[end].argmin()]]
        if not np.isfinite(best[way[0]]):
            return None
        while way[-1] != 0 and len(way) <= LEGS:
            way.append(came[way[-1]])
        return np.array(way[::-1]) if way[-1] == 0 else None
