"""The workspace of an arm: where its hand can be, and drawing postures and targets from there."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache, reduce
from itertools import pairwise
from operator import add
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from mmc_gym._errors import UserError
from mmc_gym.geometry import Floats, node_positions, reachable_radii, segments_from_joint_angles

if TYPE_CHECKING:
    from mmc_gym.body import ArmParameters

Point = tuple[float, float]

# A target within 1e-9 reaches of the border counts as reachable: rounding puts them there.
REACH_TOLERANCE = 1e-9
_CELLS = 60  # grid cells across the reach, where joint limits shape the reachable set
_MOST_POSTURES, MOST_TARGETS = 10_000, 100


class NoTarget(UserError):
    """No target was found; there may be one for another posture."""


class ShownHand(Protocol):
    """A cursor that stands for the hand, see `mmc_gym.envs.cursor.Cursor`."""

    @property
    def turns_about_base(self) -> bool:
        """Whether it is as far from the base as the hand."""

    def at(self, x: Any, y: Any, target: tuple[Any, Any]) -> tuple[Any, Any]:
        """Return where the cursor is for a hand at (x, y)."""

    def hand(self, x: Any, y: Any) -> tuple[Any, Any]:
        """Return where the hand is for a cursor at (x, y)."""


class Workspace:
    """The points that the hand of one arm can reach.

    The joints in `locked` cannot move: the segments on both sides of each form one rigid piece, and
    the reachable points depend on the posture.
    """

    inner: float  #: smallest distance of a reachable point from the base, with all joints free
    outer: float  #: largest distance, likewise

    def __init__(
        self,
        body: ArmParameters,
        given_body: ArmParameters | None = None,
        locked: Sequence[int] = (),
        cursor: ShownHand | None = None,
        at_all_times: ShownHand | None = None,
    ) -> None:
        """Make the workspace of `body`, in which the joints `locked` (indices) never move.

        Targets are also in reach of `given_body`, the arm that agents are given (by default
        `body`).  A `cursor` must reach targets in place of the hand.  If the cursor changes within
        an episode, `at_all_times` is that cursor, with arrays over times as its numbers.

        Raises:
            UserError: if no point is in reach of both arms.
        """
        self.body, self.given_body = body, given_body or body
        self.locked, self.cursor, self._at_all_times = tuple(locked), cursor, at_all_times
        self.inner, self.outer = shared_ring(self.body, self.given_body)
        if self.inner > self.outer * (1 + REACH_TOLERANCE):
            raise self._no_target()
        limits = body.joint_limits
        self._limits = limits or ((-math.pi, math.pi),) * len(body.segment_lengths)
        self._hands = limits and not locked and reachable_hands(body.segment_lengths, limits)

    def contains(self, point: Sequence[float], posture: Sequence[float] | None = None) -> bool:
        """Return whether the hand, or the cursor in its place, can be at `point` (x, y).

        Joint limits are left aside.  Locked joints keep their angles in `posture`, N joint angles;
        None ignores locks.
        """
        x, y = point
        if self._at_all_times is not None:
            hands = np.broadcast_arrays(*self._at_all_times.hand(x, y))
            return all(self._can_be((x, y), hand, posture) for hand in zip(*map(np.ravel, hands)))
        hand = (x, y) if self.cursor is None else self.cursor.hand(x, y)
        return self._can_be((x, y), hand, posture)

    def _can_be(self, point: Point, hand: Point, posture: Sequence[float] | None) -> bool:
        """Return whether the hand can be at `hand`, and the cursor that shows it at `point`.

        Both must be within reach and clear of obstacles.  With a posture, the hand must be within
        reach of the joints that turn, while the locked ones keep their angles.
        """
        radius = self.body.segment_radius
        is_free = all(math.dist(hand, disc[:2]) > disc[2] + radius for disc in self.body.obstacles)
        is_inside = is_free and self._is_in_ring(point) and self._is_in_ring(hand)
        if not is_inside or posture is None or not self.locked:
            return is_inside
        base, lengths = self._rigid_pieces(posture)
        inner, outer = reachable_radii(lengths) if lengths else (0.0, 0.0)
        slack = REACH_TOLERANCE * self.outer
        return inner - slack <= math.dist(base, hand) <= outer + slack

    def nearest(self, point: Sequence[float]) -> Point:
        """Return the nearest point to `point` (x, y) between `inner` and `outer`."""
        x, y = point
        distance = math.hypot(x, y)
        if self.inner <= distance <= self.outer:
            return x, y
        radius = self.inner if distance < self.inner else self.outer
        angle = math.atan2(y, x)  # defined at the base too, and no division by a tiny distance
        return radius * math.cos(angle), radius * math.sin(angle)

    def draw_posture(self, random: np.random.Generator) -> list[float]:
        """Draw joint angles, uniform on the circle or within their limits, clear of obstacles."""
        for _ in range(_MOST_POSTURES):
            posture = [random.uniform(low, high) for low, high in self._limits]
            if self.is_clear(posture):
                return posture
        raise UserError(f"obstacles must leave room for the arm, got {self.body.obstacles}")

    def draw_target(self, random: np.random.Generator, posture: Sequence[float]) -> Point:
        """Draw a target that the hand can reach from `posture`, clear of obstacles.

        Targets are area-uniform over the reachable set; with joint limits, up to the size of a grid
        cell.  With locked joints and joint limits, they are where the hand is in random postures,
        uniform in the free angles.  `NoTarget` is raised if none is found.
        """
        for _ in range(MOST_TARGETS):
            target = hand = self._draw_hand(random, posture)
            if self.cursor is not None:
                target = self.cursor.at(*hand, hand)
            if self.contains(target, posture if self._at_all_times else None):
                return target
        raise self._no_target()

    def _no_target(self) -> NoTarget:
        body, given_body = self.body, self.given_body
        return NoTarget(
            "perturbations must leave targets in reach, got segment_lengths "
            f"{body.segment_lengths}, given as {given_body.segment_lengths}, locked joints "
            f"{self.locked}, joint_limits {body.joint_limits}, obstacles {body.obstacles} and "
            f"cursor {self.cursor}"
        )

    @property
    def is_ring(self) -> bool:
        """Whether all postures are possible, and hands are drawn between two radii."""
        body, cursors = self.body, self._at_all_times
        is_free = cursors is None or (cursors.turns_about_base and not self.locked)
        return is_free and not body.joint_limits and not body.obstacles

    def _draw_hand(self, random: np.random.Generator, posture: Sequence[float]) -> Point:
        if self._hands:
            cell = self._hands[random.integers(len(self._hands))]
            x, y = cell[random.integers(len(cell))]
            return float(x), float(y)
        if not self.locked:
            return _draw_from_ring(self.inner, self.outer, random)
        if self.body.joint_limits:
            angles = [
                posture[joint] if joint in self.locked else random.uniform(low, high)
                for joint, (low, high) in enumerate(self._limits)
            ]
            return self._nodes(angles)[-1]
        base, lengths = self._rigid_pieces(posture)
        if not lengths:
            return base
        x, y = _draw_from_ring(*reachable_radii(lengths), random)
        return base[0] + x, base[1] + y

    def is_clear(self, posture: Sequence[float]) -> bool:
        """Return whether the arm in this posture (N joint angles) is clear of all obstacles."""
        if not self.body.obstacles:
            return True
        rods = list(pairwise(complex(x, y) for x, y in self._nodes(posture)))
        radius = self.body.segment_radius
        return all(
            _distance_to_rod(complex(x, y), start, end) > disc + radius
            for x, y, disc in self.body.obstacles
            for start, end in rods
        )

    def posture_at(self, point: Sequence[float]) -> list[float]:
        """Return the evenly bent posture (N joint angles) with the hand at `point` (x, y).

        All joints but the first have the same angle, 0 (stretched) or more, counter-clockwise.

        Raises:
            UserError: if there is no such posture, or none within the joint limits.
        """
        lengths = self.body.segment_lengths
        bend = _even_bend(lengths, math.hypot(*point))
        if bend is None:
            raise UserError(f"no evenly bent posture has the hand at {tuple(point)}")
        x, y = _bent_hand(lengths, bend)
        base = math.remainder(math.atan2(point[1], point[0]) - math.atan2(y, x), math.tau)
        posture = [base] + [bend] * (len(lengths) - 1)
        if any(not low <= angle <= high for angle, (low, high) in zip(posture, self._limits)):
            raise UserError(
                f"the evenly bent posture with the hand at {tuple(point)}, {posture}, is beyond "
                f"the joint limits {self.body.joint_limits}"
            )
        return posture

    def _nodes(self, posture: Sequence[float]) -> list[Point]:
        segments = segments_from_joint_angles(np.array(posture), self.body.segment_lengths)
        return [(float(x), float(y)) for x, y in node_positions(segments)]

    def _rigid_pieces(self, posture: Sequence[float]) -> tuple[Point, list[float]]:
        """Return the first free joint, and the lengths of the rigid pieces beyond it."""
        return _pieces_of(self._nodes(posture), self.locked)

    def _is_in_ring(self, point: Point) -> bool:
        slack = REACH_TOLERANCE * self.outer
        return self.inner - slack <= math.hypot(*point) <= self.outer + slack


def uniform_numbers(randoms: Sequence[np.random.Generator], count: int) -> NDArray[np.float64]:
    """Return `count` numbers, uniform in [0, 1), from each of k generators, (k, count)."""
    numbers = np.empty((len(randoms), count))
    for random, row in zip(randoms, numbers, strict=True):
        random.random(out=row)
    return numbers


def places_from(
    uniform: Floats, ring: tuple[Any, Any], lengths: Floats, locked: NDArray[np.bool_] | None
) -> tuple[Floats, Floats]:
    """Return postures, (k, N), from uniform numbers, (k, N), and places of the hands, (k, 6).

    A place is a centre (x, y), two radii about it between which the hand can be, and the two radii
    of the ring about the base.  `ring` has numbers or (k,), `lengths` of segments are (N,) or
    (k, N), and `locked` marks joints locked from the start, (k, N); None if there are none.
    """
    postures = -math.pi + math.tau * uniform
    places = np.zeros((len(postures), 6))
    places[:, 2:4] = places[:, 4:] = np.transpose(np.broadcast_arrays(*ring))
    if locked is not None:
        nodes = node_positions(segments_from_joint_angles(postures, lengths)).tolist()
        for row in np.flatnonzero(locked.any(axis=-1)).tolist():
            base, pieces = _pieces_of(nodes[row], np.flatnonzero(locked[row]).tolist())
            places[row, :4] = (*base, *reachable_radii(pieces)) if pieces else np.nan
    return postures, places


def targets_from(
    uniform: Floats, places: Floats, cursor: ShownHand | None
) -> tuple[Floats, NDArray[np.bool_]]:
    """Return targets, (k, 2), from uniform numbers, (k, 2), and whether each is in reach, (k,).

    Hands are area-uniform in `places`, see `places_from`; targets are at the hands or cursors.
    """
    base, inner, outer = places[:, :2].T, places[:, 4], places[:, 5]
    hands: Any = base + _points_from(uniform, places[:, 2], places[:, 3])
    targets: Any = hands
    is_reached, slack = np.ones(len(places), dtype=bool), REACH_TOLERANCE * outer
    if cursor is not None:
        x, y = hands
        targets = cursor.at(x, y, (x, y))
        hands = cursor.hand(*targets)
    # A locked joint may let the hand reach beyond the ring, which the given arm narrows.
    is_within = not base.any() and (places[:, 2] >= inner).all() and (places[:, 3] <= outer).all()
    for x, y in () if cursor is None and is_within else (targets, hands):
        # Not numpy's root, which may differ in the last bit.
        radii = np.array([*map(math.hypot, x.tolist(), y.tolist())])
        is_reached &= (inner - slack <= radii) & (radii <= outer + slack)
    return np.stack(targets, axis=-1), is_reached


def _pieces_of(nodes: Sequence[Any], locked: Sequence[int]) -> tuple[Any, list[float]]:
    """Return the place of the first free joint, and the lengths of the rigid pieces beyond it."""
    ends = [node for joint, node in enumerate(nodes) if joint not in locked]
    return ends[0], [math.dist(start, end) for start, end in pairwise(ends)]


def _points_from(uniform: Floats, inner: Any, outer: Any) -> tuple[Floats, Floats]:
    """Return area-uniform points between two radii, x and y (k,), from uniform numbers (k, 2)."""
    inner_square = inner * inner
    radii = np.sqrt(inner_square + (outer * outer - inner_square) * uniform[:, 0])
    angles = (-math.pi + math.tau * uniform[:, 1]).tolist()
    # Not numpy's cosine, which may differ in the last bit.
    return radii * [*map(math.cos, angles)], radii * [*map(math.sin, angles)]


def rings(lengths: Sequence[Any], given_lengths: Sequence[float]) -> tuple[Any, Any]:
    """Return `shared_ring` of arms of `lengths`, numbers or (k,), and of one of `given` lengths."""
    reach, longest = reduce(add, lengths), reduce(np.maximum, lengths)
    inner, outer = reachable_radii(given_lengths)
    return np.maximum(np.maximum(0.0, 2 * longest - reach), inner), np.minimum(reach, outer)


def shared_ring(*arms: ArmParameters) -> tuple[float, float]:
    """Return the smallest and the largest distance from the base that all these arms reach."""
    inner, outer = zip(*(reachable_radii(arm.segment_lengths) for arm in arms))
    return max(inner), min(outer)


def distances(hands: Floats, targets: Floats) -> Floats:
    """Return the distances (...) from hands (..., 2) to targets (..., 2)."""
    offset = targets - hands
    x, y = offset[..., 0], offset[..., 1]
    return np.asarray(np.sqrt(x * x + y * y))[()]


@lru_cache(maxsize=8)  # a vector of environments asks once for each
def reachable_hands(
    segment_lengths: tuple[float, ...], joint_limits: tuple[tuple[float, float], ...]
) -> list[Floats]:
    """Return hand positions of an arm with joint limits, an array (n, 2) per cell of a square grid.

    Drawing a cell, and then a position from it, is area-uniform up to the size of a cell.
    """
    random = np.random.default_rng(0)
    low, high = np.array(joint_limits).T
    angles = random.uniform(low, high, size=(100_000, len(low)))
    hands = segments_from_joint_angles(angles, segment_lengths).sum(axis=-2)
    reach = reachable_radii(segment_lengths)[1]
    columns, rows = ((hands / reach + 1) / 2 * _CELLS).astype(int).T
    cells = rows * (_CELLS + 1) + columns
    order = np.argsort(cells, kind="stable")
    borders = np.flatnonzero(np.diff(cells[order])) + 1
    return np.split(hands[order], borders)


@lru_cache(maxsize=64)  # tasks start from the same few points
def _even_bend(segment_lengths: tuple[float, ...], distance: float) -> float | None:
    """Return the least bend (see `_bent_hand`) that puts the hand at this distance, or None."""
    from scipy.optimize import brentq  # not with the registration of the environments

    if math.isclose(distance, sum(segment_lengths), rel_tol=REACH_TOLERANCE):
        return 0.0

    def beyond(angle: float) -> float:
        return math.hypot(*_bent_hand(segment_lengths, angle)) - distance

    # The hand comes nearer to the base as the arm bends; by 2π/N equal segments are a ring.
    angles = np.linspace(0.0, math.tau / max(len(segment_lengths), 2), 200).tolist()
    nearer = next((i for i, angle in enumerate(angles) if beyond(angle) <= 0), 0)
    return float(brentq(beyond, angles[nearer - 1], angles[nearer])) if nearer else None


def _bent_hand(segment_lengths: Sequence[float], bend: float) -> Point:
    """Return the hand of an arm whose first joint angle is 0 and whose others are `bend`."""
    x = sum(length * math.cos(joint * bend) for joint, length in enumerate(segment_lengths))
    y = sum(length * math.sin(joint * bend) for joint, length in enumerate(segment_lengths))
    return x, y


def _draw_from_ring(inner: float, outer: float, random: np.random.Generator) -> Point:
    """Draw a point area-uniformly between two distances from the base."""
    radius = math.sqrt(random.uniform(inner * inner, outer * outer))
    angle = random.uniform(-math.pi, math.pi)
    return radius * math.cos(angle), radius * math.sin(angle)


def _distance_to_rod(point: complex, start: complex, end: complex) -> float:
    along, offset = end - start, point - start
    share = (offset * along.conjugate()).real / (along * along.conjugate()).real
    return abs(offset - min(max(share, 0.0), 1.0) * along)
