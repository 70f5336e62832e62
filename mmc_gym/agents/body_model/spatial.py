"""The body agents for an arm of hinges in space.

    observation → links and locks → imagination → action

**Links.**  The hand x is a sum over the links, the vectors a_i between the points of neighbouring
hinges, each turned by the hinges before it: x = Σ (1 + s_i) R_i(q) a_i + c.  The shares s_i by
which links are longer than given follow from the seen hand by least squares.  Hypotheses leave
nothing free, one link, or all, and are compared as in `body`; the offset c follows what is left.

**Locks.**  A joint that hardly turns while it is asked to is held in the internal model.

**Imagination.**  The model settles from the present posture and from the last goal; if the hand
still misses the target, also from postures around.  The nearest posture that reaches is the goal.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from typing_extensions import override

from mmc_gym.agents.base import InternalModelAgent, Started
from mmc_gym.agents.body_model.arm import Bools
from mmc_gym.agents.body_model.body import PENALTY
from mmc_gym.interface import Observation, ReachInterface, Seen, Sensed
from mmc_gym.network import HingeArm, HingeNetwork
from mmc_gym.network.chain import Floats

if TYPE_CHECKING:
    from mmc_gym.agents.body_model.agent import Parts

Solver: TypeAlias = Callable[[HingeArm, Floats, Floats, Bools, float], Floats]
"""Postures (..., n) with the hand at a target (3,), from starts (..., n).

