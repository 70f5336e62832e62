"""The body agents for an arm of hinges in space.

**Links.**  The hand x is the sum of the links, vectors a_i from hinge to hinge, each turned by the
hinges before it: x = Σ (1 + s_i) R_i(q) a_i + c.  By which shares s_i links are longer than given
follows from the seen hand by least squares.  Hypotheses leave nothing free, one link, or all, and
are compared as in `body`; the offset c follows what is left.

**Locks.**  A joint that hardly turns in spite of its commands is held in the internal model.

**Sensors.**  A joint that is felt to stand still, but moves the hand, turns as the hand says, see
`stuck`.

**Imagination.**  The model settles from the present posture and from the last goal; if the hand
still misses the target, also from postures around.  The goal is the nearest posture that reaches.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from mmc_gym.agents.base import FeedbackAgent, any_true, where
from mmc_gym.agents.body_model.body import PENALTY
from mmc_gym.agents.body_model.forward_model import FAST_RATE, KEEP_LONG, REST_TURN, WEAK, Bools
from mmc_gym.agents.body_model.imagination import SPREAD
from mmc_gym.agents.body_model.parts import Parts
from mmc_gym.agents.body_model.stuck import Stuck
from mmc_gym.geometry import Floats, damped_least_squares
from mmc_gym.interface import CannotActError, ReachInterface, Seen, Sensed
from mmc_gym.robots import HingeArm, HingeNetwork

SpatialModel: TypeAlias = Callable[[HingeArm, Floats, Floats, Bools, float], Floats]
"""A function that returns postures (m, n) with the hand at a target (3,), within a tolerance.

