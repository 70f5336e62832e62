"""Imagination: a posture with the hand at the target, from an internal model, before moving.

A redundant arm has many postures for a target.  Several copies of the model start from postures
around the present one, and settle with their hand at the target; joints that are locked, or would
turn beyond a limit, are held.  The nearest posture is chosen: the one whose joints turn least,
above all the joint that turns farthest.  MMC networks have been used for planning by internal
simulation before (Schilling & Cruse 2017, Front. Neurorobot. 11:3).

The internal model is the MMC network, or damped least squares for comparison.  The network is the
paper's, with the learned normalizer and with velocities.  A velocity acts as a momentum, and with
less damping than the paper's (d just above (N + 1)/2, where the network still converges, and
d_v = 2) the network settles in a third of the iterations: after 20 the median distance is 0.001
(kinematic network, d = 2.5: 0.013).
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mmc_gym.agents.base import all_true, any_true
from mmc_gym.agents.body_model.forward_model import (
    SAME,
    SMALL,
    Bools,
    Points,
    as_vectors,
    hand,
    pull_hand,
    to_hand,
    unit_vectors,
)
from mmc_gym.geometry import Floats, wrap_angle
from mmc_gym.interface import ReachInterface
from mmc_gym.network import MMCNetwork
from mmc_gym.network.embodied import Embodiment, embodied_run

SPREAD = 1.0  # distance of the starts from the present posture, radians
SETTLE = 30  # iterations in which the copies settle
FOLLOW = 6  # iterations per control step in which the chosen posture follows the target
MISS_COST = 20.0  # cost of what a posture misses the target by, radians per segment length
DAMPING = 0.1  # λ of damped least squares, segment lengths
LONGEST_ERROR = 0.5  # longest error that counts in damped least squares, segment lengths


class ReachProblem(NamedTuple):
    """Arms to be brought to targets."""

    joint_angles: Floats  # present posture, radians, (..., N)
    aim: Points  # where the hand should be, (...)
    lengths: Floats  # of the segments, (..., N)
    held: Bools | None  # joints that keep their angles, (..., N); None: none

    def of(self, arms: NDArray[Any]) -> ReachProblem:
        """Return the problem of some of the arms, chosen by a mask or by indices."""
        held = None if self.held is None else self.held[arms]
        return ReachProblem(self.joint_angles[arms], self.aim[arms], self.lengths[arms], held)


InternalModel: TypeAlias = Callable[[ReachProblem, int], Floats]
"""A function that returns the postures (..., N) after a number of iterations."""


def settle_network(network: MMCNetwork, problem: ReachProblem, iterations: int) -> Floats:
    """Run a network from rest in each posture: for a given network, an `InternalModel`.

    Beyond three segments the number of iterations grows with the square of the number of segments,
    because it takes longer until all segments are affected by the target.
    """
    joint_angles, aim, lengths, held = problem
    if held is not None:
        is_held = np.asarray(held.any(axis=-1))
        if not all_true(is_held):  # each arm moves as it does alone
            free = settle_network(network, problem.of(~is_held)._replace(held=None), iterations)
            angles = np.empty_like(joint_angles)
            angles[~is_held] = free
            if any_true(is_held):
                angles[is_held] = settle_network(network, problem.of(is_held), iterations)
            return angles
    iterations = max(iterations, round(iterations * (lengths.shape[-1] / 3) ** 2))
    # In single precision some processors round an arm's sums otherwise in another batch.
    start = network.state_from_segments(as_vectors(lengths * unit_vectors(joint_angles)))
    clamps = network.inverse(as_vectors(aim))
    if held is None and all_true(lengths == network.segment_lengths):
        settled = network.run(start, clamps, iterations)
    else:
        body = Embodiment(lengths, locked=held, joint_angles=joint_angles)
        settled = embodied_run(network, start, clamps, body, iterations)
    angles = settled.joint_angles
    return angles if held is None else np.where(held, joint_angles, angles)


def least_squares(problem: ReachProblem, iterations: int) -> Floats:
    """Iterate damped least squares: an `InternalModel`.

    Errors are shortened to `LONGEST_ERROR`.  There are half as many iterations as given, because
    one costs more than an iteration of the network.
    """
    joint_angles, aim, lengths, held = problem
    for _ in range((iterations + 1) // 2):
        levers = to_hand(joint_angles, lengths)
        error = aim - levers[..., 0]
        error = error * np.minimum(1, LONGEST_ERROR / np.maximum(np.abs(error), 1e-9))
        joint_angles = joint_angles + pull_hand(levers, error, DAMPING, held)
    return wrap_angle(joint_angles)


class Imagination:
    """The search for postures with the hand at a target."""

    def __init__(self, interface: ReachInterface, model: InternalModel, is_broad: bool) -> None:
        """Make the imagination of an arm, which starts from several postures if `is_broad`."""
        self.interface, self.model = interface, model
        joints = len(interface.segment_lengths)
        self.offsets = start_offsets(joints) if is_broad else np.zeros((1, joints))

    def settle(self, problem: ReachProblem, iterations: int) -> Floats:
        """Return the postures in which models settle within the joint limits, (..., N)."""
        postures = self.model(problem, iterations)
        within = self.interface.within_limits(postures)
        is_beyond = np.abs(wrap_angle(postures - within)) > SAME
        again = np.asarray(is_beyond.any(axis=-1))
        if any_true(again):
            held = is_beyond if problem.held is None else problem.held | is_beyond
            stopped = problem._replace(joint_angles=within, held=held).of(again)
            within = within.copy()
            within[again] = self.model(stopped, iterations)
        return self.interface.within_limits(within)

    def follow(self, goal: Floats, problem: ReachProblem) -> Floats:
        """Return the goal postures, improved where the hand misses the target, (n, N)."""
        if problem.held is not None:
            goal = np.where(problem.held, problem.joint_angles, goal)
        misses = np.abs(hand(goal, problem.lengths) - problem.aim) > SMALL
        if any_true(misses):
            moved = problem._replace(joint_angles=goal).of(misses)
            goal = goal.copy()
            goal[misses] = self.settle(moved, FOLLOW)
        return goal

    def improve(self, goal: Floats, problem: ReachProblem) -> Floats:
        """Return the goal postures, or the best imagined ones where these are better, (n, N)."""
        postures, costs = self.imagine(problem)
        cheapest = costs.argmin(axis=0), np.arange(len(goal))
        is_better = costs[cheapest] < self.cost(problem, goal)
        return np.where(is_better[:, None], postures[cheapest], goal)

    def imagine(self, problem: ReachProblem) -> tuple[Floats, Floats]:
        """Return all imagined postures (starts, n, N), and their costs, (starts, n)."""
        joint_angles, aim, lengths, held = problem
        starts = joint_angles + self.offsets[:, None]
        if held is not None:
            starts = np.where(held, joint_angles, starts)
            held = np.broadcast_to(held, starts.shape)
        lengths = np.broadcast_to(lengths, starts.shape)
        aims = np.broadcast_to(aim, starts.shape[:-1])
        postures = self.settle(ReachProblem(starts, aims, lengths, held), SETTLE)
        return postures, self.cost(problem, postures)

    def cost(self, problem: ReachProblem, postures: Floats) -> Floats:
        """Return the cost of turning to postures (..., n, N), radians, (..., n)."""
        turns = np.abs(self.interface.turn(problem.joint_angles, postures))
        missed = np.abs(hand(postures, problem.lengths) - problem.aim)
        cost: Floats = turns.max(axis=-1)
        if self.interface.has_drive:  # the effort counts, and not when the last joint arrives
            cost = np.sqrt((turns * turns).sum(axis=-1))
        return cost + MISS_COST * missed


def start_offsets(joints: int) -> Floats:
    """Return how the starts differ from the present posture, radians, (starts, N).

    Each third of the arm is bent by −`SPREAD`, 0 or `SPREAD`, in all combinations; the first start
    is the present posture.
    """
    parts = [len(part) for part in np.array_split(np.arange(joints), min(joints, 3))]
    bends = np.array(list(product((0.0, -SPREAD, SPREAD), repeat=len(parts))))
    return np.repeat(bends / parts, parts, axis=-1)


def within_reach(aim: Points, lengths: Floats) -> Points:
    """Return the points nearest to `aim` (...) that arms of these lengths (..., N) can reach."""
    distance, reach = np.abs(aim), lengths.sum(axis=-1)
    inner = np.maximum(2 * lengths.max(axis=-1) - reach, 0.0)
    allowed = np.minimum(np.maximum(distance, inner + SMALL), reach - SMALL)
    if all_true(allowed == distance):
        return aim
    direction = np.where(distance > 0, aim / np.maximum(distance, 1e-12), 1.0)
    return np.where(allowed == distance, aim, direction * allowed)
