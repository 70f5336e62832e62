"""Finding out about the body by watching it: delay, segment lengths, locked joints.

Each is a named tuple of arrays that lead with the batch, and is replaced by a new one with every
observation.

**The delay of the senses** is estimated, not told.  A joint that is asked to move is expected to
have turned by `MOVED` after some step a, and is seen to have after some step b; the delay is the
least b − a of all joints.  Before a joint is seen to move, the delay is at least the time since it
was expected to.  Each joint counts for itself, since one that is locked never moves.  The delay is
bridged by a model of the servos (Miall et al. 1993): the posture q of k control steps ago is taken
through the commands c that were sent since::

    q̂(t) = servo(… servo(servo(q(t−k), c(t−k)), c(t−k+1)) …, c(t−1))

**The segment lengths** follow from posture and hand: the hand is linear in them, x = Σ ℓ_i u(θ_i)
with the unit vectors u of the segment angles θ.  So recursive least squares, the Kalman filter of a
constant, finds them::

    K = P Uᵀ (U P Uᵀ + σ² I)⁻¹,     ℓ ← ℓ + K (x − U ℓ),     P ← P − K U P

with U = (u_1 … u_N), starting from the told lengths with the doubt `PRIOR`.  What the postures so
far do not tell stays as it was told, so little movement does little harm.  An observation counts
only if the arm has turned since the last one that did, for an arm at rest would repeat the same
error until it is believed.  The lengths are used only where they foretell the hand clearly better
than those told: noise alone, or a cursor that is turned, does not look like other lengths.

**A locked joint** is asked to turn, and stays where it is.  For each joint, the turns that the
servo model expects are summed up for as long as it stays.  Asked for enough, it is taken as locked;
seen elsewhere, it is free again.  Nothing counts before a joint of the arm is seen to move, for
`PATIENCE` control steps at most: senses that are late show an arm that does not move at all.  A
load or an obstacle that holds a joint for long looks the same.

Literature: R. C. Miall, D. J. Weir, D. M. Wolpert, J. F. Stein (1993), Is the cerebellum a Smith
predictor?, J. Motor Behavior 25, 203–216.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmc_gym.agents.base import where
from mmc_gym.agents.body_model.drive import command_of, commanded_turn
from mmc_gym.interface import ReachInterface
from mmc_gym.network.chain import Floats, wrap_angle

LONGEST_DELAY = 25
"""The longest delay that is bridged, control steps."""
MOVED = 0.1
"""A joint has moved if it has turned by this since the start, radians; noise turns it by less."""

PRIOR = 0.3
"""Standard deviation of the told lengths, as a fraction of them."""
NOISE = 0.02
"""σ: standard deviation with which hand and posture agree, segment lengths."""
TURN = 0.05
"""Least turn of a joint for an observation to count, radians."""
MEMORY = 0.7
"""Share of the mean square errors that an observation leaves as it is."""
BETTER = 0.25
"""Identified lengths are used while their mean square error is less than this share of the told."""
SHORTEST, LONGEST = 0.3, 2.0
"""And while all of them are within these factors of those told."""

ASKED = 0.8
"""Turn that must have been asked of a joint before it is taken as locked, radians."""
ASKED_IF_TOLD = 0.2
"""The same for a joint that the agent was told to be one that locks."""
STILL = 0.08
"""A joint within this of where it was is still, radians; noise seldom takes it out."""
AVERAGED = 0.3
"""Share by which the place of a joint that is still is averaged in a control step."""
PATIENCE = 25
"""For so many control steps an arm of which nothing moves may be one that is seen late."""


class Delay(NamedTuple):
    """The memory that tells the delay, and bridges it.

    Attributes:
        commands: those sent, see `command_of`, the latest last, radians,
            (..., LONGEST_DELAY + 1, N).
        start: posture of the first observation, radians, (..., N).
        waited: control steps since each joint should have moved, 0 if it need not yet, (..., N).
        late: how late each joint was, or is by now if it has not moved, (..., N).
        has_moved: 1 where a joint has been seen to move, (..., N).
    """

    commands: Floats
    start: Floats
    waited: Floats
    late: Floats
    has_moved: Floats

    @classmethod
    def unknown(cls, interface: ReachInterface, joint_angles: Floats) -> Delay:
        """Return the memory of arms that servos hold where they are, (..., N)."""
        hold = command_of(interface, joint_angles, joint_angles)
        held = np.repeat(hold[..., None, :], LONGEST_DELAY + 1, axis=-2)
        zero = np.zeros_like(joint_angles)
        return cls(held, joint_angles, zero, zero, zero)

    def sent(self, command: Floats) -> Delay:
        """Return the memory after the joints were sent these commands (..., N), radians."""
        latest = command[..., None, :]
        commands = np.concatenate([self.commands[..., 1:, :], latest], axis=-2)
        return self._replace(commands=commands)

    def observed(self, joint_angles: Floats, expected: Floats) -> Delay:
        """Return the memory after joints were seen; `expected`: where the servo model has them."""
        is_due = np.abs(wrap_angle(expected - self.start)) > MOVED
        moves = np.abs(wrap_angle(joint_angles - self.start)) > MOVED
        waited = np.where(is_due | (self.waited > 0), self.waited + 1, 0.0)
        late = np.where(self.has_moved > 0, self.late, np.maximum(waited - 1, 0.0))
        return self._replace(waited=waited, late=late, has_moved=np.maximum(self.has_moved, moves))

    @property
    def steps(self) -> NDArray[np.intp]:
        """The estimated delay, control steps, (...)."""
        late = np.where(self.waited > 0, self.late, np.inf).min(axis=-1)
        return np.clip(np.where(np.isfinite(late), late, 0.0), 0, LONGEST_DELAY).astype(np.intp)

    def command_before(self, steps: NDArray[np.intp]) -> Floats:
        """Return the commands (..., N) sent `steps` (...) control steps before the latest."""
        index = (LONGEST_DELAY - steps)[..., None, None]
        command: Floats = np.take_along_axis(self.commands, index, axis=-2)[..., 0, :]
        return command

    def run_forward(
        self, interface: ReachInterface, joint_angles: Floats, steps: NDArray[np.intp]
    ) -> Floats:
        """Return where joints should be now that were at these angles `steps` ago, (..., N)."""
        for back in range(int(steps.max(initial=0)), 0, -1):
            turn = commanded_turn(interface, joint_angles, self.commands[..., -back, :])
            joint_angles = joint_angles + np.where((back <= steps)[..., None], turn, 0.0)
        return joint_angles


class Lengths(NamedTuple):
    """Knowledge of the segment lengths.

    Attributes:
        mean: ℓ, segment lengths, (..., N).
        covariance: P, (..., N, N).
        last: posture of the last observation that counted, radians, (..., N); NaN: none did yet.
        told_error: mean square error of hands foretold with the told lengths, (...).
        error: the same of the identified lengths, (...).
    """

    mean: Floats
    covariance: Floats
    last: Floats
    told_error: Floats
    error: Floats

    @classmethod
    def told(cls, segment_lengths: tuple[float, ...], batch: tuple[int, ...]) -> Lengths:
        """Return the told lengths, for a batch of arms that have not been observed yet."""
        told = np.array(segment_lengths)
        return cls(
            np.broadcast_to(told, (*batch, told.size)).copy(),
            np.broadcast_to(np.diag((PRIOR * told) ** 2), (*batch, told.size, told.size)).copy(),
            np.full((*batch, told.size), np.nan),
            np.zeros(batch),
            np.zeros(batch),
        )

    def observed(self, joint_angles: Floats, hand: Floats, told: tuple[float, ...]) -> Lengths:
        """Return the knowledge after the hand was seen there, (..., 2), with this posture."""
        turn = np.abs(wrap_angle(joint_angles - self.last)).max(axis=-1)
        counts = ~(turn <= TURN)  # NaN: the first one does
        angles = np.cumsum(joint_angles, axis=-1)
        units = np.stack([np.cos(angles), np.sin(angles)], axis=-2)  # U, (..., 2, N)
        transposed = np.swapaxes(units, -1, -2)

        error = hand - _product(units, self.mean)
        shares = units @ self.covariance  # U P
        solved = np.linalg.solve(shares @ transposed + NOISE**2 * np.eye(2), shares)
        gain = np.swapaxes(solved, -1, -2)
        covariance = self.covariance - gain @ shares
        new = Lengths(
            self.mean + _product(gain, error),
            (covariance + np.swapaxes(covariance, -1, -2)) / 2,
            joint_angles,
            _averaged(self.told_error, hand - units @ np.array(told)),
            _averaged(self.error, error),
        )
        return where(counts, new, self)

    def best(self, told: tuple[float, ...]) -> Floats:
        """Return the lengths to go by, (..., N): identified where they are better, else told."""
        ratio = self.mean / np.array(told)
        is_plausible = ((ratio > SHORTEST) & (ratio < LONGEST)).all(axis=-1)
        is_better = self.error < BETTER * self.told_error
        return np.where((is_plausible & is_better)[..., None], self.mean, np.array(told))


def _averaged(mean: Floats, error: Floats) -> Floats:
    """Return a mean square with one more error (..., 2) in it."""
    average: Floats = MEMORY * mean + (1 - MEMORY) * (error * error).sum(axis=-1)
    return average


def _product(matrix: Floats, vector: Floats) -> Floats:
    product: Floats = (matrix @ vector[..., None])[..., 0]
    return product


class Locks(NamedTuple):
    """Knowledge of locked joints, (..., N).

    Attributes:
        anchor: where each joint was when it last had moved, radians.
        place: where it has been since, averaged, radians.
        asked: the turns that were asked of it there in all, radians.
        last: the posture last seen, radians.
        watched: control steps for which the arm was seen; `PATIENCE` once any joint moved.
        is_locked: 1 where a joint is taken as locked, at its `place`.
    """

    anchor: Floats
    place: Floats
    asked: Floats
    last: Floats
    watched: Floats
    is_locked: Floats

    @classmethod
    def none(cls, joint_angles: Floats) -> Locks:
        """Return that all joints are free, and none was seen to move."""
        zero = np.zeros_like(joint_angles)
        return cls(joint_angles, joint_angles, zero, joint_angles, zero, zero)

    def observed(
        self, joint_angles: Floats, expected: Floats, lockable: tuple[int, ...] = ()
    ) -> Locks:
        """Return the knowledge after joints were seen at these angles.

        Args:
            joint_angles: radians, (..., N).
            expected: by how much the servo model has them turned, radians, (..., N).
            lockable: the only joints that can lock, where that was told.
        """
        enough = np.full(joint_angles.shape[-1], np.inf if lockable else ASKED)
        enough[list(lockable)] = ASKED_IF_TOLD
        was_locked = self.is_locked > 0
        away = wrap_angle(joint_angles - np.where(was_locked, self.place, self.anchor))
        is_still = np.abs(away) < STILL
        any_moved = ~is_still.all(axis=-1, keepdims=True)
        watched = np.where(any_moved, PATIENCE, np.minimum(self.watched + 1, PATIENCE))
        asked = np.where(is_still & (watched >= PATIENCE), self.asked + expected, 0.0)
        is_locked = is_still & (was_locked | (np.abs(asked) > enough))
        average = self.place + AVERAGED * wrap_angle(joint_angles - self.place)
        return Locks(
            np.where(is_still, self.anchor, joint_angles),
            np.where(is_still, average, joint_angles),
            asked,
            joint_angles,
            watched,
            is_locked.astype(float),
        )