Joints start at angles (m, n); some of them, (n,), keep these.
"""

EXACT_SHARE = 1e-3  # negligible error, shares of the reach
PRIOR = 0.1  # likely share by which a link is longer, where its length leaves a negligible error
HELD_AFTER = 0.12  # commanded turn of a resting joint until it is taken as locked, radians
SUCCESS = 0.03  # success distance if none is given, shares of the reach
TOLERANCE_SHARE = 0.1  # tolerance of the imagined hand, shares of the success distance
FREE_SHARE = 0.8  # what a posture may miss without a cost, shares of the success distance
MISS_COST_PER_REACH = 100.0  # cost of what a posture misses beyond that, radians per reach
AROUND = 16  # number of postures around the present one that are tried
DAMPING_SHARE = 0.1  # λ of damped least squares, shares of the reach


class SpatialState(NamedTuple):
    """State of the agent for m arms; with the columns R_i a_i and x − Σ R_i a_i it sums W."""

    joint_angles: Floats  # as last seen, (m, n)
    goal: Floats  # posture to which the arm turned then, (m, n)
    waited: Floats  # turns commanded of a joint since it rests, (m, n)
    looks: Floats  # observations, (m,)
    sums: Floats  # Σ WᵀW, (m, n + 2, n + 2)
    shares: Floats  # s, (m, n + 1)
    offset: Floats  # c, (m, 3)
    stuck: Stuck  # of the sensors


class SpatialBodyAgent(FeedbackAgent[SpatialState]):
    """A body agent for an arm in space, see `ReachInterface.arm`."""

    is_in_space = True

    def __init__(self, interface: ReachInterface, model: SpatialModel, parts: Parts) -> None:
        """Make the agent; `parts` switch links, sensors, locks and imagination off.

        It cannot act for an arm in the plane or with slides or followers, or under torque control.
        """
        super().__init__(interface)
        if not interface.arm.has_only_hinges:
            raise CannotActError(
                "interface must be of an arm of hinges, without slides and joints "
                "that follow others (<mimic>), for this agent"
            )
        self.model, self.parts, self.arm = model, parts, interface.arm
        self.reach = np.linalg.norm(links_of(self.arm), axis=1).sum()
        self.within = interface.success_distance or SUCCESS * self.reach
        shape = AROUND, self.arm.joint_count
        self.around = np.random.default_rng(0).normal(0.0, SPREAD, shape)

    @override
    def start(self, sensed: Sensed) -> SpatialState:
        angles = sensed.joint_angles
        arms, joints = angles.shape
        return SpatialState(
            joint_angles=angles,
            goal=angles,
            waited=np.zeros_like(angles),
            looks=np.zeros(arms),
            sums=np.zeros((arms, joints + 2, joints + 2)),
            shares=np.zeros((arms, joints + 1)),
            offset=np.zeros((arms, 3)),
            stuck=Stuck.start(sensed),
        )

    @override
    def respond(self, state: SpatialState, seen: Seen) -> tuple[NDArray[np.float32], SpatialState]:
        if self.parts.finds_motors:
            state, seen = self._correct(state, seen)
        state = self._observe_turns(state, seen.joint_angles)
        if self.parts.identifies_body:
            state = self._identify_links(state, seen.hand)
        goals = [self._imagine(state, target, arm) for arm, target in enumerate(seen.target)]
        state = state._replace(goal=np.reshape(goals, seen.joint_angles.shape))
        return self.interface.act(state.goal, seen), state

    def _correct(self, state: SpatialState, seen: Seen) -> tuple[SpatialState, Seen]:
        """Return the state, and what is seen, with stuck sensors corrected."""
        stuck, model = state.stuck.feel(seen), partial(self._see, state)
        doubted = stuck.doubted(state.stuck)
        if any_true(doubted):
            before = state.joint_angles
            compared = stuck.compare(model, before, None, state.looks > 0)
            stuck = where(doubted, compared, stuck)
            seen = stuck.corrected(seen, state.stuck, self.interface.control_step)
        return state._replace(stuck=stuck), seen

    def _see(self, state: SpatialState, joint_angles: Floats) -> tuple[Floats, Floats]:
        """Return where hands are seen, (m, 3), and their derivatives: a `HandModel`."""
        links, axes = self._turned_links(joint_angles)
        links = (1 + state.shares)[..., None] * links
        to_hand = np.cumsum(links[:, ::-1], axis=1)[:, ::-1]
        return to_hand[:, 0] + state.offset, np.cross(axes, to_hand[:, 1:])

    def _turned_links(self, joint_angles: Floats) -> tuple[Floats, Floats]:
        """Return the links R_i a_i, (m, n + 1, 3), and the axes of the hinges, (m, n, 3)."""
        frames = self.arm.frames(joint_angles)
        base, end = np.zeros((len(joint_angles), 1, 3)), frames.hand[:, None, :3, 3]
        return np.diff(np.concatenate([base, frames.points, end], axis=1), axis=1), frames.axes

    def _observe_turns(self, state: SpatialState, joint_angles: Floats) -> SpatialState:
        farthest = self.interface.speed_limit * self.interface.control_step
        commanded = np.abs(state.goal - state.joint_angles).clip(max=farthest)
        turned = np.abs(joint_angles - state.joint_angles)
        more = commanded * (self.parts.finds_locks & (commanded > REST_TURN))
        moves = turned > np.maximum(WEAK * commanded, REST_TURN)
        waited = np.where(moves, 0.0, state.waited + more)
        return state._replace(joint_angles=joint_angles, waited=waited, looks=state.looks + 1)

    def _identify_links(self, state: SpatialState, hand: Floats) -> SpatialState:
        columns = np.swapaxes(self._turned_links(state.joint_angles)[0], 1, 2)
        error = hand - columns.sum(axis=-1)
        w = np.concatenate([columns, error[..., None]], axis=-1)
        sums = KEEP_LONG * state.sums + np.swapaxes(w, -1, -2) @ w
        exact = (EXACT_SHARE * self.reach) ** 2
        shares = np.array([likely_shares(*pair, exact) for pair in zip(sums, state.looks)])
        left = error - (columns * shares[:, None]).sum(axis=-1)
        rate = np.maximum(FAST_RATE, 1 / state.looks)[:, None]
        offset = state.offset + rate * (left - state.offset)
        return state._replace(sums=sums, shares=shares, offset=offset)

    def _imagine(self, state: SpatialState, target: Floats, index: int) -> Floats:
        """Return the goal posture (n,) of one of the arms, for a target (3,)."""
        now, goal = state.joint_angles[index], state.goal[index]
        held = state.waited[index] > HELD_AFTER
        arm, aim = lengthened(self.arm, state.shares[index]), target - state.offset[index]
        postures = np.empty((0, len(now)))
        for starts in (np.array([now, goal]), np.clip(now + self.around, *arm.limits.T)):
            starts = np.where(held, now, starts)
            settled = self.model(arm, aim, starts, held, TOLERANCE_SHARE * self.within)
            postures = np.concatenate([postures, settled])
            missed = np.linalg.norm(arm.forward(postures)[:, :3, 3] - aim, axis=-1)
            beyond = np.maximum(missed - FREE_SHARE * self.within, 0.0) / self.reach
            if not self.parts.imagines or not beyond.all():
                break
        turns = np.abs(postures - now)
        cost = turns.max(axis=-1) + MISS_COST_PER_REACH * beyond
        best: Floats = postures[cost.argmin()]
        return best


def links_of(arm: HingeArm) -> Floats:
    """Return the links of an arm in the zero posture, (n + 1, 3), from the base to the hand."""
    return np.diff([np.zeros(3), *arm.points, arm.home[:3, 3]], axis=0)


def lengthened(arm: HingeArm, shares: Floats) -> HingeArm:
    """Return an arm whose links are longer by these shares of their lengths, (n + 1,)."""
    if not shares.any():
        return arm
    moved = np.cumsum(shares[:, None] * links_of(arm), axis=0)
    home = arm.home.copy()
    home[:3, 3] += moved[-1]
    return replace(arm, points=arm.points + moved[:-1], home=home)


def likely_shares(sums: Floats, looks: float, exact: float) -> Floats:
    """Return the best hypothesis s, (n + 1,), from Σ WᵀW; `exact` is the negligible square."""
    gram, pull, ridge, size = sums[:-1, :-1], sums[:-1, -1], exact / PRIOR**2, len(sums) - 1
    one_link = np.diag(pull / (np.diagonal(gram) + ridge))
    all_links = np.linalg.solve(gram + ridge * np.eye(size), pull)
    shares = np.vstack([np.zeros(size), one_link, all_links])
    left = sums[-1, -1] - 2 * shares @ pull + ((shares @ gram + ridge * shares) * shares).sum(1)
    criterion = looks * np.log((np.maximum(left, 0.0) + exact) / (looks + 1))
    criterion += np.array([0, *[1] * size, size]) * (PENALTY + 2 * np.log1p(looks))
    best: Floats = shares[criterion.argmin()]
    return best


def settle_network(
    arm: HingeArm, target: Floats, starts: Floats, held: Bools, tolerance: float
) -> Floats:
    """Let the network settle from each start: a `SpatialModel`."""
    network = HingeNetwork(arm, damping=0.7 * arm.joint_count, velocity_decay=0.5)
    targets = np.tile(target, (len(starts), 1))
    within = np.clip(starts, *arm.limits.T)  # what is sensed may be noisy
    places = {int(joint): within[:, joint] for joint in np.flatnonzero(held)}
    near = tolerance, 1.0
    return network.solve(targets, start=starts, held=places, starts=1, tolerance=near).joint_angles


def least_squares(
    arm: HingeArm, target: Floats, starts: Floats, held: Bools, tolerance: float
) -> Floats:
    """Iterate damped least squares within the limits, at most 100 times: a `SpatialModel`."""
    damping = DAMPING_SHARE * np.linalg.norm(links_of(arm), axis=1).sum()
    for _ in range(100):
        _, axes, points, hand = arm.frames(starts)
        error = target - hand[:, :3, 3]
        if (np.linalg.norm(error, axis=-1) < tolerance).all():
            break
        lever = np.cross(axes, hand[:, None, :3, 3] - points)
        lever *= ~held[:, None]
        turns = damped_least_squares(np.swapaxes(lever, -1, -2), error, damping)
        starts = np.clip(starts + turns, *arm.limits.T)
    return starts
