"""Obstacles: remembered where they stopped the arm, and routes round them.

**Contacts.**  Obstacles are not seen, only felt: they push back joints that are commanded to turn.
Where the arm rests or slides against an obstacle, one of its points does not move across its
segment, although it should.  For points along the segments, with the normal n of their segment, the
intended speed w·n and the actual speed a·n follow from the commanded turns of the joints and those
seen.  Over the last control steps,

    r = Σ |a·n| / Σ |w·n|

is nearly 0 at the point of contact.  A load that gathers speed looks similar, but no point of it
loses speed in a blow.  So a point that lost speed counts as in contact once r is small, any other
point only after many control steps of small r.  There a disc of `RADIUS` is remembered, on the side
to which the point should move.

**Routes.**  Postures anywhere form a map of where the arm can be.  Legs between them that lead a
segment into a remembered disc are left out, and the shortest route from the present posture to one
with the hand at the target is taken (a probabilistic roadmap: Kavraki, Švestka, Latombe & Overmars
1996, IEEE Trans. Robotics Automation 12, 566–580).  There may be more obstacles than are known, so
a leg costs more the farther the arm moves in the plane.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmc_gym.agents.base import any_true, where
from mmc_gym.agents.body_model.forward_model import (
    RATE,
    Bools,
    Points,
    turn_by_speeds,
    unit_vectors,
)
from mmc_gym.agents.body_model.imagination import Imagination, ReachProblem
from mmc_gym.agents.body_model.senses import LastStep
from mmc_gym.geometry import Floats
from mmc_gym.interface import ReachInterface

POINTS = np.arange(1, 13) / 12  # positions along a segment at which contacts are looked for
LACKED_TURN = 0.02  # turn that a joint lacks in a control step if the arm is held back, radians
RECENT = 0.6  # share of the sums of speeds that remains after a control step
INTENDED_WAY, STOPPED_RATIO = 0.12, 0.06  # least Σ |w·n|, segment lengths, and largest r in contact
BLOW = 0.03  # loss of speed in a blow, segment lengths per control step
TOUCHES = 16  # control steps of small r until a point that lost no speed is in contact
RADIUS = 0.28  # radius of an obstacle, with half the thickness of a segment, segment lengths
MOST_DISCS = 6  # number of discs that are remembered
NOWHERE = 1e6 + 0j  # place of a disc that is free to be used

DISC_MARGIN = 0.02  # distance kept from a disc, segment lengths
STAGES = np.arange(1, 17) / 16  # shares of a leg at which it is checked
EVERYWHERE = 32  # number of postures in the map
HAZARD = 0.1  # cost of moving the ends of segments, radians per length
LEGS = 5  # largest number of legs of a route
ARRIVED = 0.3  # a leg is over when no joint is farther from its end, radians


class Contacts(NamedTuple):
    """Memory of obstacles, and running sums about each point of the arm, (n, N · points)."""

    discs: Points  # centres of the obstacles, `NOWHERE` if there are fewer, (n, MOST_DISCS)
    intended: Floats  # Σ |w·n|, segment lengths
    actual: Floats  # Σ |a·n|, segment lengths
    blow: Floats  # speed recently lost, segment lengths per control step
    rests: Floats  # number of control steps of small r
    located: Floats  # number of obstacles so far, (n,)
    is_new: Bools  # whether the last observation was a contact, (n,)

    @classmethod
    def start(cls, arms: int, joints: int) -> Contacts:
        """Return the memory without obstacles."""
        sums, none = np.zeros((arms, joints * len(POINTS))), np.zeros(arms)
        discs = np.full((arms, MOST_DISCS), NOWHERE)
        return cls(discs, sums, sums, sums, sums, located=none, is_new=none > 0)

    def locate(
        self, step: LastStep, lengths: Floats, counts: Bools, control_step: float
    ) -> Contacts:
        """Return the memory after a control step of arms that count (`counts`, (n,)).

        How far joints turned follows from their speeds, which are less noisy than their angles.
        """
        speeds = step.before.speeds
        turn = turn_by_speeds(speeds, step.after.speeds, control_step)
        lacks = (np.abs(step.commanded - turn).max(axis=-1) > LACKED_TURN) & counts
        if not any_true(lacks):
            return self._released() if any_true(self.intended) or any_true(self.is_new) else self
        units = unit_vectors(step.after.joint_angles)
        intended = _across(units, lengths, step.commanded)
        actual = _across(units, lengths, turn)
        lost = (_across(units, lengths, control_step * speeds) - actual) * np.sign(intended)
        after = where(lacks, self._pressed(intended, actual, lost), self._released())
        is_new, point = after._point_of_contact()
        after = after._replace(is_new=is_new)
        if not any_true(is_new):
            return after
        arms, (segment, place) = np.arange(len(units)), np.divmod(point, len(POINTS))
        segments = lengths * units
        begin = (np.cumsum(segments, axis=-1) - segments)[arms, segment]
        normal = 1j * units[arms, segment] * np.sign(intended[arms, point])
        disc = begin + POINTS[place] * segments[arms, segment] + RADIUS * normal
        return where(is_new, self._remember(disc)._released()._replace(is_new=is_new), after)

    def _released(self) -> Contacts:
        """Return the contacts with empty running sums, for arms that nothing holds back."""
        arms, points = self.intended.shape
        start = self.start(arms, points // len(POINTS))
        return start._replace(discs=self.discs, located=self.located)

    def _pressed(self, intended: Floats, actual: Floats, lost: Floats) -> Contacts:
        """Return the contacts with running sums that count one more control step.

        In it, points of the arm should have moved by `intended`, but moved by `actual`, and became
        slower by `lost`, segment lengths per control step.
        """
        total = RECENT * self.intended + np.abs(intended)
        moved = RECENT * self.actual + np.abs(actual)
        is_at_rest = (total > INTENDED_WAY) & (moved < STOPPED_RATIO * total)
        rests = np.where(is_at_rest, self.rests + 1, 0.0)
        blow = np.maximum((1 - RATE) * self.blow, lost)
        return self._replace(intended=total, actual=moved, blow=blow, rests=rests)

    def _point_of_contact(self) -> tuple[Bools, NDArray[np.intp]]:
        """Return which arms are in contact, (n,), and with which of their points, (n,)."""
        touches = (self.rests > 0) & ((self.blow > BLOW) | (self.rests >= TOUCHES))
        ratio = np.where(touches, self.actual / np.maximum(self.intended, 1e-9), np.inf)
        is_felt: Bools = np.any(touches, axis=-1)
        return is_felt, ratio.argmin(axis=-1)

    def _remember(self, disc: Points) -> Contacts:
        """Return the memory of one more disc for each arm; a known one improves its place."""
        arms, distance = np.arange(len(disc)), np.abs(self.discs - disc[:, None])
        nearest = distance.argmin(axis=-1)
        is_known = distance[arms, nearest] < RADIUS
        slot = np.where(is_known, nearest, self.located % MOST_DISCS).astype(int)
        discs = self.discs.copy()
        discs[arms, slot] = np.where(is_known, (disc + self.discs[arms, slot]) / 2, disc)
        return self._replace(discs=discs, located=self.located + ~is_known)


def _across(units: Points, lengths: Floats, turn: Floats) -> Floats:
    """Return how far the points move across their segment in a turn, (n, N · points)."""
    rotation = np.cumsum(turn, axis=-1)
    moved = 1j * lengths * units * rotation  # the end of each segment, relative to its begin
    begin = np.cumsum(moved, axis=-1) - moved
    across: Floats = (begin * (1j * units).conj()).real[:, :, None]
    across = across + (lengths * rotation)[:, :, None] * POINTS
    return across.reshape(len(units), -1)


class Route(NamedTuple):
    """The postures through which an arm should go."""

    goal: Floats  # posture with the hand at the target
    vias: Floats  # postures to go through before that, the last one first, (n, LEGS - 1, N)
    ahead: NDArray[np.intp]  # number of them that are still to be reached, (n,)
    begin: Floats  # posture in which the leg began, on the same turn as its end
    aim: Points  # position of the hand for which the route was planned
    goal_turn: Floats  # how far the goal turns in this control step, after a moving target
    begins: Bools  # whether a movement begins now, (n,)

    @classmethod
    def start(cls, joint_angles: Floats, aim: Points) -> Route:
        """Return the route that stays."""
        vias = np.repeat(joint_angles[:, None], LEGS - 1, axis=1)
        no, still = np.zeros(len(aim), bool), np.zeros_like(joint_angles)
        return cls(joint_angles, vias, no.astype(np.intp), joint_angles, aim, still, no)

    @property
    def next(self) -> Floats:
        """The posture to go to now, radians, (n, N)."""
        if not any_true(self.ahead):
            return self.goal
        via = self.vias[np.arange(len(self.ahead)), self.ahead - 1]
        return np.where((self.ahead > 0)[:, None], via, self.goal)

    def advance(self, interface: ReachInterface, joint_angles: Floats) -> Route:
        """Return the route, with the next leg for arms whose posture ends one."""
        if not any_true(self.ahead):
            return self
        end = self.next
        left = np.abs(interface.turn(joint_angles, end)).max(axis=-1)
        is_there = (self.ahead > 0) & (left < ARRIVED)
        begin = self.begin + interface.turn(self.begin, end)
        begin = np.where(is_there[:, None], begin, self.begin)
        return self._replace(ahead=self.ahead - is_there, begin=begin)


def clearance(joint_angles: Floats, lengths: Floats, discs: Points) -> Floats:
    """Return the distance (...) of postures (..., N) from the nearest of the discs (M,)."""
    units = unit_vectors(joint_angles)
    segments = lengths * units
    begin = np.cumsum(segments, axis=-1) - segments
    to_disc = (discs - begin[..., None]) * units.conj()[..., None]  # along and across the segments
    past_end = to_disc.real - np.clip(to_disc.real, 0, lengths[:, None])
    return np.hypot(past_end, to_disc.imag).min(axis=(-1, -2))


def leg_costs(
    interface: ReachInterface, start: Floats, end: Floats, lengths: Floats, discs: Points
) -> Floats:
    """Return the cost of legs between postures (..., N), radians, infinite if not free, (...).

    A leg is free if it keeps its distance from discs.  One that begins in contact has to lead away.
    """
    turn = interface.turn(start, end)
    stages = start[..., None, :] + STAGES[:, None] * turn[..., None, :]
    begin = clearance(start, lengths, discs)[..., None]
    needed = np.minimum(RADIUS + DISC_MARGIN, begin + 2 * DISC_MARGIN * STAGES)
    spare = (clearance(stages, lengths, discs) - needed).min(axis=-1)
    ends = np.cumsum(lengths * unit_vectors(stages), axis=-1)
    swept = np.abs(np.diff(ends, axis=-2)).sum(axis=(-1, -2))
    return np.where(spare > 0, np.abs(turn).max(axis=-1) + HAZARD * swept, np.inf)


class RoadMap:
    """The map on which routes round the remembered contacts are planned."""

    def __init__(self, imagination: Imagination) -> None:
        self.imagination, self.interface = imagination, imagination.interface
        joints = len(self.interface.segment_lengths)
        random = np.random.default_rng(0)  # always the same map
        anywhere = random.uniform(-np.pi, np.pi, (EVERYWHERE, joints))
        self.everywhere = self.interface.within_limits(anywhere)

    def plan(self, route: Route, contacts: Contacts, problem: ReachProblem, begins: Bools) -> Route:
        """Return the routes, new where a movement begins, and round the known contacts."""
        route = route._replace(
            goal=route.goal.copy(),
            vias=route.vias.copy(),
            ahead=np.where(begins, 0, route.ahead),
            begin=np.where(begins[:, None], problem.joint_angles, route.begin),
        )
        for arm in np.flatnonzero(begins & (contacts.located > 0)):
            discs = contacts.discs[arm]
            ends = self._ends_of_legs(problem.of(np.array([arm])), discs[discs != NOWHERE])
            if ends is not None:
                route.goal[arm] = ends[-1]
                route.ahead[arm] = len(ends) - 1
                route.vias[arm, : len(ends) - 1] = ends[-2::-1]
        return route

    def _ends_of_legs(self, problem: ReachProblem, discs: Points) -> Floats | None:
        """Return the ends of the legs of a route, (legs, N); None if there is none."""
        start, lengths = problem.joint_angles[0], problem.lengths[0]
        goals = self.imagination.imagine(problem)[0][:, 0]
        vias = self.everywhere
        if problem.held is not None:
            vias = np.where(problem.held[0], start, vias)
        goals, vias = (
            postures[clearance(postures, lengths, discs) > RADIUS] for postures in (goals, vias)
        )
        if not len(goals):
            return None
        nodes = np.concatenate([start[None], goals, vias])
        begins, ends = np.triu_indices(len(nodes), 1)
        cost = np.full((len(nodes), len(nodes)), np.inf)
        leg_cost = leg_costs(self.interface, nodes[begins], nodes[ends], lengths, discs)
        cost[begins, ends] = cost[ends, begins] = leg_cost
        shortest = _shortest(cost, np.arange(1, 1 + len(goals)))
        return None if shortest is None else nodes[shortest][1:]


def _shortest(cost: Floats, ends: NDArray[np.intp]) -> list[int] | None:
    """Return the nodes on the cheapest route from node 0 to one of `ends`; None if there is none.

    Legs between nodes cost `cost` (nodes, nodes), infinite where there is none.  A route of more
    than `LEGS` legs does not count.
    """
    from scipy.sparse.csgraph import dijkstra  # `import mmc_gym` loads no scipy

    [costs], [previous] = dijkstra(cost, indices=[0], return_predecessors=True)
    node = int(ends[costs[ends].argmin()])
    nodes = [node]
    while node > 0:  # scipy's mark for no predecessor is negative
        node = int(previous[node])
        nodes.insert(0, node)
    return nodes if node == 0 and len(nodes) <= LEGS + 1 else None