Further arguments: which joints keep the angles of the starts, (n,), and the tolerance.
"""

FORGET = 0.02  # share of the sums that is forgotten in a control step
EXACT = 1e-3  # negligible error, shares of the reach
PRIOR = 0.1  # likely share by which a link is longer, where its length leaves an error of `EXACT`
OFFSET_RATE = 0.3  # rate at which the offset follows the errors
STILL, REST = 0.12, 0.006  # a joint rests that turns by less, shares of what was asked or radians
ASKED = 0.12  # turn that is asked of a joint at rest until it is taken as locked, radians
SUCCESS = 0.03  # success distance if none is given, shares of the reach
NEAR, ALLOWED = 0.1, 0.8  # tolerance of the imagined hand, and miss without a cost, shares of that
MISSED = 100.0  # cost of what a posture misses beyond that, radians per reach
TOTAL = 0.05  # weight of the sum of all turns, beside that of the joint that turns farthest
STARTS, SPREAD = 16, 1.0  # postures around the present one, standard deviation of their angles


class Links(NamedTuple):
    """Running sums over the observations, and the links identified; W are the columns R_i a_i."""

    count: Floats  # observations, (...)
    gram: Floats  # Σ WᵀW, (..., n + 1, n + 1)
    pull: Floats  # Σ Wᵀe, for the errors e of the given arm, (..., n + 1)
    square: Floats  # Σ e², (...)
    shares: Floats  # s, (..., n + 1)
    offset: Floats  # c, (..., 3)

    def observed(self, columns: Floats, hand: Floats, exact: float) -> Links:
        """Return the links after a hand (..., 3) was seen, for W (..., 3, n + 1)."""
        error = hand - columns.sum(axis=-1)
        count = (1 - FORGET) * self.count + 1
        gram = (1 - FORGET) * self.gram + np.swapaxes(columns, -1, -2) @ columns
        pull = (1 - FORGET) * self.pull + (columns * error[..., None]).sum(axis=-2)
        square = (1 - FORGET) * self.square + (error**2).sum(axis=-1)
        rows = zip(count, gram, pull, square, strict=True)
        shares = np.array([likely_shares(*row, exact=exact**2) for row in rows])
        left = error - (columns * shares[:, None, :]).sum(axis=-1)
        rate = np.maximum(OFFSET_RATE, 1 / count)[:, None]
        return Links(count, gram, pull, square, shares, self.offset + rate * (left - self.offset))


class SpatialState(NamedTuple):
    """State of the agent, angles in radians, (..., n)."""

    joint_angles: Floats  # as last seen
    goal: Floats  # posture to which the arm turned then
    waited: Floats  # sum of the turns that were asked of a joint since it rests
    links: Links


class SpatialBodyAgent(InternalModelAgent[SpatialState]):
    """A body agent for an arm in space, see `ReachInterface.arm`."""

    is_in_space = True

    def __init__(self, interface: ReachInterface, solver: Solver, parts: Parts) -> None:
        """Make the agent; `parts` switch links, locks and the imagination off.

        Raises:
            CannotActError: for an arm in the plane, or under torque control.
        """
        super().__init__(interface)
        self.solver, self.parts, self.arm = solver, parts, interface.arm
        self.reach = np.linalg.norm(links_of(self.arm), axis=1).sum()
        self.within = interface.success_distance or SUCCESS * self.reach
        self.farthest = interface.speed_limit * interface.control_step
        shape = STARTS, self.arm.joint_count
        self.offsets = np.random.default_rng(0).normal(0.0, SPREAD, shape)

    @override
    def start(self, sensed: Sensed) -> SpatialState:
        angles, arms = sensed.joint_angles, len(sensed.joint_angles)
        zero, shares = np.zeros(arms), np.zeros((arms, self.arm.joint_count + 1))
        gram = shares[..., None] * shares[..., None, :]
        links = Links(zero, gram, shares, zero, shares, offset=np.zeros((arms, 3)))
        return SpatialState(angles, angles, np.zeros_like(angles), links)

    @override
    def predict(
        self,
        observation: Observation,
        state: SpatialState | None = None,
        episode_start: Started = None,
        deterministic: bool = False,
    ) -> tuple[NDArray[np.float32], SpatialState]:
        seen = self.interface.see(observation)
        batch = seen.joint_angles.shape[:-1]
        arms = math.prod(batch)
        seen = Seen(**{key: each.reshape(arms, each.shape[-1]) for key, each in vars(seen).items()})
        state = self.resumed(state, seen, episode_start)
        links, waited = state.links, self._waited(state, seen.joint_angles)
        if self.parts.identifies_body:
            columns = turned_links(self.arm, seen.joint_angles)
            links = links.observed(columns, seen.hand, EXACT * self.reach)
        state = SpatialState(seen.joint_angles, state.goal, waited, links)
        goal = [self._imagined(state, seen.target[arm], arm) for arm in range(arms)]
        state = state._replace(goal=np.reshape(goal, state.goal.shape))
        action = self.interface.act(state.goal, seen)
        return action.reshape(*batch, action.shape[-1]), state

    def _waited(self, state: SpatialState, joint_angles: Floats) -> Floats:
        """Return the turns that were asked of each joint since it rests, radians, (..., n)."""
        asked = np.abs(state.goal - state.joint_angles).clip(max=self.farthest)
        turn = np.abs(joint_angles - state.joint_angles)
        more = asked * (self.parts.finds_locks & (asked > REST))
        return np.where(turn > np.maximum(STILL * asked, REST), 0.0, state.waited + more)

    def _imagined(self, state: SpatialState, target: Floats, index: int) -> Floats:
        """Return the goal posture of one of the arms, (n,)."""
        now, links, held = state.joint_angles[index], state.links, state.waited[index] > ASKED
        arm = lengthened(self.arm, links.shares[index])
        aim = target - links.offset[index]
        postures = np.empty((0, len(now)))
        around = np.clip(now + self.offsets, *arm.limits.T)
        for starts in (np.array([now, state.goal[index]]), around):
            starts = np.where(held, now, starts)
            found = self.solver(arm, aim, starts, held, NEAR * self.within)
            postures = np.concatenate([postures, found])
            missed = np.linalg.norm(arm.forward(postures)[..., :3, 3] - aim, axis=-1)
            beyond = np.maximum(missed - ALLOWED * self.within, 0.0) / self.reach
            if not self.parts.imagines or not beyond.all():
                break
        turns = np.abs(postures - now)
        cost = turns.max(axis=-1) + TOTAL * turns.sum(axis=-1) + MISSED * beyond
        best: Floats = postures[cost.argmin()]
        return best


def links_of(arm: HingeArm) -> Floats:
    """Return the links of an arm in the zero posture, (n + 1, 3), from the base to the hand."""
    return np.diff(np.vstack([np.zeros(3), arm.points, arm.home[:3, 3]]), axis=0)


def turned_links(arm: HingeArm, joint_angles: Floats) -> Floats:
    """Return the links of arms in postures (m, n), the columns W, (m, 3, n + 1)."""
    turn, columns = Rotation.identity(len(joint_angles)), []
    first, *others = links_of(arm)
    columns = [np.broadcast_to(first, (len(joint_angles), 3))]
    for axis, angle, link in zip(arm.axes, joint_angles.T, others, strict=True):
        turn = turn * Rotation.from_rotvec(angle[:, None] * axis)
        columns.append(turn.apply(link))
    return np.stack(columns, axis=-1)


def lengthened(arm: HingeArm, shares: Floats) -> HingeArm:
    """Return an arm whose links are longer by these shares of their lengths, (n + 1,)."""
    if not shares.any():
        return arm
    moved = np.cumsum(shares[:, None] * links_of(arm), axis=0)
    home = arm.home.copy()
    home[:3, 3] += moved[-1]
    return replace(arm, points=arm.points + moved[:-1], home=home)


def likely_shares(count: float, gram: Floats, pull: Floats, square: float, exact: float) -> Floats:
    """Return the shares of the best hypothesis, (n + 1,); `exact` is the negligible square."""
    size, ridge = len(pull), exact / PRIOR**2
    one = np.diag(pull / (np.diagonal(gram) + ridge))
    each = np.vstack([np.zeros(size), one, np.linalg.solve(gram + ridge * np.eye(size), pull)])
    free = np.array([0, *[1] * size, size])
    left = square - (2 * each @ pull - ((each @ gram) * each).sum(axis=1))
    left = np.maximum(left, 0.0) + ridge * (each**2).sum(axis=1)
    criterion = count * np.log((left + exact) / (count + 1)) + free * (
        PENALTY + 2 * np.log1p(count)
    )
    best: Floats = each[criterion.argmin()]
    return best


def settled_network(
    arm: HingeArm, target: Floats, starts: Floats, held: Bools, tolerance: float
) -> Floats:
    """Let the network settle from each start: a `Solver`."""
    places = {int(joint): starts[..., joint] for joint in np.flatnonzero(held)}
    network = HingeNetwork(arm, velocity_decay=0.5)
    position = np.broadcast_to(target, (*starts.shape[:-1], 3))
    settled = network.solve(
        position, start=starts, held=places, starts=1, tolerance=(tolerance, 1.0)
    )
    return settled.joint_angles


def least_squares(
    arm: HingeArm, target: Floats, starts: Floats, held: Bools, tolerance: float
) -> Floats:
    """Iterate Δq = Jᵀ(JJᵀ + λ²I)⁻¹e within the limits, at most 100 times: the other `Solver`."""
    damping = (0.1 * np.linalg.norm(links_of(arm), axis=1).sum()) ** 2 * np.eye(3)
    for _ in range(100):
        nodes, axes, hand = arm.frames(starts)
        error = target - hand[..., :3, 3]
        if (np.linalg.norm(error, axis=-1) < tolerance).all():
            break
        lever = np.cross(axes, hand[..., None, :3, 3] - nodes[..., list(arm.joint_nodes), :])
        lever = lever * ~held[:, None]
        pull = np.linalg.solve(np.swapaxes(lever, -1, -2) @ lever + damping, error[..., None])
        starts = np.clip(starts + (lever @ pull)[..., 0], *arm.limits.T)
    return starts
