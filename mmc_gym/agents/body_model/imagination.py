"""Imagination: in which posture to be at the target, found by an internal model before moving.

Several copies of the model start from different postures about the present one, and settle with
their hand at the target.  The posture that is nearest wins: the one whose joints turn least, where
it is the joint that has to turn farthest that counts.  A redundant arm has many postures for a
target, and a single model settles in the one that happens to be near in its own dynamics.  This is
planning by internal simulation, as MMC networks have been used before (Schilling and Cruse 2017).

Every joint that is locked is held, and so is one that would go beyond its limit.

The model is a `Solver`: the network, or damped least squares for comparison.  The network is the
paper's, with the learned normalizer and with velocities.  The velocity is a momentum, and with less
damping than the paper's (d just above (N + 1)/2, where the network still converges, and d_v = 2) it
settles in a third of the iterations: after 20 the median distance is 0.001 (kinematic network,
d = 2.5: 0.013).

Literature: M. Schilling, H. Cruse (2017), ReaCog, a minimal cognitive controller based on
recruitment of reactive systems, Front. Neurorobot. 11:3.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from mmc_gym.agents.base import every, some
from mmc_gym.agents.body_model.senses import Bools, Points
from mmc_gym.interface import ReachInterface
from mmc_gym.network import MMCNetwork
from mmc_gym.network.chain import Floats, wrap_angle
from mmc_gym.network.embodied import Embodiment, embodied_run

SPREAD = 1.0
"""How far the starts are from the present posture, radians."""
SETTLE = 30
"""Iterations in which the copies settle."""
FOLLOW = 6
"""Iterations in a control step by which the chosen one follows the target."""
NEAR = 0.002
"""A model whose hand is nearer to the target has settled, segment lengths."""
MARGIN = 1e-3
"""Distance that targets are kept from the borders of the reach, segment lengths."""
TOTAL = 0.05
"""What the turns of all joints count beside that of the joint that turns farthest."""
MISSED, ALLOWED = 20.0, 0.01
"""What a posture that misses the target by more than `ALLOWED` costs, radians per length."""

BEYOND = 1e-6
"""A joint that is farther than this beyond a limit is held at it, radians."""


class Arms(NamedTuple):
    """Arms that are to be brought to targets.

    Attributes:
        joint_angles: where they are, radians, (..., N).
        aim: where the hand is to be, (...).
        lengths: of the segments, (..., N).
        held: joints that keep their angles, (..., N); None: none.
    """

    joint_angles: Floats
    aim: Points
    lengths: Floats
    held: Bools | None

    def of(self, chosen: NDArray[Any]) -> Arms:
        """Return some of the arms, by a mask or by indices."""
        held = None if self.held is None else self.held[chosen]
        return Arms(self.joint_angles[chosen], self.aim[chosen], self.lengths[chosen], held)


class Solver(Protocol):
    """An internal model that finds postures with the hand at a target."""

    def __call__(self, arms: Arms, iterations: int) -> Floats:
        """Return the postures in which arms settle in some iterations, radians, (..., N)."""


@dataclass(frozen=True)
class NetworkSolver:
    """The MMC network as internal model."""

    network: MMCNetwork

    def __call__(self, arms: Arms, iterations: int) -> Floats:
        """Run networks that are at rest in these postures; see `Solver`.

        Of more than three segments they iterate more often, with the square of their number: it
        takes longer until all segments have heard of the target.
        """
        joint_angles, aim, lengths, held = arms
        iterations = max(iterations, round(iterations * (lengths.shape[-1] / 3) ** 2))
        units = np.exp(1j * np.cumsum(joint_angles, axis=-1))
        network = self.network
        # Single precision is that of the senses, and four times as quick.
        start = network.state_from_segments(_pairs(lengths * units))
        clamps = network.inverse(_pairs(aim))
        if held is None and every(lengths == network.segment_lengths):
            settled = network.run(start, clamps, iterations)
        else:
            body = Embodiment(lengths, locked=held, joint_angles=joint_angles)
            settled = embodied_run(network, start, clamps, body, iterations)
        angles = settled.joint_angles.astype(np.float64)
        return angles if held is None else np.where(held, joint_angles, angles)


def _pairs(points: Points) -> Floats:
    return np.stack([points.real, points.imag], axis=-1).astype(np.float32)


@dataclass(frozen=True)
class LeastSquaresSolver:
    """Damped least squares as internal model: Δq = Jᵀ(JJᵀ + λ²I)⁻¹e, the error shortened.

    Attributes:
        damping: λ, segment lengths.
        longest: the most that the error counts, segment lengths.
    """

    damping: float = 0.1
    longest: float = 0.5

    def __call__(self, arms: Arms, iterations: int) -> Floats:
        """Iterate half as often, for an iteration costs more than the network's; see `Solver`."""
        joint_angles, aim, lengths, held = arms
        for _ in range((iterations + 1) // 2):
            segments = lengths * np.exp(1j * np.cumsum(joint_angles, axis=-1))
            beyond = np.cumsum(segments[..., ::-1], axis=-1)[..., ::-1]
            error = aim - beyond[..., 0]
            error = error * np.minimum(1, self.longest / np.maximum(np.abs(error), 1e-9))
            moved = 1j * beyond if held is None else np.where(held, 0, 1j * beyond)  # J
            xx = (moved.real**2).sum(axis=-1) + self.damping**2
            yy = (moved.imag**2).sum(axis=-1) + self.damping**2
            xy = (moved.real * moved.imag).sum(axis=-1)
            pull_x = yy * error.real - xy * error.imag
            pull_y = xx * error.imag - xy * error.real
            pull = (pull_x - 1j * pull_y) / (xx * yy - xy * xy)
            joint_angles = joint_angles + (moved * pull[..., None]).real
        return wrap_angle(joint_angles)


class Imagination:
    """Finds postures with the hand at a target, from several starts or from the present one."""

    def __init__(self, interface: ReachInterface, solver: Solver, is_broad: bool) -> None:
        """Make the imagination of an arm; not `is_broad`: from the present posture alone."""
        self.interface, self.solver = interface, solver
        joints = len(interface.segment_lengths)
        self.offsets = start_offsets(joints) if is_broad else np.zeros((1, joints))

    def settle(self, arms: Arms, iterations: int) -> Floats:
        """Return postures within the joint limits that settle, (..., N); see `Solver`."""
        postures = self.solver(arms, iterations)
        if self.interface.joint_limits is None:
            return postures
        within = self.interface.within_limits(postures)
        is_beyond = np.abs(wrap_angle(postures - within)) > BEYOND
        if some(is_beyond):
            held = is_beyond if arms.held is None else arms.held | is_beyond
            within = self.solver(arms._replace(joint_angles=within, held=held), iterations)
        return self.interface.within_limits(within)

    def best(self, arms: Arms) -> tuple[Floats, Floats]:
        """Return the nearest of the imagined postures (n, N), and what each costs, (n,)."""
        postures, costs = self.all(arms)
        chosen, arm = costs.argmin(axis=0), np.arange(len(arms.aim))
        return postures[chosen, arm], costs[chosen, arm]

    def all(self, arms: Arms) -> tuple[Floats, Floats]:
        """Return all imagined postures (starts, n, N), and what each costs, (starts, n)."""
        starts = arms.joint_angles + self.offsets[:, None]
        held = arms.held
        if held is not None:
            starts = np.where(held, arms.joint_angles, starts)
            held = np.broadcast_to(held, starts.shape)
        aims = np.broadcast_to(arms.aim, starts.shape[:-1])
        postures = self.settle(Arms(starts, aims, arms.lengths, held), SETTLE)
        return postures, self.cost(arms, postures)

    def cost(self, arms: Arms, postures: Floats) -> Floats:
        """Return what it costs arms to turn to postures (..., n, N), radians, (..., n)."""
        turns = np.abs(self.interface.turn(arms.joint_angles, postures))
        missed = np.abs(hand(postures, arms.lengths) - arms.aim)
        cost: Floats = turns.max(axis=-1) + TOTAL * turns.sum(axis=-1)
        return cost + MISSED * np.maximum(missed - ALLOWED, 0.0)


def start_offsets(joints: int) -> Floats:
    """Return how the starts differ from the present posture, radians, (starts, N).

    Each of three parts of the arm is bent by −`SPREAD`, 0 or `SPREAD`; the first start is the
    present posture.
    """
    parts = np.array_split(np.arange(joints), min(joints, 3))
    offsets = np.zeros((3 ** len(parts), joints))
    for row, bends in zip(offsets, product((0.0, -SPREAD, SPREAD), repeat=len(parts)), strict=True):
        for part, bend in zip(parts, bends, strict=True):
            row[part] = bend / len(part)
    return offsets


def within_reach(aim: Points, lengths: Floats) -> Points:
    """Return the points nearest to these (...) that arms of these lengths (..., N) can reach."""
    distance, reach = np.abs(aim), lengths.sum(axis=-1)
    inner = np.maximum(2 * lengths.max(axis=-1) - reach, 0.0)
    allowed = np.minimum(np.maximum(distance, inner + MARGIN), reach - MARGIN)
    if every(allowed == distance):
        return aim
    direction = np.where(distance > 0, aim / np.maximum(distance, 1e-12), 1.0)
    near: Points = direction * allowed
    return near


def hand(joint_angles: Floats, lengths: Floats) -> Points:
    """Return where the hand is, (...), for joint angles and lengths (..., N)."""
    place: Points = (lengths * np.exp(1j * np.cumsum(joint_angles, axis=-1))).sum(axis=-1)
    return place
